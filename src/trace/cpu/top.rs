//! The top level, near instances first.

use fearless_simd::Simd;
use fearless_simd::prelude::*;
use glam::Vec3;

use super::packet::{LANES, Packet};
use crate::accel::TopLevel;
use crate::device::layout::{Node, PrimitiveRange, Ray};
use crate::trace::kernel::{BOX_SLACK, KernelScene, meets_box, slab_ray};

/// Visits the instances whose boxes the ray meets no farther than `t_max`, which `visit` returns anew.
#[inline(always)]
pub(super) fn walk_top(scene: &KernelScene<'_>, ray: &Ray, mut t_max: f32, mut visit: impl FnMut(u32) -> f32) {
    let direction = Vec3::from_array(ray.direction);
    let slab = slab_ray(Vec3::from_array(ray.origin), direction);
    walk_nodes(
        scene.tlas_nodes,
        direction,
        #[inline(always)]
        |node, instance| {
            let met = meets_box(&slab, ray.t_min, t_max, node);
            if let (true, Some(instance)) = (met, instance) {
                t_max = visit(instance);
            }
            met
        },
    );
}

/// Visits the instances whose boxes a ray of the packet may meet no farther than its `t_max`, which `visit` may lower.
#[inline(always)]
pub(super) fn walk_top_packet<S: Simd>(
    simd: S,
    scene: &KernelScene<'_>,
    packet: &Packet<S>,
    t_max: &mut [f32; LANES],
    mut visit: impl FnMut(u32, &mut [f32; LANES]),
) {
    let slabs = packet.slabs(simd);
    let direction = Vec3::new(
        packet.directions[0].as_array()[0],
        packet.directions[1].as_array()[0],
        packet.directions[2].as_array()[0],
    );
    walk_nodes(
        scene.tlas_nodes,
        direction,
        #[inline(always)]
        |node, instance| {
            let (enters, leaves) = slabs.meet(simd, node.min, node.max, t_max);
            let met = (enters * BOX_SLACK).simd_le(leaves).any_true();
            if let (true, Some(instance)) = (met, instance) {
                visit(instance, t_max);
            }
            met
        },
    );
}

/// Shows nodes to `visit`, which is told the instance where it is a leaf, and says whether to go on below.
///
/// The stack is never too short for a [`TopLevel`]. One made by hand may be deeper: what has no room is walked along escape indices.
#[inline(always)]
fn walk_nodes(nodes: &[Node], direction: Vec3, mut visit: impl FnMut(&Node, Option<u32>) -> bool) {
    // A hierarchy of nothing is absent or zero.
    if nodes.first().is_none_or(|node| node.escape_index == 0) {
        return;
    }
    if nodes[0].primitives != PrimitiveRange::INNER {
        visit(&nodes[0], Some(nodes[0].primitives.first()));
        return;
    }
    let mut stack = [0; TopLevel::MAX_DEPTH + 1];
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
        let is_leaf = node.primitives != PrimitiveRange::INNER;
        let opens = visit(node, is_leaf.then(|| node.primitives.first())) && !is_leaf && !node.is_unused();
        let left = index + 1;
        if on_rope {
            rope.start = if opens { left } else { node.escape_index };
        } else if opens && waiting + 2 > stack.len() {
            rope = left..node.escape_index;
        } else if opens {
            let right = nodes[left as usize].escape_index;
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
