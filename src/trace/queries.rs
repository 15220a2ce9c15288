//! What is asked of a ray by the executors that have walks of their own: the three queries of the kernel.

use glam::Vec3;

use crate::device::layout::{HitRecord, InstanceRecord, NONE, RayRecord, Triangle};
use crate::trace::kernel::{
    KernelScene, accept_hit, candidate_transmittance, is_layered, max_component, transmittance_of_layers,
};

/// A crossing of the ray and a triangle.
pub(crate) struct CandidateHit {
    pub(crate) t: f32,
    pub(crate) u: f32,
    pub(crate) v: f32,
    pub(crate) back: bool,
    /// Index into `triangles`.
    pub(crate) triangle: u32,
}

/// What is asked of a ray: told of everything that it crosses, near or far, it says how far the ray goes on.
pub(crate) trait Query: Copy {
    fn new(t_max: f32) -> Self;

    fn accept_hit(&mut self, scene: &KernelScene<'_>, index: u32, instance: &InstanceRecord, candidate: &CandidateHit);

    /// Farther than this nothing matters.
    fn t_max(&self) -> f32;

    /// Called when all has been crossed by who asks one ray at a time.
    fn finish(&mut self) {}
}

/// See [`closest_hit`](crate::trace::kernel::closest_hit).
#[derive(Clone, Copy)]
pub(crate) struct ClosestQuery(pub(crate) HitRecord);

impl Query for ClosestQuery {
    #[inline(always)]
    fn new(t_max: f32) -> Self {
        Self(HitRecord { t: t_max, ..HitRecord::MISS })
    }

    #[inline(always)]
    fn accept_hit(&mut self, scene: &KernelScene<'_>, index: u32, instance: &InstanceRecord, candidate: &CandidateHit) {
        let &CandidateHit { t, u, v, triangle, back } = candidate;
        let (primitive, back) = (scene.triangles[triangle as usize].primitive, u32::from(back));
        let crossed = HitRecord { t, u, v, instance: index, primitive, triangle, back_face: back, ..HitRecord::MISS };
        accept_hit(scene, &mut self.0, crossed, instance.flags);
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
pub(crate) struct AnyQuery {
    pub(crate) t_max: f32,
    pub(crate) is_hit: bool,
}

impl Query for AnyQuery {
    #[inline(always)]
    fn new(t_max: f32) -> Self {
        Self { t_max, is_hit: false }
    }

    #[inline(always)]
    fn accept_hit(&mut self, scene: &KernelScene<'_>, _: u32, instance: &InstanceRecord, candidate: &CandidateHit) {
        let triangle = &scene.triangles[candidate.triangle as usize];
        if is_opaque_at(scene, instance, triangle, candidate.u, candidate.v) {
            *self = Self { t_max: f32::NEG_INFINITY, is_hit: true };
        }
    }

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.t_max
    }
}

/// Whether no light passes a triangle at a point.
pub(crate) fn is_opaque_at(
    scene: &KernelScene<'_>,
    instance: &InstanceRecord,
    triangle: &Triangle,
    u: f32,
    v: f32,
) -> bool {
    max_component(candidate_transmittance(scene, instance, triangle, u, v)) <= 0.0
}

/// See [`transmittance`](crate::trace::kernel::transmittance).
#[derive(Clone, Copy)]
pub(crate) struct TransmittanceQuery {
    pub(crate) t_max: f32,
    pub(crate) transmittance: Vec3,
    /// Whether there are layered instances, which are left out.
    pub(crate) has_layers: bool,
}

impl TransmittanceQuery {
    /// All that gets through, layered instances included.
    #[inline(always)]
    pub(crate) fn with_layers(&self, scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> Vec3 {
        if self.has_layers {
            self.transmittance * transmittance_of_layers(scene, ray, ray_mask)
        } else {
            self.transmittance
        }
    }
}

impl Query for TransmittanceQuery {
    #[inline(always)]
    fn new(t_max: f32) -> Self {
        Self { t_max, transmittance: Vec3::ONE, has_layers: false }
    }

    #[inline(always)]
    fn accept_hit(&mut self, scene: &KernelScene<'_>, _: u32, instance: &InstanceRecord, candidate: &CandidateHit) {
        if is_layered(instance.flags) {
            self.has_layers = true;
            return;
        }
        let triangle = &scene.triangles[candidate.triangle as usize];
        self.transmittance *= candidate_transmittance(scene, instance, triangle, candidate.u, candidate.v);
        if max_component(self.transmittance) <= 0.0 {
            *self = Self { t_max: f32::NEG_INFINITY, transmittance: Vec3::ZERO, has_layers: false };
        }
    }

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.t_max
    }
}
