//! The kd-tree: the top-down builder with spatial splits alone.
//!
//! Each node is a cell of space, cut down to what is in it, and each plane is the surface area heuristic's. Where the budget for
//! duplicated references is used up, primitives are divided instead.

use super::SahParams;
use super::binned_sah;
use super::spatial_split::SpatialSplits;
use crate::accel::tree::{BuildTree, PrimitiveReference, ReferenceBounds};
use crate::graph::Geometry;

/// How many references spatial splits may add, as a share of the geometry's triangles: leaves then hold no more than twice as many.
/// More of them make the tree worse (`docs/BENCHMARKS.md`).
const DUPLICATE_BUDGET: f32 = 1.0;

/// Builds a kd-tree over references; `extent` is that of all of them. O(n log n).
pub(super) fn build(
    geometry: &Geometry,
    references: Vec<PrimitiveReference>,
    extent: &ReferenceBounds,
    params: &SahParams,
) -> BuildTree {
    let splits = SpatialSplits::new(geometry, extent, references.len(), DUPLICATE_BUDGET);
    let splits = splits.map(|splits| SpatialSplits { spatial_only: true, ..splits });
    binned_sah::build(references, extent, params, splits)
}
