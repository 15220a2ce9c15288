//! The hot path of the graph: all nodes in preorder, with their world transforms, masks and visibilities.

use std::ops::Range;

use super::bit_set::BitSet;
use super::core::CoreSlot;
use super::key_map::KeyMap;
use super::node::Node;
use super::store::Store;
use super::{Core, CoreKey, NodeKey};
use glam::DAffine3;

/// All nodes of a scene in preorder: a node's subtree is a range of indices that
/// begins with the node's own.
///
/// Indices change with the structure of the scene; keys do not. It is rebuilt after structural edits; else only the
/// ranges of changed subtrees are recomputed. About 250 bytes a node.
#[derive(Debug)]
pub struct Hierarchy {
    nodes: Vec<NodeKey>,
    parents: Vec<u32>,
    subtree_ends: Vec<u32>,
    own: Vec<Own>,
    worlds: Vec<DAffine3>,
    masks: Vec<u32>,
    visible: Vec<bool>,
    indices: KeyMap<NodeKey, u32>,
    state: State,
}

/// What has to be done to catch up with the scene.
#[derive(Debug)]
enum State {
    /// Build everything.
    OutOfDate,
    /// Recompute the subtrees at these indices, whose `own` is right already.
    Built(BitSet),
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

    /// `world_from_local` of each node: its own transform applied, if it has one. Not finite where the product
    /// overflows.
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

/// Catching up with the scene.
impl Hierarchy {
    /// Knows nothing yet.
    pub(super) fn new() -> Self {
        Self {
            nodes: Vec::new(),
            parents: Vec::new(),
            subtree_ends: Vec::new(),
            own: Vec::new(),
            worlds: Vec::new(),
            masks: Vec::new(),
            visible: Vec::new(),
            indices: KeyMap::new(),
            state: State::OutOfDate,
        }
    }

    /// Whether it shows the scene as it is.
    pub(super) fn is_up_to_date(&self) -> bool {
        matches!(&self.state, State::Built(dirty) if dirty.is_empty())
    }

    /// Nodes came, went or moved to other parents. O(1).
    pub(super) fn structure_changed(&mut self) {
        self.state = State::OutOfDate;
    }

    /// The node's own transform, mask or visibility changed. O(1).
    pub(super) fn node_changed(&mut self, key: NodeKey, node: &Node, core: &Core) {
        if let State::Built(dirty) = &mut self.state {
            let index = self.indices[key] as usize;
            self.own[index] = Own::new(node, core);
            dirty.insert(index);
        }
    }

    /// Shows all edits made so far.
    pub(super) fn update(&mut self, root: NodeKey, nodes: &Store<NodeKey, Node>, cores: &Store<CoreKey, CoreSlot>) {
        match std::mem::replace(&mut self.state, State::OutOfDate) {
            State::OutOfDate => {
                self.rebuild(root, nodes, cores);
                self.state = State::Built(BitSet::new(self.nodes.len()));
            }
            State::Built(mut dirty) => {
                let mut end = 0;
                dirty.drain(|index| {
                    if index >= end {
                        end = self.subtree_ends[index] as usize;
                        self.propagate(index..end);
                    }
                });
                self.state = State::Built(dirty);
            }
        }
    }

    /// The first node that the two show differently, to the last bit of its world transform.
    pub(super) fn first_difference(&self, other: &Self) -> Option<NodeKey> {
        let bits = |world: &DAffine3| world.to_cols_array().map(f64::to_bits);
        let same = |i: usize| {
            i < self.nodes.len()
                && self.nodes.get(i) == other.nodes.get(i)
                && self.parents[i] == other.parents[i]
                && self.subtree_ends[i] == other.subtree_ends[i]
                && bits(&self.worlds[i]) == bits(&other.worlds[i])
                && self.masks[i] == other.masks[i]
                && self.visible[i] == other.visible[i]
                && self.index(self.nodes[i]) == Some(i)
        };
        let longer = if self.nodes.len() < other.nodes.len() { other } else { self };
        (0..longer.nodes.len()).find(|&i| !same(i)).map(|i| longer.nodes[i])
    }

    fn rebuild(&mut self, root: NodeKey, nodes: &Store<NodeKey, Node>, cores: &Store<CoreKey, CoreSlot>) {
        self.clear(nodes.len());
        let (mut current, mut parent) = (root, Self::NO_PARENT);
        'down: loop {
            let node = &nodes[current];
            let index = self.push(current, parent, Own::new(node, &cores[node.core].core));
            if let Some(child) = node.first_child {
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
        self.indices.set_capacity(capacity);
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

    /// Computes worlds, masks and visibilities of a range from those of the parents, which are right or lie in the
    /// range.
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

impl Own {
    fn new(node: &Node, core: &Core) -> Self {
        let (local, has_transform) = match core {
            Core::Transform(transform) => (transform.to_affine(), true),
            _ => (DAffine3::IDENTITY, false),
        };
        Self { local, mask: node.mask, visible: node.visible, has_transform }
    }
}
