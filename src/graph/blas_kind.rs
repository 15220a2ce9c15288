//! Which acceleration structure a geometry gets.

use serde::{Deserialize, Serialize};

/// The kind of a bottom-level structure, of one geometry. Every kind ends in the same arrays, so that geometries beside each
/// other can have different ones (the paper's hybrid structures). What is seen is the same with all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum BlasKind {
    /// A bounding volume hierarchy.
    Bvh(Quality),
    /// A kd-tree: space is cut in two again and again, and a triangle is in every cell that it reaches into. It takes the most
    /// memory and time to build.
    KdTree,
}

impl Default for BlasKind {
    fn default() -> Self {
        Self::Bvh(Quality::default())
    }
}

/// How good a bounding volume hierarchy is, against how long it takes to build.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Quality {
    /// Built in the least time: for what changes every few frames.
    Low,
    /// For what changes now and then.
    #[default]
    Medium,
    /// Traced in the least time, with some triangles in several leaves: for what stays as it is.
    High,
}
