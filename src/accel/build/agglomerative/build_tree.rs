//! The bottom level's use of clustering: a build tree over triangles.

use std::collections::HashSet;

use rayon::prelude::*;

use super::cluster::{ChildCluster, Cluster, ClusterKind};
use super::clustering::{MergeRecord, build};
use super::morton::MortonOrder;
use crate::Cancel;
use crate::accel::build::coincident::CoincidentTriangles;
use crate::accel::tree::{BuildNode, BuildTree, PrimitiveReference};
use crate::math::Aabb;

/// Builds a tree with one reference in each leaf; pruning merges leaves where that is cheaper. O(n log n). References
/// to triangles that coincide are merged. Once cancelled, it leaves references out.
pub(in crate::accel) fn build_tree(
    references: &mut Vec<PrimitiveReference>,
    coincident: &CoincidentTriangles<'_>,
    cancel: &Cancel,
) -> BuildTree {
    // 1. Sort the boxes along a Morton curve; again if some triangles coincide and are left out.
    let sort = |references: &[PrimitiveReference]| {
        let boxes: Vec<Aabb> = references.par_iter().with_min_len(CHUNK).map(|r| r.bounds().aabb()).collect();
        MortonOrder::new(&boxes)
    };
    let mut order = sort(references);
    if merge_coincident(&order, references, coincident) {
        order = sort(references);
    }
    let references = &*references;
    // 2. Merge neighbours until one cluster is left; each merge writes its two children as a pair of build nodes.
    let mut nodes: Vec<BuildNode> = bytemuck::zeroed_vec(1 + 2 * order.len());
    match build::<[BuildNode; 2]>(&order, bytemuck::cast_slice_mut(&mut nodes[1..]), cancel) {
        Some(root) => nodes[0] = build_node(root),
        None => nodes.clear(),
    }
    // 3. List the primitives in Morton order, in which leaves refer to them.
    let primitive = |cluster: &Cluster| references[cluster.box_index() as usize].primitive();
    let primitive_indices = order.leaf_clusters().par_iter().with_min_len(CHUNK).map(primitive).collect();
    BuildTree { nodes, primitive_indices, has_duplicates: false }
}

/// Removes the references to triangles that coincide with others, which are among those of the same Morton code.
/// Returns whether there were any.
fn merge_coincident(
    order: &MortonOrder,
    references: &mut Vec<PrimitiveReference>,
    coincident: &CoincidentTriangles<'_>,
) -> bool {
    let (mut run_references, mut left_out) = (Vec::new(), Vec::new());
    for run in order.equal_codes() {
        run_references.clear();
        run_references.extend(run.iter().map(|cluster| references[cluster.box_index() as usize]));
        let kept = coincident.merge(&mut run_references);
        if kept < run.len() {
            let kept: HashSet<u32> = run_references[..kept].iter().map(PrimitiveReference::primitive).collect();
            let indices = run.iter().map(Cluster::box_index);
            left_out.extend(indices.filter(|&index| !kept.contains(&references[index as usize].primitive())));
        }
    }
    // From the last on: what takes the place of a reference is then kept.
    left_out.sort_unstable();
    for &index in left_out.iter().rev() {
        references.swap_remove(index as usize);
    }
    !left_out.is_empty()
}

/// References per parallel chunk.
const CHUNK: usize = 1 << 12;

impl MergeRecord for [BuildNode; 2] {
    fn new(children: [ChildCluster; 2], _: &[Self], _: usize) -> Self {
        children.map(build_node)
    }
}

fn build_node(cluster: ChildCluster) -> BuildNode {
    match cluster.kind {
        ClusterKind::Single(position) => BuildNode::leaf(&cluster.bounds, position, 1),
        ClusterKind::Merged(merge) => BuildNode::inner(&cluster.bounds, 1 + 2 * merge),
    }
}
