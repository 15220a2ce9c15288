//! The hot path of the graph: all nodes in arrays, with what they inherit from those above them.
//!
//! An *entry* is one appearance of a node: most nodes have one, a node below the target of [`Core::Instance`] has one
//! more for each instance of it. Entries stand in preorder, so that a subtree is a range. After structural edits only
//! the changed part is touched: what was removed leaves *gaps*, what was added is a *graft*, a range of its own at the
//! end of the arrays, which refers to its parent before it. When a quarter of the arrays is gaps and grafts, they are
//! built anew in preorder; so an edit costs what it changes, amortised.
//!
//! `entries` plants and removes, `propagate` computes what is inherited, `subtree_bounds` the world boxes of subtrees.

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

/// All nodes of a scene, flattened: a node's subtree is a range of indices that begins with the node's own, and the
/// ranges of what was added below it since.
///
/// Indices of entries stay as they are until [`generation`](Self::generation) changes; keys do not change at all.
/// 256 bytes an entry, measured.
#[derive(Debug, Default)]
pub struct Hierarchy {
    nodes: Vec<NodeKey>,
    parents: Vec<u32>,
    subtree_ends: Vec<u32>,
    properties: Vec<EntryProperties>,
    placed: Vec<ResolvedEntry>,
    /// One entry of each node: where it stands itself, if it does.
    first_entries: SecondaryMap<NodeKey, u32>,
    /// The others, of nodes that are instanced.
    instanced_entries: HashMap<NodeKey, BTreeSet<u32>>,
    /// The starts of the grafts below each entry that has some; dead ones start with a gap.
    appended_subtrees: BTreeMap<u32, Vec<u32>>,
    /// Entries in grafts.
    appended_count: usize,
    gaps: Vec<u32>,
    generation: u64,
    pending: PendingUpdates,
    subtree_bounds: Option<SubtreeBounds>,
}

/// An entry in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResolvedEntry {
    /// `world_from_local`: the node's own transform applied, if it has one. Not finite where the product overflows.
    pub world_from_local: DAffine3,
    /// The material of the outermost material group at or above it.
    pub material: Option<MaterialKey>,
    /// Its own mask AND those of all above it.
    pub mask: u32,
    /// Whether it and all above it are visible and chosen by their switches. (Levels of detail depend on the view.)
    pub visible: bool,
}

/// Which appearance of a node: the instances through which it is seen, and the node.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct NodePath {
    /// The nodes with [`Core::Instance`] on the way from the root, outermost first; empty where the node itself stands.
    pub instances: Vec<NodeKey>,
    /// The node.
    pub node: NodeKey,
}

/// What an entry contributes to itself and to all below it.
#[derive(Clone, Copy, Debug)]
struct EntryProperties {
    local: DAffine3,
    material: Option<MaterialKey>,
    mask: u32,
    visible: bool,
    has_transform: bool,
    /// Whether the switch above it, if there is one, shows it.
    selected: bool,
    /// Whether it is there because the entry above it instances its node.
    is_instance_root: bool,
    /// Whether it or something above it is instanced.
    is_in_instance: bool,
}

/// What has to be done to catch up with the scene.
#[derive(Debug, Default)]
struct PendingUpdates {
    is_built: bool,
    /// Nodes that came or moved to other parents.
    reattached: Vec<NodeKey>,
    /// Nodes whose core is or was an instance of another node.
    instances: BTreeSet<NodeKey>,
    /// Nodes whose children may be chosen otherwise.
    switches: BTreeSet<NodeKey>,
    /// Entries whose `own` is right already.
    dirty: BitSet,
}

/// The objects of the scene that a hierarchy shows.
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
    /// The parent of the root: no index.
    pub const NO_PARENT: u32 = u32::MAX;

    /// Entries with what is instanced cannot be more than the nodes and this many: 4 GB.
    pub const MAX_INSTANCED: usize = 1 << 24;

    /// Changes when indices of entries are no longer what they were.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// The node of each entry; a null key for a gap.
    pub fn nodes(&self) -> &[NodeKey] {
        &self.nodes
    }

    /// Whether the entry was removed. A gap is not visible, and what else is said of it means nothing.
    ///
    /// # Panics
    /// If there is no entry at the index.
    pub fn is_removed(&self, entry: usize) -> bool {
        self.nodes[entry].is_null()
    }

    /// The index of the parent of each entry; [`NO_PARENT`](Self::NO_PARENT) for the root. Lower than the entry's own.
    pub fn parents(&self) -> &[u32] {
        &self.parents
    }

    /// Where each entry is.
    pub fn resolved(&self) -> &[ResolvedEntry] {
        &self.placed
    }

    /// The entries that became gaps, oldest first, since the [`generation`](Self::generation) began.
    pub fn removed_entries(&self) -> &[u32] {
        &self.gaps
    }

    /// Where the node itself stands, not through an instance; `None` if it is not in the scene. O(1).
    pub fn entry(&self, node: NodeKey) -> Option<usize> {
        let entry = *self.first_entries.get(node)? as usize;
        (!self.properties[entry].is_in_instance).then_some(entry)
    }

    /// All entries of a node, in no particular order; none if it is not in the scene.
    pub fn entries(&self, node: NodeKey) -> impl Iterator<Item = usize> + Clone {
        let more = self.instanced_entries.get(&node).into_iter().flatten();
        self.first_entries.get(node).into_iter().chain(more).map(|&entry| entry as usize)
    }

    /// Whether the entry is there because its parent instances its node.
    ///
    /// # Panics
    /// If there is no entry at the index.
    pub fn is_instance_root(&self, entry: usize) -> bool {
        self.properties[entry].is_instance_root
    }

    /// The world transform that the entry's own is applied to.
    ///
    /// # Panics
    /// If there is no entry at the index.
    pub fn world_from_parent(&self, entry: usize) -> DAffine3 {
        match self.parents[entry] {
            Self::NO_PARENT => DAffine3::IDENTITY,
            parent => self.placed[parent as usize].world_from_local,
        }
    }

    /// Which appearance of its node the entry is. O(depth).
    ///
    /// # Panics
    /// If there is no entry at the index.
    pub fn path(&self, entry: usize) -> NodePath {
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

    /// The entries whose parent is this one, in no particular order. O(them and the gaps between them).
    ///
    /// # Panics
    /// If there is no entry at the index.
    pub fn children(&self, entry: usize) -> impl Iterator<Item = usize> {
        let end = self.subtree_ends[entry] as usize;
        let within =
            std::iter::successors(Some(entry + 1), |&child| self.subtree_ends.get(child).map(|&end| end as usize));
        let within = within.take_while(move |&child| child < end).filter(|&child| !self.is_removed(child));
        within.chain(self.appended_below(entry..entry + 1))
    }

    /// The ranges of an entry and all below it, the entry's own first. Gaps may be among them.
    ///
    /// # Panics
    /// If there is no entry at the index.
    pub fn subtree(&self, entry: usize) -> Vec<Range<usize>> {
        let own = entry..self.subtree_ends[entry] as usize;
        let mut ranges = Vec::from([own]);
        let mut next = 0;
        while let Some(range) = ranges.get(next).cloned() {
            ranges.extend(self.appended_below(range).map(|start| start..self.subtree_ends[start] as usize));
            next += 1;
        }
        ranges
    }

    /// The ranges of these entries and all below them, sorted and disjoint. O(n log n) of the entries given and the
    /// grafts below them.
    pub fn subtrees(&self, entries: impl IntoIterator<Item = usize>) -> Vec<Range<usize>> {
        let mut entries: Vec<usize> = entries.into_iter().collect();
        entries.par_sort_unstable();
        self.subtrees_from(entries)
    }

    /// The same for entries in ascending order. Ranges that touch are one, unless the second is a graft.
    fn subtrees_from(&self, entries: impl IntoIterator<Item = usize>) -> Vec<Range<usize>> {
        let mut entries = entries.into_iter().peekable();
        // Grafts lie behind what they are grafted to.
        let mut grafts: BTreeSet<usize> = BTreeSet::new();
        let mut ranges: Vec<Range<usize>> = Vec::new();
        while let Some(start) = match (grafts.first(), entries.peek()) {
            (Some(graft), Some(entry)) if graft <= entry => grafts.pop_first(),
            (Some(_), None) => grafts.pop_first(),
            _ => entries.next(),
        } {
            let range = start..self.subtree_ends[start] as usize;
            match ranges.last_mut() {
                Some(last) if start < last.end => continue,
                Some(last) if start == last.end && (self.appended_subtrees.is_empty() || !self.is_appended(start)) => {
                    last.end = range.end;
                }
                _ => ranges.push(range.clone()),
            }
            if !self.appended_subtrees.is_empty() {
                grafts.extend(self.appended_below(range));
            }
        }
        ranges
    }

    /// Whether the entry stands apart from its parent's range.
    fn is_appended(&self, entry: usize) -> bool {
        self.subtree_ends.get(self.parents[entry] as usize).is_some_and(|&end| end as usize <= entry)
    }

    /// The starts of the grafts that are attached to entries in a range.
    fn appended_below(&self, range: Range<usize>) -> impl Iterator<Item = usize> {
        let grafts = self.appended_subtrees.range(range.start as u32..range.end as u32).flat_map(|(_, starts)| starts);
        grafts.map(|&start| start as usize).filter(|&start| !self.nodes[start].is_null())
    }

    /// Whether it shows the scene as it is.
    pub(super) fn is_up_to_date(&self) -> bool {
        let pending = &self.pending;
        pending.is_built
            && pending.dirty.is_empty()
            && pending.reattached.is_empty()
            && pending.instances.is_empty()
            && pending.switches.is_empty()
    }

    /// Checks the arrays against each other, and against those that would be built now.
    pub(super) fn validate(&self, tree: SceneStores<'_>) -> Result<()> {
        let mut fresh = Self::default();
        fresh.update(tree)?;
        let mut entries: HashMap<NodePath, usize> = HashMap::new();
        for entry in (0..self.nodes.len()).filter(|&entry| !self.nodes[entry].is_null()) {
            let node = self.nodes[entry];
            let is_first = entries.insert(self.path(entry), entry).is_none();
            require_invariant(is_first, node, "it appears twice in one place")?;
            require_invariant(self.entries(node).any(|e| e == entry), node, "the hierarchy does not find it")?;
            let parent = self.parents[entry];
            if parent != Self::NO_PARENT {
                let parent = parent as usize;
                let inside = (parent + 1..self.subtree_ends[parent] as usize).contains(&entry);
                let grafted = self.appended_below(parent..parent + 1).any(|graft| graft == entry);
                require_invariant(
                    parent < entry && (inside || grafted),
                    node,
                    "the hierarchy has it outside its parent",
                )?;
            }
        }
        let bits = |placed: &ResolvedEntry| placed.world_from_local.to_cols_array().map(f64::to_bits);
        for (index, placed) in fresh.placed.iter().enumerate() {
            let path = fresh.path(index);
            let same = entries.remove(&path).is_some_and(|entry| {
                let (own, world) = (self.placed[entry], DAffine3::IDENTITY);
                bits(&own) == bits(placed)
                    && ResolvedEntry { world_from_local: world, ..own }
                        == ResolvedEntry { world_from_local: world, ..*placed }
            });
            require_invariant(same, path.node, "the hierarchy shows it otherwise than it is")?;
        }
        entries
            .keys()
            .next()
            .map_or(Ok(()), |path| require_invariant(false, path.node, "the hierarchy shows what is not there"))
    }
}
