//! The invariants of a flattened hierarchy, and the check for them.

use std::fmt;

use glam::Vec3;

use crate::device::layout::{NONE, Node, PrimitiveRange};
use crate::math::Aabb;

/// An invariant that a hierarchy violates. It is always a defect of the builder, never of its input.
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
    /// A box is flat or not finite, or does not contain what is below it.
    #[error("the box of node {node} {fault}")]
    Box {
        /// The node.
        node: usize,
        /// What is wrong with its box.
        fault: BoxFault,
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
    /// A primitive occurs more often than allowed: in two leaves of a hierarchy without duplicates, or twice in one
    /// leaf.
    #[error("primitive {primitive} occurs more than once")]
    Repeated {
        /// The triangle's index in its geometry.
        primitive: u32,
    },
}

/// What is wrong with the box of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum BoxFault {
    /// It is flat along some axis, or not finite.
    Degenerate,
    /// It is not inside the box of the node's parent.
    OutsideParent,
    /// It does not contain the primitives of the leaf with a margin.
    ExcludesPrimitives,
}

impl fmt::Display for BoxFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Degenerate => "is flat or not finite",
            Self::OutsideParent => "is not inside its parent's",
            Self::ExcludesPrimitives => "does not contain its primitives with a margin",
        })
    }
}

/// Checks the escape indices and the boxes of all nodes. `leaf_bounds` returns the box of a leaf's primitives, or
/// `None` if the range is invalid; it is called once per leaf in depth-first order.
pub(super) fn validate_nodes(
    nodes: &[Node],
    mut leaf_bounds: impl FnMut(PrimitiveRange) -> Option<Aabb>,
) -> Result<(), BvhError> {
    // The enclosing inner nodes of the current node, each with the end of its subtree and its box.
    let mut ancestors: Vec<(usize, Aabb)> = Vec::new();
    for (index, node) in nodes.iter().enumerate() {
        // 1. Leave the subtrees that end here.
        while ancestors.last().is_some_and(|&(end, _)| end == index) {
            ancestors.pop();
        }
        // 2. Its escape index leads to the end of its subtree.
        let end = checked_subtree_end(nodes, index, ancestors.last().map(|&(end, _)| end))?;
        // 3. Its box is finite and not flat.
        let bounds = bounds(node);
        let finite = bounds.min.is_finite() && bounds.max.is_finite();
        if !finite || !bounds.min.cmplt(bounds.max).all() {
            return Err(BvhError::Box { node: index, fault: BoxFault::Degenerate });
        }
        // 4. It lies in its parent's box. An unused node has a box outside of its parent's by design; a used node below
        // an unused one is caught by its box.
        if !node.is_empty() && ancestors.last().is_some_and(|(_, parent)| !parent.contains(&bounds)) {
            return Err(BvhError::Box { node: index, fault: BoxFault::OutsideParent });
        }
        if !node.is_leaf() {
            if end > index + 1 {
                ancestors.push((end, bounds));
            }
            continue;
        }
        // 5. A leaf's primitives lie in its box.
        let (first, count) = (node.primitives.first_primitive(), node.primitives.primitive_count());
        let content = leaf_bounds(node.primitives).ok_or(BvhError::Leaf { node: index, first, count })?;
        if !has_margin(&bounds, &content) {
            return Err(BvhError::Box { node: index, fault: BoxFault::ExcludesPrimitives });
        }
    }
    Ok(())
}

/// Whether `content` lies strictly inside `bounds`; a face may coincide only at the largest finite f32.
fn has_margin(bounds: &Aabb, content: &Aabb) -> bool {
    let farthest = Vec3::splat(f32::MAX);
    let min = bounds.min.cmplt(content.min) | content.min.cmpeq(-farthest);
    let max = bounds.max.cmpgt(content.max) | content.max.cmpeq(farthest);
    bounds.contains(content) && (min & max).all()
}

/// The index after the node's subtree, checked: `index + 1` for a leaf, at least `index + 3` for an inner node (two
/// children), `index + 1` for an unused leaf that is not the last node; never past the parent's end.
fn checked_subtree_end(nodes: &[Node], index: usize, parent_end: Option<usize>) -> Result<usize, BvhError> {
    let node = &nodes[index];
    let end = node.subtree_end(nodes.len());
    let is_unused_leaf = node.is_empty() && end == index + 1 && end < nodes.len();
    let fits = if node.is_leaf() { end == index + 1 } else { end >= index + 3 || is_unused_leaf };
    // `NONE`, and only that, stands for the end of the array.
    let is_marked = (node.escape_index == NONE) == (end == nodes.len());
    // The root, and only the root, has no parent.
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
