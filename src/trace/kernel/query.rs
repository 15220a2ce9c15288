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
use super::math::{max, min};
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

/// Relative width of one step of the order in which a ray meets surfaces that touch, see [`HitOrder`]: 2^-19, about
/// twice the rounding of t of a plane that is not seen at grazing angles.
pub(crate) const TOUCH_STEP: f32 = 1.0 / (1 << 19) as f32;
/// Barycentric weight up to which a hit counts as one on the edge of its triangle: the rounding of the weights.
pub(crate) const EDGE_WEIGHT: f32 = 1.0 / (1 << 22) as f32;

/// The place of a hit in the order in which a ray meets surfaces: by depth, then by instance, then by primitive. Depth
/// is t, but that of a translucent surface is two [steps](TOUCH_STEP) less, that of a back face one step more. So where
/// surfaces touch, a translucent one (a label on a wall, glass on a table) is met before an opaque one, and of the
/// faces of a closed surface the one that faces the ray before the other. Elsewhere that changes nothing.
///
/// Only the ray and the triangle enter, so that the order is the same whatever else was visited, and in whatever order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HitOrder {
    pub(crate) depth: f32,
    pub(crate) instance: u32,
    pub(crate) primitive: u32,
}

impl HitOrder {
    /// After all hits.
    pub(crate) const LAST: Self = Self { depth: f32::MAX, instance: NONE, primitive: NONE };

    #[inline(always)]
    pub(crate) fn of(hit: &HitRecord, flags: u32) -> Self {
        let depth = hit.t * depth_scale(hit.back_face != 0, flags);
        Self { depth, instance: hit.instance, primitive: hit.primitive }
    }

    #[inline(always)]
    pub(crate) fn is_before(&self, other: &Self) -> bool {
        if self.depth != other.depth {
            return self.depth < other.depth;
        }
        (self.instance, self.primitive) < (other.instance, other.primitive)
    }
}

/// The depth of a hit over its t.
#[inline(always)]
pub(crate) fn depth_scale(is_back: bool, flags: u32) -> f32 {
    match (is_back, has_flags(flags, InstanceFlags::TRANSLUCENT)) {
        (false, false) => 1.0,
        (true, false) => 1.0 + TOUCH_STEP,
        (false, true) => 1.0 - 2.0 * TOUCH_STEP,
        (true, true) => 1.0 - TOUCH_STEP,
    }
}

/// Times a depth: the greatest t of a hit that may come before a hit at that depth.
pub(crate) const T_BEFORE_SCALE: f32 = 1.0 + 4.0 * TOUCH_STEP;
/// Times the depth of the hit that was passed: the greatest depth of what may be the same surface once more.
pub(crate) const SAME_SURFACE_SCALE: f32 = 1.0 + 2.0 * TOUCH_STEP;

/// Where a ray goes on: behind a hit that it has passed. The next hit is then the first one after that in the
/// [order](HitOrder) of hits, so that a ray through many layers meets each of them once, however close they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Continuation {
    pub(crate) passed: HitOrder,
    /// Whether the hit that was passed was a back face, and whether it was on an edge of its triangle.
    pub(crate) is_back: bool,
    pub(crate) is_on_edge: bool,
    /// Whether the ray passes all translucent surfaces.
    pub(crate) only_opaque: bool,
}

impl Continuation {
    /// A ray that has passed nothing yet.
    pub(crate) const START: Self = Self {
        passed: HitOrder { depth: -1.0, instance: NONE, primitive: NONE },
        is_back: false,
        is_on_edge: false,
        only_opaque: false,
    };

    /// A ray that has passed a hit of an instance with these flags.
    pub(crate) fn behind(hit: &HitRecord, flags: u32) -> Self {
        let (is_back, is_on_edge) = (hit.back_face != 0, is_on_edge(hit));
        Self { passed: HitOrder::of(hit, flags), is_back, is_on_edge, only_opaque: false }
    }

    /// The least t of a hit that may come next.
    pub(crate) fn t_min(&self) -> f32 {
        max(self.passed.depth * (1.0 - 2.0 * TOUCH_STEP), 0.0)
    }

    /// Whether a hit comes after the one that was passed. A ray along an edge hits both of its triangles: the second
    /// one is the same surface once more, and does not count.
    #[inline(always)]
    pub(crate) fn is_before(&self, hit: &HitRecord, order: &HitOrder) -> bool {
        let is_same_surface = hit.instance == self.passed.instance
            && (hit.back_face != 0) == self.is_back
            && order.depth <= self.passed.depth * SAME_SURFACE_SCALE
            && (self.is_on_edge || is_on_edge(hit));
        self.passed.is_before(order) && !is_same_surface
    }
}

/// Whether a hit is on an edge of its triangle, to within rounding.
#[inline(always)]
fn is_on_edge(hit: &HitRecord) -> bool {
    min(min(hit.u, hit.v), (1.0 - hit.u) - hit.v) <= EDGE_WEIGHT
}

/// State of [`closest_hit`](super::closest_hit).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClosestQuery {
    /// Where the ray goes on.
    pub(crate) start: Continuation,
    /// The first hit so far; before one is found its `instance` is [`NONE`].
    pub(crate) hit: HitRecord,
    /// The depth of `hit`.
    pub(crate) depth: f32,
    /// The greatest t of a hit that may come before `hit`, or the ray's `t_max`.
    pub(crate) t_max: f32,
}

impl ClosestQuery {
    /// For the first hit of a ray.
    #[inline(always)]
    pub(crate) fn new(t_max: f32) -> Self {
        Self::behind(t_max, Continuation::START)
    }

    /// For the first hit of a ray that goes on.
    #[inline(always)]
    pub(crate) fn behind(t_max: f32, start: Continuation) -> Self {
        Self { start, hit: HitRecord::MISS, depth: HitOrder::LAST.depth, t_max }
    }

    /// The first of all candidates offered, or [`HitRecord::MISS`].
    #[inline(always)]
    pub(crate) fn result(&self) -> HitRecord {
        self.hit
    }

    /// The place of the first hit so far, after all hits before one is found.
    #[inline(always)]
    pub(crate) fn first(&self) -> HitOrder {
        HitOrder { depth: self.depth, instance: self.hit.instance, primitive: self.hit.primitive }
    }

    /// Whether a candidate comes before the first hit so far, but after the one that the ray has passed.
    #[inline(always)]
    fn is_first(&self, candidate: &HitRecord, order: &HitOrder) -> bool {
        order.is_before(&self.first()) && self.start.is_before(candidate, order)
    }

    /// Makes a candidate the first hit.
    #[inline(always)]
    fn keep(&mut self, candidate: &HitRecord, order: &HitOrder) {
        (self.hit, self.depth) = (*candidate, order.depth);
        self.t_max = min(self.t_max, order.depth * T_BEFORE_SCALE);
    }
}

impl Query for ClosestQuery {
    const ORDER: VisitOrder = VisitOrder::NearFirst;

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.t_max
    }

    /// Never: an earlier hit may follow.
    #[inline(always)]
    fn is_decided(&self) -> bool {
        false
    }

    #[inline(always)]
    fn accept_hit(&mut self, scene: &KernelScene<'_>, candidate: &HitRecord, flags: u32) {
        let order = HitOrder::of(candidate, flags);
        if self.is_first(candidate, &order)
            && !is_culled(candidate, flags)
            && !is_cut_out(scene, candidate, flags)
            && (!self.start.only_opaque || is_opaque_at(scene, candidate, flags))
        {
            self.keep(candidate, &order);
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

/// Finds the first hit of a [layered](is_layered) instance behind another one: a [`ClosestQuery`] of only these, which
/// neither culls nor tests alpha.
#[derive(Clone, Copy)]
pub(super) struct LayerQuery(pub(super) ClosestQuery);

impl Query for LayerQuery {
    const ORDER: VisitOrder = VisitOrder::NearFirst;

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.0.t_max
    }

    /// Never: an earlier layer may follow.
    #[inline(always)]
    fn is_decided(&self) -> bool {
        false
    }

    #[inline(always)]
    fn skips_instance(&mut self, flags: u32) -> bool {
        !is_layered(flags)
    }

    #[inline(always)]
    fn accept_hit(&mut self, _: &KernelScene<'_>, candidate: &HitRecord, flags: u32) {
        let order = HitOrder::of(candidate, flags);
        if self.0.is_first(candidate, &order) {
            self.0.keep(candidate, &order);
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
