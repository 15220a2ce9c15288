//! Builders: from the boxes of primitives to a binary build tree.
//!
//! One file per builder. [`build_tree`] chooses the one that a [`BlasKind`] asks for: `agglomerative` merges neighbours
//! bottom up; `binned_sah` splits top down, by object splits (`object_bins`) and, given a duplicate budget, by spatial
//! splits (`spatial_split`); `kd_tree` is the top-down builder with spatial splits wherever one is possible;
//! `reinsertion` lowers the SAH cost of a finished tree.

pub(super) mod agglomerative;
mod binned_sah;
pub(super) mod coincident;
mod kd_tree;
mod object_bins;
mod partition;
mod reinsertion;
mod spatial_split;
mod triangle_clip;

use glam::Vec3;
use rayon::prelude::*;

use self::coincident::CoincidentTriangles;
use self::reinsertion::{ReinsertionParams, reinsert};
use self::spatial_split::SpatialSplits;
use super::degenerate::is_degenerate;
use super::tree::{BuildTree, PrimitiveReference, ReferenceBounds, SahParams};
use crate::graph::{BlasKind, Geometry, Quality};
use crate::math::Aabb;
use crate::{Cancel, Result};

/// The duplicate budget of spatial splits for [`Quality::High`], as a fraction of the triangle count. What a
/// larger one gains is in `docs/benchmarks/log.md`.
const HIGH_QUALITY_DUPLICATE_BUDGET: f32 = 0.3;
/// The reinsertion done for [`Quality::High`].
const HIGH_QUALITY_REINSERTION: ReinsertionParams = ReinsertionParams { iterations: 4, candidate_fraction: 0.1 };

/// Builds the tree of a structure over `references` to the triangles of `geometry`; their bounds are `extent`. Only the
/// tree of [`Quality::Low`] may be deeper than [`MAX_BLAS_DEPTH`](super::MAX_BLAS_DEPTH); building it leaves
/// `references` as they are but for those to coincident triangles, while the other builders take them. What is left out
/// of the tree because it coincides with something in it goes to `coincident`.
///
/// Builders look at the token at each large subtree, and leave the rest of the tree unfinished once it has stopped
/// them.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub(super) fn build_tree(
    geometry: &Geometry,
    references: &mut Vec<PrimitiveReference>,
    extent: &ReferenceBounds,
    structure: BlasKind,
    params: &SahParams,
    coincident: &CoincidentTriangles<'_>,
    cancel: &Cancel,
) -> Result<BuildTree> {
    let tree = build_tree_unless_cancelled(geometry, references, extent, structure, params, coincident, cancel);
    cancel.check()?;
    Ok(tree)
}

/// [`build_tree`], which is unfinished if the token has stopped it.
fn build_tree_unless_cancelled(
    geometry: &Geometry,
    references: &mut Vec<PrimitiveReference>,
    extent: &ReferenceBounds,
    structure: BlasKind,
    params: &SahParams,
    coincident: &CoincidentTriangles<'_>,
    cancel: &Cancel,
) -> BuildTree {
    // Low quality: agglomerative clustering.
    if structure == BlasKind::Bvh(Quality::Low) {
        return agglomerative::build_tree(references, coincident, cancel);
    }
    let references = std::mem::take(references);
    match structure {
        // Medium quality: object splits only.
        BlasKind::Bvh(Quality::Low | Quality::Medium) => {
            binned_sah::build(references, extent, params, None, coincident, cancel)
        }
        // High quality: object and spatial splits, then reinsertion.
        BlasKind::Bvh(Quality::High) => {
            let splits = SpatialSplits::new(geometry, extent, references.len(), HIGH_QUALITY_DUPLICATE_BUDGET);
            let mut tree = binned_sah::build(references, extent, params, splits, coincident, cancel);
            reinsert(&mut tree, HIGH_QUALITY_REINSERTION, cancel);
            tree
        }
        // A kd-tree: spatial splits wherever possible.
        BlasKind::KdTree => kd_tree::build(geometry, references, extent, params, coincident, cancel),
    }
}

/// Triangles per parallel chunk.
const CHUNK: usize = 1 << 13;

/// References to all triangles that can be hit, and their bounds.
pub(super) fn triangle_references(geometry: &Geometry) -> Result<(Vec<PrimitiveReference>, ReferenceBounds)> {
    if geometry.indices.len() > Geometry::MAX_TRIANGLES {
        geometry.validate()?;
    }
    // 1. Bound all triangles in parallel.
    let mut references: Vec<PrimitiveReference> = bytemuck::zeroed_vec(geometry.indices.len());
    let measured = references
        .par_chunks_mut(CHUNK)
        .enumerate()
        .map(|(chunk, references)| measure_triangles(geometry, chunk * CHUNK, references))
        .reduce(MeasuredTriangles::default, MeasuredTriangles::join);
    // 2. Report the first invalid index or coordinate.
    if !measured.valid {
        geometry.validate()?;
    }
    // 3. Remove degenerate triangles.
    for &primitive in measured.degenerate_triangles.iter().rev() {
        references.swap_remove(primitive);
    }
    Ok((references, measured.extent))
}

/// What a pass over a range of triangles found.
struct MeasuredTriangles {
    extent: ReferenceBounds,
    /// Indices of degenerate triangles, ascending; their references are zero and removed afterwards.
    degenerate_triangles: Vec<usize>,
    /// Whether all indices are in range and all corners finite.
    valid: bool,
}

impl Default for MeasuredTriangles {
    fn default() -> Self {
        Self { extent: ReferenceBounds::EMPTY, degenerate_triangles: Vec::new(), valid: true }
    }
}

impl MeasuredTriangles {
    fn join(mut self, mut next: Self) -> Self {
        self.degenerate_triangles.append(&mut next.degenerate_triangles);
        Self { extent: self.extent.union(next.extent), valid: self.valid && next.valid, ..self }
    }
}

/// Validates the triangles from index `first` on, and writes a reference to each that is not degenerate.
fn measure_triangles(geometry: &Geometry, first: usize, references: &mut [PrimitiveReference]) -> MeasuredTriangles {
    let mut measured = MeasuredTriangles::default();
    for (i, reference) in references.iter_mut().enumerate() {
        let primitive = first + i;
        let [a, b, c] =
            geometry.indices[primitive].map(|v| geometry.positions.get(v as usize).copied().unwrap_or(Vec3::NAN));
        measured.valid &= a.is_finite() && b.is_finite() && c.is_finite();
        if is_degenerate([a, b, c]) {
            measured.degenerate_triangles.push(primitive);
        } else {
            *reference =
                PrimitiveReference::new(&Aabb { min: a.min(b).min(c), max: a.max(b).max(c) }, primitive as u32);
            measured.extent = measured.extent.extended_by(reference);
        }
    }
    measured
}
