//! Builders: from the boxes of primitives to a binary build tree.
//!
//! One file a builder. [`build_tree`] picks the one that a [`Structure`] asks for: `agglomerative` merges neighbours from the
//! bottom up; `binned_sah` divides primitives from the top down and, given a budget for them, takes spatial splits
//! (`spatial_split`); `kd_tree` is the top-down builder with spatial splits alone; `reinsertion` improves a finished tree.

pub(super) mod agglomerative;
mod binned_sah;
mod bins;
mod clip;
mod kd_tree;
mod partition;
mod reinsertion;
mod spatial_split;

use glam::Vec3;
use rayon::prelude::*;

pub use self::binned_sah::MAX_DEPTH;
use self::reinsertion::{Effort, reinsert};
use self::spatial_split::SpatialSplits;
use super::tree::{BuildTree, Extent, Reference};
use crate::Result;
use crate::graph::{Geometry, Quality, Structure};
use crate::math::Aabb;

/// What the surface area heuristic weighs.
#[derive(Clone, Copy)]
pub(super) struct SahParams {
    /// The most primitives in a leaf.
    pub(super) max_leaf_size: usize,
    /// Cost of testing a primitive, in units of fetching a node and testing its box.
    pub(super) primitive_cost: f32,
}

/// For [`Quality::Best`], how many references spatial splits may add, as a share of the geometry's triangles. More of them hardly
/// improve the tree (`docs/BENCHMARKS.md`).
const BEST_DUPLICATE_BUDGET: f32 = 0.3;
/// For [`Quality::Best`], how much reinsertion is done.
const BEST_EFFORT: Effort = Effort { rounds: 4, share: 0.1 };

/// Builds the tree of a structure over references to the triangles of `geometry`; `extent` is that of all of them. Only the
/// tree of [`Quality::Fast`] may be deeper than [`MAX_DEPTH`]; it leaves the references as they are, the others take them.
pub(super) fn build_tree(
    geometry: &Geometry,
    references: &mut Vec<Reference>,
    extent: &Extent,
    structure: Structure,
    params: &SahParams,
) -> BuildTree {
    if structure == Structure::Bvh(Quality::Fast) {
        return agglomerative::build_tree(references);
    }
    let references = std::mem::take(references);
    match structure {
        Structure::Bvh(Quality::Fast | Quality::Balanced) => binned_sah::build(references, extent, params, None),
        Structure::Bvh(Quality::Best) => {
            let splits = SpatialSplits::new(geometry, extent, references.len(), BEST_DUPLICATE_BUDGET);
            let mut tree = binned_sah::build(references, extent, params, splits);
            reinsert(&mut tree, BEST_EFFORT);
            tree
        }
        Structure::KdTree => kd_tree::build(geometry, references, extent, params),
    }
}

/// Triangles that one thread takes at a time.
const CHUNK: usize = 1 << 13;

/// The boxes of all triangles that can be hit.
pub(super) fn references(geometry: &Geometry) -> Result<(Vec<Reference>, Extent)> {
    if geometry.indices.len() > Geometry::MAX_TRIANGLES {
        geometry.validate()?;
    }
    let mut references: Vec<Reference> = bytemuck::zeroed_vec(geometry.indices.len());
    let measured = references
        .par_chunks_mut(CHUNK)
        .enumerate()
        .map(|(chunk, references)| measure(geometry, chunk * CHUNK, references))
        .reduce(Measured::default, Measured::join);
    if !measured.valid {
        geometry.validate()?;
    }
    for &primitive in measured.without_area.iter().rev() {
        references.swap_remove(primitive);
    }
    Ok((references, measured.extent))
}

/// What is known of a run of triangles.
struct Measured {
    extent: Extent,
    /// Triangles with equal corners, ascending; their references mean nothing.
    without_area: Vec<usize>,
    /// Whether all indices are in range and all corners finite.
    valid: bool,
}

impl Default for Measured {
    fn default() -> Self {
        Self { extent: Extent::EMPTY, without_area: Vec::new(), valid: true }
    }
}

impl Measured {
    fn join(mut self, mut next: Self) -> Self {
        self.without_area.append(&mut next.without_area);
        Self { extent: self.extent.union(next.extent), valid: self.valid && next.valid, ..self }
    }
}

fn measure(geometry: &Geometry, first: usize, references: &mut [Reference]) -> Measured {
    let mut measured = Measured::default();
    for (i, reference) in references.iter_mut().enumerate() {
        let primitive = first + i;
        let [a, b, c] =
            geometry.indices[primitive].map(|v| geometry.positions.get(v as usize).copied().unwrap_or(Vec3::NAN));
        measured.valid &= a.is_finite() && b.is_finite() && c.is_finite();
        if a == b || b == c || c == a {
            measured.without_area.push(primitive);
        } else {
            *reference = Reference::new(&Aabb { min: a.min(b).min(c), max: a.max(b).max(c) }, primitive as u32);
            measured.extent = measured.extent.with(reference);
        }
    }
    measured
}
