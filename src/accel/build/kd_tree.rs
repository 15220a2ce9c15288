//! The kd-tree: the top-down builder with spatial splits wherever one is possible.
//!
//! The planes are chosen by the SAH, and node boxes are clipped to their contents. Where the duplicate budget is used
//! up, object splits follow.

use super::binned_sah;
use super::coincident::CoincidentTriangles;
use super::spatial_split::SpatialSplits;
use crate::Cancel;
use crate::accel::tree::{BuildTree, PrimitiveReference, ReferenceBounds, SahParams};
use crate::graph::Geometry;

/// The duplicate budget as a fraction of the triangle count: leaves hold at most twice as many references as there are
/// triangles. A larger budget makes the tree worse (`docs/benchmarks/log.md`).
const DUPLICATE_BUDGET: f32 = 1.0;

/// Builds a kd-tree over `references`, whose bounds are `extent`. O(n log n).
pub(super) fn build(
    geometry: &Geometry,
    references: Vec<PrimitiveReference>,
    extent: &ReferenceBounds,
    params: &SahParams,
    coincident: &CoincidentTriangles<'_>,
    cancel: &Cancel,
) -> BuildTree {
    let splits = SpatialSplits::new(geometry, extent, references.len(), DUPLICATE_BUDGET);
    let splits = splits.map(|splits| SpatialSplits { spatial_only: true, ..splits });
    binned_sah::build(references, extent, params, splits, coincident, cancel)
}
