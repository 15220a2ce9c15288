//! Pure functions that make nodes of the top level: leaves of instances, and inner nodes around their children.

use glam::Vec4;

use crate::accel::padding::{SIDE_MARGIN, pad_corners};
use crate::device::layout::{Node, PrimitiveRange};
use crate::math::Aabb;

/// The leaf of an instance, with its padded box.
#[inline]
pub(super) fn instance_leaf(instance_index: u32, bounds: &Aabb, escape_index: u32) -> Node {
    let (min, max) = pad_corners(bounds.min, bounds.max, SIDE_MARGIN);
    let lane = |bits| f32::from_bits(bits);
    let primitives = bytemuck::cast(PrimitiveRange::leaf(instance_index, 1));
    bytemuck::cast([min.extend(lane(escape_index)), max.extend(lane(primitives))])
}

/// The inner node at `index` with the box around its children.
pub(super) fn around_children(nodes: &[Node], index: usize) -> Node {
    with_box_around(&nodes[index], &nodes[index + 1], &nodes[Node::right_child(nodes, index)])
}

/// `node` with the union of two child boxes; an unused child is ignored. The children's boxes are padded, so the result
/// is.
#[inline]
pub(super) fn with_box_around(node: &Node, a: &Node, b: &Node) -> Node {
    let (a, b) = if a.is_empty() {
        (b, b)
    } else if b.is_empty() {
        (a, a)
    } else {
        (a, b)
    };
    // Computed on four lanes; the fourth holds an index and is restored from `node`.
    let [[node_min, node_max], [a_min, a_max], [b_min, b_max]] =
        [node, a, b].map(|n| bytemuck::cast::<_, [Vec4; 2]>(*n));
    bytemuck::cast([a_min.min(b_min).with_w(node_min.w), a_max.max(b_max).with_w(node_max.w)])
}
