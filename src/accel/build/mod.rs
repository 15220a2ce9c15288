//! Builders: from the boxes of primitives to a binary build tree.
//!
//! One file a builder. [`build_tree`] picks the one that a [`BlasKind`] asks for: `agglomerative` merges neighbours from the
//! bottom up; `binned_sah` divides primitives from the top down and, given a budget for them, takes spatial splits
//! (`spatial_split`); `kd_tree` is the top-down builder with spatial splits alone; `reinsertion` improves a finished tree.

pub(super) mod agglomerative;
mod binned_sah;
mod kd_tree;
mod object_bins;
mod partition;
mod reinsertion;
mod spatial_split;
mod triangle_clip;

use glam::Vec3;
use rayon::prelude::*;

pub use self::binned_sah::MAX_BLAS_DEPTH;
use self::reinsertion::{ReinsertionParams, reinsert};
use self::spatial_split::SpatialSplits;
use super::tree::{BuildTree, PrimitiveReference, ReferenceBounds};
use crate::Result;
use crate::graph::{BlasKind, Geometry, Quality};
use crate::math::Aabb;

/// What the surface area heuristic weighs.
#[derive(Clone, Copy)]
pub(super) struct SahParams {
    /// The most primitives in a leaf.
    pub(super) max_leaf_size: usize,
    /// Cost of testing a primitive, in units of fetching a node and testing its box.
    pub(super) primitive_cost: f32,
}

/// For [`Quality::High`], how many references spatial splits may add, as a share of the geometry's triangles. More of them hardly
/// improve the tree (`docs/BENCHMARKS.md`).
const BEST_DUPLICATE_BUDGET: f32 = 0.3;
/// For [`Quality::High`], how much reinsertion is done.
const HIGH_QUALITY_REINSERTION: ReinsertionParams = ReinsertionParams { rounds: 4, share: 0.1 };

/// Builds the tree of a structure over references to the triangles of `geometry`; `extent` is that of all of them. Only the
/// tree of [`Quality::Low`] may be deeper than [`MAX_BLAS_DEPTH`]; it leaves the references as they are, the others take them.
pub(super) fn build_tree(
    geometry: &Geometry,
    references: &mut Vec<PrimitiveReference>,
    extent: &ReferenceBounds,
    structure: BlasKind,
    params: &SahParams,
) -> BuildTree {
    if structure == BlasKind::Bvh(Quality::Low) {
        return agglomerative::build_tree(references);
    }
    let references = std::mem::take(references);
    match structure {
        BlasKind::Bvh(Quality::Low | Quality::Medium) => binned_sah::build(references, extent, params, None),
        BlasKind::Bvh(Quality::High) => {
            let splits = SpatialSplits::new(geometry, extent, references.len(), BEST_DUPLICATE_BUDGET);
            let mut tree = binned_sah::build(references, extent, params, splits);
            reinsert(&mut tree, HIGH_QUALITY_REINSERTION);
            tree
        }
        BlasKind::KdTree => kd_tree::build(geometry, references, extent, params),
    }
}

/// Triangles that one thread takes at a time.
const CHUNK: usize = 1 << 13;

/// The boxes of all triangles that can be hit.
pub(super) fn triangle_references(geometry: &Geometry) -> Result<(Vec<PrimitiveReference>, ReferenceBounds)> {
    if geometry.indices.len() > Geometry::MAX_TRIANGLES {
        geometry.validate()?;
    }
    let mut references: Vec<PrimitiveReference> = bytemuck::zeroed_vec(geometry.indices.len());
    let measured = references
        .par_chunks_mut(CHUNK)
        .enumerate()
        .map(|(chunk, references)| measure_triangles(geometry, chunk * CHUNK, references))
        .reduce(MeasuredTriangles::default, MeasuredTriangles::join);
    if !measured.valid {
        geometry.validate()?;
    }
    for &primitive in measured.degenerate_triangles.iter().rev() {
        references.swap_remove(primitive);
    }
    Ok((references, measured.extent))
}

/// What is known of a run of triangles.
struct MeasuredTriangles {
    extent: ReferenceBounds,
    /// Triangles with equal corners, ascending; their references mean nothing.
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

fn measure_triangles(geometry: &Geometry, first: usize, references: &mut [PrimitiveReference]) -> MeasuredTriangles {
    let mut measured = MeasuredTriangles::default();
    for (i, reference) in references.iter_mut().enumerate() {
        let primitive = first + i;
        let [a, b, c] =
            geometry.indices[primitive].map(|v| geometry.positions.get(v as usize).copied().unwrap_or(Vec3::NAN));
        measured.valid &= a.is_finite() && b.is_finite() && c.is_finite();
        if a == b || b == c || c == a {
            measured.degenerate_triangles.push(primitive);
        } else {
            *reference =
                PrimitiveReference::new(&Aabb { min: a.min(b).min(c), max: a.max(b).max(c) }, primitive as u32);
            measured.extent = measured.extent.extended_by(reference);
        }
    }
    measured
}
