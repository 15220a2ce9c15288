//! Writes a pruned build tree as device nodes in depth-first order with escape indices. (`tlas::build` does it for the
//! top level.)

use super::prune::{PrunedTree, SubtreeRoot};
use crate::device::layout::{NONE, Node, PrimitiveRange};

/// The flattened form of a build tree.
#[derive(Default)]
pub(super) struct FlattenedTree {
    /// In depth-first order.
    pub(super) nodes: Vec<Node>,
    /// Primitive indices in leaf order; leaf ranges refer to this array.
    pub(super) primitive_indices: Vec<u32>,
}

/// Flattens a tree. O(n).
///
/// Each node's escape index is that of the node after its subtree (paper, section 3), or [`NONE`].
pub(super) fn flatten(tree: &PrunedTree<'_>) -> FlattenedTree {
    // 1. Allocate arrays of exactly the size that pruning found.
    let size = tree.size(tree.root().node);
    let mut nodes = bytemuck::zeroed_vec(size.nodes as usize);
    let mut primitive_indices = bytemuck::zeroed_vec(size.primitives as usize);
    // 2. Write them from the root, large subtrees in parallel.
    let position = SubtreePosition { node: 0, end: size.nodes, depth: 0 };
    write_subtree(tree, tree.root(), position, &mut nodes, &mut primitive_indices);
    FlattenedTree { nodes, primitive_indices }
}

/// Where the nodes of a subtree are written in the output array.
#[derive(Clone, Copy)]
struct SubtreePosition {
    /// The index of the subtree's first node.
    node: u32,
    /// The total number of nodes: a subtree that ends there has escape index [`NONE`].
    end: u32,
    /// Levels of the build tree above the subtree.
    depth: u32,
}

/// Writes a subtree depth-first into slices of exactly its size. Recursion is as deep as the build tree.
fn write_subtree(
    tree: &PrunedTree<'_>,
    subtree: SubtreeRoot,
    position: SubtreePosition,
    mut nodes: &mut [Node],
    primitive_indices: &mut [u32],
) {
    let size = tree.size(subtree.node);
    let mut below = SubtreePosition { depth: position.depth + 1, ..position };
    // 1. If the root of the subtree is kept, write it: its box, its escape index, which is that of the first node after
    // the subtree, and, for a leaf, its primitives.
    if size.top_node_count == 1
        && let Some(node) = nodes.split_off_first_mut()
    {
        below.node += 1;
        let next = below.node + nodes.len() as u32;
        let escape_index = if next == position.end { NONE } else { next };
        let [min, max] = tree.padded_corners(subtree.node).map(|corner| corner.to_array());
        let is_leaf = nodes.is_empty();
        let primitives = match is_leaf {
            true => PrimitiveRange::leaf(subtree.first_primitive, size.primitives),
            false => PrimitiveRange::INNER,
        };
        *node = Node { min, escape_index, max, primitives };
        if is_leaf {
            tree.gather(subtree.node, primitive_indices);
            return;
        }
    }
    // 2. Write both children, the larger first, each to its part of the arrays.
    if let Some([first, second]) = tree.children(subtree) {
        let first_size = tree.size(first.node);
        let (first_nodes, second_nodes) = nodes.split_at_mut(first_size.nodes as usize);
        let (first_indices, second_indices) = primitive_indices.split_at_mut(first_size.primitives as usize);
        let after_first = SubtreePosition { node: below.node + first_size.nodes, ..below };
        tree.join_near_root(
            position.depth,
            || write_subtree(tree, first, below, first_nodes, first_indices),
            || write_subtree(tree, second, after_first, second_nodes, second_indices),
        );
    }
}
