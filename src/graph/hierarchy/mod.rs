//! The flattened hierarchy: all occurrences of nodes in arrays, with inherited world matrix, mask, visibility and
//! material. This is the per-frame hot path of the graph.
//!
//! An *entry* is one occurrence of a node: most nodes have one; a node at or below the target of [`Core::Instance`] has
//! one more per instance. Entries are stored in preorder, so a subtree is a contiguous range. An edit touches only what
//! it changes: removed entries stay in the arrays, marked removed; an added subtree is appended at the end as a range
//! of its own whose first entry refers to its parent. When removed and appended entries exceed 1024 plus a quarter of
//! the arrays, or as many nodes were added or reparented since the last update, all arrays are rebuilt in preorder; so
//! edits cost O(entries changed), amortised.
//!
//! `entries` adds and removes entries, `propagate` computes inherited values top down, `subtree_bounds` the world
//! bounds of subtrees.

mod entries;
mod propagate;
mod subtree_bounds;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;

use glam::DAffine3;
use rayon::prelude::*;
use slotmap::{Key, SecondaryMap};

use self::subtree_bounds::SubtreeBounds;
use super::assets::{StoredGeometry, UseCounted};
use super::bit_set::BitSet;
use super::core::CoreSlot;
use super::node::Node;
use super::store::Store;
use super::{Core, CoreKey, GeometryKey, MaterialKey, NodeKey};
use crate::Result;
use crate::error::require_invariant;

/// All nodes of a scene, flattened: the subtree of an entry is a range of indices that begins with the entry, and the
/// ranges that were appended below it since.
///
/// Entry indices are stable until [`generation`](Self::generation) changes; node keys are always stable. 256 bytes per
/// entry, measured.
#[derive(Debug, Default)]
pub struct Hierarchy {
    nodes: Vec<NodeKey>,
    parents: Vec<u32>,
    subtree_ends: Vec<u32>,
    properties: Vec<EntryProperties>,
    resolved: Vec<ResolvedEntry>,
    /// For each node its own entry (not inside an instance) if it has one, else one of its instanced entries.
    first_entries: SecondaryMap<NodeKey, u32>,
    /// All further entries of nodes that occur in instances.
    instanced_entries: HashMap<NodeKey, BTreeSet<u32>>,
    /// Start indices of the ranges appended below each entry; a range whose first entry is removed is unused.
    appended_subtrees: BTreeMap<u32, Vec<u32>>,
    /// Number of entries in appended ranges.
    appended_count: usize,
    /// Removed entries, oldest first.
    removed: Vec<u32>,
    generation: u64,
    pending: PendingUpdates,
    subtree_bounds: Option<SubtreeBounds>,
}

/// The values of an entry after inheritance from its ancestors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResolvedEntry {
    /// World matrix, including the node's own transform. Contains non-finite numbers if the product of transforms
    /// overflows f64.
    pub world_from_local: DAffine3,
    /// The material of the outermost material group at or above the entry.
    pub material: Option<MaterialKey>,
    /// The AND of the ray masks from the root to the entry.
    pub mask: u32,
    /// Whether the entry and all above it are visible and selected by their switches. Level-of-detail selection is not
    /// included: it depends on the viewpoint.
    pub visible: bool,
}

/// Identifies one occurrence of a node: the chain of instance nodes that lead to it, and the node.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct NodePath {
    /// The nodes with [`Core::Instance`] on the path from the root, outermost first; empty for the node's own entry.
    pub instances: Vec<NodeKey>,
    /// The node.
    pub node: NodeKey,
}

/// The entry's own values, before inheritance.
#[derive(Clone, Copy, Debug)]
struct EntryProperties {
    local: DAffine3,
    material: Option<MaterialKey>,
    mask: u32,
    visible: bool,
    has_transform: bool,
    /// Whether its parent, if that is a switch, selects it.
    selected: bool,
    /// Whether it is the root of an instanced subtree: its parent entry's core is an instance of its node.
    is_instance_root: bool,
    /// Whether it lies in an instanced subtree.
    is_in_instance: bool,
}

/// Changes that the next [`update`](Hierarchy::update) must apply.
#[derive(Debug, Default)]
struct PendingUpdates {
    /// Whether the arrays were built; until then, changes need not be recorded.
    is_built: bool,
    /// Nodes that were added or reparented.
    reattached: Vec<NodeKey>,
    /// Nodes whose core is or was an instance of another node.
    instances: BTreeSet<NodeKey>,
    /// Switch nodes whose selection may have changed.
    switches: BTreeSet<NodeKey>,
    /// Entries whose own values are up to date but whose inherited values must be recomputed.
    dirty: BitSet,
}

/// The objects of the scene that a hierarchy is built from.
#[derive(Clone, Copy)]
pub(super) struct SceneStores<'a> {
    pub(super) root: NodeKey,
    pub(super) nodes: &'a Store<NodeKey, Node>,
    pub(super) cores: &'a Store<CoreKey, CoreSlot>,
    pub(super) geometries: &'a Store<GeometryKey, UseCounted<StoredGeometry>>,
    /// Whether any core is an instance.
    pub(super) has_instances: bool,
}

impl<'a> SceneStores<'a> {
    fn core(self, node: NodeKey) -> &'a Core {
        &self.cores[self.nodes[node].core].core
    }
}

/// Reading.
impl Hierarchy {
    /// The parent index of the root entry.
    pub const NO_PARENT: u32 = u32::MAX;

    /// Upper bound on entries beyond one per node: 2^24, about 4 GB.
    pub const MAX_INSTANCED: usize = 1 << 24;

    /// Changes when the arrays are rebuilt, which changes the indices of entries.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// The node of each entry; a null key for a removed entry.
    pub fn nodes(&self) -> &[NodeKey] {
        &self.nodes
    }

    /// Whether the entry was removed. A removed entry is never visible; its other values are unspecified.
    ///
    /// # Panics
    /// If there is no entry at the index.
    pub fn is_removed(&self, entry: usize) -> bool {
        self.nodes[entry].is_null()
    }

    /// The index of the parent of each entry; [`NO_PARENT`](Self::NO_PARENT) for the root. A parent index is always
    /// lower than its entry's.
    pub fn parents(&self) -> &[u32] {
        &self.parents
    }

    /// The values of each entry after inheritance.
    pub fn resolved(&self) -> &[ResolvedEntry] {
        &self.resolved
    }

    /// Entries removed in the current [`generation`](Self::generation), oldest first.
    pub fn removed_entries(&self) -> &[u32] {
        &self.removed
    }

    /// The entry of the node itself (not of an instance of it); `None` if the node is not in the scene. O(1).
    pub fn entry(&self, node: NodeKey) -> Option<usize> {
        let entry = *self.first_entries.get(node)? as usize;
        (!self.properties[entry].is_in_instance).then_some(entry)
    }

    /// All entries of a node, in no particular order; none if it is not in the scene.
    pub fn entries(&self, node: NodeKey) -> impl Iterator<Item = usize> + Clone {
        let more = self.instanced_entries.get(&node).into_iter().flatten();
        self.first_entries.get(node).into_iter().chain(more).map(|&entry| entry as usize)
    }

    /// Whether the entry is the root of an instanced subtree: its parent entry's core is an instance of its node.
    ///
    /// # Panics
    /// If there is no entry at the index.
    pub fn is_instance_root(&self, entry: usize) -> bool {
        self.properties[entry].is_instance_root
    }

    /// World matrix of the parent entry; the identity for the root.
    ///
    /// # Panics
    /// If there is no entry at the index.
    pub fn world_from_parent(&self, entry: usize) -> DAffine3 {
        match self.parents[entry] {
            Self::NO_PARENT => DAffine3::IDENTITY,
            parent => self.resolved[parent as usize].world_from_local,
        }
    }

    /// Which occurrence of its node the entry is. O(depth).
    ///
    /// # Panics
    /// If there is no entry at the index.
    pub fn path(&self, entry: usize) -> NodePath {
        // Ascend until the entry is outside all instances, and collect the instance nodes on the way.
        let mut instances = Vec::new();
        let mut above = entry;
        while self.properties[above].is_in_instance {
            let parent = self.parents[above] as usize;
            if self.properties[above].is_instance_root {
                instances.push(self.nodes[parent]);
            }
            above = parent;
        }
        instances.reverse();
        NodePath { instances, node: self.nodes[entry] }
    }

    /// The entries whose parent is this one, in no particular order. O(children + removed entries between them).
    ///
    /// # Panics
    /// If there is no entry at the index.
    pub fn children(&self, entry: usize) -> impl Iterator<Item = usize> {
        // In the entry's own range, each child begins where the subtree of the one before ends.
        let end = self.subtree_ends[entry] as usize;
        let within =
            std::iter::successors(Some(entry + 1), |&child| self.subtree_ends.get(child).map(|&end| end as usize));
        let within = within.take_while(move |&child| child < end).filter(|&child| !self.is_removed(child));
        // The others were appended.
        within.chain(self.appended_below(entry..entry + 1))
    }

    /// The ranges of an entry and all below it, the entry's own first. They may contain removed entries.
    ///
    /// # Panics
    /// If there is no entry at the index.
    pub fn subtree(&self, entry: usize) -> Vec<Range<usize>> {
        // Breadth-first: append the ranges found below each range in the list.
        let own = entry..self.subtree_ends[entry] as usize;
        let mut ranges = Vec::from([own]);
        let mut next = 0;
        while let Some(range) = ranges.get(next).cloned() {
            ranges.extend(self.appended_below(range).map(|start| start..self.subtree_ends[start] as usize));
            next += 1;
        }
        ranges
    }

    /// The ranges of these entries and all below them, ascending and disjoint. O(n log n) of the entries given and the
    /// ranges appended below them.
    pub fn subtrees(&self, entries: impl IntoIterator<Item = usize>) -> Vec<Range<usize>> {
        let mut entries: Vec<usize> = entries.into_iter().collect();
        entries.par_sort_unstable();
        self.subtrees_from(entries)
    }

    /// As [`subtrees`](Self::subtrees) for ascending entries. Adjacent ranges are merged, unless the second was
    /// appended.
    fn subtrees_from(&self, entries: impl IntoIterator<Item = usize>) -> Vec<Range<usize>> {
        let mut entries = entries.into_iter().peekable();
        // Merges two ascending sequences: the entries given, and the appended ranges found below those taken so far. An
        // appended range always has higher indices than its parent.
        let mut appended: BTreeSet<usize> = BTreeSet::new();
        let mut ranges: Vec<Range<usize>> = Vec::new();
        while let Some(start) = match (appended.first(), entries.peek()) {
            (Some(start), Some(entry)) if start <= entry => appended.pop_first(),
            (Some(_), None) => appended.pop_first(),
            _ => entries.next(),
        } {
            let range = start..self.subtree_ends[start] as usize;
            match ranges.last_mut() {
                // It lies in a range that was taken, and so does all below it.
                Some(last) if start < last.end => continue,
                Some(last) if start == last.end && (self.appended_subtrees.is_empty() || !self.is_appended(start)) => {
                    last.end = range.end;
                }
                _ => ranges.push(range.clone()),
            }
            if !self.appended_subtrees.is_empty() {
                appended.extend(self.appended_below(range));
            }
        }
        ranges
    }

    /// Whether the entry lies outside the range of its parent.
    fn is_appended(&self, entry: usize) -> bool {
        self.subtree_ends.get(self.parents[entry] as usize).is_some_and(|&end| end as usize <= entry)
    }

    /// The starts of the ranges appended below the entries of a range.
    fn appended_below(&self, range: Range<usize>) -> impl Iterator<Item = usize> {
        let starts = self.appended_subtrees.range(range.start as u32..range.end as u32).flat_map(|(_, starts)| starts);
        starts.map(|&start| start as usize).filter(|&start| !self.nodes[start].is_null())
    }

    /// Whether all changes were applied.
    pub(super) fn is_up_to_date(&self) -> bool {
        let pending = &self.pending;
        pending.is_built
            && pending.dirty.is_empty()
            && pending.reattached.is_empty()
            && pending.instances.is_empty()
            && pending.switches.is_empty()
    }

    /// Checks the arrays for consistency, and compares every entry bit for bit with a hierarchy built from scratch.
    pub(super) fn validate(&self, tree: SceneStores<'_>) -> Result<()> {
        // 1. Build a second hierarchy from scratch.
        let mut fresh = Self::default();
        fresh.update(tree)?;
        // 2. Check each entry: its occurrence is unique, its node finds it, and it lies in its parent's subtree.
        let mut entries: HashMap<NodePath, usize> = HashMap::new();
        for entry in (0..self.nodes.len()).filter(|&entry| !self.nodes[entry].is_null()) {
            let node = self.nodes[entry];
            let is_first = entries.insert(self.path(entry), entry).is_none();
            require_invariant(is_first, node, "it has two entries for one occurrence")?;
            require_invariant(self.entries(node).any(|e| e == entry), node, "the hierarchy does not find it")?;
            let parent = self.parents[entry];
            if parent != Self::NO_PARENT {
                let parent = parent as usize;
                let is_inside = (parent + 1..self.subtree_ends[parent] as usize).contains(&entry);
                let is_appended = self.appended_below(parent..parent + 1).any(|start| start == entry);
                require_invariant(
                    parent < entry && (is_inside || is_appended),
                    node,
                    "the hierarchy has it outside its parent",
                )?;
            }
        }
        // 3. Compare the resolved values by occurrence, since indices differ; the matrices as bits, so that equal NaN
        //    agree.
        let bits = |resolved: &ResolvedEntry| resolved.world_from_local.to_cols_array().map(f64::to_bits);
        for (index, resolved) in fresh.resolved.iter().enumerate() {
            let path = fresh.path(index);
            let same = entries.remove(&path).is_some_and(|entry| {
                let (own, world) = (self.resolved[entry], DAffine3::IDENTITY);
                bits(&own) == bits(resolved)
                    && ResolvedEntry { world_from_local: world, ..own }
                        == ResolvedEntry { world_from_local: world, ..*resolved }
            });
            require_invariant(same, path.node, "its entry differs from one built from scratch")?;
        }
        // 4. No entry may be left over.
        entries.keys().next().map_or(Ok(()), |path| {
            require_invariant(false, path.node, "it has an entry that one built from scratch has not")
        })
    }
}
