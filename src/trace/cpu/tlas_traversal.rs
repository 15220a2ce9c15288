//! The top level, near instances first.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use glam::Vec3;

use super::packet_queries::PacketQuery;
use super::packet_traversal::SINGLE_RAY_THRESHOLD;
use super::ray_packet::{RayPacket, reciprocals, slab_test};
use super::simd::{F32Lanes, lanes_of, load, map_axes};
use crate::accel::Tlas;
use crate::device::layout::{Node, RayRecord};
use crate::trace::kernel::{KernelScene, intersects_box, slab_ray};

/// Visits the instances below the node of index `root` whose boxes the ray meets no farther than `t_max`, which `visit` returns anew.
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
            let met = intersects_box(&slab, ray.t_min, t_max, node);
            if let (true, Some(instance)) = (met, instance) {
                t_max = visit(instance);
            }
            met
        },
    );
}

/// Visits the instances whose boxes rays of the packet meet no farther than its answers, with a bit for each of these rays: near ones
/// first for the first ray, and for each of those few that go on one by one.
#[inline(always)]
pub(super) fn traverse_tlas_packet<S: Simd, A: PacketQuery>(
    simd: S,
    scene: &KernelScene<'_>,
    packet: &RayPacket<S>,
    answers: &mut A,
    mut visit: impl FnMut(u32, u64, &mut A),
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
            let met = slabs.meet(simd, node, answers.t_max());
            if met == 0 {
                return false;
            }
            if let Some(instance) = instance {
                visit(instance, met, answers);
                return false;
            }
            if met.count_ones() > SINGLE_RAY_THRESHOLD {
                return true;
            }
            for lane in lanes_of(met) {
                traverse_tlas_single(
                    scene,
                    index,
                    &packet.ray(lane),
                    answers.t_max()[lane],
                    #[inline(always)]
                    |instance| {
                        visit(instance, 1 << lane, answers);
                        answers.t_max()[lane]
                    },
                );
            }
            false
        },
    );
}

/// The rays of a packet as boxes see them.
struct PacketSlabTest<S: Simd> {
    origins: [f32x16<S>; 3],
    reciprocals: [f32x16<S>; 3],
    t_min: f32x16<S>,
}

impl<S: Simd> PacketSlabTest<S> {
    /// A bit for each ray that meets a box.
    #[inline(always)]
    fn meet(&self, simd: S, node: &Node, t_max: &F32Lanes) -> u64 {
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

/// Shows nodes from `root` on to `visit`, with their indices: it is told the instance where a node is a leaf, and says whether to go on below.
///
/// The stack is never too short for a [`Tlas`]. One made by hand may be deeper: what has no room is walked along escape indices.
#[inline(always)]
fn traverse_tlas(nodes: &[Node], root: u32, direction: Vec3, mut visit: impl FnMut(u32, &Node, Option<u32>) -> bool) {
    // A hierarchy of nothing is absent or zero.
    if nodes.first().is_none_or(Node::is_empty_root) {
        return;
    }
    if nodes[0].is_leaf() {
        visit(0, &nodes[0], Some(nodes[0].primitives.first_primitive()));
        return;
    }
    let mut stack = [root; Tlas::MAX_DEPTH + 1];
    let mut waiting = 1;
    // What is left to be walked along escape indices.
    let mut rope = 0..0;
    while waiting > 0 || !rope.is_empty() {
        let on_rope = !rope.is_empty();
        let index = if on_rope {
            rope.start
        } else {
            waiting -= 1;
            stack[waiting]
        };
        let node = &nodes[index as usize];
        let is_leaf = node.is_leaf();
        let opens =
            visit(index, node, is_leaf.then(|| node.primitives.first_primitive())) && !is_leaf && !node.is_empty();
        let left = index + 1;
        if on_rope {
            rope.start = if opens { left } else { node.escape_index };
        } else if opens && waiting + 2 > stack.len() {
            rope = left..node.escape_index;
        } else if opens {
            let right = Node::right_child(nodes, index as usize) as u32;
            let from_left = center(&nodes[right as usize]) - center(&nodes[left as usize]);
            let [near, far] = if from_left.dot(direction) < 0.0 { [right, left] } else { [left, right] };
            stack[waiting] = far;
            stack[waiting + 1] = near;
            waiting += 2;
        }
    }
}

/// Twice the centre of a box; infinite where that overflows.
fn center(node: &Node) -> Vec3 {
    Vec3::from_array(node.min) + Vec3::from_array(node.max)
}
