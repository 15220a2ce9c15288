//! Queries by region: what overlaps it.

use super::region::{Clipper, Containment, Region, TraversalRegion};
use super::{PlacedInstance, Queries, to_dvec3};
use crate::device::layout::Triangle;
use crate::graph::NodePath;

/// How much of a node's geometry must lie in a region.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Overlap {
    /// Some point of a triangle at least.
    Touching,
    /// Every triangle, entirely.
    Inside,
}

/// By region.
impl Queries<'_> {
    /// The nodes whose geometry overlaps the region, exactly: by triangles, not by boxes, where boxes do not decide it already.
    /// Only surfaces are asked: a region deep within a closed mesh touches nothing. A node that comes closer to the boundary
    /// than positions are rounded may be found or not. O(log triangles) for each node at the boundary, as a rule, and
    /// O(log instances) for each that lies well inside.
    pub fn overlapping(&self, region: &Region, overlap: Overlap) -> Vec<NodePath> {
        let world = TraversalRegion::relative(region, self.compiler.origin());
        let mut clipper = Clipper::default();
        let mut slots = Vec::new();
        let mut top = self.traverse_tlas();
        while let Some(leaf) = top.next_leaf(|node| world.classify_box(node) != Containment::Outside) {
            let Some((slot, instance)) = self.instance(leaf) else { continue };
            let is_found = world.classify_box(leaf) == Containment::Inside || {
                let placement = PlacedInstance::new(slot, instance);
                let local = world.transformed(&placement.world_from_local);
                match overlap {
                    Overlap::Touching => self.touches(&placement, &local, &mut clipper),
                    Overlap::Inside => self.is_inside(&placement, &local),
                }
            };
            if is_found {
                slots.push(slot);
            }
        }
        self.paths(slots)
    }

    /// Whether some triangle meets the region.
    fn touches(&self, placement: &PlacedInstance<'_>, region: &TraversalRegion, clipper: &mut Clipper) -> bool {
        let mut bottom = self.traverse_blas(placement);
        // A box that lies inside has triangles, which lie there too.
        let mut is_sure = false;
        let mut enter = |node: &_| {
            let side = region.classify_box(node);
            is_sure |= side == Containment::Inside;
            side == Containment::Intersecting && !is_sure
        };
        while let Some(leaf) = bottom.next_leaf(&mut enter) {
            let (_, triangles) = self.triangles(placement, leaf.primitives);
            if triangles.iter().any(|triangle| region.overlaps_triangle(corners(triangle), clipper)) {
                return true;
            }
        }
        is_sure
    }

    /// Whether every triangle lies in the region.
    fn is_inside(&self, placement: &PlacedInstance<'_>, region: &TraversalRegion) -> bool {
        let mut bottom = self.traverse_blas(placement);
        let mut is_out = false;
        let mut enter = |node: &_| {
            let side = region.classify_box(node);
            is_out |= side == Containment::Outside;
            side == Containment::Intersecting && !is_out
        };
        while let Some(leaf) = bottom.next_leaf(&mut enter) {
            let (_, triangles) = self.triangles(placement, leaf.primitives);
            if !triangles.iter().flat_map(corners).all(|corner| region.contains(corner)) {
                return false;
            }
        }
        !is_out
    }
}

fn corners(triangle: &Triangle) -> [glam::DVec3; 3] {
    [triangle.v0, triangle.v1, triangle.v2].map(to_dvec3)
}
