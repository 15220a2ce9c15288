//! Executors of the device arrays.

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
pub(crate) use kernel::MAX_DEPTH;
pub use recursive::Recursive;
pub use traversal::{FrameCounts, Traversal, TraversalCounts};

use std::time::Duration;

use serde::Serialize;

use crate::Result;
use crate::device::DeviceArrays;
use crate::device::Needs;
use crate::device::layout::{FrameParams, HitRecord, RayRecord};
use crate::image::Image;

/// Something that traces rays through [`DeviceArrays`]: the same rays through the same arrays give the same hits in
/// every executor (see the tie band in `docs/ARCHITECTURE.md`).
///
/// Call [`upload`](Self::upload) after the arrays change and before tracing. A ray with a number that is not finite, or
/// with a direction of zero, hits nothing or anything, but does no harm.
///
/// Each call may fail with [`Error::DeviceLost`](crate::Error::DeviceLost), after which all do, with
/// [`Error::OutOfMemory`](crate::Error::OutOfMemory) and [`Error::Gpu`](crate::Error::Gpu), where the driver does, and with
/// [`Error::Limit`](crate::Error::Limit), where an image is too large for the device.
pub trait Tracer {
    /// What runs the kernel.
    fn device(&self) -> &DeviceInfo;

    /// Brings the executor's copy of the arrays up to date and returns how many bytes had changed. After an error the next
    /// call copies everything.
    ///
    /// # Errors
    /// [`Error::Limit`](crate::Error::Limit) if an array is too large for the device, before anything is copied;
    /// as above if the driver fails.
    fn upload(&mut self, arrays: &mut DeviceArrays) -> Result<u64>;

    /// Traces a frame, which stays where it was made until [`read_image`](Self::read_image).
    fn render(&mut self, arrays: &DeviceArrays, request: &FrameRequest) -> Result<()>;

    /// The last frame rendered.
    fn read_image(&self) -> Result<Image>;

    /// The last frame's linear colour as a texture, where it is one: `Rgba32Float`, to be bound (unfiltered) or copied from.
    #[cfg(feature = "gpu")]
    fn texture(&self) -> Option<&wgpu::Texture> {
        None
    }

    /// The executor as a GPU, if it is one.
    #[cfg(feature = "gpu")]
    fn as_gpu(&mut self) -> Option<&mut gpu::GpuTracer> {
        None
    }

    /// How long the device itself says that it traced the last frame, where it has a clock. Waits for the frame.
    fn trace_time(&self) -> Option<Duration> {
        None
    }

    /// The closest hit of each ray, of instances that share a bit with `ray_mask`.
    fn closest_hits(&mut self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<HitRecord>>;

    /// For each ray, whether it meets anything opaque.
    fn any_hits(&mut self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<bool>>;
}

/// One frame to trace.
#[derive(Clone, Copy, Debug)]
pub struct FrameRequest {
    /// Camera, sky and limits.
    pub params: FrameParams,
    /// What the kernel must be able to do.
    pub needs: Needs,
    /// Whether [`Image::aovs`] is wanted.
    pub aovs: bool,
}

/// What runs the kernel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeviceInfo {
    /// "gpu", "cpu", "emulated" or "recursive".
    pub executor: &'static str,
    /// The device's own name and driver, or the number of threads.
    pub name: String,
}
