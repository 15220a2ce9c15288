//! The fast builder: clusters of boxes that are near each other, as a build tree.

use super::cluster::{self, Joint, Kind, Member, Order};
use super::tree::{BuildNode, BuildTree, Reference};
use crate::math::Aabb;

/// Builds a tree over references, with one in each leaf. O(n log n).
pub(super) fn build(references: &[Reference]) -> BuildTree {
    // 1. Boxes by primitive; of primitives that are left out, empty ones.
    let count = references.iter().map(Reference::primitive).max().map_or(0, |last| last as usize + 1);
    let mut boxes = vec![Aabb::EMPTY; count];
    references.iter().for_each(|reference| boxes[reference.primitive() as usize] = reference.bounds().aabb());
    // 2. What is near in space becomes near in an array, and neighbours merge until one cluster is left.
    let order = Order::new(&boxes);
    let mut nodes: Vec<BuildNode> = bytemuck::zeroed_vec(1 + 2 * order.len());
    match cluster::build::<[BuildNode; 2]>(&order, bytemuck::cast_slice_mut(&mut nodes[1..])) {
        Some(root) => nodes[0] = node(root),
        None => nodes.clear(),
    }
    let order = order.boxes().iter().map(cluster::Cluster::slot).collect();
    BuildTree { nodes, order, repeats: false }
}

impl Joint for [BuildNode; 2] {
    fn new(children: [Member; 2], _: &[Self], _: usize) -> Self {
        children.map(node)
    }
}

fn node(cluster: Member) -> BuildNode {
    match cluster.kind {
        Kind::Single(place) => BuildNode::leaf(&cluster.bounds, place, 1),
        Kind::Merged(joint) => BuildNode::inner(&cluster.bounds, 1 + 2 * joint),
    }
}
