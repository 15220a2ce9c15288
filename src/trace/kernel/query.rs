//! The rules of the ray queries: which candidate hits a query accepts, what it keeps of them, and when it is decided.
//! Twin of `shaders/shared/query.wgsl`.
//!
//! A *candidate* is a [`HitRecord`] of a triangle that the ray intersects within [`t_min`, `t_max`] and that no query
//! has accepted yet. Traversals offer candidates in any order; all executors apply the rules in this file, so that the
//! result depends on the order only in the rounding of a product of transmittances. WGSL has no traits: what is
//! `ClosestQuery::accept_hit` here is `accept_closest` there, and so on for each query.

use glam::Vec3;

use super::KernelScene;
use super::intersect::{TriangleHit, intersect_triangle, max_component};
use super::material::{fails_alpha_test, surface_transmittance};
use super::traversal_state::TraversalRay;
use super::traverse::transmittance_of_layers;
use crate::device::layout::{HitRecord, InstanceFlags, NONE, RayRecord, Triangle};

/// The order in which a traversal visits nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum VisitOrder {
    /// Near nodes first, so that hits shorten the ray early.
    NearFirst,
    /// The order of least cost a node, as an early hit does not shorten the ray.
    Any,
}

/// The state of one ray's query, to which a traversal offers candidates.
pub(crate) trait Query: Copy {
    /// The order in which candidates are best found.
    const ORDER: VisitOrder;

    /// The distance beyond which candidates cannot change the result.
    fn t_max(&self) -> f32;

    /// Whether no further candidate can change the result.
    fn is_decided(&self) -> bool {
        self.t_max() == f32::NEG_INFINITY
    }

    /// Whether the query ignores all triangles of an instance with these flags. To be called before
    /// [`accept_hit`](Self::accept_hit), per leaf or per candidate.
    #[inline(always)]
    fn skips_instance(&mut self, _flags: u32) -> bool {
        false
    }

    /// Offers a candidate of an instance with these flags.
    fn accept_hit(&mut self, scene: &KernelScene<'_>, candidate: &HitRecord, flags: u32);
}

/// State of [`closest_hit`](super::closest_hit).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClosestQuery {
    /// The closest hit so far; before the first one `t` is the ray's `t_max` and `instance` is [`NONE`].
    pub(crate) hit: HitRecord,
}

impl ClosestQuery {
    #[inline(always)]
    pub(crate) fn new(t_max: f32) -> Self {
        Self { hit: HitRecord { t: t_max, ..HitRecord::MISS } }
    }

    /// The closest of all candidates offered, or [`HitRecord::MISS`].
    #[inline(always)]
    pub(crate) fn result(&self) -> HitRecord {
        if self.hit.instance == NONE { HitRecord::MISS } else { self.hit }
    }
}

impl Query for ClosestQuery {
    const ORDER: VisitOrder = VisitOrder::NearFirst;

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.hit.t
    }

    /// Never: a closer hit may follow.
    #[inline(always)]
    fn is_decided(&self) -> bool {
        false
    }

    #[inline(always)]
    fn accept_hit(&mut self, scene: &KernelScene<'_>, candidate: &HitRecord, flags: u32) {
        if is_before(candidate, &self.hit) && !is_culled(candidate, flags) && !is_cut_out(scene, candidate, flags) {
            self.hit = *candidate;
        }
    }
}

/// State of [`any_hit`](super::any_hit).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AnyQuery {
    /// [`f32::NEG_INFINITY`] after a hit.
    pub(crate) t_max: f32,
    pub(crate) is_hit: bool,
}

impl AnyQuery {
    #[inline(always)]
    pub(crate) fn new(t_max: f32) -> Self {
        Self { t_max, is_hit: false }
    }
}

impl Query for AnyQuery {
    const ORDER: VisitOrder = VisitOrder::Any;

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.t_max
    }

    #[inline(always)]
    fn accept_hit(&mut self, scene: &KernelScene<'_>, candidate: &HitRecord, flags: u32) {
        if is_opaque_at(scene, candidate, flags) {
            *self = Self { t_max: f32::NEG_INFINITY, is_hit: true };
        }
    }
}

/// State of [`transmittance`](super::transmittance).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TransmittanceQuery {
    /// [`f32::NEG_INFINITY`] after an opaque candidate.
    pub(crate) t_max: f32,
    /// The product over the candidates of all instances that are not layered.
    pub(crate) transmittance: Vec3,
    /// Whether a [layered](is_layered) instance was skipped; those need a second pass, see [`Self::with_layers`].
    pub(crate) has_layers: bool,
}

impl TransmittanceQuery {
    #[inline(always)]
    pub(crate) fn new(t_max: f32) -> Self {
        Self { t_max, transmittance: Vec3::ONE, has_layers: false }
    }

    /// The transmittance of all instances: multiplies by that of the layered ones, which takes further closest-hit
    /// traversals.
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
    const ORDER: VisitOrder = VisitOrder::Any;

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.t_max
    }

    /// Skips layered instances, and notes that there are any.
    #[inline(always)]
    fn skips_instance(&mut self, flags: u32) -> bool {
        let skips = is_layered(flags);
        self.has_layers |= skips;
        skips
    }

    #[inline(always)]
    fn accept_hit(&mut self, scene: &KernelScene<'_>, candidate: &HitRecord, flags: u32) {
        self.transmittance *= candidate_transmittance(scene, candidate, flags);
        if max_component(self.transmittance) <= 0.0 {
            *self = Self { t_max: f32::NEG_INFINITY, transmittance: Vec3::ZERO, has_layers: false };
        }
    }
}

/// Finds the first hit of a [layered](is_layered) instance after another one, in the order of t, instance and
/// primitive.
#[derive(Clone, Copy)]
pub(super) struct LayerQuery {
    /// The layer before.
    last: HitRecord,
    /// The first hit after `last` so far; before one is found `t` is the ray's `t_max` and `instance` is [`NONE`].
    pub(super) hit: HitRecord,
}

impl LayerQuery {
    pub(super) fn new(t_max: f32, last: HitRecord) -> Self {
        Self { last, hit: HitRecord { t: t_max, ..HitRecord::MISS } }
    }
}

impl Query for LayerQuery {
    const ORDER: VisitOrder = VisitOrder::NearFirst;

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.hit.t
    }

    /// Never: a closer layer may follow.
    #[inline(always)]
    fn is_decided(&self) -> bool {
        false
    }

    #[inline(always)]
    fn skips_instance(&mut self, flags: u32) -> bool {
        !is_layered(flags)
    }

    #[inline(always)]
    fn accept_hit(&mut self, _: &KernelScene<'_>, candidate: &HitRecord, _: u32) {
        if is_before(&self.last, candidate) && is_before(candidate, &self.hit) {
            self.hit = *candidate;
        }
    }
}

/// Tests the triangles of a leaf of the instance that `ray` is in, and offers the hits in [`t_min`, `t_max`] to a
/// query. `first` is the index of the first of `triangles` in the scene.
#[inline(always)]
pub(crate) fn intersect_leaf(
    scene: &KernelScene<'_>,
    ray: &TraversalRay,
    first: u32,
    triangles: &[Triangle],
    query: &mut impl Query,
) {
    for (index, triangle) in (first..).zip(triangles) {
        let Some(hit) = intersect_triangle(&ray.local_shear, triangle) else { continue };
        // Clip to the part of the ray that can still change the result.
        if hit.t >= ray.t_min && hit.t <= query.t_max() {
            query.accept_hit(scene, &candidate_hit(ray.instance, index, triangle.primitive, &hit), ray.flags);
            if query.is_decided() {
                return;
            }
        }
    }
}

/// A hit of triangle `triangle` of an instance as a candidate.
#[inline(always)]
pub(crate) fn candidate_hit(instance: u32, triangle: u32, primitive: u32, hit: &TriangleHit) -> HitRecord {
    let &TriangleHit { t, u, v, back } = hit;
    HitRecord { t, u, v, instance, primitive, triangle, back_face: u32::from(back), ..HitRecord::MISS }
}

/// Whether one hit comes before another: the nearer one; of hits at equal t the one of the lower instance, then the
/// lower primitive.
#[inline(always)]
pub(crate) fn is_before(a: &HitRecord, b: &HitRecord) -> bool {
    if a.t != b.t {
        return a.t < b.t;
    }
    (a.instance, a.primitive) < (b.instance, b.primitive)
}

/// Whether a candidate is a back face of an instance whose back faces are culled.
#[inline(always)]
pub(crate) fn is_culled(candidate: &HitRecord, flags: u32) -> bool {
    candidate.back_face != 0 && has_flags(flags, InstanceFlags::CULL_BACK)
}

/// Alpha test: whether a candidate lies in a hole of an alpha-masked material.
#[inline(always)]
pub(crate) fn is_cut_out(scene: &KernelScene<'_>, candidate: &HitRecord, flags: u32) -> bool {
    if !has_flags(flags, InstanceFlags::ALPHA_MASK) {
        return false;
    }
    let instance = &scene.instances[candidate.instance as usize];
    fails_alpha_test(scene, instance, candidate.primitive, candidate.u, candidate.v)
}

/// Whether a candidate stops all light.
#[inline(always)]
pub(crate) fn is_opaque_at(scene: &KernelScene<'_>, candidate: &HitRecord, flags: u32) -> bool {
    max_component(candidate_transmittance(scene, candidate, flags)) <= 0.0
}

/// The transmittance of a candidate per colour channel: 0 unless its instance is translucent.
#[inline(always)]
pub(crate) fn candidate_transmittance(scene: &KernelScene<'_>, candidate: &HitRecord, flags: u32) -> Vec3 {
    if !has_flags(flags, InstanceFlags::TRANSLUCENT) {
        return Vec3::ZERO;
    }
    let instance = &scene.instances[candidate.instance as usize];
    surface_transmittance(scene, instance, candidate.primitive, candidate.u, candidate.v)
}

/// Whether an instance is layered: translucent, and with triangles that several leaves refer to. A traversal may offer
/// a hit of it more than once, but it must dim light once, so it is traversed hit by hit in order of t.
#[inline(always)]
pub(crate) fn is_layered(flags: u32) -> bool {
    has_flags(flags, InstanceFlags::TRANSLUCENT | InstanceFlags::HAS_DUPLICATES)
}

#[inline(always)]
fn has_flags(flags: u32, wanted: InstanceFlags) -> bool {
    InstanceFlags::from_bits_retain(flags).contains(wanted)
}
