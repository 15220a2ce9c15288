//! Queries by ray.

use std::ops::ControlFlow;

use glam::DVec3;

use super::hit::{Hit, HitCandidate};
use super::intersect::{TraversalRay, TriangleIntersection};
use super::{PlacedInstance, Queries, require};
use crate::Result;
use crate::device::layout::{self, InstanceFlags, NONE, Triangle};
use crate::trace::kernel::{KernelScene, closest_hit, fails_alpha_test};

/// A ray in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts.
    pub origin: DVec3,
    /// Where it goes; any length but zero.
    pub direction: DVec3,
    /// What is nearer is passed over; in units of the direction's length. Below zero it looks back.
    pub t_min: f64,
    /// What is farther is passed over; may be infinite.
    pub t_max: f64,
}

impl Ray {
    /// From its origin on, without end.
    pub fn new(origin: DVec3, direction: DVec3) -> Self {
        Self { origin, direction, t_min: 0.0, t_max: f64::INFINITY }
    }

    /// Checks that it is one.
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange): an origin or direction that is not finite, a direction of zero, a limit
    /// that is not a number.
    pub fn validate(&self) -> Result<()> {
        require(self.origin.is_finite(), "ray origin", &self.origin, "finite")?;
        let points_somewhere = self.direction.is_finite() && self.direction != DVec3::ZERO;
        require(points_somewhere, "ray direction", &self.direction, "finite and not zero")?;
        let range = [self.t_min, self.t_max];
        require(range.iter().all(|t| !t.is_nan()), "ray interval", &range, "two numbers")
    }
}

/// By ray: what a camera ray sees.
///
/// Back faces of single-sided materials and the holes of an alpha mask are passed by; surfaces that blend or transmit are hit.
/// Where a ray runs exactly through an edge or a corner, one triangle there is hit for each time that the ray passes through the
/// surface; at a silhouette, which it only touches, both or none. A camera's own rays are f32, and differ within their rounding.
impl Queries<'_> {
    /// The hit of least distance; of equal ones that of the lower place in the `instances` array, then of the lower triangle.
    /// O(log triangles) as a rule.
    ///
    /// # Errors
    /// As [`Ray::validate`].
    pub fn closest_hit(&self, ray: &Ray) -> Result<Option<Hit>> {
        let mut closest: Option<HitCandidate> = None;
        self.for_each_crossing(ray, |found| {
            if closest.is_none_or(|closest| found.precedes(&closest)) {
                closest = Some(found);
            }
            ControlFlow::Continue(closest.map_or(ray.t_max, |closest| closest.distance))
        })?;
        Ok(closest.and_then(|found| self.hit(&found)))
    }

    /// Whether there is a hit: as soon as one is found. O(log triangles) as a rule.
    ///
    /// # Errors
    /// As [`Ray::validate`].
    pub fn any_hit(&self, ray: &Ray) -> Result<bool> {
        let mut any = false;
        self.for_each_crossing(ray, |_| {
            any = true;
            ControlFlow::Break(())
        })?;
        Ok(any)
    }

    /// Every hit, by distance; equal ones in the order that [`closest`](Self::closest_hit) prefers. O(log triangles + hits) as a
    /// rule.
    ///
    /// # Errors
    /// As [`Ray::validate`].
    pub fn all_hits(&self, ray: &Ray) -> Result<Vec<Hit>> {
        let mut all = Vec::new();
        self.for_each_crossing(ray, |found| {
            all.push(found);
            ControlFlow::Continue(ray.t_max)
        })?;
        all.sort_unstable_by(|a, b| {
            a.distance
                .total_cmp(&b.distance)
                .then((a.instance_index, a.primitive).cmp(&(b.instance_index, b.primitive)))
        });
        // A triangle that is in several leaves counts once.
        all.dedup_by_key(|found| (found.instance_index, found.primitive));
        Ok(all.iter().filter_map(|found| self.hit(found)).collect())
    }

    /// What the kernel hits by this ray of its own, which is relative to the render origin: the pixel's truth, tie or not.
    pub(crate) fn closest_hit_of_kernel(&self, ray: &layout::RayRecord) -> Option<Hit> {
        let hit = closest_hit(&KernelScene::new(self.compiler.arrays()), ray, self.mask);
        self.hit_from_record(&hit, f64::from(hit.t))
    }

    /// What the kernel hit, at a distance in the ray's own terms.
    pub(crate) fn hit_from_record(&self, hit: &layout::HitRecord, distance: f64) -> Option<Hit> {
        let (u, v) = (f64::from(hit.u), f64::from(hit.v));
        let found = HitCandidate {
            instance_index: hit.instance,
            triangle: hit.triangle,
            primitive: hit.primitive,
            barycentrics: DVec3::new(1.0 - u - v, u, v),
            distance,
            back: hit.back_face != 0,
        };
        if hit.instance == NONE { None } else { self.hit(&found) }
    }

    /// Finds what the ray meets in no particular order. `found` says how far it is of interest from then on.
    fn for_each_crossing(&self, ray: &Ray, mut found: impl FnMut(HitCandidate) -> ControlFlow<(), f64>) -> Result<()> {
        ray.validate()?;
        let origin = self.relative(ray.origin);
        let world = TraversalRay::new(origin, ray.direction);
        let mut t_max = ray.t_max;
        let mut top = self.traverse_tlas();
        while let Some(leaf) = top.next_leaf(|node| world.intersects_box(node, ray.t_min, t_max)) {
            let Some(placement) = self.placement(leaf) else { continue };
            let local = TraversalRay::new(
                placement.local_from_world.transform_point3(origin),
                placement.local_from_world.transform_vector3(ray.direction),
            );
            let mut bottom = self.traverse_blas(&placement);
            while let Some(leaf) = bottom.next_leaf(|node| local.intersects_box(node, ray.t_min, t_max)) {
                let (first, triangles) = self.triangles(&placement, leaf.primitives);
                for (index, triangle) in (first..).zip(triangles) {
                    let Some(crossing) = local.intersect_triangle(triangle) else { continue };
                    let in_range = ray.t_min <= crossing.t && crossing.t <= t_max;
                    if !in_range || !self.is_accepted(&placement, triangle, &crossing) {
                        continue;
                    }
                    let TriangleIntersection { t, weights, back } = crossing;
                    let (slot, primitive) = (placement.slot, triangle.primitive);
                    match found(HitCandidate {
                        instance_index: slot,
                        triangle: index,
                        primitive,
                        barycentrics: weights,
                        distance: t,
                        back,
                    }) {
                        ControlFlow::Continue(limit) => t_max = limit,
                        ControlFlow::Break(()) => return Ok(()),
                    }
                }
            }
        }
        Ok(())
    }

    /// Whether a camera ray would stop here: the kernel's rules.
    fn is_accepted(
        &self,
        placement: &PlacedInstance<'_>,
        triangle: &Triangle,
        crossing: &TriangleIntersection,
    ) -> bool {
        let instance = placement.instance;
        let flags = InstanceFlags::from_bits_retain(instance.flags);
        if crossing.back && flags.contains(InstanceFlags::CULL_BACK) {
            return false;
        }
        let [u, v] = [crossing.weights.y, crossing.weights.z].map(|weight| weight as f32);
        let scene = KernelScene::new(self.compiler.arrays());
        !(flags.contains(InstanceFlags::ALPHA_MASK) && fails_alpha_test(&scene, instance, triangle.primitive, u, v))
    }
}
