//! Which acceleration structure a geometry gets.

use serde::{Deserialize, Serialize};

/// Which acceleration structure (BLAS) is built for a geometry. All kinds are flattened into the same node format, so
/// that kinds can be mixed in one scene (the paper's hybrid structures), and all give the same hits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum BlasKind {
    /// A bounding volume hierarchy.
    Bvh(Quality),
    /// A kd-tree with SAH split planes: a triangle is referenced by every cell that it overlaps, up to twice the
    /// triangles in total; nodes are the cells clipped to their content. Highest memory use and build time.
    KdTree,
}

impl Default for BlasKind {
    fn default() -> Self {
        Self::Bvh(Quality::default())
    }
}

/// Build quality of a bounding volume hierarchy: trace speed against build time (as Embree's `RTC_BUILD_QUALITY`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Quality {
    /// Fastest build; for geometry that changes every few frames.
    Low,
    /// Default; for geometry that changes occasionally.
    #[default]
    Medium,
    /// Fastest traversal: spatial splits may reference a triangle from several leaves; for static geometry.
    High,
}
