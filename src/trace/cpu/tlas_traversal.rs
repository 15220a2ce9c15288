//! Ordered traversal of the TLAS, by packets and single rays: near child first. A subtree that few rays of a packet
//! enter is traversed by each of them alone.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use glam::Vec3;

use super::node_test::slab_test;
use super::packet_queries::PacketQuery;
use super::packet_traversal::SINGLE_RAY_THRESHOLD;
use super::ray_packet::{RayPacket, reciprocals};
use super::simd::{F32Lanes, lanes_of, load, map_axes};
use crate::accel::Tlas;
use crate::device::layout::{Node, RayRecord};
use crate::trace::kernel::{KernelScene, intersects_box, slab_ray};

/// Calls `visit` with each instance below `root` whose box the ray enters by `t_max`; `visit` returns the new `t_max`.
#[inline(always)]
fn traverse_tlas_single(
    scene: &KernelScene<'_>,
    root: u32,
    ray: &RayRecord,
    mut t_max: f32,
    mut visit: impl FnMut(u32) -> f32,
) {
    let direction = Vec3::from_array(ray.direction);
    let slab = slab_ray(Vec3::from_array(ray.origin), direction);
    traverse_tlas(
        scene.tlas_nodes,
        root,
        direction,
        #[inline(always)]
        |_, node, instance| {
            // Test the box; at a leaf, hand the instance over.
            let is_hit = intersects_box(&slab, ray.t_min, t_max, node);
            if let (true, Some(instance)) = (is_hit, instance) {
                t_max = visit(instance);
            }
            is_hit
        },
    );
}

/// Calls `visit` with each instance whose box some ray of the packet enters by its own `t_max`, and the mask of those
/// rays. Children are ordered for the packet's first ray; subtrees with at most [`SINGLE_RAY_THRESHOLD`] active rays
/// are traversed one ray at a time, ordered for that ray.
#[inline(always)]
pub(super) fn traverse_tlas_packet<S: Simd, Q: PacketQuery>(
    simd: S,
    scene: &KernelScene<'_>,
    packet: &RayPacket<S>,
    queries: &mut Q,
    mut visit: impl FnMut(u32, u64, &mut Q),
) {
    let slabs = PacketSlabTest {
        origins: packet.origins,
        reciprocals: reciprocals(simd, packet.directions),
        t_min: packet.t_min,
    };
    traverse_tlas(
        scene.tlas_nodes,
        0,
        Vec3::from_array(packet.ray(0).direction),
        #[inline(always)]
        |index, node, instance| {
            // Test the box against all rays of the packet.
            let lanes = slabs.active_lanes(simd, node, queries.t_max());
            if lanes == 0 {
                return false;
            }
            // Leaf: hand over the instance and the mask.
            if let Some(instance) = instance {
                visit(instance, lanes, queries);
                return false;
            }
            // Many active rays: descend.
            if lanes.count_ones() > SINGLE_RAY_THRESHOLD {
                return true;
            }
            // Few active rays: traverse the subtree per ray.
            for lane in lanes_of(lanes) {
                traverse_tlas_single(
                    scene,
                    index,
                    &packet.ray(lane),
                    queries.t_max()[lane],
                    #[inline(always)]
                    |instance| {
                        visit(instance, 1 << lane, queries);
                        queries.t_max()[lane]
                    },
                );
            }
            false
        },
    );
}

/// Operands of the slab test for a packet.
struct PacketSlabTest<S: Simd> {
    origins: [f32x16<S>; 3],
    reciprocals: [f32x16<S>; 3],
    t_min: f32x16<S>,
}

impl<S: Simd> PacketSlabTest<S> {
    /// Mask of the rays that intersect a node's box.
    #[inline(always)]
    fn active_lanes(&self, simd: S, node: &Node, t_max: &F32Lanes) -> u64 {
        let t = map_axes(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let a = (f32x16::splat(simd, node.min[axis]) - self.origins[axis]) * self.reciprocals[axis];
                let b = (f32x16::splat(simd, node.max[axis]) - self.origins[axis]) * self.reciprocals[axis];
                [a.min(b), a.max(b)]
            },
        );
        slab_test(t, self.t_min, load(simd, *t_max))
    }
}

/// Calls `visit(index, node, instance)` for nodes below `root`, near child first along `direction`; `instance` is set
/// for a leaf; `visit` returns whether to descend.
///
/// The stack is never too short for a [`Tlas`]. A hand-made TLAS may be deeper: a subtree for which the stack has no
/// room is traversed along escape indices.
#[inline(always)]
fn traverse_tlas(nodes: &[Node], root: u32, direction: Vec3, mut visit: impl FnMut(u32, &Node, Option<u32>) -> bool) {
    // An empty TLAS has no nodes, or a zeroed or unused root.
    if nodes.first().is_none_or(Node::is_empty_root) {
        return;
    }
    // A TLAS of one instance is a single leaf.
    if nodes[0].is_leaf() {
        visit(0, &nodes[0], Some(nodes[0].primitives.first_primitive()));
        return;
    }
    let mut stack = [root; Tlas::MAX_DEPTH + 1];
    let mut stack_size = 1;
    // What is left of a subtree that is traversed along escape indices.
    let mut escape_range = 0..0;
    while stack_size > 0 || !escape_range.is_empty() {
        // Take the next node: from the escape range, else from the stack.
        let in_escape_range = !escape_range.is_empty();
        let index = if in_escape_range {
            escape_range.start
        } else {
            stack_size -= 1;
            stack[stack_size]
        };
        // Visit it.
        let node = &nodes[index as usize];
        let is_leaf = node.is_leaf();
        let descends =
            visit(index, node, is_leaf.then(|| node.primitives.first_primitive())) && !is_leaf && !node.is_empty();
        let left = index + 1;
        if in_escape_range {
            // Escape range: step to the first child, or to the escape index.
            escape_range.start = if descends { left } else { node.escape_index };
        } else if descends && stack_size + 2 > stack.len() {
            // Stack full: traverse this subtree along escape indices.
            escape_range = left..node.escape_index;
        } else if descends {
            // Push the far child, then the near child.
            let right = Node::right_child(nodes, index as usize) as u32;
            let from_left = doubled_center(&nodes[right as usize]) - doubled_center(&nodes[left as usize]);
            let [near, far] = if from_left.dot(direction) < 0.0 { [right, left] } else { [left, right] };
            stack[stack_size] = far;
            stack[stack_size + 1] = near;
            stack_size += 2;
        }
    }
}

/// Twice the centre of a box, infinite where that overflows; used only to order children.
fn doubled_center(node: &Node) -> Vec3 {
    Vec3::from_array(node.min) + Vec3::from_array(node.max)
}
