//! From a build tree to device nodes: the one place where depth-first order and escape indices are set.

use glam::{Vec3, Vec4, Vec4Swizzles};

use super::tree::{BuildNode, BuildTree, LaneBox, right_child};
use crate::device::layout::{NONE, Node, PrimitiveRange};

/// Subtrees of fewer nodes are flattened by one thread.
const TASK_MINIMUM: u32 = 1 << 12;

/// The nodes in depth-first order, and the primitives in leaf order: a leaf's range counts in the latter. O(n).
///
/// Each node's escape index is that of the node after its subtree (paper, section 3), or [`NONE`]. The child with the
/// larger surface comes first: it is hit more often, and what it hides need not be visited.
pub(super) fn flatten(tree: &BuildTree) -> (Vec<Node>, Vec<u32>) {
    let Some(root) = tree.nodes.first() else {
        return (Vec::new(), Vec::new());
    };
    let mut nodes = bytemuck::zeroed_vec(root.node_count as usize);
    let mut order = bytemuck::zeroed_vec(tree.order.len());
    let subtree = Subtree { slots: &tree.nodes, order: &tree.order, first_node: 0, first_primitive: 0 };
    subtree.emit(&mut nodes, &mut order, root.node_count);
    (nodes, order)
}

/// A subtree of the build tree and where it goes.
#[derive(Clone, Copy)]
struct Subtree<'a> {
    slots: &'a [BuildNode],
    order: &'a [u32],
    first_node: u32,
    first_primitive: u32,
}

impl Subtree<'_> {
    /// Recursion is as deep as the tree, see [`MAX_DEPTH`](super::MAX_DEPTH).
    fn emit(self, nodes: &mut [Node], order: &mut [u32], total: u32) {
        let root = &self.slots[0];
        let end = self.first_node + root.node_count;
        let escape_index = if end == total { NONE } else { end };
        let (min, max) = padded(root.min, root.max);
        let (node, nodes) = nodes.split_at_mut(1);
        let mut primitives = PrimitiveRange::INNER;
        if root.left_primitives == 0 {
            order.copy_from_slice(self.order);
            primitives = PrimitiveRange::leaf(self.first_primitive, self.order.len() as u32);
        } else {
            let [first, second] = self.children(root.left_primitives as usize);
            let (first_nodes, second_nodes) = nodes.split_at_mut(first.slots[0].node_count as usize);
            let (first_order, second_order) = order.split_at_mut(first.order.len());
            if root.node_count >= TASK_MINIMUM {
                rayon::join(
                    || first.emit(first_nodes, first_order, total),
                    || second.emit(second_nodes, second_order, total),
                );
            } else {
                first.emit(first_nodes, first_order, total);
                second.emit(second_nodes, second_order, total);
            }
        }
        node[0] = Node { min: min.to_array(), escape_index, max: max.to_array(), primitives };
    }

    /// Both children, the one with the larger surface first.
    fn children(self, left_primitives: usize) -> [Self; 2] {
        let right = right_child(self.order.len(), left_primitives, self.slots[1].node_count);
        let (left_slots, right_slots) = self.slots[1..].split_at(right);
        let (left_order, right_order) = self.order.split_at(left_primitives);
        let mut children = [(left_slots, left_order), (right_slots, right_order)];
        if half_area(&right_slots[0]) > half_area(&left_slots[0]) {
            children.swap(0, 1);
        }
        let [(slots, order), (second_slots, second_order)] = children;
        let first = Self { slots, order, first_node: self.first_node + 1, ..self };
        let second = Self {
            slots: second_slots,
            order: second_order,
            first_node: first.first_node + slots[0].node_count,
            first_primitive: self.first_primitive + order.len() as u32,
        };
        [first, second]
    }
}

/// In f64, where no box of finite floats has an infinite area.
fn half_area(node: &BuildNode) -> f64 {
    let d = node.max.as_dvec3() - node.min.as_dvec3();
    d.x * d.y + d.y * d.z + d.z * d.x
}

/// The box moved outward on every side: by 2 to 4 ulp of the coordinate, 2^-22 of the box's longest side and the smallest
/// normal number.
///
/// A slab test misses rays that lie exactly in a face plane, and all rays through a flat box. Ulps alone do not help a
/// flat box at coordinate 0, hence the share of the longest side; nor would a subnormal number, which a GPU may take for
/// zero. A box inside another stays inside: every operation here is monotonic. The result is finite.
pub(super) fn padded(min: Vec3, max: Vec3) -> (Vec3, Vec3) {
    let padded = padded_lanes(LaneBox { min: min.extend(0.0), max: max.extend(0.0) });
    (padded.min.xyz(), padded.max.xyz())
}

/// The same, four lanes at a time.
#[inline]
pub(super) fn padded_lanes(LaneBox { min, max }: LaneBox) -> LaneBox {
    const ULPS: f32 = 1.0 / (1 << 22) as f32;
    // What is in the fourth lanes may be a subnormal number, which would slow the other lanes a hundredfold.
    let (min, max) = (min.with_w(0.0), max.with_w(0.0));
    let half_side = (max * 0.5 - min * 0.5).max_element();
    let margin = Vec4::splat(half_side * (2.0 * ULPS) + f32::MIN_POSITIVE);
    let finite = Vec4::splat(f32::MAX);
    LaneBox {
        min: (min - (min.abs() * ULPS + margin)).max(-finite),
        max: (max + (max.abs() * ULPS + margin)).min(finite),
    }
}
