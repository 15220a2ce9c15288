//! Region queries: the nodes whose geometry overlaps a convex region.

use super::region::{Clipper, Containment, Region, TraversalRegion};
use super::{PlacedInstance, Queries, to_dvec3};
use crate::device::layout::Triangle;
use crate::graph::NodePath;

/// How much of a node's geometry must lie in a region.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Overlap {
    /// At least one point of a triangle.
    Touching,
    /// Every triangle, completely.
    Inside,
}

/// Region queries.
impl Queries<'_> {
    /// The nodes whose geometry overlaps the region. The test is exact: triangles are tested where boxes do not decide
    /// already. Only surfaces are tested: a region strictly inside a closed mesh overlaps nothing. A node that comes
    /// closer to the boundary than the rounding of positions may be found or not. O(log triangles) on average for each
    /// node at the boundary, and O(log instances) for each that lies well inside.
    pub fn overlapping(&self, region: &Region, overlap: Overlap) -> Vec<NodePath> {
        let world = TraversalRegion::relative(region, self.compiler.origin());
        let mut clipper = Clipper::default();
        let mut instances = Vec::new();
        // For each leaf of the TLAS that is not outside: inside as a whole, or a traversal of its BLAS decides.
        let mut tlas = self.traverse_tlas();
        while let Some(leaf) = tlas.next_leaf(|node| world.classify_box(node) != Containment::Outside) {
            let Some((instance_index, instance)) = self.instance(leaf) else { continue };
            let is_found = world.classify_box(leaf) == Containment::Inside || {
                let Some(placement) = self.placed(instance_index, instance) else { continue };
                let local = world.transformed(&placement.world_from_local);
                match overlap {
                    Overlap::Touching => self.touches(&placement, &local, &mut clipper),
                    Overlap::Inside => self.is_inside(&placement, &local),
                }
            };
            if is_found {
                instances.push(instance_index);
            }
        }
        self.paths(instances)
    }

    /// Whether some triangle overlaps the region.
    fn touches(&self, placement: &PlacedInstance<'_>, region: &TraversalRegion, clipper: &mut Clipper) -> bool {
        let mut blas = self.traverse_blas(placement);
        // A box fully inside the region contains at least one triangle, so the answer is yes.
        let mut contains_a_box = false;
        let mut enter = |node: &_| {
            let containment = region.classify_box(node);
            contains_a_box |= containment == Containment::Inside;
            containment == Containment::Intersecting && !contains_a_box
        };
        while let Some(leaf) = blas.next_leaf(&mut enter) {
            let (_, triangles) = self.triangles(placement, leaf.primitives);
            if triangles.iter().any(|triangle| region.overlaps_triangle(corners(triangle), clipper)) {
                return true;
            }
        }
        contains_a_box
    }

    /// Whether every triangle lies in the region.
    fn is_inside(&self, placement: &PlacedInstance<'_>, region: &TraversalRegion) -> bool {
        let mut blas = self.traverse_blas(placement);
        // A box outside the region contains at least one triangle, so the answer is no.
        let mut has_box_outside = false;
        let mut enter = |node: &_| {
            let containment = region.classify_box(node);
            has_box_outside |= containment == Containment::Outside;
            containment == Containment::Intersecting && !has_box_outside
        };
        while let Some(leaf) = blas.next_leaf(&mut enter) {
            let (_, triangles) = self.triangles(placement, leaf.primitives);
            if !triangles.iter().flat_map(corners).all(|corner| region.contains(corner)) {
                return false;
            }
        }
        !has_box_outside
    }
}

fn corners(triangle: &Triangle) -> [glam::DVec3; 3] {
    [triangle.v0, triangle.v1, triangle.v2].map(to_dvec3)
}
