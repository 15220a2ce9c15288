//! What must hold in every flattened hierarchy.

use glam::Vec3;

use crate::device::layout::{NONE, Node, PrimitiveRange};
use crate::math::Aabb;

/// How a hierarchy is broken: a defect of the builder, never of its input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BvhError {
    /// An escape index leads backward, out of the parent's subtree, or into the middle of one.
    #[error("the escape index {escape_index} of node {node} does not lead to the end of its subtree")]
    Escape {
        /// The node.
        node: usize,
        /// Its escape index.
        escape_index: u32,
    },
    /// A box does not contain what is below it, or is flat, or not finite.
    #[error("the box of node {node} is flat, infinite or does not contain {content}")]
    Box {
        /// The node.
        node: usize,
        /// What sticks out: "its parent's share", "its primitives".
        content: &'static str,
    },
    /// A leaf's primitives do not exist, are in another leaf too, or are out of order.
    #[error(
        "the leaf {node} holds {count} primitives from {first}: out of range, out of order or held by another leaf"
    )]
    Leaf {
        /// The node.
        node: usize,
        /// Its first primitive.
        first: u32,
        /// How many.
        count: u32,
    },
    /// A primitive is in no leaf.
    #[error("primitive {primitive} is in no leaf")]
    Missing {
        /// The triangle's index in its geometry, or the instance.
        primitive: u32,
    },
    /// A primitive is there twice.
    #[error("primitive {primitive} is there more than once")]
    Repeated {
        /// The triangle's index in its geometry.
        primitive: u32,
    },
}

/// Checks escape order and containment. `leaf_bounds` gives the box of a leaf's primitives, or `None` for a range that must
/// not be there; it is called in depth-first order.
pub(super) fn validate_nodes(
    nodes: &[Node],
    mut leaf_bounds: impl FnMut(PrimitiveRange) -> Option<Aabb>,
) -> Result<(), BvhError> {
    // The inner nodes around the current one, each with the end of its subtree.
    let mut ancestors: Vec<(usize, Aabb)> = Vec::new();
    for (index, node) in nodes.iter().enumerate() {
        while ancestors.last().is_some_and(|&(end, _)| end == index) {
            ancestors.pop();
        }
        let end = subtree_end(nodes, index, ancestors.last().map(|&(end, _)| end))?;
        let bounds = bounds(node);
        let finite = bounds.min.is_finite() && bounds.max.is_finite();
        if !finite || !bounds.min.cmplt(bounds.max).all() {
            return Err(BvhError::Box { node: index, content: "a point" });
        }
        // An unused node lies outside; what is in use below one sticks out of it.
        if !node.is_empty() && ancestors.last().is_some_and(|(_, parent)| !parent.contains(&bounds)) {
            return Err(BvhError::Box { node: index, content: "less than its parent" });
        }
        if node.primitives == PrimitiveRange::INNER {
            if end > index + 1 {
                ancestors.push((end, bounds));
            }
            continue;
        }
        let (first, count) = (node.primitives.first_primitive(), node.primitives.primitive_count());
        let content = leaf_bounds(node.primitives).ok_or(BvhError::Leaf { node: index, first, count })?;
        if !has_margin(&bounds, &content) {
            return Err(BvhError::Box { node: index, content: "its primitives with a margin" });
        }
    }
    Ok(())
}

/// Whether `content` lies strictly inside, or where no float is farther out.
fn has_margin(bounds: &Aabb, content: &Aabb) -> bool {
    let farthest = Vec3::splat(f32::MAX);
    let min = bounds.min.cmplt(content.min) | content.min.cmpeq(-farthest);
    let max = bounds.max.cmpgt(content.max) | content.max.cmpeq(farthest);
    bounds.contains(content) && (min & max).all()
}

/// The index after the node's subtree: one further for a leaf, at least three further (two children) for an inner node or one
/// for an unused leaf that is not the last node, and not past the parent's end.
fn subtree_end(nodes: &[Node], index: usize, parent_end: Option<usize>) -> Result<usize, BvhError> {
    let node = &nodes[index];
    let end = if node.escape_index == NONE { nodes.len() } else { node.escape_index as usize };
    let is_leaf = node.primitives != PrimitiveRange::INNER;
    let is_unused_leaf = node.is_empty() && end == index + 1 && end < nodes.len();
    let fits = if is_leaf { end == index + 1 } else { end >= index + 3 || is_unused_leaf };
    let is_marked = (node.escape_index == NONE) == (end == nodes.len());
    // The root, and only the root, spans everything.
    if fits
        && is_marked
        && end <= parent_end.unwrap_or(end)
        && (index > 0) == parent_end.is_some()
        && end <= nodes.len()
    {
        Ok(end)
    } else {
        Err(BvhError::Escape { node: index, escape_index: node.escape_index })
    }
}

fn bounds(node: &Node) -> Aabb {
    Aabb { min: Vec3::from_array(node.min), max: Vec3::from_array(node.max) }
}
