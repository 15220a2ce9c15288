//! From merged clusters to device nodes in depth-first order.

use super::cost::AreaSums;
use super::leaf_table::LeafTable;
use super::node::{instance_leaf, with_box_around};
use crate::accel::build::agglomerative::{self, ClusterKind, Member, MergeRecord, MortonOrder};
use crate::device::layout::{NONE, Node, PrimitiveRange};

/// Subtrees of fewer leaves are flattened by one thread.
const TASK_MINIMUM: u32 = 1 << 11;

/// What was merged into what.
pub(super) struct ClusterTree {
    order: MortonOrder,
    links: Vec<MergedCluster>,
    root: Option<Member>,
}

/// A merged cluster.
#[derive(Clone, Copy, bytemuck::Zeroable)]
struct MergedCluster {
    /// The places of single boxes; numbers of links with [`MERGED_BIT`] set.
    children: [u32; 2],
    leaf_count: u32,
}

/// Numbers are below 2^29.
const MERGED_BIT: u32 = 1 << 31;

impl MergeRecord for MergedCluster {
    fn new(children: [Member; 2], links: &[Self], first: usize) -> Self {
        let leaves = |child: &Member| match child.kind {
            ClusterKind::Single(_) => 1,
            ClusterKind::Merged(link) => links[link - first].leaf_count,
        };
        let leaf_count = children.iter().map(leaves).sum();
        Self { children: children.map(MergedCluster::number), leaf_count }
    }
}

impl MergedCluster {
    fn number(cluster: Member) -> u32 {
        match cluster.kind {
            ClusterKind::Single(place) => place as u32,
            ClusterKind::Merged(link) => link as u32 | MERGED_BIT,
        }
    }
}

impl ClusterTree {
    /// Of boxes in their order.
    pub(super) fn new(order: MortonOrder) -> Self {
        let mut links = bytemuck::zeroed_vec(order.len());
        let root = agglomerative::build(&order, &mut links);
        Self { order, links, root }
    }

    pub(super) fn leaf_count(&self) -> usize {
        self.order.len()
    }

    fn merged(&self, number: u32) -> Option<&MergedCluster> {
        (number & MERGED_BIT != 0).then(|| &self.links[(number & !MERGED_BIT) as usize])
    }

    fn leaf_count_below(&self, number: u32) -> u32 {
        self.merged(number).map_or(1, |link| link.leaf_count)
    }
}

/// How many nodes `tree` gives with `room` unused leaves beside it.
pub(super) fn node_count(tree: &ClusterTree, room: usize) -> usize {
    (2 * tree.leaf_count()).saturating_sub(1) + 2 * room
}

/// Writes nodes and their parents, and puts the instances in leaves. Unused leaves come first, in a subtree of their own: the
/// last node is always in use.
pub(super) fn flatten(
    tree: &ClusterTree,
    room: usize,
    nodes: &mut [Node],
    parents: &mut [u32],
    leaves: &mut LeafTable,
) -> AreaSums {
    let Some(root) = tree.root.map(MergedCluster::number) else { return AreaSums::default() };
    let emitter = NodeWriter { tree, leaves };
    if room == 0 {
        let mut areas = emitter.emit(root, NodeLinks::ROOT, nodes, parents);
        if nodes.len() == 1 {
            areas.add_node(&nodes[0]);
        }
        return areas;
    }
    let [unused, used] = NodeLinks::ROOT.children(2 * room as u32 - 1);
    let mut areas = emitter.emit(root, used, &mut nodes[used.index as usize..], &mut parents[used.index as usize..]);
    areas.add_node(&nodes[used.index as usize]);
    (nodes[0], parents[0]) = (Node { escape_index: NONE, ..nodes[used.index as usize] }, NONE);
    nodes[0].primitives = PrimitiveRange::INNER;
    let mut free = Vec::with_capacity(room);
    write_unused_subtree(room as u32, unused, nodes, parents, &mut free);
    leaves.set_free(free);
    areas
}

/// Where a subtree goes.
#[derive(Clone, Copy)]
struct NodeLinks {
    index: u32,
    parent: u32,
    escape_index: u32,
}

impl NodeLinks {
    const ROOT: Self = Self { index: 0, parent: NONE, escape_index: NONE };

    /// Where the children go, if the first has so many nodes.
    fn children(self, first_nodes: u32) -> [Self; 2] {
        let (first, second) = (self.index + 1, self.index + 1 + first_nodes);
        [
            Self { index: first, parent: self.index, escape_index: second },
            Self { index: second, parent: self.index, escape_index: self.escape_index },
        ]
    }
}

/// What the threads share.
struct NodeWriter<'a> {
    tree: &'a ClusterTree,
    leaves: &'a LeafTable,
}

impl NodeWriter<'_> {
    /// Writes a subtree to the start of `nodes` and `parents`. Returns the areas of what is below its root. Recursion is as deep
    /// as the tree.
    fn emit(&self, cluster: u32, place: NodeLinks, nodes: &mut [Node], parents: &mut [u32]) -> AreaSums {
        parents[0] = place.parent;
        let Some(link) = self.tree.merged(cluster) else {
            let single = &self.tree.order.leaf_clusters()[cluster as usize];
            let (slot, bounds) = (single.box_index(), single.bounds());
            self.leaves.assign(slot, place.index);
            nodes[0] = instance_leaf(slot, &bounds, place.escape_index);
            return AreaSums::default();
        };
        let first_nodes = 2 * self.tree.leaf_count_below(link.children[0]) - 1;
        let [first, second] = place.children(first_nodes);
        let (root, below) = nodes.split_at_mut(1);
        let (first_slots, second_slots) = below.split_at_mut(first_nodes as usize);
        let (first_parents, second_parents) = parents[1..].split_at_mut(first_nodes as usize);
        let mut emit_first = || self.emit(link.children[0], first, first_slots, first_parents);
        let mut emit_second = || self.emit(link.children[1], second, second_slots, second_parents);
        let (mut areas, second_areas) = if link.leaf_count >= TASK_MINIMUM {
            rayon::join(emit_first, emit_second)
        } else {
            (emit_first(), emit_second())
        };
        areas.add(second_areas);
        areas.add_node(&first_slots[0]);
        areas.add_node(&second_slots[0]);
        root[0].escape_index = place.escape_index;
        root[0].primitives = PrimitiveRange::INNER;
        root[0] = with_box_around(&root[0], &first_slots[0], &second_slots[0]);
        areas
    }
}

/// Writes a balanced subtree of unused leaves into the whole arrays and lists the leaves.
fn write_unused_subtree(count: u32, place: NodeLinks, nodes: &mut [Node], parents: &mut [u32], free: &mut Vec<u32>) {
    nodes[place.index as usize] = Node::unused_leaf(place.escape_index);
    parents[place.index as usize] = place.parent;
    if count == 1 {
        free.push(place.index);
        return;
    }
    let half = count.div_ceil(2);
    let [first, second] = place.children(2 * half - 1);
    write_unused_subtree(half, first, nodes, parents, free);
    write_unused_subtree(count - half, second, nodes, parents, free);
}
