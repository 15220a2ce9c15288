//! The fast builder: clusters of boxes that are near each other, as a build tree.

use rayon::prelude::*;

use super::{Cluster, ClusterKind, Member, MergeRecord, MortonOrder, build};
use crate::accel::tree::{BuildNode, BuildTree, PrimitiveReference};
use crate::math::Aabb;

/// Builds a tree over references, with one in each leaf. O(n log n).
pub(in crate::accel) fn build_tree(references: &[PrimitiveReference]) -> BuildTree {
    // 1. What is near in space becomes near in an array.
    let boxes: Vec<Aabb> = references.par_iter().with_min_len(CHUNK).map(|r| r.bounds().aabb()).collect();
    let order = MortonOrder::new(&boxes);
    // 2. Neighbours merge until one cluster is left.
    let mut nodes: Vec<BuildNode> = bytemuck::zeroed_vec(1 + 2 * order.len());
    match build::<[BuildNode; 2]>(&order, bytemuck::cast_slice_mut(&mut nodes[1..])) {
        Some(root) => nodes[0] = build_node(root),
        None => nodes.clear(),
    }
    let primitive = |cluster: &Cluster| references[cluster.box_index() as usize].primitive();
    let order = order.leaf_clusters().par_iter().with_min_len(CHUNK).map(primitive).collect();
    BuildTree { nodes, primitive_indices: order, has_duplicates: false }
}

/// References that one thread takes at a time.
const CHUNK: usize = 1 << 12;

impl MergeRecord for [BuildNode; 2] {
    fn new(children: [Member; 2], _: &[Self], _: usize) -> Self {
        children.map(build_node)
    }
}

fn build_node(cluster: Member) -> BuildNode {
    match cluster.kind {
        ClusterKind::Single(place) => BuildNode::leaf(&cluster.bounds, place, 1),
        ClusterKind::Merged(joint) => BuildNode::inner(&cluster.bounds, 1 + 2 * joint),
    }
}
