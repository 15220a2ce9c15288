//! The report of a compile.

use std::time::Duration;

use serde::Serialize;

use super::BlasBuildReasons;
use crate::accel::TlasUpdate;
use crate::device::Needs;

/// What one [`Compiler::compile`](super::Compiler::compile) did, and what the scene then consists of.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CompileReport {
    /// How the TLAS was updated: kept, patched, refitted or rebuilt.
    ///
    /// A compile that moves the render origin ([`rebased`](Self::rebased)) updates it twice; this is the last of the
    /// two that changed it. When the last instance has gone the TLAS is emptied, which is reported as
    /// [`Kept`](TlasUpdate::Kept) with [`instances`](Self::instances) 0.
    pub tlas: TlasUpdate,
    /// Whether the render origin moved to the viewpoint because that had gone too far from it; every instance record
    /// was then written again.
    pub rebased: bool,
    /// Instance records written; those written again after the render origin moved count twice.
    pub instances_written: usize,
    /// Bottom-level structures built.
    pub blas_built: usize,
    /// Triangles in them.
    pub blas_built_triangles: usize,
    /// Why they were built.
    pub blas_builds: BlasBuildReasons,
    /// Bottom-level structures refitted: their geometry deformed, and boxes were recomputed in the unchanged hierarchy.
    pub blas_refitted: usize,
    /// Triangles in them.
    pub blas_refitted_triangles: usize,
    /// Bottom-level structures freed.
    pub blas_freed: usize,
    /// Bottom-level structures there are now.
    pub blas_count: usize,
    /// Visible instances that a ray can hit.
    pub instances: usize,
    /// Those of them that coincide with others: they show the same geometry with the same matrix, material and mask,
    /// and another one has the leaf of the TLAS and is hit in their place. They are searched whenever the TLAS is
    /// rebuilt.
    pub coincident_instances: usize,
    /// Visible instances with triangles that no ray can hit: their matrix scales two axes to zero or is beyond
    /// f32, or all their triangles are degenerate.
    pub unhittable_instances: usize,
    /// Visible instances that frames and batches show farther than 2^-20 of their distance to the render origin from
    /// where the scene has them, since their matrix shears: it scales unevenly, by a hundred and more, something that
    /// is turned both before and after. Exact queries are not displaced. Where that matters, apply the scale to the
    /// vertices instead.
    pub displaced_instances: usize,
    /// A bound of the greatest such displacement, relative to the coordinates of a point and of its instance's origin,
    /// both relative to the render origin; 0 without displaced instances.
    pub greatest_displacement: f64,
    /// Triangles of the geometries in use, each geometry counted once.
    pub unique_triangles: usize,
    /// Triangles of all instances that can be hit: those of a geometry count once for each instance.
    pub instanced_triangles: usize,
    /// Materials in use.
    pub materials: usize,
    /// Textures in use.
    pub textures: usize,
    /// Visible lights that emit.
    pub lights: usize,
    /// The kernel features that the scene needs.
    pub needs: Needs,
    /// Bytes of the device arrays.
    pub device_bytes: u64,
    /// Time to find what changed and to write instances, materials and lights, in seconds.
    #[serde(serialize_with = "seconds")]
    pub update_time: Duration,
    /// Time to build and refit bottom-level structures, and to write them and their streams, in seconds.
    #[serde(serialize_with = "seconds")]
    pub blas_time: Duration,
    /// Time to update the TLAS (patch, refit or rebuild), in seconds; both updates where the render origin moved.
    #[serde(serialize_with = "seconds")]
    pub tlas_time: Duration,
}

impl CompileReport {
    /// The report of a compile that finds nothing changed after this one.
    pub(super) fn as_unchanged(&self) -> Self {
        Self {
            tlas: TlasUpdate::Kept,
            rebased: false,
            instances_written: 0,
            blas_built: 0,
            blas_built_triangles: 0,
            blas_builds: BlasBuildReasons::default(),
            blas_refitted: 0,
            blas_refitted_triangles: 0,
            blas_freed: 0,
            update_time: Duration::ZERO,
            blas_time: Duration::ZERO,
            tlas_time: Duration::ZERO,
            ..self.clone()
        }
    }
}

/// Serialises a duration as seconds.
pub(crate) fn seconds<S: serde::Serializer>(time: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_f64(time.as_secs_f64())
}
