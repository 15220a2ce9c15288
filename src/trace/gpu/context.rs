//! A device and its queue, and what makes their failures errors: wgpu reports most of them beside the call that
//! caused them, and panics where nobody asked.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use wgpu::{BufferUsages, ErrorFilter};

use super::adapter::describe;
use crate::trace::DeviceInfo;
use crate::{Error, Result};

/// A device, its queue, and what is known of both.
#[derive(Debug)]
pub(super) struct Context {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) info: DeviceInfo,
    pub(super) limits: wgpu::Limits,
    /// How the device was lost, if it was: nothing works from then on.
    lost_reason: Arc<OnceLock<String>>,
    /// The first thing that the driver said outside any call of ours and that no call has reported yet.
    uncaptured_error: Arc<Mutex<Option<wgpu::Error>>>,
}

impl Context {
    pub(super) fn new(device: wgpu::Device, queue: wgpu::Queue) -> Self {
        let info = DeviceInfo { executor: "gpu", name: describe(&device.adapter_info()) };
        let limits = device.limits();
        Self { device, queue, info, limits, lost_reason: Arc::default(), uncaptured_error: Arc::default() }
    }

    /// Listens for errors that no scope catches and for the loss of the device. Each device has one listener: only for
    /// devices of our own, since an application may have set its own.
    pub(super) fn install_error_callbacks(&self) {
        let complaint = Arc::clone(&self.uncaptured_error);
        self.device.on_uncaptured_error(Arc::new(move |error| {
            complaint.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        }));
        let loss = Arc::clone(&self.lost_reason);
        self.device.set_device_lost_callback(move |reason, words| {
            let _ = loss.set(one_line(&format!("{reason:?} {words}")));
        });
    }

    /// Does `work` and returns what it returned, or what the driver said: of it, or, once, of something before that nobody
    /// heard.
    pub(super) fn with_error_scopes<T>(&self, during: &'static str, work: impl FnOnce() -> Result<T>) -> Result<T> {
        let [validation, memory, internal] = [ErrorFilter::Validation, ErrorFilter::OutOfMemory, ErrorFilter::Internal]
            .map(|filter| self.device.push_error_scope(filter));
        let outcome = work();
        let [internal, memory, validation] =
            [internal, memory, validation].map(|scope| pollster::block_on(scope.pop()));
        let unheard = self.uncaptured_error.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(message) = self.lost_reason.get() {
            return Err(Error::DeviceLost { during, message: message.clone() });
        }
        if matches!(outcome, Err(Error::DeviceLost { .. })) {
            // A device refuses work that refers to what it could not make, too: then it still takes other work.
            self.submit(during, |_| {})?;
        }
        // Want of memory first: what could not be made for it is then invalid.
        match memory.or(internal).or(validation).or(unheard) {
            Some(error) => Err(failure(during, &error)),
            None => outcome,
        }
    }

    /// Waits until the GPU has done all that it was given.
    pub(super) fn wait(&self, during: &'static str) -> Result<()> {
        match self.poll(during, wgpu::PollType::wait_indefinitely())? {
            Ok(_) => Ok(()),
            Err(error) => Err(Error::Gpu { during, message: error.to_string() }),
        }
    }

    /// Waits for the GPU and passes the first `size` bytes of `staging`, a [`staging`](Self::staging) buffer, to `take`.
    pub(super) fn read<T>(
        &self,
        during: &'static str,
        staging: &wgpu::Buffer,
        size: u64,
        take: impl FnOnce(&[u8]) -> T,
    ) -> Result<T> {
        let failed = |message: String| Error::Gpu { during, message };
        let mapped = Arc::new(OnceLock::new());
        let answer = Arc::clone(&mapped);
        let slice = staging.slice(..size);
        slice.map_async(wgpu::MapMode::Read, move |result| {
            let _ = answer.set(result);
        });
        self.wait(during)?;
        match mapped.get() {
            Some(Ok(())) => {}
            Some(Err(error)) => return Err(failed(error.to_string())),
            None => return Err(failed("the device did not answer".into())),
        }
        let view = slice.get_mapped_range().map_err(|error| failed(error.to_string()))?;
        let taken = take(&view);
        drop(view);
        staging.unmap();
        Ok(taken)
    }

    /// A buffer that the GPU copies to and [`read`](Self::read) reads from.
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

    /// Records commands and hands them to the GPU.
    pub(super) fn submit(&self, during: &'static str, record: impl FnOnce(&mut wgpu::CommandEncoder)) -> Result<()> {
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        record(&mut encoder);
        let submission_index = Some(self.queue.submit([encoder.finish()]));
        // A lost device takes nothing and says so only if waited for; without patience a wait costs nothing.
        match self.poll(during, wgpu::PollType::Wait { submission_index, timeout: Some(Duration::ZERO) })? {
            Err(wgpu::PollError::WrongSubmissionIndex(..)) => Err(lost(during)),
            Ok(_) | Err(wgpu::PollError::Timeout) => Ok(()),
        }
    }

    fn poll(
        &self,
        during: &'static str,
        patience: wgpu::PollType,
    ) -> Result<Result<wgpu::PollStatus, wgpu::PollError>> {
        // wgpu 30 panics when the device is lost while it waits.
        catch_unwind(AssertUnwindSafe(|| self.device.poll(patience))).map_err(|_| lost(during))
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

/// An error and what caused it.
fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(error.source(), |error| error.source());
    causes.fold(error.to_string(), |words, cause| format!("{words}: {cause}"))
}

fn one_line(words: &str) -> String {
    words.split_whitespace().collect::<Vec<_>>().join(" ")
}
