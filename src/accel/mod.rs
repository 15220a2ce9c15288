//! Acceleration structures: bounding volume hierarchies as depth-first arrays with escape indices (paper, section 3).
//!
//! Two levels: a [`Blas`] over the triangles of each geometry, in local space, and one [`Tlas`] over the instances,
//! in device world space. The first is built for good, by the builder that suits it ([`BlasBuildParams::structure`]), and refitted
//! where its geometry deforms; the second is kept up with what moves, and when it is rebuilt, that is done fast (clustering). In
//! debug builds every result is [validated](Blas::validate).
//!
//! Builders make a binary build tree: `sah` from the top down, dividing primitives or cutting space, `agglomerate` from the bottom
//! up; `reinsert` makes one better. `flatten` turns it into device nodes with escape indices, `wide` into nodes of eight children.
//!
//! Guarantees, for any finite input:
//! - Every primitive is in exactly one leaf, or every part of it in one that holds it ([`Blas::has_duplicates`]); each box contains,
//!   with a margin, what is below it, and is not flat.
//! - No bottom-level hierarchy is deeper than [`MAX_BLAS_DEPTH`].
//! - The same input gives the same arrays, whatever the number of threads.

mod blas;
mod build;
mod padding;
mod stats;
mod support;
mod tlas;
mod tree;
mod validate;

pub use blas::{Blas, BlasBuildParams, MAX_CHILDREN, MAX_WIDE_DEPTH};
pub(crate) use blas::{RefitReport, refit};
pub use build::MAX_BLAS_DEPTH;
pub use stats::BvhStats;
pub use support::SupportFunction;
pub use tlas::{RebuildReason, Tlas, TlasUpdate};
pub use validate::BvhError;
