//! What is asked of a ray by the executors that have walks of their own: the three queries of the kernel.

use glam::Vec3;

use crate::device::layout::{Hit, Instance, NONE, Ray, Triangle};
use crate::trace::kernel::{KernelScene, is_layered, light_through_layers, max_component, passes_at, take_closer};

/// A crossing of the ray and a triangle.
pub(crate) struct Candidate {
    pub(crate) t: f32,
    pub(crate) u: f32,
    pub(crate) v: f32,
    pub(crate) back: bool,
    /// Index into `triangles`.
    pub(crate) triangle: u32,
}

/// What is asked of a ray: told of everything that it crosses, near or far, it says how far the ray goes on.
pub(crate) trait Query: Copy {
    fn start(t_max: f32) -> Self;

    fn cross(&mut self, scene: &KernelScene<'_>, index: u32, instance: &Instance, candidate: &Candidate);

    /// Farther than this nothing matters.
    fn t_max(&self) -> f32;

    /// Called when all has been crossed by who asks one ray at a time.
    fn finish(&mut self) {}
}

/// See [`closest_hit`](crate::trace::kernel::closest_hit).
#[derive(Clone, Copy)]
pub(crate) struct Closest(pub(crate) Hit);

impl Query for Closest {
    #[inline(always)]
    fn start(t_max: f32) -> Self {
        Self(Hit { t: t_max, ..Hit::MISS })
    }

    #[inline(always)]
    fn cross(&mut self, scene: &KernelScene<'_>, index: u32, instance: &Instance, candidate: &Candidate) {
        let &Candidate { t, u, v, triangle, back } = candidate;
        let (primitive, back) = (scene.triangles[triangle as usize].primitive, u32::from(back));
        let crossed = Hit { t, u, v, instance: index, primitive, triangle, back, ..Hit::MISS };
        take_closer(scene, &mut self.0, crossed, instance.flags);
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
pub(crate) struct Any {
    pub(crate) t_max: f32,
    pub(crate) is_hit: bool,
}

impl Query for Any {
    #[inline(always)]
    fn start(t_max: f32) -> Self {
        Self { t_max, is_hit: false }
    }

    #[inline(always)]
    fn cross(&mut self, scene: &KernelScene<'_>, _: u32, instance: &Instance, candidate: &Candidate) {
        let triangle = &scene.triangles[candidate.triangle as usize];
        if stops(scene, instance, triangle, candidate.u, candidate.v) {
            *self = Self { t_max: f32::NEG_INFINITY, is_hit: true };
        }
    }

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.t_max
    }
}

/// Whether no light passes a triangle at a point.
pub(crate) fn stops(scene: &KernelScene<'_>, instance: &Instance, triangle: &Triangle, u: f32, v: f32) -> bool {
    max_component(passes_at(scene, instance, triangle, u, v)) <= 0.0
}

/// See [`transmittance`](crate::trace::kernel::transmittance).
#[derive(Clone, Copy)]
pub(crate) struct Transmittance {
    pub(crate) t_max: f32,
    pub(crate) light: Vec3,
    /// Whether there are layered instances, which are left out.
    pub(crate) has_layers: bool,
}

impl Transmittance {
    /// All that gets through, layered instances included.
    #[inline(always)]
    pub(crate) fn light(&self, scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32) -> Vec3 {
        if self.has_layers { self.light * light_through_layers(scene, ray, ray_mask) } else { self.light }
    }
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
