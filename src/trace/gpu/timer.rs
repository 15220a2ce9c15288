//! GPU time of a frame, from timestamp queries.

use std::time::Duration;

use wgpu::BufferUsages;

use super::context::Context;
use crate::Result;

/// Operation named in errors.
const OPERATION: &str = "reading the trace time";

const BYTES: u64 = 2 * size_of::<u64>() as u64;

/// Two timestamps: when a frame's first dispatch began and when its last one ended.
#[derive(Debug)]
pub(super) struct Timer {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    staging: wgpu::Buffer,
    nanoseconds_per_tick: f32,
}

impl Timer {
    /// `None` if the device has no timestamp queries.
    pub(super) fn new(context: &Context) -> Option<Self> {
        context.device.features().contains(wgpu::Features::TIMESTAMP_QUERY).then(|| Self {
            queries: context.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("trace time"),
                ty: wgpu::QueryType::Timestamp,
                count: 2,
            }),
            resolved: context.buffer("trace time", BYTES, BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC),
            staging: context.staging(BYTES),
            nanoseconds_per_tick: context.queue.get_timestamp_period(),
        })
    }

    /// The timestamps that a pass writes if it is the first of a frame, the last, both or neither.
    pub(super) fn writes(&self, first: bool, last: bool) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        (first || last).then(|| wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: first.then_some(0),
            end_of_pass_write_index: last.then_some(1),
        })
    }

    /// Records, after the last pass, the copy of the timestamps for [`read`](Self::read).
    pub(super) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.resolve_query_set(&self.queries, 0..2, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.staging, 0, BYTES);
    }

    /// Blocks until the frame is done and returns its time.
    pub(super) fn read(&self, context: &Context) -> Result<Duration> {
        let [began, ended] = context.with_error_scopes(OPERATION, || {
            context.read(OPERATION, &self.staging, BYTES, bytemuck::pod_read_unaligned::<[u64; 2]>)
        })?;
        let ticks = ended.saturating_sub(began);
        Ok(Duration::from_nanos((ticks as f64 * f64::from(self.nanoseconds_per_tick)) as u64))
    }
}
