//! From a pruned build tree to device nodes: where depth-first order and escape indices of the bottom level are set.

use super::prune::{PrunedTree, SubtreeRoot};
use crate::device::layout::{NONE, Node, PrimitiveRange};

/// Device nodes, and which primitives their leaves hold.
#[derive(Default)]
pub(super) struct FlattenedTree {
    /// In depth-first order.
    pub(super) nodes: Vec<Node>,
    /// The primitives in leaf order: a leaf's range counts in it.
    pub(super) order: Vec<u32>,
}

/// Flattens a tree. O(n).
///
/// Each node's escape index is that of the node after its subtree (paper, section 3), or [`NONE`].
pub(super) fn flatten(tree: &PrunedTree<'_>) -> FlattenedTree {
    let size = tree.size(tree.root().node);
    let mut nodes = bytemuck::zeroed_vec(size.nodes as usize);
    let mut order = bytemuck::zeroed_vec(size.primitives as usize);
    let position = EmitPosition { node: 0, end: size.nodes, depth: 0 };
    write_subtree(tree, tree.root(), position, &mut nodes, &mut order);
    FlattenedTree { nodes, order }
}

/// Where the nodes of a subtree are written.
#[derive(Clone, Copy)]
struct EmitPosition {
    /// The index of its first node.
    node: u32,
    /// How many nodes there are in all.
    end: u32,
    depth: u32,
}

/// Writes a subtree to slices of its size. Recursion is as deep as the build tree.
fn write_subtree(
    tree: &PrunedTree<'_>,
    subtree: SubtreeRoot,
    position: EmitPosition,
    mut nodes: &mut [Node],
    order: &mut [u32],
) {
    let size = tree.size(subtree.node);
    let mut below = EmitPosition { depth: position.depth + 1, ..position };
    // 1. The root of the subtree, where it is kept. Its escape index is the first node after the subtree.
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
            tree.gather(subtree.node, order);
            return;
        }
    }
    // 2. Its children, one after the other.
    if let Some([first, second]) = tree.children(subtree) {
        let first_size = tree.size(first.node);
        let (first_nodes, second_nodes) = nodes.split_at_mut(first_size.nodes as usize);
        let (first_order, second_order) = order.split_at_mut(first_size.primitives as usize);
        let after_first = EmitPosition { node: below.node + first_size.nodes, ..below };
        tree.join_near_root(
            position.depth,
            || write_subtree(tree, first, below, first_nodes, first_order),
            || write_subtree(tree, second, after_first, second_nodes, second_order),
        );
    }
}
