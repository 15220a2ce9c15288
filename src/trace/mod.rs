//! Executors: implementations of [`Tracer`] that trace rays through the device arrays on a GPU, on all CPU cores, or on
//! one thread as a reference.

mod cpu;
mod emulated;
mod frame_buffer;
#[cfg(feature = "gpu")]
pub mod gpu;
pub(crate) mod kernel;
mod recursive;
pub mod shader;
mod traversal;

pub use cpu::Cpu;
pub use emulated::Emulated;
pub use recursive::Recursive;
pub use traversal::{FrameCounts, Traversal, TraversalCounts};

use std::time::Duration;

use serde::Serialize;

use crate::device::DeviceArrays;
use crate::device::Needs;
use crate::device::layout::{FrameParams, HitRecord, RayRecord};
use crate::image::Image;
use crate::{Cancel, Result};

/// Traces rays through [`DeviceArrays`]: the same rays through the same arrays give the same hits in every executor
/// (see the tie band in `docs/ARCHITECTURE.md`).
///
/// Call [`upload`](Self::upload) after the arrays change and before tracing. A ray with a non-finite component or a
/// zero direction has an unspecified result (a hit or a miss); it never panics, loops forever or reads out of bounds.
///
/// Every call may fail with [`Error::DeviceLost`](crate::Error::DeviceLost): the device is gone and every later call
/// fails the same way. With [`Error::OutOfMemory`](crate::Error::OutOfMemory) or [`Error::Gpu`](crate::Error::Gpu): the
/// driver reported it; the tracer can still be used. With [`Error::Limit`](crate::Error::Limit): the image exceeds a
/// limit of the device.
pub trait Tracer {
    /// The device that this executor runs on.
    fn device(&self) -> &DeviceInfo;

    /// Sets the token that stops [`render`](Self::render), [`closest_hits`](Self::closest_hits) and
    /// [`any_hits`](Self::any_hits) from now on: they then return [`Error::Cancelled`](crate::Error::Cancelled), after
    /// which the next call works as ever. By default it is ignored: calls of such an executor run to their end.
    fn set_cancel(&mut self, _cancel: Option<Cancel>) {}

    /// Brings the executor's copy of the arrays up to date and returns how many bytes had changed. After an error the
    /// next call copies everything.
    ///
    /// # Errors
    /// [`Error::Limit`](crate::Error::Limit) if an array is too large for the device, before anything is copied;
    /// [`Error::DeviceLost`](crate::Error::DeviceLost), [`Error::OutOfMemory`](crate::Error::OutOfMemory) or
    /// [`Error::Gpu`](crate::Error::Gpu) if the driver fails.
    fn upload(&mut self, arrays: &mut DeviceArrays) -> Result<u64>;

    /// Traces a frame. The pixels stay in the executor's memory (on the GPU, for `gpu`) until
    /// [`read_image`](Self::read_image) copies them. After an error there is no frame to be copied.
    fn render(&mut self, arrays: &DeviceArrays, request: &FrameRequest) -> Result<()>;

    /// Copies the last frame rendered into an image.
    fn read_image(&self) -> Result<Image>;

    /// How many pixels of the last frame needed more rays than [`FrameParams::max_rays`]; 0 for an executor that does
    /// not count them.
    fn limited_pixels(&self) -> Result<u64> {
        Ok(0)
    }

    /// The last frame's linear colour as an `Rgba32Float` texture, or `None` for executors without one. Usable as a
    /// non-filterable texture binding and as a copy source. Alpha is 1 plus the share of unlit surfaces, see
    /// [`Frame::texture`](crate::render::Frame::texture).
    #[cfg(feature = "gpu")]
    fn texture(&self) -> Option<&wgpu::Texture> {
        None
    }

    /// The executor as a GPU, if it is one.
    #[cfg(feature = "gpu")]
    fn as_gpu(&mut self) -> Option<&mut gpu::GpuTracer> {
        None
    }

    /// GPU time of the last frame from timestamp queries, or `None` where the device has none. Blocks until the frame
    /// is done.
    fn trace_time(&self) -> Option<Duration> {
        None
    }

    /// The closest hit of each ray, of instances that share a bit with `ray_mask`.
    ///
    /// # Errors
    /// As [`RayRecord::validate`], before anything is traced.
    fn closest_hits(&mut self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<HitRecord>>;

    /// Occlusion query: for each ray, whether an opaque surface lies between `t_min` and `t_max`.
    ///
    /// # Errors
    /// As [`closest_hits`](Self::closest_hits).
    fn any_hits(&mut self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<bool>>;
}

/// One frame to trace.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct FrameRequest {
    /// Camera, sky and limits.
    pub params: FrameParams,
    /// Kernel features that the scene needs.
    pub needs: Needs,
    /// Whether [`Image::aovs`] is wanted.
    pub aovs: bool,
}

impl FrameRequest {
    /// A frame without AOVs.
    pub fn new(params: FrameParams, needs: Needs) -> Self {
        Self { params, needs, aovs: false }
    }

    /// The same frame, with [`Image::aovs`] or without.
    #[must_use]
    pub fn with_aovs(self, aovs: bool) -> Self {
        Self { aovs, ..self }
    }
}

/// Name and kind of the device that runs the kernel.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct DeviceInfo {
    /// "gpu", "cpu", "emulated" or "recursive".
    pub executor: &'static str,
    /// The device's own name and driver, or the number of threads.
    pub name: String,
}

impl DeviceInfo {
    /// The info of an application's own [`Tracer`].
    pub fn new(executor: &'static str, name: impl Into<String>) -> Self {
        Self { executor, name: name.into() }
    }
}

/// Rays that an executor of one thread traces between two looks at its token.
const RAYS_PER_CHECK: usize = 256;

/// Traces valid rays one after the other until the token stops it.
fn trace_rays<T>(rays: &[RayRecord], cancel: &Cancel, trace: impl Fn(&RayRecord) -> T) -> Result<Vec<T>> {
    rays.iter().try_for_each(RayRecord::validate)?;
    let mut results = Vec::with_capacity(rays.len());
    for rays in rays.chunks(RAYS_PER_CHECK) {
        cancel.check()?;
        results.extend(rays.iter().map(&trace));
    }
    Ok(results)
}
