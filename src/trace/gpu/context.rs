//! Device and queue, with wgpu's asynchronous errors turned into `Result`s of the call that caused them, and its panics
//! on device loss caught.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use wgpu::{BufferUsages, ErrorFilter};

use super::adapter::describe;
use crate::trace::DeviceInfo;
use crate::{Cancel, Error, Result};

/// Device, queue, limits and error state.
#[derive(Debug)]
pub(super) struct Context {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) info: DeviceInfo,
    pub(super) limits: wgpu::Limits,
    /// The token that stops frames and batches of rays.
    pub(super) cancel: Option<Cancel>,
    /// Why the device was lost, if it was; every later operation fails.
    lost_reason: Arc<OnceLock<String>>,
    /// First uncaptured error not yet reported by a call.
    uncaptured_error: Arc<Mutex<Option<wgpu::Error>>>,
}

impl Context {
    pub(super) fn new(device: wgpu::Device, queue: wgpu::Queue) -> Self {
        let info = DeviceInfo { executor: "gpu", name: describe(&device.adapter_info()) };
        let limits = device.limits();
        let (lost_reason, uncaptured_error) = Default::default();
        Self { device, queue, info, limits, cancel: None, lost_reason, uncaptured_error }
    }

    /// Installs callbacks for errors that no scope captures and for the loss of the device. A device has one callback
    /// of each kind: only for devices that this tracer has opened, since an application may have set its own.
    pub(super) fn install_error_callbacks(&self) {
        let uncaptured_error = Arc::clone(&self.uncaptured_error);
        self.device.on_uncaptured_error(Arc::new(move |error| {
            uncaptured_error.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        }));
        let lost_reason = Arc::clone(&self.lost_reason);
        self.device.set_device_lost_callback(move |reason, message| {
            let _ = lost_reason.set(one_line(&format!("{reason:?} {message}")));
        });
    }

    /// Runs `work` inside wgpu error scopes; returns its result, or the first captured error, or an earlier uncaptured
    /// one.
    pub(super) fn with_error_scopes<T>(&self, during: &'static str, work: impl FnOnce() -> Result<T>) -> Result<T> {
        // Run the work inside a scope for each kind of error.
        let [validation, memory, internal] = [ErrorFilter::Validation, ErrorFilter::OutOfMemory, ErrorFilter::Internal]
            .map(|filter| self.device.push_error_scope(filter));
        let outcome = work();
        let [internal, memory, validation] =
            [internal, memory, validation].map(|scope| pollster::block_on(scope.pop()));
        let unreported = self.uncaptured_error.lock().unwrap_or_else(PoisonError::into_inner).take();
        // A lost device takes precedence over all else.
        if let Some(message) = self.lost_reason.get() {
            return Err(Error::DeviceLost { during, message: message.clone() });
        }
        if matches!(outcome, Err(Error::DeviceLost { .. })) {
            // An invalid resource also makes a submission fail; an empty submission tells that from a lost device.
            self.submit(during, |_| {})?;
        }
        // Out of memory takes precedence: it causes the validation errors that follow.
        match memory.or(internal).or(validation).or(unreported) {
            Some(error) => Err(failure(during, &error)),
            None => outcome,
        }
    }

    /// Blocks until the GPU has finished all submitted work.
    pub(super) fn wait(&self, during: &'static str) -> Result<()> {
        match self.poll(during, wgpu::PollType::wait_indefinitely())? {
            Ok(_) => Ok(()),
            Err(error) => Err(Error::Gpu { during, message: error.to_string() }),
        }
    }

    /// Blocks until the GPU has finished and passes the first `size` bytes of `staging`, a [`staging`](Self::staging)
    /// buffer, to `take`.
    pub(super) fn read<T>(
        &self,
        during: &'static str,
        staging: &wgpu::Buffer,
        size: u64,
        take: impl FnOnce(&[u8]) -> T,
    ) -> Result<T> {
        let failed = |message: String| Error::Gpu { during, message };
        // Request the mapping; its result arrives while the device is polled.
        let mapped = Arc::new(OnceLock::new());
        let on_mapped = Arc::clone(&mapped);
        let slice = staging.slice(..size);
        slice.map_async(wgpu::MapMode::Read, move |result| {
            let _ = on_mapped.set(result);
        });
        // Wait for the GPU.
        self.wait(during)?;
        match mapped.get() {
            Some(Ok(())) => {}
            Some(Err(error)) => return Err(failed(error.to_string())),
            None => return Err(failed("the device did not answer".into())),
        }
        // Hand over the bytes, and unmap the buffer for the next copy.
        let view = slice.get_mapped_range().map_err(|error| failed(error.to_string()))?;
        let taken = take(&view);
        drop(view);
        staging.unmap();
        Ok(taken)
    }

    /// Creates a buffer to which the GPU copies and from which [`read`](Self::read) reads.
    pub(super) fn staging(&self, size: u64) -> wgpu::Buffer {
        self.buffer("ropewalk readback", size, BufferUsages::MAP_READ | BufferUsages::COPY_DST)
    }

    pub(super) fn buffer(&self, label: &str, size: u64, usage: BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }

    /// Records commands and submits them. Returns the submission, to [wait for](Self::wait_for) it.
    pub(super) fn submit(
        &self,
        during: &'static str,
        record: impl FnOnce(&mut wgpu::CommandEncoder),
    ) -> Result<wgpu::SubmissionIndex> {
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        record(&mut encoder);
        let submission = self.queue.submit([encoder.finish()]);
        // A zero-timeout poll detects a lost device without blocking.
        self.poll_submission(during, submission.clone(), Some(Duration::ZERO))?;
        Ok(submission)
    }

    /// Blocks until the GPU has finished a submission and all before it.
    pub(super) fn wait_for(&self, during: &'static str, submission: wgpu::SubmissionIndex) -> Result<()> {
        self.poll_submission(during, submission, None)
    }

    /// Waits for a submission, but not longer than `timeout`.
    fn poll_submission(
        &self,
        during: &'static str,
        submission: wgpu::SubmissionIndex,
        timeout: Option<Duration>,
    ) -> Result<()> {
        match self.poll(during, wgpu::PollType::Wait { submission_index: Some(submission), timeout })? {
            Err(wgpu::PollError::WrongSubmissionIndex(..)) => Err(lost(during)),
            Ok(_) | Err(wgpu::PollError::Timeout) => Ok(()),
        }
    }

    /// Polls the device; a lost one is [`Error::DeviceLost`].
    fn poll(
        &self,
        during: &'static str,
        poll_type: wgpu::PollType,
    ) -> Result<Result<wgpu::PollStatus, wgpu::PollError>> {
        // wgpu 30 panics when the device is lost while it waits.
        catch_unwind(AssertUnwindSafe(|| self.device.poll(poll_type))).map_err(|_| lost(during))
    }
}

fn lost(during: &'static str) -> Error {
    Error::DeviceLost { during, message: "it takes no more work".into() }
}

fn failure(during: &'static str, error: &wgpu::Error) -> Error {
    match error {
        wgpu::Error::OutOfMemory { source } => {
            Error::OutOfMemory { during, message: one_line(&chain(source.as_ref())) }
        }
        wgpu::Error::Validation { description, .. } | wgpu::Error::Internal { description, .. } => {
            Error::Gpu { during, message: one_line(description) }
        }
    }
}

/// Formats an error and its causes.
fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(error.source(), |error| error.source());
    causes.fold(error.to_string(), |message, cause| format!("{message}: {cause}"))
}

fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}
