//! What a frame cost, and why.

use std::fmt;
use std::time::Duration;

use serde::Serialize;

use crate::compile::{CompileReport, seconds};
use crate::trace::DeviceInfo;

/// What one [`Renderer::render`](super::Renderer::render) did and why, so that cost can be asserted.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameReport {
    /// What traced it.
    pub device: DeviceInfo,
    /// What became of the scene's acceleration structures.
    pub compile: CompileReport,
    /// Bytes copied to the device: 0 for an unchanged scene, and on the CPU, which reads the arrays where they are.
    pub uploaded_bytes: u64,
    /// Time to copy them, in seconds.
    #[serde(serialize_with = "seconds")]
    pub upload_time: Duration,
    /// Time to trace the frame, in seconds. On the GPU, until its commands are submitted.
    #[serde(serialize_with = "seconds")]
    pub trace_time: Duration,
    /// Time of the whole call, in seconds.
    #[serde(serialize_with = "seconds")]
    pub total_time: Duration,
}

impl FrameReport {
    /// The time that was not spent tracing.
    pub fn overhead(&self) -> Duration {
        self.total_time.saturating_sub(self.trace_time)
    }
}

impl fmt::Display for FrameReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let c = &self.compile;
        write!(
            f,
            "{}: top level {}, {} bottom-level built ({} triangles), {} refitted ({} triangles), {} bytes uploaded; \
             {:.2} ms update, {:.2} ms bottom level, {:.2} ms top level, {:.2} ms upload, {:.2} ms trace",
            self.device.executor,
            c.tlas,
            c.blas_built,
            c.blas_built_triangles,
            c.blas_refitted,
            c.blas_refitted_triangles,
            self.uploaded_bytes,
            c.update_time.as_secs_f64() * 1e3,
            c.blas_time.as_secs_f64() * 1e3,
            c.tlas_time.as_secs_f64() * 1e3,
            self.upload_time.as_secs_f64() * 1e3,
            self.trace_time.as_secs_f64() * 1e3,
        )
    }
}
