//! Writes a clustered tree as top-level device nodes in depth-first order with escape indices.

use super::cost::AreaSums;
use super::leaf_table::LeafTable;
use super::node::{instance_leaf, with_box_around};
use crate::Cancel;
use crate::accel::build::agglomerative::{self, ChildCluster, ClusterKind, MergeRecord, MortonOrder};
use crate::device::layout::{NONE, Node, PrimitiveRange};

/// Subtrees of fewer leaves are flattened by one thread.
const TASK_MINIMUM: u32 = 1 << 11;

/// The result of clustering: the sorted boxes and a record of each merge.
pub(super) struct ClusterTree {
    order: MortonOrder,
    merges: Vec<MergedCluster>,
    root: Option<ChildCluster>,
}

/// A merged cluster.
#[derive(Clone, Copy, bytemuck::Zeroable)]
struct MergedCluster {
    /// A child that is a single box: its position in Morton order. A merged child: its index in `merges` with
    /// [`MERGED_BIT`] set.
    children: [u32; 2],
    leaf_count: u32,
}

/// Marks a merged child. Positions and indices are below 2^29.
const MERGED_BIT: u32 = 1 << 31;

impl MergeRecord for MergedCluster {
    fn new(children: [ChildCluster; 2], merges: &[Self], first: usize) -> Self {
        let leaves = |child: &ChildCluster| match child.kind {
            ClusterKind::Single(_) => 1,
            ClusterKind::Merged(merge) => merges[merge - first].leaf_count,
        };
        let leaf_count = children.iter().map(leaves).sum();
        Self { children: children.map(MergedCluster::encode), leaf_count }
    }
}

impl MergedCluster {
    /// A cluster as [`children`](Self::children) has it.
    fn encode(cluster: ChildCluster) -> u32 {
        match cluster.kind {
            ClusterKind::Single(position) => position as u32,
            ClusterKind::Merged(merge) => merge as u32 | MERGED_BIT,
        }
    }
}

impl ClusterTree {
    /// Clusters the boxes of an order.
    pub(super) fn new(order: MortonOrder) -> Self {
        let mut merges = bytemuck::zeroed_vec(order.len());
        let root = agglomerative::build(&order, &mut merges, &Cancel::new());
        Self { order, merges, root }
    }

    pub(super) fn leaf_count(&self) -> usize {
        self.order.len()
    }

    /// The record of a cluster that was merged; `None` for a single box.
    fn merged(&self, cluster: u32) -> Option<&MergedCluster> {
        (cluster & MERGED_BIT != 0).then(|| &self.merges[(cluster & !MERGED_BIT) as usize])
    }

    fn leaf_count_below(&self, cluster: u32) -> u32 {
        self.merged(cluster).map_or(1, |merged| merged.leaf_count)
    }
}

/// How many nodes the hierarchy of `tree` has with `reserved` unused leaves.
pub(super) fn node_count(tree: &ClusterTree, reserved: usize) -> usize {
    (2 * tree.leaf_count()).saturating_sub(1) + 2 * reserved
}

/// Writes all nodes and their parent indices, and enters the instances' leaves in `leaves`. Reserved leaves come first,
/// in a balanced subtree of their own, so that the last node is always a used leaf. Returns the area sums.
pub(super) fn flatten(
    tree: &ClusterTree,
    reserved: usize,
    nodes: &mut [Node],
    parents: &mut [u32],
    leaves: &mut LeafTable,
) -> AreaSums {
    let Some(root) = tree.root.map(MergedCluster::encode) else { return AreaSums::default() };
    let writer = NodeWriter { tree, leaves };
    // 1. Without reserved leaves the tree is the whole array.
    if reserved == 0 {
        let mut areas = writer.write_subtree(root, NodeLinks::ROOT, nodes, parents);
        if nodes.len() == 1 {
            areas.add_node(&nodes[0]);
        }
        return areas;
    }
    // 2. With them, the root's first child is their subtree and its second child the tree.
    let [unused, used] = NodeLinks::ROOT.children(2 * reserved as u32 - 1);
    let tree_start = used.index as usize;
    let mut areas = writer.write_subtree(root, used, &mut nodes[tree_start..], &mut parents[tree_start..]);
    areas.add_node(&nodes[tree_start]);
    // 3. The root has the box of the tree.
    (nodes[0], parents[0]) = (Node { escape_index: NONE, ..nodes[tree_start] }, NONE);
    nodes[0].primitives = PrimitiveRange::INNER;
    // 4. Write the reserved leaves, and list them.
    let mut unused_leaves = Vec::with_capacity(reserved);
    write_unused_subtree(reserved as u32, unused, nodes, parents, &mut unused_leaves);
    leaves.set_unused(unused_leaves);
    areas
}

/// The index, parent and escape index of a subtree's root.
#[derive(Clone, Copy)]
struct NodeLinks {
    index: u32,
    parent: u32,
    escape_index: u32,
}

impl NodeLinks {
    const ROOT: Self = Self { index: 0, parent: NONE, escape_index: NONE };

    /// The positions of the two children if the first child's subtree has `first_nodes` nodes.
    fn children(self, first_nodes: u32) -> [Self; 2] {
        let (first, second) = (self.index + 1, self.index + 1 + first_nodes);
        [
            Self { index: first, parent: self.index, escape_index: second },
            Self { index: second, parent: self.index, escape_index: self.escape_index },
        ]
    }
}

/// Read-only state shared by all threads.
struct NodeWriter<'a> {
    tree: &'a ClusterTree,
    leaves: &'a LeafTable,
}

impl NodeWriter<'_> {
    /// Writes a subtree to the start of `nodes` and `parents`. Returns the area sums of everything below its root.
    /// Recursion is as deep as the tree.
    fn write_subtree(&self, cluster: u32, links: NodeLinks, nodes: &mut [Node], parents: &mut [u32]) -> AreaSums {
        parents[0] = links.parent;
        // 1. A single box is a leaf: write it, and enter it in the table.
        let Some(merged) = self.tree.merged(cluster) else {
            let single = &self.tree.order.leaf_clusters()[cluster as usize];
            let (instance_index, bounds) = (single.box_index(), single.bounds());
            self.leaves.assign(instance_index, links.index);
            nodes[0] = instance_leaf(instance_index, &bounds, links.escape_index);
            return AreaSums::default();
        };
        // 2. Divide the arrays between the children.
        let first_nodes = 2 * self.tree.leaf_count_below(merged.children[0]) - 1;
        let [first, second] = links.children(first_nodes);
        let (root, below) = nodes.split_at_mut(1);
        let (first_subtree, second_subtree) = below.split_at_mut(first_nodes as usize);
        let (first_parents, second_parents) = parents[1..].split_at_mut(first_nodes as usize);
        // 3. Write both, in parallel while they are large.
        let mut write_first = || self.write_subtree(merged.children[0], first, first_subtree, first_parents);
        let mut write_second = || self.write_subtree(merged.children[1], second, second_subtree, second_parents);
        let (mut areas, second_areas) = if merged.leaf_count >= TASK_MINIMUM {
            rayon::join(write_first, write_second)
        } else {
            (write_first(), write_second())
        };
        // 4. Sum the areas.
        areas.add(second_areas);
        areas.add_node(&first_subtree[0]);
        areas.add_node(&second_subtree[0]);
        // 5. Write the inner node around its children.
        root[0].escape_index = links.escape_index;
        root[0].primitives = PrimitiveRange::INNER;
        root[0] = with_box_around(&root[0], &first_subtree[0], &second_subtree[0]);
        areas
    }
}

/// Writes a balanced subtree of `count` unused leaves into the whole arrays, and lists the leaves.
fn write_unused_subtree(
    count: u32,
    links: NodeLinks,
    nodes: &mut [Node],
    parents: &mut [u32],
    unused_leaves: &mut Vec<u32>,
) {
    nodes[links.index as usize] = Node::unused_leaf(links.escape_index);
    parents[links.index as usize] = links.parent;
    // One leaf: list it.
    if count == 1 {
        unused_leaves.push(links.index);
        return;
    }
    // More: halve the count.
    let half = count.div_ceil(2);
    let [first, second] = links.children(2 * half - 1);
    write_unused_subtree(half, first, nodes, parents, unused_leaves);
    write_unused_subtree(count - half, second, nodes, parents, unused_leaves);
}
