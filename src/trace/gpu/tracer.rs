//! The executor itself: uploads, traces frames in bands, traces ray batches.

use std::time::Duration;

use bytemuck::Pod;

use super::adapter::{self, GpuOptions};
use super::batch::{self, BatchBuffers, RayBuffers};
use super::context::Context;
use super::frame::{self, FrameTextures};
use super::pipelines::Pipelines;
use super::probe;
use super::scene::SceneBuffers;
use super::timer::Timer;
use crate::device::DeviceArrays;
use crate::device::Needs;
use crate::device::layout::{HitRecord, RayRecord};
use crate::image::Image;
use crate::trace::frame_buffer::FrameBuffer;
use crate::trace::shader::{EntryPoint, Include};
use crate::trace::{DeviceInfo, FrameRequest, Tracer, Traversal};
use crate::{Cancel, Error, Result};

/// Traces rays on a GPU, through wgpu.
///
/// It keeps a copy of the [`DeviceArrays`] in GPU memory; an upload costs time in proportion to the bytes that changed.
/// Frames are submitted in bands of rows, so that no dispatch runs into a driver's timeout.
///
/// After [`Error::OutOfMemory`] and [`Error::Gpu`] the tracer stays usable and recreates failed resources on the next
/// call. After [`Error::DeviceLost`] every call fails with that error, and a new tracer must be made. A frame of width
/// or height 0 gives an empty image.
#[derive(Debug)]
pub struct GpuTracer {
    context: Context,
    scene: SceneBuffers,
    pipelines: Pipelines,
    timer: Option<Timer>,
    /// The last frame, if it has pixels and did not fail.
    frame: Option<FrameTextures>,
    /// The last frame, if it has no pixels.
    empty_frame: Option<FrameBuffer>,
    /// The last batch's buffers, if it did not fail.
    batch: Option<BatchBuffers>,
}

impl GpuTracer {
    /// Opens a device on the best adapter: a discrete GPU before an integrated, virtual or other one, then, with
    /// [`AdapterKinds::IncludingSoftware`](super::AdapterKinds::IncludingSoftware), a software renderer. Takes tens of
    /// milliseconds.
    ///
    /// # Errors
    /// [`Error::NoGpu`] names each adapter and why it was refused: it is a software renderer, lacks a feature or limit,
    /// or its driver ends long shader loops early; or it says that no driver offers an adapter.
    pub fn new(options: &GpuOptions) -> Result<Self> {
        Self::with_context(adapter::open(options)?)
    }

    /// Shares the application's device, so that its own passes can use frames, hits and the scene without a copy.
    ///
    /// Request the device with [`required_limits`](super::required_limits) and, for
    /// [`trace_time`](Tracer::trace_time), [`optional_features`](super::optional_features).
    ///
    /// # Errors
    /// [`Error::Limit`] names the first limit of the device that is too low: it was requested without
    /// `required_limits`. [`Error::NoGpu`] if its driver ends long shader loops early. [`Error::DeviceLost`],
    /// [`Error::OutOfMemory`] and [`Error::Gpu`] if the device failed.
    pub fn from_device(device: wgpu::Device, queue: wgpu::Queue) -> Result<Self> {
        let context = Context::new(device, queue);
        adapter::check_limits(&context.limits)?;
        probe::check_loops(&context)?;
        Self::with_context(context)
    }

    fn with_context(context: Context) -> Result<Self> {
        context
            .with_error_scopes("preparing the kernel", || {
                let pipelines = Pipelines::new(frame::layout(&context), batch::layout(&context));
                Ok((SceneBuffers::new(&context, Traversal::default()), pipelines, Timer::new(&context)))
            })
            .map(|(scene, pipelines, timer)| Self {
                context,
                scene,
                pipelines,
                timer,
                frame: None,
                empty_frame: Some(FrameBuffer::default()),
                batch: None,
            })
    }

    /// Sets the traversal. Hits do not depend on it. Takes effect with the next upload, which copies everything.
    #[must_use]
    pub fn with_traversal(mut self, traversal: Traversal) -> Self {
        self.scene = SceneBuffers::new(&self.context, traversal);
        self
    }

    /// The device that traces.
    pub fn wgpu_device(&self) -> &wgpu::Device {
        &self.context.device
    }

    /// The queue of the device that traces.
    pub fn wgpu_queue(&self) -> &wgpu::Queue {
        &self.context.queue
    }

    /// Records a closest-hit query into `encoder`: for each ray of the buffer a [`HitRecord`] is written to the
    /// results. Rays and hits stay on the GPU; other passes of the encoder may write the rays and read the hits. The
    /// scene is that of the last upload. A batch of very many rays may take longer than a driver lets one submission
    /// run (seconds): split it over several submissions.
    ///
    /// # Errors
    /// [`Error::Limit`] if a buffer is too small for its count of rays, or larger than a binding of the device.
    /// [`Error::OutOfRange`] if a buffer lacks the usage `STORAGE`. [`Error::Gpu`] if no scene was uploaded.
    /// [`Error::DeviceLost`], [`Error::OutOfMemory`] and [`Error::Gpu`] if the device failed.
    pub fn record_closest_hits(&mut self, encoder: &mut wgpu::CommandEncoder, rays: &RayBuffers<'_>) -> Result<()> {
        self.record(EntryPoint::ClosestHits, size_of::<HitRecord>(), encoder, rays)
    }

    /// Records an occlusion query: as [`record_closest_hits`](Self::record_closest_hits), but each result is a `u32`, 1
    /// if the ray hits an opaque surface in [`t_min`, `t_max`], else 0.
    ///
    /// # Errors
    /// [`Error::Limit`] if a buffer is too small for its count of rays, or larger than a binding of the device.
    /// [`Error::OutOfRange`] if a buffer lacks the usage `STORAGE`. [`Error::Gpu`] if no scene was uploaded.
    /// [`Error::DeviceLost`], [`Error::OutOfMemory`] and [`Error::Gpu`] if the device failed.
    pub fn record_any_hits(&mut self, encoder: &mut wgpu::CommandEncoder, rays: &RayBuffers<'_>) -> Result<()> {
        self.record(EntryPoint::AnyHits, size_of::<u32>(), encoder, rays)
    }

    /// The WGSL source with which a compute shader of the application traces rays through the uploaded scene. `needs`
    /// are those that [the scene was compiled with](crate::compile::CompileReport::needs); extra ones cost speed only.
    /// By default the scene is bind group 0 and surfaces are left out:
    ///
    /// ```
    /// # use ropewalk::{device::Needs, trace::{gpu::GpuTracer, shader::Include}};
    /// # fn include(gpu: &GpuTracer, needs: Needs) -> Include {
    /// gpu.include(needs).in_group(1).with_surfaces()
    /// # }
    /// ```
    ///
    /// Pipelines stay valid while this returns an equal value.
    pub fn include(&self, needs: Needs) -> Include {
        Include::new(self.scene.variant(needs))
    }

    /// The layout of the include's bind group, for the application's pipeline layout.
    pub fn include_layout(&self, include: &Include) -> wgpu::BindGroupLayout {
        SceneBuffers::include_layout(&self.context, include)
    }

    /// The include's bind group. It references the current buffers: recreate it after each upload (microseconds).
    ///
    /// # Errors
    /// [`Error::Gpu`] if no scene was uploaded, or if the scene's bindings have changed since the include was made:
    /// then call [`include`](Self::include) again and rebuild the shader. [`Error::DeviceLost`], [`Error::OutOfMemory`]
    /// and [`Error::Gpu`] if the device failed.
    pub fn include_bind_group(&self, include: &Include) -> Result<wgpu::BindGroup> {
        self.scene.bind_include(&self.context, include)
    }

    /// GPU memory held for the scene, the last frame and ray batches, in bytes.
    pub fn memory_bytes(&self) -> u64 {
        self.scene.bytes()
            + self.frame.as_ref().map_or(0, FrameTextures::bytes)
            + self.batch.as_ref().map_or(0, BatchBuffers::bytes)
    }

    /// Number of times the scene's bind group was recreated because a buffer was replaced.
    #[doc(hidden)]
    pub fn bind_group_rebuilds(&self) -> u64 {
        self.scene.bind_group_rebuilds()
    }

    /// Number of compiled pipelines, one per entry point and variant.
    #[doc(hidden)]
    pub fn pipeline_count(&self) -> usize {
        self.pipelines.len()
    }

    /// Records a batch between two buffers of the application.
    fn record(
        &mut self,
        entry_point: EntryPoint,
        result_size: usize,
        encoder: &mut wgpu::CommandEncoder,
        rays: &RayBuffers<'_>,
    ) -> Result<()> {
        let Self { context, scene, pipelines, .. } = self;
        // Check the scene and the buffers.
        let bound = scene.bind_group()?;
        rays.check(&context.limits, result_size)?;
        if rays.count == 0 {
            return Ok(());
        }
        // Find the pipeline, and record the dispatches.
        let variant = scene.variant(BATCH_NEEDS);
        let (pipeline, _) = pipelines.pipeline(context, scene.layout(), entry_point, variant)?;
        context.with_error_scopes(batch::OPERATION, || {
            rays.record(context, pipelines.batch_layout(), encoder, &pipeline, bound, result_size);
            Ok(())
        })
    }

    /// Traces a batch and reads back one `T` per ray.
    fn trace_batch<T: Pod>(&mut self, entry_point: EntryPoint, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<T>> {
        rays.iter().try_for_each(RayRecord::validate)?;
        let Self { context, scene, pipelines, batch, .. } = self;
        let bound = scene.bind_group()?;
        if rays.is_empty() {
            return Ok(Vec::new());
        }
        // Find the pipeline.
        let variant = scene.variant(BATCH_NEEDS);
        let (pipeline, _) = pipelines.pipeline(context, scene.layout(), entry_point, variant)?;
        // Trace with the last batch's buffers, if they are large enough. After an error they are dropped.
        let last = batch.take().filter(|batch| batch.can_hold(context, rays.len()));
        let (used, results) = context.with_error_scopes(batch::OPERATION, || {
            let batch = last.unwrap_or_else(|| BatchBuffers::new(context, pipelines.batch_layout(), rays.len()));
            let results = batch.trace(context, &pipeline, bound, rays, ray_mask)?;
            Ok((batch, results))
        })?;
        *batch = Some(used);
        Ok(results)
    }
}

/// Batch queries compile in every feature, so that culling, alpha and transmission always apply.
const BATCH_NEEDS: Needs = Needs::all();

impl Tracer for GpuTracer {
    fn device(&self) -> &DeviceInfo {
        &self.context.info
    }

    fn set_cancel(&mut self, cancel: Option<Cancel>) {
        self.context.cancel = cancel;
    }

    fn upload(&mut self, arrays: &mut DeviceArrays) -> Result<u64> {
        self.scene.upload(&self.context, arrays)
    }

    fn render(&mut self, _: &DeviceArrays, request: &FrameRequest) -> Result<()> {
        let Self { context, scene, pipelines, timer, .. } = self;
        let bound = scene.bind_group()?;
        let size = [request.params.width, request.params.height];
        frame::check_size(size, &context.limits)?;
        // A frame without pixels needs no textures.
        if size.contains(&0) {
            self.frame = None;
            self.empty_frame = Some(FrameBuffer::new(size[0], size[1], request.aovs)?);
            return Ok(());
        }
        // Find the pipeline, and textures of the right size.
        let entry_point = if request.aovs { EntryPoint::RenderAovs } else { EntryPoint::Render };
        let variant = scene.variant(request.needs);
        let (pipeline, is_new) = pipelines.pipeline(context, scene.layout(), entry_point, variant)?;
        self.empty_frame = None;
        let last = self.frame.take().filter(|frame| frame.matches(size, request.aovs));
        // Trace. After an error no frame is kept, not even the last one.
        let frame = context.with_error_scopes(frame::TRACING, || {
            let frame =
                last.unwrap_or_else(|| FrameTextures::new(context, pipelines.frame_layout(), size, request.aovs));
            frame.trace(context, &pipeline, is_new, bound, timer.as_ref(), request)?;
            Ok(frame)
        })?;
        self.frame = Some(frame);
        Ok(())
    }

    fn texture(&self) -> Option<&wgpu::Texture> {
        Some(self.frame.as_ref()?.color())
    }

    fn as_gpu(&mut self) -> Option<&mut GpuTracer> {
        Some(self)
    }

    fn trace_time(&self) -> Option<Duration> {
        self.frame.as_ref()?;
        self.timer.as_ref()?.read(&self.context).ok()
    }

    fn limited_pixels(&self) -> Result<u64> {
        self.frame.as_ref().map_or(Ok(0), |frame| frame.read_limited_pixels(&self.context))
    }

    fn read_image(&self) -> Result<Image> {
        match (&self.frame, &self.empty_frame) {
            (Some(frame), _) => Ok(frame.read(&self.context)?.into_image()),
            (None, Some(empty)) => Ok(empty.clone().into_image()),
            (None, None) => self.context.with_error_scopes(frame::READING, || {
                // Report a lost device, if that is why the last frame failed.
                self.context.submit(frame::READING, |_| {})?;
                Err(Error::Gpu { during: frame::READING, message: "the last frame failed".into() })
            }),
        }
    }

    fn closest_hits(&mut self, _: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<HitRecord>> {
        self.trace_batch(EntryPoint::ClosestHits, rays, ray_mask)
    }

    fn any_hits(&mut self, _: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<bool>> {
        let results: Vec<u32> = self.trace_batch(EntryPoint::AnyHits, rays, ray_mask)?;
        Ok(results.into_iter().map(|result| result != 0).collect())
    }
}
