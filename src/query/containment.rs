//! Point containment queries.

use glam::DVec3;

use super::intersect::TraversalRay;
use super::{PlacedInstance, Queries, require, to_dvec3};
use crate::Result;
use crate::device::layout::{Node, Triangle};
use crate::graph::NodePath;

/// An arbitrary direction that avoids axis-aligned faces and diagonals, and so degenerate cases. Correctness does not
/// depend on it: crossings are counted exactly.
const PROBE_DIRECTION: DVec3 = DVec3::new(0.612_372_435, 0.267_261_241, 0.744_023_809);

/// Point containment.
impl Queries<'_> {
    /// The nodes whose world box contains the point, boundary included. The boxes are those of the acceleration
    /// structure: wider than the geometry by 2^-18 of their size, 2^-22 of their distance to the render origin, and by
    /// more if a matrix is nearly singular. O(log instances + found) on average.
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) for a point that is not finite.
    pub fn boxes_containing(&self, point: DVec3) -> Result<Vec<NodePath>> {
        Ok(self.paths(self.instances_around(point)?.into_iter().map(|placement| placement.instance_index).collect()))
    }

    /// The nodes with a closed geometry that contains the point: a ray from it crosses the triangles an odd number of
    /// times, triangles that [coincide](crate::accel::Blas::build) once. Alpha masks and culling are ignored. The
    /// result is unspecified for geometry that is not closed, and for a point closer to the surface than the rounding
    /// of positions. O(log triangles) on average for each box that contains the point.
    ///
    /// # Errors
    /// As [`boxes_containing`](Self::boxes_containing).
    pub fn solids_containing(&self, point: DVec3) -> Result<Vec<NodePath>> {
        let around = self.instances_around(point)?;
        let point = self.relative(point);
        let containing = around.into_iter().filter(|placement| self.is_inside_solid(placement, point));
        Ok(self.paths(containing.map(|placement| placement.instance_index).collect()))
    }

    /// The instances whose box contains the point.
    fn instances_around(&self, point: DVec3) -> Result<Vec<PlacedInstance<'_>>> {
        require(point.is_finite(), "point", &point, "finite")?;
        let point = self.relative(point);
        let contains = |node: &Node| to_dvec3(node.min).cmple(point).all() && to_dvec3(node.max).cmpge(point).all();
        let mut tlas = self.traverse_tlas();
        let leaves = std::iter::from_fn(|| tlas.next_leaf(contains));
        Ok(leaves.filter_map(|leaf| self.placement(leaf)).collect())
    }

    /// Whether a ray from the point crosses the instance's triangles an odd number of times.
    fn is_inside_solid(&self, placement: &PlacedInstance<'_>, point: DVec3) -> bool {
        let ray = TraversalRay::new(placement.local_from_world.transform_point3(point), PROBE_DIRECTION);
        // 1. Collect the triangles that the ray crosses.
        let mut crossed = Vec::new();
        let mut blas = self.traverse_blas(placement);
        while let Some(leaf) = blas.next_leaf(|node| ray.intersects_box(node, 0.0, f64::INFINITY)) {
            let (_, triangles) = self.triangles(placement, leaf.primitives);
            let is_crossed =
                |triangle: &&Triangle| ray.intersect_triangle(triangle).is_some_and(|crossing| crossing.t > 0.0);
            crossed.extend(triangles.iter().filter(is_crossed).map(|triangle| triangle.primitive));
        }
        // 2. Count each once, in however many leaves it is.
        crossed.sort_unstable();
        crossed.dedup();
        crossed.len() % 2 == 1
    }
}
