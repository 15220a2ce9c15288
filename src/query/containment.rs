//! Queries by point: what contains it.

use glam::DVec3;

use super::intersect::TraversalRay;
use super::{PlacedInstance, Queries, require, to_dvec3};
use crate::Result;
use crate::device::layout::{Node, Triangle};
use crate::graph::NodePath;

/// A direction along no plane or diagonal that a model is likely to have. Any would do: crossings are counted exactly.
const PROBE_DIRECTION: DVec3 = DVec3::new(0.612_372_435, 0.267_261_241, 0.744_023_809);

/// By point: what it lies in.
impl Queries<'_> {
    /// The nodes whose world box contains the point, boundary included. The boxes are those of the acceleration structure:
    /// wider than the geometry by 2^-22 of their size and of their distance to the render origin, and by more where a matrix
    /// flattens. O(log instances + found) as a rule.
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) for a point that is not finite.
    pub fn boxes_containing(&self, point: DVec3) -> Result<Vec<NodePath>> {
        Ok(self.paths(self.instances_around(point)?.into_iter().map(|placement| placement.slot).collect()))
    }

    /// The nodes with a closed geometry that the point lies inside of: a ray from it crosses the triangles an odd number of
    /// times. Holes and culling do not count. A geometry with a boundary gives either answer, and so does a point closer to the
    /// surface than its rounding. O(log triangles) for each box that contains the point, as a rule.
    ///
    /// # Errors
    /// As [`boxes_containing`](Self::boxes_containing).
    pub fn solids_containing(&self, point: DVec3) -> Result<Vec<NodePath>> {
        let around = self.instances_around(point)?;
        let point = self.relative(point);
        let slots = around.into_iter().filter(|placement| self.encloses(placement, point));
        Ok(self.paths(slots.map(|placement| placement.slot).collect()))
    }

    /// The instances whose box contains the point.
    fn instances_around(&self, point: DVec3) -> Result<Vec<PlacedInstance<'_>>> {
        require(point.is_finite(), "point", &point, "finite")?;
        let point = self.relative(point);
        let contains = |node: &Node| to_dvec3(node.min).cmple(point).all() && to_dvec3(node.max).cmpge(point).all();
        let mut top = self.traverse_tlas();
        let leaves = std::iter::from_fn(|| top.next_leaf(contains));
        Ok(leaves.filter_map(|leaf| self.placement(leaf)).collect())
    }

    fn encloses(&self, placement: &PlacedInstance<'_>, point: DVec3) -> bool {
        let ray = TraversalRay::new(placement.local_from_world.transform_point3(point), PROBE_DIRECTION);
        let mut crossed = Vec::new();
        let mut bottom = self.traverse_blas(placement);
        while let Some(leaf) = bottom.next_leaf(|node| ray.intersects_box(node, 0.0, f64::INFINITY)) {
            let (_, triangles) = self.triangles(placement, leaf.primitives);
            let is_crossed =
                |triangle: &&Triangle| ray.intersect_triangle(triangle).is_some_and(|crossing| crossing.t > 0.0);
            crossed.extend(triangles.iter().filter(is_crossed).map(|triangle| triangle.primitive));
        }
        // A triangle that is in several leaves counts once.
        crossed.sort_unstable();
        crossed.dedup();
        crossed.len() % 2 == 1
    }
}
