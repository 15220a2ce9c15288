//! The nodes of the top level: leaves around instances, inner nodes around their children.

use glam::Vec4;

use crate::accel::padding::pad_corners;
use crate::device::layout::{Node, PrimitiveRange};
use crate::math::Aabb;

/// The leaf of an instance: its box, padded.
#[inline]
pub(super) fn instance_leaf(slot: u32, bounds: &Aabb, escape_index: u32) -> Node {
    let (min, max) = pad_corners(bounds.min, bounds.max);
    let lane = |bits| f32::from_bits(bits);
    let primitives = bytemuck::cast(PrimitiveRange::leaf(slot, 1));
    bytemuck::cast([min.extend(lane(escape_index)), max.extend(lane(primitives))])
}

/// An inner node with the box around its children.
pub(super) fn around_children(nodes: &[Node], index: usize) -> Node {
    let second = nodes[index + 1].escape_index as usize;
    with_box_around(&nodes[index], &nodes[index + 1], &nodes[second])
}

/// `node` with the box around two others. Those boxes are padded: so is this.
#[inline]
pub(super) fn with_box_around(node: &Node, a: &Node, b: &Node) -> Node {
    let (a, b) = if a.is_empty() {
        (b, b)
    } else if b.is_empty() {
        (a, a)
    } else {
        (a, b)
    };
    // Four lanes at a time, of which the fourth is none of a box.
    let [[node_min, node_max], [a_min, a_max], [b_min, b_max]] =
        [node, a, b].map(|n| bytemuck::cast::<_, [Vec4; 2]>(*n));
    bytemuck::cast([a_min.min(b_min).with_w(node_min.w), a_max.max(b_max).with_w(node_max.w)])
}
