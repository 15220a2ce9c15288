//! Acceleration structures: bounding volume hierarchies as depth-first arrays with escape indices (paper, section 3).
//!
//! Two levels: a [`Blas`] over the triangles of each geometry, in local space, and one [`TopLevel`] over the instances,
//! in device world space. The first is built for good, by the builder that suits it ([`BuildParams::structure`]), and refitted
//! where its geometry deforms; the second is kept up with what moves, and when it is rebuilt, that is done fast (clustering). In
//! debug builds every result is [validated](Blas::validate).
//!
//! Builders make a binary build tree: `sah` from the top down, dividing primitives or cutting space, `agglomerate` from the bottom
//! up; `reinsert` makes one better. `flatten` turns it into device nodes with escape indices, `wide` into nodes of eight children.
//!
//! Guarantees, for any finite input:
//! - Every primitive is in exactly one leaf, or every part of it in one that holds it ([`Blas::repeats`]); each box contains,
//!   with a margin, what is below it, and is not flat.
//! - No bottom-level hierarchy is deeper than [`MAX_DEPTH`].
//! - The same input gives the same arrays, whatever the number of threads.

mod agglomerate;
mod bins;
mod blas;
mod clip;
mod cluster;
mod flatten;
mod partition;
mod refit;
mod reinsert;
mod sah;
mod spatial;
mod stats;
mod support;
mod top_level;
mod tree;
mod validate;
mod wide;
mod wide_refit;

pub use blas::{Blas, BuildParams};
pub use flatten::MAX_CHILDREN;
pub(crate) use refit::{Refitted, refit};
pub use sah::MAX_DEPTH;
pub use stats::Stats;
pub use support::Support;
pub use top_level::{Rebuild, TopLevel, Update};
pub use validate::StructureError;
pub use wide::MAX_WIDE_DEPTH;
