//! Ray queries.

use std::ops::ControlFlow;

use glam::DVec3;

use super::hit::{Hit, HitCandidate};
use super::intersect::{TraversalRay, TriangleIntersection};
use super::{PlacedInstance, Queries, require};
use crate::Result;
use crate::device::layout::{self, NONE, Triangle};
use crate::trace::kernel::{KernelScene, is_culled, is_cut_out, primary_hit};

/// A ray in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// The start of the ray; t is 0 there.
    pub origin: DVec3,
    /// The direction; any non-zero length.
    pub direction: DVec3,
    /// Hits at smaller t are ignored, in units of the direction's length; negative values include hits behind the
    /// origin.
    pub t_min: f64,
    /// Hits at larger t are ignored; may be infinite.
    pub t_max: f64,
}

impl Ray {
    /// A ray with t from 0 to infinity.
    pub fn new(origin: DVec3, direction: DVec3) -> Self {
        Self { origin, direction, t_min: 0.0, t_max: f64::INFINITY }
    }

    /// Validates the ray.
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) if the origin or the direction is not finite, the direction is
    /// zero, or a limit is NaN.
    pub fn validate(&self) -> Result<()> {
        require(self.origin.is_finite(), "ray origin", &self.origin, "finite")?;
        let is_direction = self.direction.is_finite() && self.direction != DVec3::ZERO;
        require(is_direction, "ray direction", &self.direction, "finite and not zero")?;
        let range = [self.t_min, self.t_max];
        require(range.iter().all(|t| !t.is_nan()), "ray interval", &range, "two numbers")
    }
}

/// How far around a hit of the kernel it is searched in f64, relative to t: 2^-14, many times the rounding of a t that
/// is not seen at a grazing angle.
const RELATIVE_SLACK: f64 = 1.0 / (1 << 14) as f64;

/// Ray queries, with the hit rules of camera rays.
///
/// Back faces of single-sided materials and the holes of an alpha mask are not hit; surfaces that blend or transmit
/// are. A ray exactly through a shared edge or vertex hits exactly one triangle per crossing of the surface; at a
/// silhouette edge it hits both or none. The rays of a frame are f32, and may differ within their rounding.
impl Queries<'_> {
    /// The closest hit. Ties are broken by lower instance index, then lower triangle index; at a ridge, the face that
    /// faces the ray is hit. O(log triangles) on average.
    ///
    /// # Errors
    /// As [`Ray::validate`].
    pub fn closest_hit(&self, ray: &Ray) -> Result<Option<Hit>> {
        ray.validate()?;
        Ok(self.closest_candidate(ray).and_then(|found| self.hit(&found)))
    }

    fn closest_candidate(&self, ray: &Ray) -> Option<HitCandidate> {
        let mut closest: Option<HitCandidate> = None;
        self.for_each_crossing(ray, |found| {
            if closest.is_none_or(|closest| found.order(&closest).is_lt()) {
                closest = Some(found);
            }
            ControlFlow::Continue(
                closest.map_or(ray.t_max, |closest| closest.greatest_distance_before().min(ray.t_max)),
            )
        });
        closest
    }

    /// Whether there is any hit; stops at the first one found. O(log triangles) on average.
    ///
    /// # Errors
    /// As [`Ray::validate`].
    pub fn any_hit(&self, ray: &Ray) -> Result<bool> {
        ray.validate()?;
        let mut any = false;
        self.for_each_crossing(ray, |_| {
            any = true;
            ControlFlow::Break(())
        });
        Ok(any)
    }

    /// All hits by distance, ties in the order that [`closest_hit`](Self::closest_hit) prefers. Of triangles of one
    /// geometry that [coincide](crate::accel::Blas::build) the first stands for all. O(log triangles + hits) on
    /// average.
    ///
    /// # Errors
    /// As [`Ray::validate`].
    pub fn all_hits(&self, ray: &Ray) -> Result<Vec<Hit>> {
        ray.validate()?;
        let mut all = Vec::new();
        self.for_each_crossing(ray, |found| {
            let instances = self.compiler.coincident_instances(found.instance_index);
            all.extend(instances.map(|instance_index| HitCandidate { instance_index, ..found }));
            ControlFlow::Continue(ray.t_max)
        });
        all.sort_unstable_by(HitCandidate::order);
        // A triangle that is in several leaves was found several times.
        all.dedup_by_key(|found| (found.instance_index, found.primitive));
        Ok(all.iter().filter_map(|found| self.hit(found)).collect())
    }

    /// The hit that a pixel shows, by the f32 kernel and its primary ray, relative to the render origin: picking agrees
    /// with the rendered pixel.
    pub(crate) fn hit_of_pixel(&self, primary: &layout::RayRecord) -> Option<Hit> {
        let hit = primary_hit(&mut &KernelScene::new(self.compiler.arrays()), primary, self.mask);
        self.hit_from_record(&hit, [hit.u, hit.v].map(f64::from), f64::from(hit.t))
    }

    /// The closest hit of a ray of which the kernel has found `hit`, at `t` in f64: the first one within the rounding
    /// of that, `rounding` being that of positions, in units of t. If there is none, or the triangle that was hit is
    /// elsewhere, the whole ray is traced again.
    pub(crate) fn closest_hit_near(
        &self,
        ray: &Ray,
        hit: &layout::HitRecord,
        t: f64,
        rounding: f64,
    ) -> Option<HitCandidate> {
        let slack = t.abs() * RELATIVE_SLACK + rounding;
        let near = Ray { t_min: ray.t_min.max(t - slack), t_max: ray.t_max.min(t + slack), ..*ray };
        let found = self.closest_candidate(&near).filter(|found| {
            let is_as_expected = (found.distance - t).abs() <= 0.5 * slack;
            is_as_expected || (found.instance_index, found.primitive) != (hit.instance, hit.primitive)
        });
        found.or_else(|| self.closest_candidate(ray))
    }

    /// Resolves a hit record of the kernel; `None` for a miss. `u` and `v` are the weights of the second and third
    /// vertex, `distance` is t in the units of the caller's ray.
    pub(crate) fn hit_from_record(&self, hit: &layout::HitRecord, [u, v]: [f64; 2], distance: f64) -> Option<Hit> {
        let found = HitCandidate {
            instance_index: hit.instance,
            triangle: hit.triangle,
            primitive: hit.primitive,
            barycentrics: DVec3::new(1.0 - u - v, u, v),
            distance,
            back_face: hit.back_face != 0,
        };
        if hit.instance == NONE { None } else { self.hit(&found) }
    }

    /// Calls `found` for every hit in the t range, in no particular order. It returns the new `t_max`, or stops the
    /// traversal.
    fn for_each_crossing(&self, ray: &Ray, mut found: impl FnMut(HitCandidate) -> ControlFlow<(), f64>) {
        let origin = self.relative(ray.origin);
        let world = TraversalRay::new(origin, ray.direction);
        let mut t_max = ray.t_max;
        // For each leaf of the TLAS: transform the ray to the instance's local space, without normalising it, so that t
        // means the same in both levels.
        let mut tlas = self.traverse_tlas();
        while let Some(leaf) = tlas.next_leaf(|node| world.intersects_box(node, ray.t_min, t_max)) {
            let Some(placement) = self.placement(leaf) else { continue };
            let local = TraversalRay::new(
                placement.local_from_world.transform_point3(origin),
                placement.local_from_world.transform_vector3(ray.direction),
            );
            // For each leaf of its BLAS: test the triangles.
            let mut blas = self.traverse_blas(&placement);
            while let Some(leaf) = blas.next_leaf(|node| local.intersects_box(node, ray.t_min, t_max)) {
                let (first, triangles) = self.triangles(&placement, leaf.primitives);
                for (index, triangle) in (first..).zip(triangles) {
                    let Some(crossing) = local.intersect_triangle(triangle) else { continue };
                    // Apply the t range and the hit rules.
                    let in_range = ray.t_min <= crossing.t && crossing.t <= t_max;
                    if !in_range || !self.is_accepted(&placement, triangle, &crossing) {
                        continue;
                    }
                    let TriangleIntersection { t, barycentrics, back_face } = crossing;
                    match found(HitCandidate {
                        instance_index: placement.instance_index,
                        triangle: index,
                        primitive: triangle.primitive,
                        barycentrics,
                        distance: t,
                        back_face,
                    }) {
                        ControlFlow::Continue(limit) => t_max = limit,
                        ControlFlow::Break(()) => return,
                    }
                }
            }
        }
    }

    /// Applies the kernel's hit rules for camera rays: back-face culling and alpha mask.
    fn is_accepted(
        &self,
        placement: &PlacedInstance<'_>,
        triangle: &Triangle,
        crossing: &TriangleIntersection,
    ) -> bool {
        let flags = placement.instance.flags;
        let candidate = layout::HitRecord {
            u: crossing.barycentrics.y as f32,
            v: crossing.barycentrics.z as f32,
            instance: placement.instance_index,
            primitive: triangle.primitive,
            back_face: u32::from(crossing.back_face),
            ..layout::HitRecord::MISS
        };
        let scene = KernelScene::new(self.compiler.arrays());
        !is_culled(&candidate, flags) && !is_cut_out(&scene, &candidate, flags)
    }
}
