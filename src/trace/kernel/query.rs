//! The rules of the ray queries: which candidate hits a query accepts, what it keeps of them, and when it is decided.
//! Twin of `shaders/shared/query.wgsl`.
//!
//! A *candidate* is a [`HitRecord`] of a triangle that the ray intersects within [`t_min`, `t_max`] and that no query
//! has accepted yet. Traversals offer candidates in any order; all executors apply the rules in this file, so that the
//! result depends on the order only in the rounding of a product of transmittances. WGSL has no traits: what is
//! `ClosestQuery::accept_hit` here is `accept_closest` there, and so on for each query.

use glam::Vec3;

use super::KernelScene;
use super::intersect::{TriangleHit, intersect_triangle, max_component, scaled_edges};
use super::material::{fails_alpha_test, surface_transmittance};
use super::math::{dot3, max, min, transform_vector};
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

/// Width of one step of the order in which a ray meets surfaces that touch, relative to t, for a surface at right
/// angles to the ray: 2^-19, more than twice the rounding of t.
pub(crate) const TOUCH_STEP: f32 = 1.0 / (1 << 19) as f32;
/// Greatest factor by which a step is wider where a surface is seen at a grazing angle, as the rounding of t is greater
/// there.
pub(crate) const MAX_GRAZING: f32 = 64.0;
/// Times a depth: the greatest t of a hit that may come before a hit at that depth.
pub(crate) const T_BEFORE_SCALE: f32 = 1.0 + 4.0 * TOUCH_STEP * MAX_GRAZING;
/// Times a depth: the least t of a hit that may come after a hit at that depth.
pub(crate) const T_AFTER_SCALE: f32 = 1.0 - 2.0 * TOUCH_STEP * MAX_GRAZING;
/// Barycentric weight up to which a hit counts as one on the edge of its triangle: the rounding of the weights.
pub(crate) const EDGE_WEIGHT: f32 = 1.0 / (1 << 22) as f32;

/// The place of a hit in the order in which a ray meets surfaces: by [depth](hit_depth), then by instance, then by
/// primitive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HitOrder {
    pub(crate) depth: f32,
    pub(crate) instance: u32,
    pub(crate) primitive: u32,
}

impl HitOrder {
    /// That of a hit; of [`HitRecord::MISS`] it is after all hits.
    #[inline(always)]
    pub(crate) fn of(hit: &HitRecord) -> Self {
        Self { depth: hit.depth, instance: hit.instance, primitive: hit.primitive }
    }

    #[inline(always)]
    pub(crate) fn is_before(&self, other: &Self) -> bool {
        if self.depth != other.depth {
            return self.depth < other.depth;
        }
        (self.instance, self.primitive) < (other.instance, other.primitive)
    }
}

/// The depth of a hit, by which hits are ordered: t, but that of a translucent surface is two [steps](TOUCH_STEP) less,
/// that of a back face one step more. So where surfaces touch, a translucent one (a label on a wall, glass on a table)
/// is met before an opaque one, and of the faces of a closed surface the one that faces the ray before the other.
/// Elsewhere that changes nothing. `direction` is the ray's in local space.
///
/// Only the ray and the triangle enter, so that the order is the same whatever else was visited, and in whatever order.
#[inline(always)]
pub(crate) fn hit_depth(hit: &TriangleHit, flags: u32, triangle: &Triangle, direction: Vec3) -> f32 {
    let steps = depth_steps(hit.back, flags);
    if steps == 0.0 {
        return hit.t;
    }
    hit.t + hit.t * (steps * TOUCH_STEP * GrazingPlane::of(triangle).grazing(direction))
}

/// By how many steps the depth of a hit differs from its t.
#[inline(always)]
pub(crate) fn depth_steps(is_back: bool, flags: u32) -> f32 {
    match (is_back, has_flags(flags, InstanceFlags::TRANSLUCENT)) {
        (false, false) => 0.0,
        (true, false) => 1.0,
        (false, true) => -2.0,
        (true, true) => -1.0,
    }
}

/// A triangle's normal, and the same with the absolute values of all products, scaled by a power of two: what bounds
/// the rounding of t (`intersect.rs`, point 5).
pub(crate) struct GrazingPlane {
    pub(crate) normal: Vec3,
    pub(crate) bound: Vec3,
}

impl GrazingPlane {
    #[inline(always)]
    pub(crate) fn of(triangle: &Triangle) -> Self {
        let [a, b] = scaled_edges(triangle);
        let plus = Vec3::new(a.y * b.z, a.z * b.x, a.x * b.y);
        let minus = Vec3::new(a.z * b.y, a.x * b.z, a.y * b.x);
        Self { normal: plus - minus, bound: plus.abs() + minus.abs() }
    }

    /// How much greater the rounding of t is along this direction than at right angles to a plane along two axes: about
    /// 1 over the cosine, at most [`MAX_GRAZING`].
    #[inline(always)]
    pub(crate) fn grazing(&self, direction: Vec3) -> f32 {
        let slope = dot3(self.normal, direction).abs();
        let bound = dot3(self.bound, direction.abs());
        if slope * MAX_GRAZING <= bound { MAX_GRAZING } else { bound / slope }
    }
}

/// Where a ray goes on: behind a hit that it has passed. The next hit is then the first one after that in the
/// [order](HitOrder) of hits, so that a ray through many layers meets each of them once, however close they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Continuation {
    pub(crate) passed: HitOrder,
    /// The greatest depth of what may be the surface that was passed once more.
    pub(crate) same_surface_end: f32,
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
        same_surface_end: -1.0,
        is_back: false,
        is_on_edge: false,
        only_opaque: false,
    };

    /// A ray of this direction that has passed a hit.
    pub(crate) fn behind(scene: &KernelScene<'_>, hit: &HitRecord, direction: Vec3) -> Self {
        let instance = &scene.instances[hit.instance as usize];
        let local_direction = transform_vector(&instance.local_from_world, direction);
        let plane = GrazingPlane::of(&scene.triangles[hit.triangle as usize]);
        let same_surface_end = hit.depth + hit.depth * (2.0 * TOUCH_STEP * plane.grazing(local_direction));
        let (is_back, is_on_edge) = (hit.back_face != 0, is_on_edge(hit));
        Self { passed: HitOrder::of(hit), same_surface_end, is_back, is_on_edge, only_opaque: false }
    }

    /// The least t of a hit that may come next.
    pub(crate) fn t_min(&self) -> f32 {
        max(self.passed.depth * T_AFTER_SCALE, 0.0)
    }

    /// Whether a hit comes after the one that was passed. A ray along an edge hits both of its triangles: the second
    /// one is the same surface once more, and does not count.
    #[inline(always)]
    pub(crate) fn is_before(&self, hit: &HitRecord) -> bool {
        let is_same_surface = hit.instance == self.passed.instance
            && (hit.back_face != 0) == self.is_back
            && hit.depth <= self.same_surface_end
            && (self.is_on_edge || is_on_edge(hit));
        self.passed.is_before(&HitOrder::of(hit)) && !is_same_surface
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
    /// The first of all candidates offered so far, or [`HitRecord::MISS`].
    pub(crate) hit: HitRecord,
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
        Self { start, hit: HitRecord::MISS, t_max }
    }

    /// Whether a candidate comes before the first hit so far, but after the one that the ray has passed.
    #[inline(always)]
    fn is_first(&self, candidate: &HitRecord) -> bool {
        HitOrder::of(candidate).is_before(&HitOrder::of(&self.hit)) && self.start.is_before(candidate)
    }

    /// Makes a candidate the first hit.
    #[inline(always)]
    fn keep(&mut self, candidate: &HitRecord) {
        self.hit = *candidate;
        self.t_max = min(self.t_max, candidate.depth * T_BEFORE_SCALE);
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
        if self.is_first(candidate)
            && !is_culled(candidate, flags)
            && !is_cut_out(scene, candidate, flags)
            && (!self.start.only_opaque || is_opaque_at(scene, candidate, flags))
        {
            self.keep(candidate);
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
    /// Whether a translucent triangle was hit on an edge, where its neighbour is hit too: then all translucent
    /// instances need the second pass, in which a surface counts once.
    pub(crate) has_edges: bool,
}

impl TransmittanceQuery {
    #[inline(always)]
    pub(crate) fn new(t_max: f32) -> Self {
        Self { t_max, transmittance: Vec3::ONE, has_layers: false, has_edges: false }
    }

    /// The transmittance of all instances. What was layered, or hit on an edge, takes further closest-hit traversals.
    #[inline(always)]
    pub(crate) fn with_layers(&self, scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> Vec3 {
        match (self.has_layers, self.has_edges) {
            (_, true) => transmittance_of_layers(scene, ray, InstanceFlags::TRANSLUCENT, ray_mask),
            (true, false) => self.transmittance * transmittance_of_layers(scene, ray, LAYERED, ray_mask),
            (false, false) => self.transmittance,
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
        if is_lit_from_behind(candidate, flags) {
            return;
        }
        self.has_edges |= has_flags(flags, InstanceFlags::TRANSLUCENT) && is_on_edge(candidate);
        self.transmittance *= candidate_transmittance(scene, candidate, flags);
        if max_component(self.transmittance) <= 0.0 {
            *self = Self { t_max: f32::NEG_INFINITY, transmittance: Vec3::ZERO, has_layers: false, has_edges: false };
        }
    }
}

/// Finds the first hit behind another one that dims light, of instances with certain flags: a [`ClosestQuery`] of only
/// these, which does not test alpha and culls as shadow rays do.
#[derive(Clone, Copy)]
pub(super) struct LayerQuery {
    pub(super) closest: ClosestQuery,
    /// The flags of the instances.
    pub(super) flags: InstanceFlags,
}

impl Query for LayerQuery {
    const ORDER: VisitOrder = VisitOrder::NearFirst;

    #[inline(always)]
    fn t_max(&self) -> f32 {
        self.closest.t_max
    }

    /// Never: an earlier layer may follow.
    #[inline(always)]
    fn is_decided(&self) -> bool {
        false
    }

    #[inline(always)]
    fn skips_instance(&mut self, flags: u32) -> bool {
        !has_flags(flags, self.flags)
    }

    #[inline(always)]
    fn accept_hit(&mut self, _: &KernelScene<'_>, candidate: &HitRecord, flags: u32) {
        if self.closest.is_first(candidate) && !is_lit_from_behind(candidate, flags) {
            self.closest.keep(candidate);
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
            let depth = hit_depth(&hit, ray.flags, triangle, ray.local_shear.direction);
            query.accept_hit(scene, &candidate_hit(ray.instance, index, triangle.primitive, &hit, depth), ray.flags);
            if query.is_decided() {
                return;
            }
        }
    }
}

/// A hit of triangle `triangle` of an instance as a candidate.
#[inline(always)]
pub(crate) fn candidate_hit(instance: u32, triangle: u32, primitive: u32, hit: &TriangleHit, depth: f32) -> HitRecord {
    let &TriangleHit { t, u, v, back } = hit;
    HitRecord { t, u, v, instance, primitive, triangle, back_face: u32::from(back), depth }
}

/// Whether a candidate is a back face of an instance whose back faces are culled.
#[inline(always)]
pub(crate) fn is_culled(candidate: &HitRecord, flags: u32) -> bool {
    candidate.back_face != 0 && has_flags(flags, InstanceFlags::CULL_BACK)
}

/// Whether light that travels against the ray, as that of a shadow ray does, meets the back of a single-sided triangle.
/// It passes, as sight does from there. The ray, which comes from the other side, hits the front.
#[inline(always)]
pub(crate) fn is_lit_from_behind(candidate: &HitRecord, flags: u32) -> bool {
    candidate.back_face == 0 && has_flags(flags, InstanceFlags::CULL_BACK)
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
    has_flags(flags, LAYERED)
}

/// The flags of a [layered](is_layered) instance.
pub(super) const LAYERED: InstanceFlags = InstanceFlags::TRANSLUCENT.union(InstanceFlags::HAS_DUPLICATES);

#[inline(always)]
fn has_flags(flags: u32, wanted: InstanceFlags) -> bool {
    InstanceFlags::from_bits_retain(flags).contains(wanted)
}
