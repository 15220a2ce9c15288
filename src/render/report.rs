//! The frame report.

use std::fmt;
use std::time::Duration;

use serde::Serialize;

use crate::compile::{CompileReport, seconds};
use crate::trace::DeviceInfo;

/// Work and time of one [`Renderer::render`](super::Renderer::render); tests can assert on it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FrameReport {
    /// The tracer that traced the frame.
    pub device: DeviceInfo,
    /// Acceleration structures built, refitted, patched or kept, and what the scene consists of.
    pub compile: CompileReport,
    /// Bytes copied to the device: 0 for an unchanged scene, and on the CPU, which reads the arrays in place.
    pub uploaded_bytes: u64,
    /// Time to copy them, in seconds.
    #[serde(serialize_with = "seconds")]
    pub upload_time: Duration,
    /// CPU time of the trace call, in seconds; on a GPU this ends when the commands are submitted.
    #[serde(serialize_with = "seconds")]
    pub trace_time: Duration,
    /// Time of the whole call, in seconds.
    #[serde(serialize_with = "seconds")]
    pub total_time: Duration,
}

impl FrameReport {
    /// The time of the call that was not spent tracing.
    pub fn overhead(&self) -> Duration {
        self.total_time.saturating_sub(self.trace_time)
    }
}

impl fmt::Display for FrameReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let c = &self.compile;
        write!(
            f,
            "{}: TLAS {}, {} BLAS built ({} triangles), {} refitted ({} triangles), {} bytes uploaded; \
             {:.2} ms update, {:.2} ms BLAS, {:.2} ms TLAS, {:.2} ms upload, {:.2} ms trace",
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
