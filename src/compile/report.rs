//! What a compile did, and why.

use std::time::Duration;

use serde::Serialize;

use super::BlasBuildReasons;
use crate::accel::TlasUpdate;
use crate::device::Needs;

/// What one [`Compiler::compile`](super::Compiler::compile) did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CompileReport {
    /// What became of the top level.
    pub tlas: TlasUpdate,
    /// Whether the camera went so far from the render origin that the origin followed it: then every instance was written
    /// anew.
    pub rebased: bool,
    /// Instance records written.
    pub instances_written: usize,
    /// Bottom-level structures built.
    pub blas_built: usize,
    /// Triangles in them.
    pub blas_built_triangles: usize,
    /// Why they were built.
    pub blas_builds: BlasBuildReasons,
    /// Bottom-level structures refitted: their boxes follow the triangles of a geometry that deformed.
    pub blas_refitted: usize,
    /// Triangles in them.
    pub blas_refitted_triangles: usize,
    /// Bottom-level structures freed.
    pub blas_freed: usize,
    /// Bottom-level structures there are now.
    pub blas_count: usize,
    /// Instances in the top level.
    pub instances: usize,
    /// Visible geometry nodes that no ray can hit, because their matrix is singular or beyond f32.
    pub unhittable_instances: usize,
    /// Triangles of the visible geometries, each counted once.
    pub unique_triangles: usize,
    /// Triangles in the scene, counted for each instance.
    pub instanced_triangles: usize,
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
    /// Time to build and refit bottom-level structures, and to write them and their streams, in seconds.
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

/// A duration as seconds.
pub(crate) fn seconds<S: serde::Serializer>(time: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_f64(time.as_secs_f64())
}
