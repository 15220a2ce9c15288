//! The nearest point on geometry: branch and bound over both levels.

use glam::DVec3;

use super::hit::{Hit, HitCandidate, interpolate};
use super::{PlacedInstance, Queries, require, to_dvec3};
use crate::Result;
use crate::device::layout::{Node, Triangle};

/// By distance.
impl Queries<'_> {
    /// The point nearest to `point` of all geometry, if it is no farther than `max_distance`, which may be infinite. Distances are
    /// the world's, whatever scales and shears an instance. Of points equally far, one of the lower place in the `instances`
    /// array, then of the lower triangle.
    ///
    /// O(log triangles) as a rule. Boxes of sheared instances bound distances less well, and boxes that are all as far (a
    /// point at the centre of a sphere) not at all.
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) for a point that is not finite, or a distance that is negative or not a
    /// number.
    pub fn nearest(&self, point: DVec3, max_distance: f64) -> Result<Option<Hit>> {
        require(point.is_finite(), "point", &point, "finite")?;
        require(max_distance >= 0.0, "greatest distance", &max_distance, "at least 0")?;
        let mut search = NearestSearch { queries: self, point: self.relative(point), max_distance, nearest: None };
        // 1. What is likely to be near: a first bound.
        if let Some(leaf) = self.traverse_tlas().descend_to_nearest_leaf(|node| search.distance(node)) {
            search.search_nearest_leaf(leaf);
        }
        // 2. Whatever may be nearer.
        let mut top = self.traverse_tlas();
        while let Some(leaf) = top.next_leaf(|node| search.distance(node) <= search.current_radius()) {
            search.search_instance(leaf);
        }
        Ok(search.nearest.and_then(|found| self.hit(&found)))
    }
}

/// Far above the rounding of a distance, relative to what it is computed from.
const DISTANCE_ERROR_BOUND: f64 = 1e-12;

struct NearestSearch<'a> {
    queries: &'a Queries<'a>,
    /// Relative to the render origin.
    point: DVec3,
    max_distance: f64,
    nearest: Option<HitCandidate>,
}

impl NearestSearch<'_> {
    /// How far it is to what is of interest.
    fn current_radius(&self) -> f64 {
        self.nearest.map_or(self.max_distance, |nearest| nearest.distance)
    }

    /// How far it is to a box of the top level.
    fn distance(&self, node: &Node) -> f64 {
        self.point.distance(self.point.clamp(to_dvec3(node.min), to_dvec3(node.max)))
    }

    /// Looks at one leaf of the instance only.
    fn search_nearest_leaf(&mut self, leaf: &Node) {
        let Some(placement) = self.queries.placement(leaf) else { return };
        let local = PointInInstance::new(&placement, self.point);
        if let Some(leaf) = self.queries.traverse_blas(&placement).descend_to_nearest_leaf(|node| local.distance(node))
        {
            self.search_leaf(&placement, leaf);
        }
    }

    fn search_instance(&mut self, leaf: &Node) {
        let Some(placement) = self.queries.placement(leaf) else { return };
        let local = PointInInstance::new(&placement, self.point);
        let mut bottom = self.queries.traverse_blas(&placement);
        while let Some(leaf) = bottom.next_leaf(|node| local.distance(node) <= self.current_radius()) {
            self.search_leaf(&placement, leaf);
        }
    }

    /// Compares with the triangles of a leaf.
    fn search_leaf(&mut self, placement: &PlacedInstance<'_>, leaf: &Node) {
        let (first, triangles) = self.queries.triangles(placement, leaf.primitives);
        for (index, triangle) in (first..).zip(triangles) {
            let (weights, distance, back) = nearest_on(placement, triangle, self.point);
            let (slot, primitive) = (placement.slot, triangle.primitive);
            let found = HitCandidate {
                instance_index: slot,
                triangle: index,
                primitive,
                barycentrics: weights,
                distance,
                back,
            };
            if distance <= self.current_radius() && self.nearest.is_none_or(|nearest| found.precedes(&nearest)) {
                self.nearest = Some(found);
            }
        }
    }
}

/// A point, seen from an instance.
struct PointInInstance<'a> {
    placement: &'a PlacedInstance<'a>,
    world: DVec3,
    local: DVec3,
}

impl<'a> PointInInstance<'a> {
    fn new(placement: &'a PlacedInstance<'a>, world: DVec3) -> Self {
        Self { placement, world, local: placement.local_from_world.transform_point3(world) }
    }

    /// A lower bound of the world distance to a box of the bottom level: how far the plane is that touches the box in the
    /// direction of its locally nearest point. Exact but for instances that are sheared.
    fn distance(&self, node: &Node) -> f64 {
        let [min, max] = [to_dvec3(node.min), to_dvec3(node.max)];
        let nearest = self.local.clamp(min, max);
        let world_from_local = &self.placement.world_from_local;
        let away = self.world - world_from_local.transform_point3(nearest);
        let length = away.length();
        if length == 0.0 {
            return 0.0;
        }
        // How far the box reaches beyond that point towards ours.
        let along = world_from_local.matrix3.transpose() * (away / length);
        let reach = (along * (min - nearest)).max(along * (max - nearest)).element_sum();
        // Less by what rounding may have added: what lies exactly at the limit is found.
        (length - reach - (length + reach.abs()) * DISTANCE_ERROR_BOUND).max(0.0)
    }
}

/// Whether a point is behind a triangle, both in local space: there the winding says which side is the front, and an
/// instance that is nearly flat in the world is not.
fn is_behind([a, b, c]: [DVec3; 3], point: DVec3) -> bool {
    (b - a).cross(c - a).dot(point - a) < 0.0
}

/// The weights of the point of a triangle that is nearest to one of the world, how far it is, and whether that is behind.
fn nearest_on(placement: &PlacedInstance<'_>, triangle: &Triangle, point: DVec3) -> (DVec3, f64, bool) {
    // Relative to the point, which is then the origin.
    let local = [triangle.v0, triangle.v1, triangle.v2].map(to_dvec3);
    let corners = local.map(|corner| placement.world_from_local.transform_point3(corner) - point);
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a);
    let back = is_behind(local, placement.local_from_world.transform_point3(point));

    // Above the triangle, or nearest to an edge: a triangle without area has edges, too.
    let [of_b, of_c] =
        [normal.dot((c - a).cross(a)), normal.dot(a.cross(b - a))].map(|area| area / normal.length_squared());
    let inside = DVec3::new(1.0 - of_b - of_c, of_b, of_c);
    let mut weights = nearest_on_edge(a, b).extend(0.0);
    let mut distance = interpolate(corners, weights).length();
    let [bc, ca] = [nearest_on_edge(b, c), nearest_on_edge(c, a)];
    let others = [DVec3::new(0.0, bc.x, bc.y), DVec3::new(ca.y, 0.0, ca.x), inside];
    for other in others.into_iter().filter(|weights| weights.min_element() >= 0.0) {
        let other_distance = interpolate(corners, other).length();
        if other_distance < distance {
            (weights, distance) = (other, other_distance);
        }
    }
    (weights, distance, back)
}

/// The weights of an edge's ends at its point nearest to the origin.
fn nearest_on_edge(a: DVec3, b: DVec3) -> glam::DVec2 {
    let edge = b - a;
    let share = (-a.dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
    let share = if share.is_nan() { 0.0 } else { share };
    glam::DVec2::new(1.0 - share, share)
}
