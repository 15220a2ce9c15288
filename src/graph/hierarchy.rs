//! The hot path of the graph: all nodes in preorder, with their world transforms, masks and visibilities.

use std::ops::Range;

use glam::DAffine3;
use slotmap::{SecondaryMap, SlotMap};

use super::core::CoreSlot;
use super::node::Node;
use super::{Core, CoreKey, NodeKey};

/// All nodes of a scene in preorder: a node's subtree is the range from its index to [`subtree_end`](Self::subtree_end).
///
/// Indices change with the structure of the scene; keys do not. It is rebuilt after structural edits; else only the ranges of changed
/// subtrees are recomputed. About 250 bytes a node.
#[derive(Debug, Default)]
pub struct Hierarchy {
    nodes: Vec<NodeKey>,
    parents: Vec<u32>,
    subtree_ends: Vec<u32>,
    own: Vec<Own>,
    worlds: Vec<DAffine3>,
    masks: Vec<u32>,
    visible: Vec<bool>,
    indices: SecondaryMap<NodeKey, u32>,
}

/// What a node contributes to itself and to all below it.
#[derive(Clone, Copy, Debug)]
struct Own {
    local: DAffine3,
    mask: u32,
    visible: bool,
    has_transform: bool,
}

impl Hierarchy {
    /// The parent of the root: no index.
    pub const NO_PARENT: u32 = u32::MAX;

    /// The nodes in preorder, the root first.
    pub fn nodes(&self) -> &[NodeKey] {
        &self.nodes
    }

    /// The index of each node's parent; [`NO_PARENT`](Self::NO_PARENT) for the root.
    pub fn parents(&self) -> &[u32] {
        &self.parents
    }

    /// One past the index of the last node below each node.
    pub fn subtree_ends(&self) -> &[u32] {
        &self.subtree_ends
    }

    /// `world_from_local` of each node: its own transform applied, if it has one. Not finite where the product overflows.
    pub fn worlds(&self) -> &[DAffine3] {
        &self.worlds
    }

    /// The mask of each node: its own AND those of all above it.
    pub fn masks(&self) -> &[u32] {
        &self.masks
    }

    /// Whether each node and all above it are visible.
    pub fn visible(&self) -> &[bool] {
        &self.visible
    }

    /// The index of a node; `None` if it is not in the scene. O(1).
    pub fn index(&self, node: NodeKey) -> Option<usize> {
        let index = *self.indices.get(node)? as usize;
        (self.nodes.get(index) == Some(&node)).then_some(index)
    }

    /// The range of a node and all below it. O(1).
    ///
    /// # Panics
    /// If there is no node at the index.
    pub fn subtree(&self, index: usize) -> Range<usize> {
        index..self.subtree_ends[index] as usize
    }

    /// The subtrees at these indices, without those that lie inside others, in preorder. Sorts the indices.
    pub fn outermost_subtrees(&self, indices: &mut [u32]) -> impl Iterator<Item = Range<usize>> {
        indices.sort_unstable();
        let mut end = 0;
        indices.iter().filter_map(move |&index| {
            let subtree = self.subtree(index as usize);
            (subtree.start >= end).then(|| {
                end = subtree.end;
                subtree
            })
        })
    }
}

/// Edits that the hierarchy does not show yet.
#[derive(Debug)]
pub(super) struct Stale {
    structure: bool,
    /// Nodes whose own mask, visibility or core changed; each once, by the flag in the node.
    nodes: Vec<NodeKey>,
    /// Cores whose transform changed; each once, by the flag in the core.
    cores: Vec<CoreKey>,
}

impl Stale {
    /// Nothing is known yet.
    pub(super) fn structure() -> Self {
        Self { structure: true, nodes: Vec::new(), cores: Vec::new() }
    }

    pub(super) fn is_empty(&self) -> bool {
        !self.structure && self.nodes.is_empty() && self.cores.is_empty()
    }

    pub(super) fn mark_structure(&mut self) {
        self.structure = true;
    }

    pub(super) fn mark_node(&mut self, key: NodeKey, nodes: &mut SlotMap<NodeKey, Node>) {
        if !self.structure && !std::mem::replace(&mut nodes[key].stale, true) {
            self.nodes.push(key);
        }
    }

    pub(super) fn mark_core(&mut self, key: CoreKey, cores: &mut SlotMap<CoreKey, CoreSlot>) {
        if !self.structure && !std::mem::replace(&mut cores[key].stale, true) {
            self.cores.push(key);
        }
    }
}

impl Hierarchy {
    /// Catches up with the edits in `stale`, and empties it.
    pub(super) fn update(
        &mut self,
        root: NodeKey,
        nodes: &mut SlotMap<NodeKey, Node>,
        cores: &mut SlotMap<CoreKey, CoreSlot>,
        stale: &mut Stale,
    ) {
        if stale.is_empty() {
            return;
        }
        // 1. Find the nodes concerned; those that are gone come with a structural change.
        let mut dirty = Vec::with_capacity(stale.nodes.len() + stale.cores.len());
        for key in stale.nodes.drain(..) {
            if let Some(node) = nodes.get_mut(key) {
                node.stale = false;
                dirty.push(key);
            }
        }
        for key in stale.cores.drain(..) {
            if let Some(core) = cores.get_mut(key) {
                core.stale = false;
                let first = core.first_user;
                dirty.extend(std::iter::successors(first, |&user| nodes[user].next_user));
            }
        }
        // 2. Recompute their subtrees, or all.
        if std::mem::take(&mut stale.structure) {
            self.rebuild(root, nodes, cores);
        } else {
            self.recompute(&dirty, nodes, cores);
        }
    }

    fn recompute(&mut self, dirty: &[NodeKey], nodes: &SlotMap<NodeKey, Node>, cores: &SlotMap<CoreKey, CoreSlot>) {
        let mut indices = Vec::with_capacity(dirty.len());
        for &key in dirty {
            let index = self.indices[key];
            self.own[index as usize] = own(&nodes[key], cores);
            indices.push(index);
        }
        let ranges: Vec<_> = self.outermost_subtrees(&mut indices).collect();
        for range in ranges {
            self.propagate(range);
        }
    }

    fn rebuild(&mut self, root: NodeKey, nodes: &SlotMap<NodeKey, Node>, cores: &SlotMap<CoreKey, CoreSlot>) {
        self.clear(nodes.len());
        let (mut current, mut parent) = (root, Self::NO_PARENT);
        'down: loop {
            let index = self.push(current, parent, own(&nodes[current], cores));
            if let Some(child) = nodes[current].first_child {
                (current, parent) = (child, index);
                continue;
            }
            // Go up to the next sibling, closing the subtrees that end here.
            let mut closed = index;
            while closed != Self::NO_PARENT {
                self.subtree_ends[closed as usize] = self.nodes.len() as u32;
                parent = self.parents[closed as usize];
                if let Some(sibling) = nodes[self.nodes[closed as usize]].next_sibling {
                    current = sibling;
                    continue 'down;
                }
                closed = parent;
            }
            break;
        }
        self.worlds.resize(self.nodes.len(), DAffine3::IDENTITY);
        self.masks.resize(self.nodes.len(), 0);
        self.visible.resize(self.nodes.len(), false);
        self.propagate(0..self.nodes.len());
    }

    fn clear(&mut self, capacity: usize) {
        self.nodes.clear();
        self.parents.clear();
        self.subtree_ends.clear();
        self.own.clear();
        self.nodes.reserve(capacity);
        self.parents.reserve(capacity);
        self.subtree_ends.reserve(capacity);
        self.own.reserve(capacity);
    }

    fn push(&mut self, node: NodeKey, parent: u32, own: Own) -> u32 {
        let index = self.nodes.len() as u32;
        self.nodes.push(node);
        self.parents.push(parent);
        self.subtree_ends.push(index + 1);
        self.own.push(own);
        self.indices.insert(node, index);
        index
    }

    /// Computes worlds, masks and visibilities of a range from those of the parents, which are right or lie in the range.
    fn propagate(&mut self, range: Range<usize>) {
        for index in range {
            let own = &self.own[index];
            let (world, mask, visible) = match self.parents[index] {
                Self::NO_PARENT => (DAffine3::IDENTITY, u32::MAX, true),
                parent => {
                    let parent = parent as usize;
                    (self.worlds[parent], self.masks[parent], self.visible[parent])
                }
            };
            self.worlds[index] = if own.has_transform { world * own.local } else { world };
            self.masks[index] = mask & own.mask;
            self.visible[index] = visible && own.visible;
        }
    }
}

fn own(node: &Node, cores: &SlotMap<CoreKey, CoreSlot>) -> Own {
    let (local, has_transform) = match &cores[node.core].core {
        Core::Transform(transform) => (transform.to_affine(), true),
        _ => (DAffine3::IDENTITY, false),
    };
    Own { local, mask: node.mask, visible: node.visible, has_transform }
}
