//! Queries answered by SIMD walks: of one ray, and of sixteen.

use fearless_simd::Simd;

use super::packet::{LANES, LocalPacket, Packet, walk_packet};
use super::single::{Stack, local_ray, walk};
use super::top::{walk_top, walk_top_packet};
use crate::device::layout::Ray;
use crate::trace::kernel::KernelScene;
use crate::trace::queries::{Candidate, Query};

/// One ray.
#[inline(always)]
pub(super) fn ask<S: Simd, Q: Query>(
    simd: S,
    scene: &KernelScene<'_>,
    stack: &mut Stack,
    ray: &Ray,
    ray_mask: u32,
) -> Q {
    let mut query = Q::start(ray.t_max);
    walk_top(scene, ray, ray.t_max, |index| {
        if scene.instances[index as usize].mask & ray_mask != 0 {
            ask_instance(simd, scene, stack, ray, index, &mut query);
        }
        query.t_max()
    });
    query.finish();
    query
}

/// One ray and one instance. Never inlined: it is used in several places and compiled for several sets of instructions.
#[inline(never)]
fn ask_instance<S: Simd, Q: Query>(
    simd: S,
    scene: &KernelScene<'_>,
    stack: &mut Stack,
    ray: &Ray,
    index: u32,
    query: &mut Q,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            let instance = &scene.instances[index as usize];
            let (first_node, local) = local_ray(simd, scene, instance, ray);
            let t_max = query.t_max();
            walk(
                simd,
                scene,
                [first_node, instance.first_triangle],
                &local,
                stack,
                t_max,
                #[inline(always)]
                |candidate: &Candidate| {
                    query.cross(scene, index, instance, candidate);
                    query.t_max()
                },
            );
        },
    );
}

/// Sixteen rays; one by one where they do not go much the same way.
#[inline(always)]
pub(super) fn ask_packet<S: Simd, Q: Query>(
    simd: S,
    scene: &KernelScene<'_>,
    stack: &mut Stack,
    rays: &[Ray; LANES],
    ray_mask: u32,
    queries: &mut [Q; LANES],
) {
    let packet = Packet::new(simd, rays);
    let mut t_max: [f32; LANES] = packet.t_max.into();
    for lane in 0..LANES {
        queries[lane] = Q::start(t_max[lane]);
    }
    walk_top_packet(
        simd,
        scene,
        &packet,
        &mut t_max,
        #[inline(always)]
        |index, t_max| {
            let instance = &scene.instances[index as usize];
            if instance.mask & ray_mask == 0 {
                return;
            }
            if let Some((first_node, local)) = LocalPacket::new(simd, scene, instance, &packet) {
                walk_packet(
                    simd,
                    scene,
                    [first_node, instance.first_triangle],
                    &local,
                    stack,
                    t_max,
                    #[inline(always)]
                    |lane: usize, candidate: &Candidate| {
                        queries[lane].cross(scene, index, instance, candidate);
                        queries[lane].t_max()
                    },
                );
            } else {
                for lane in 0..LANES {
                    ask_instance(simd, scene, stack, &rays[lane], index, &mut queries[lane]);
                    t_max[lane] = queries[lane].t_max();
                }
            }
        },
    );
    for query in queries {
        query.finish();
    }
}
