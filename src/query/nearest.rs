//! Nearest-point queries: branch and bound over both levels.

use glam::DVec3;

use super::hit::{Hit, HitCandidate, interpolate};
use super::{PlacedInstance, Queries, require, to_dvec3};
use crate::Result;
use crate::device::layout::{Node, Triangle};

/// Nearest-point queries.
impl Queries<'_> {
    /// The point of all geometry that is nearest to `point`, if its distance is at most `max_distance`, which may be
    /// infinite. Distances are measured in world space, whatever the scale or shear of an instance. Ties are broken by
    /// lower instance index, then lower triangle index.
    ///
    /// O(log triangles) on average. Sheared instances give weaker bounds; a point equidistant from all boxes (the
    /// centre of a sphere) degenerates to O(n).
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) for a point that is not finite, or a distance that is negative
    /// or not a number.
    pub fn nearest(&self, point: DVec3, max_distance: f64) -> Result<Option<Hit>> {
        require(point.is_finite(), "point", &point, "finite")?;
        require(max_distance >= 0.0, "greatest distance", &max_distance, "at least 0")?;
        let mut search = NearestSearch { queries: self, point: self.relative(point), max_distance, nearest: None };
        // 1. Greedy descent to one leaf for an initial bound.
        if let Some(leaf) = self.traverse_tlas().descend_to_nearest_leaf(|node| search.distance(node)) {
            search.search_nearest_leaf(leaf);
        }
        // 2. Branch and bound: visit every box closer than the best distance so far.
        let mut tlas = self.traverse_tlas();
        while let Some(leaf) = tlas.next_leaf(|node| search.distance(node) <= search.current_radius()) {
            search.search_instance(leaf);
        }
        Ok(search.nearest.and_then(|found| self.hit(&found)))
    }
}

/// Relative safety margin of a lower bound, far above f64 rounding.
const DISTANCE_ERROR_BOUND: f64 = 1e-12;

/// The state of one nearest-point query.
struct NearestSearch<'a> {
    queries: &'a Queries<'a>,
    /// Relative to the render origin.
    point: DVec3,
    max_distance: f64,
    nearest: Option<HitCandidate>,
}

impl NearestSearch<'_> {
    /// Current search radius: the best distance so far, or `max_distance`.
    fn current_radius(&self) -> f64 {
        self.nearest.map_or(self.max_distance, |nearest| nearest.distance)
    }

    /// The distance to a box of the TLAS.
    fn distance(&self, node: &Node) -> f64 {
        self.point.distance(self.point.clamp(to_dvec3(node.min), to_dvec3(node.max)))
    }

    /// Tests one leaf of the instance: that of a greedy descent.
    fn search_nearest_leaf(&mut self, leaf: &Node) {
        let Some(placement) = self.queries.placement(leaf) else { return };
        let local = PointInInstance::new(&placement, self.point);
        if let Some(leaf) = self.queries.traverse_blas(&placement).descend_to_nearest_leaf(|node| local.distance(node))
        {
            self.search_leaf(&placement, leaf);
        }
    }

    /// Tests every leaf of the instance that may be closer than the best distance so far.
    fn search_instance(&mut self, leaf: &Node) {
        let Some(placement) = self.queries.placement(leaf) else { return };
        let local = PointInInstance::new(&placement, self.point);
        let mut blas = self.queries.traverse_blas(&placement);
        while let Some(leaf) = blas.next_leaf(|node| local.distance(node) <= self.current_radius()) {
            self.search_leaf(&placement, leaf);
        }
    }

    /// Tests the triangles of a leaf.
    fn search_leaf(&mut self, placement: &PlacedInstance<'_>, leaf: &Node) {
        let (first, triangles) = self.queries.triangles(placement, leaf.primitives);
        for (index, triangle) in (first..).zip(triangles) {
            let (barycentrics, distance, back_face) = nearest_on(placement, triangle, self.point);
            let found = HitCandidate {
                instance_index: placement.instance_index,
                triangle: index,
                primitive: triangle.primitive,
                barycentrics,
                distance,
                back_face,
            };
            if distance <= self.current_radius() && self.nearest.is_none_or(|nearest| found.is_nearer(&nearest)) {
                self.nearest = Some(found);
            }
        }
    }
}

/// The query point in world space and in the local space of an instance.
struct PointInInstance<'a> {
    placement: &'a PlacedInstance<'a>,
    world: DVec3,
    local: DVec3,
}

impl<'a> PointInInstance<'a> {
    fn new(placement: &'a PlacedInstance<'a>, world: DVec3) -> Self {
        Self { placement, world, local: placement.local_from_world.transform_point3(world) }
    }

    /// Lower bound of the world distance to a BLAS box: the distance to the supporting plane of the box perpendicular
    /// to the direction towards the point nearest in local space. Exact without shear.
    fn distance(&self, node: &Node) -> f64 {
        // 1. The point of the box that is nearest in local space, and the world direction from it to the query point.
        let [min, max] = [to_dvec3(node.min), to_dvec3(node.max)];
        let nearest = self.local.clamp(min, max);
        let world_from_local = &self.placement.world_from_local;
        let away = self.world - world_from_local.transform_point3(nearest);
        let length = away.length();
        if length == 0.0 {
            return 0.0;
        }
        // 2. How far the box extends beyond that point in this direction.
        let along = world_from_local.matrix3.transpose() * (away / length);
        let reach = (along * (min - nearest)).max(along * (max - nearest)).element_sum();
        // 3. The distance to the supporting plane, less a margin for rounding, so that a point exactly at the limit is
        //    found.
        (length - reach - (length + reach.abs()) * DISTANCE_ERROR_BOUND).max(0.0)
    }
}

/// Whether a point is behind a triangle. Both are in local space, because winding defines the front side there, and
/// because an instance that is nearly flat in world space is not flat there.
fn is_behind([a, b, c]: [DVec3; 3], point: DVec3) -> bool {
    (b - a).cross(c - a).dot(point - a) < 0.0
}

/// The barycentric coordinates of the point of a triangle that is nearest to a world position, the distance, and
/// whether the position is on the back side.
fn nearest_on(placement: &PlacedInstance<'_>, triangle: &Triangle, point: DVec3) -> (DVec3, f64, bool) {
    // 1. Move the query point to the origin.
    let local = [triangle.v0, triangle.v1, triangle.v2].map(to_dvec3);
    let corners = local.map(|corner| placement.world_from_local.transform_point3(corner) - point);
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a);
    let back_face = is_behind(local, placement.local_from_world.transform_point3(point));

    // 2. Candidates: the projection onto the triangle's plane, and the nearest point of each edge (a triangle whose
    //    normal rounds to zero has only edges).
    let [of_b, of_c] =
        [normal.dot((c - a).cross(a)), normal.dot(a.cross(b - a))].map(|area| area / normal.length_squared());
    let inside = DVec3::new(1.0 - of_b - of_c, of_b, of_c);
    let mut weights = nearest_on_edge(a, b).extend(0.0);
    let mut distance = interpolate(corners, weights).length();
    let [bc, ca] = [nearest_on_edge(b, c), nearest_on_edge(c, a)];
    let others = [DVec3::new(0.0, bc.x, bc.y), DVec3::new(ca.y, 0.0, ca.x), inside];
    // 3. The nearest of those that lie in the triangle.
    for other in others.into_iter().filter(|weights| weights.min_element() >= 0.0) {
        let other_distance = interpolate(corners, other).length();
        if other_distance < distance {
            (weights, distance) = (other, other_distance);
        }
    }
    (weights, distance, back_face)
}

/// The weights of the two ends of an edge at its point nearest to the origin.
fn nearest_on_edge(a: DVec3, b: DVec3) -> glam::DVec2 {
    let edge = b - a;
    let share = (-a.dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
    let share = if share.is_nan() { 0.0 } else { share };
    glam::DVec2::new(1.0 - share, share)
}
