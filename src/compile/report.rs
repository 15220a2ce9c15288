//! What a compile did, and why.

use std::fmt;
use std::time::Duration;

use serde::Serialize;

use super::Needs;

/// What became of the top-level structure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum TlasUpdate {
    /// Nothing in it changed.
    #[default]
    Kept,
    /// It was built anew.
    Rebuilt(RebuildReason),
}

/// Why the top-level structure was rebuilt. Where several apply, the first in this order is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum RebuildReason {
    /// The renderer had not seen this scene yet, or had fallen behind its change log.
    NewScene,
    /// Nodes were added, removed, moved in the hierarchy, shown or hidden, or got another core, geometry or material.
    Structure,
    /// The camera went so far from the render origin that the origin followed it.
    Rebased,
    /// Only transforms changed: bottom-level structures stay as they were.
    Moved {
        /// How many instances moved.
        instances: usize,
    },
}

impl fmt::Display for TlasUpdate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kept => f.write_str("kept"),
            Self::Rebuilt(RebuildReason::NewScene) => f.write_str("rebuilt (new scene)"),
            Self::Rebuilt(RebuildReason::Structure) => f.write_str("rebuilt (structure changed)"),
            Self::Rebuilt(RebuildReason::Rebased) => f.write_str("rebuilt (render origin moved)"),
            Self::Rebuilt(RebuildReason::Moved { instances }) => write!(f, "rebuilt ({instances} moved)"),
        }
    }
}

/// What one [`Compiler::compile`](super::Compiler::compile) did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CompileReport {
    /// What became of the top level.
    pub tlas: TlasUpdate,
    /// Bottom-level structures built.
    pub blas_built: usize,
    /// Triangles in them.
    pub blas_built_triangles: usize,
    /// Bottom-level structures freed.
    pub blas_freed: usize,
    /// Bottom-level structures there are now.
    pub blas_count: usize,
    /// Instances in the top level.
    pub instances: usize,
    /// Visible geometry nodes that no ray can hit, because their matrix is singular or beyond f32.
    pub singular_instances: usize,
    /// Triangles of the visible geometries, each counted once.
    pub triangles: usize,
    /// Triangles in the scene, counted for each instance.
    pub scene_triangles: usize,
    /// Materials in use.
    pub materials: usize,
    /// Textures in use.
    pub textures: usize,
    /// Lights that shine.
    pub lights: usize,
    /// What the scene uses.
    pub needs: Needs,
    /// Bytes of the device arrays.
    pub device_bytes: u64,
    /// Time to find what changed and to write instances, materials and lights, in seconds.
    #[serde(serialize_with = "seconds")]
    pub update_time: Duration,
    /// Time to build bottom-level structures, in seconds.
    #[serde(serialize_with = "seconds")]
    pub blas_time: Duration,
    /// Time to build the top level, in seconds.
    #[serde(serialize_with = "seconds")]
    pub tlas_time: Duration,
}

impl CompileReport {
    /// The report of the next compile, if it finds nothing changed.
    pub(super) fn as_unchanged(&self) -> Self {
        Self {
            tlas: TlasUpdate::Kept,
            blas_built: 0,
            blas_built_triangles: 0,
            blas_freed: 0,
            update_time: Duration::ZERO,
            blas_time: Duration::ZERO,
            tlas_time: Duration::ZERO,
            ..self.clone()
        }
    }
}

/// A duration as seconds.
pub(crate) fn seconds<S: serde::Serializer>(time: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_f64(time.as_secs_f64())
}
