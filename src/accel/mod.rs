//! Acceleration structures: hierarchies of boxes (BVHs and kd-trees) as depth-first arrays with escape indices (paper,
//! section 3).
//!
//! Two levels: a [`Blas`] (bottom-level acceleration structure) over the triangles of each geometry, in the geometry's
//! local space, and one [`Tlas`] (top level) over the instances, in device world space. A `Blas` is built with the
//! builder that its geometry asks for ([`BlasBuildParams::structure`]) and refitted when the geometry deforms. The
//! `Tlas` is patched or refitted when instances change, and rebuilt by a fast builder (clustering along a Morton curve)
//! when its SAH cost has grown too much. Debug builds [validate](Blas::validate) every result.
//!
//! Builders make a binary build tree (`tree`): `build::binned_sah` top down, with object and spatial splits;
//! `build::agglomerative` bottom up. `build::reinsertion` then lowers the SAH cost of a finished tree. `blas::prune`
//! decides which nodes are kept, `blas::flatten` writes them as binary device nodes in depth-first order with escape
//! indices, and `blas::collapse` as 8-wide nodes.
//!
//! Guarantees, for any finite input:
//! - Every primitive that can be hit is in exactly one leaf, but of triangles that coincide only the first. With
//!   spatial splits ([`Blas::has_duplicates`]) it may be in several leaves instead, whose boxes together cover it. Each
//!   node's box contains everything below it with a margin for rounding, and has a positive extent along every axis.
//! - No bottom-level hierarchy is deeper than [`MAX_BLAS_DEPTH`], no top-level one that is built here than
//!   [`Tlas::MAX_DEPTH`].
//! - The same input gives the same arrays, whatever the number of threads.

mod blas;
mod build;
mod degenerate;
mod padding;
mod stats;
mod support;
mod tlas;
mod tree;
mod validate;

pub use blas::{Blas, BlasBuildParams, MAX_CHILDREN, MAX_WIDE_DEPTH};
pub(crate) use blas::{RefitReport, refit};
pub(crate) use build::coincident::MergedTriangles;
pub(crate) use padding::SIDE_MARGIN;
pub use stats::BvhStats;
pub use support::SupportFunction;
pub use tlas::{RebuildReason, Tlas, TlasUpdate};
pub use tree::MAX_BLAS_DEPTH;
pub use validate::{BoxFault, BvhError};
