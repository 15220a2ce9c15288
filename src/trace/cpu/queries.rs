//! The three queries of the kernel on SIMD walks.

use fearless_simd::Simd;
use glam::Vec3;

use super::packet::{LANES, LocalPacket, Packet, walk_packet};
use super::single::{Candidate, Stack, local_ray, walk};
use super::top::{walk_top, walk_top_packet};
use crate::device::layout::{Hit, Instance, InstanceFlags, NONE, Ray};
use crate::trace::kernel::{KernelScene, is_closer, is_hole, is_layered, max_component, passes_at};

/// What is asked of a ray: told of everything that it crosses, near or far, it says how far the ray goes on.
pub(super) trait Query: Copy {
    fn start(t_max: f32) -> Self;

    fn cross(&mut self, scene: &KernelScene<'_>, index: u32, instance: &Instance, candidate: &Candidate);

    /// Farther than this nothing matters.
    fn t_max(&self) -> f32;

    /// Called when all has been crossed.
    fn finish(&mut self) {}
}

/// See [`closest_hit`](crate::trace::kernel::closest_hit).
#[derive(Clone, Copy)]
pub(super) struct Closest(pub(super) Hit);

impl Query for Closest {
    #[inline(always)]
    fn start(t_max: f32) -> Self {
        Self(Hit { t: t_max, ..Hit::MISS })
    }

    #[inline(always)]
    fn cross(&mut self, scene: &KernelScene<'_>, index: u32, instance: &Instance, candidate: &Candidate) {
        let triangle = &scene.triangles[candidate.triangle as usize];
        let flags = InstanceFlags::from_bits_retain(instance.flags);
        if !is_closer(candidate.t, index, triangle.primitive, &self.0)
            || candidate.back && flags.contains(InstanceFlags::CULL_BACK)
            || flags.contains(InstanceFlags::ALPHA_MASK) && is_hole(scene, instance, triangle, candidate.u, candidate.v)
        {
            return;
        }
        self.0 = Hit {
            t: candidate.t,
            u: candidate.u,
            v: candidate.v,
            instance: index,
            primitive: triangle.primitive,
            triangle: candidate.triangle,
            back: u32::from(candidate.back),
            _pad: 0,
        };
    }

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.0.t
    }

    #[inline(always)]
    fn finish(&mut self) {
        self.0.t = if self.0.instance == NONE { f32::MAX } else { self.0.t };
    }
}

/// See [`any_hit`](crate::trace::kernel::any_hit).
#[derive(Clone, Copy)]
pub(super) struct Any {
    t_max: f32,
    pub(super) is_hit: bool,
}

impl Query for Any {
    #[inline(always)]
    fn start(t_max: f32) -> Self {
        Self { t_max, is_hit: false }
    }

    #[inline(always)]
    fn cross(&mut self, scene: &KernelScene<'_>, _: u32, instance: &Instance, candidate: &Candidate) {
        let triangle = &scene.triangles[candidate.triangle as usize];
        if max_component(passes_at(scene, instance, triangle, candidate.u, candidate.v)) <= 0.0 {
            *self = Self { t_max: f32::NEG_INFINITY, is_hit: true };
        }
    }

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.t_max
    }
}

/// See [`transmittance`](crate::trace::kernel::transmittance).
#[derive(Clone, Copy)]
pub(super) struct Transmittance {
    t_max: f32,
    pub(super) light: Vec3,
    /// Whether there are layered instances, which are left out.
    pub(super) has_layers: bool,
}

impl Query for Transmittance {
    #[inline(always)]
    fn start(t_max: f32) -> Self {
        Self { t_max, light: Vec3::ONE, has_layers: false }
    }

    #[inline(always)]
    fn cross(&mut self, scene: &KernelScene<'_>, _: u32, instance: &Instance, candidate: &Candidate) {
        if is_layered(instance.flags) {
            self.has_layers = true;
            return;
        }
        let triangle = &scene.triangles[candidate.triangle as usize];
        self.light *= passes_at(scene, instance, triangle, candidate.u, candidate.v);
        if max_component(self.light) <= 0.0 {
            *self = Self { t_max: f32::NEG_INFINITY, light: Vec3::ZERO, has_layers: false };
        }
    }

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.t_max
    }
}

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
                first_node,
                instance.first_triangle,
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
                    first_node,
                    instance.first_triangle,
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
