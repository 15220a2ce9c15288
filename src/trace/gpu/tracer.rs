//! The executor itself: uploads, traces frames in bands, answers batches.

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
use crate::{Error, Result};

/// The kernel on a GPU.
///
/// After [`Error::OutOfMemory`] and [`Error::Gpu`] a tracer can be used on: what it could not make it tries to make anew.
/// After [`Error::DeviceLost`] every call fails so, and a new tracer must be made. An image without pixels renders as such.
#[derive(Debug)]
pub struct GpuTracer {
    context: Context,
    scene: SceneBuffers,
    pipelines: Pipelines,
    timer: Option<Timer>,
    /// The last frame, where that has pixels and did not fail.
    frame: Option<FrameTextures>,
    /// The last frame, where that has no pixels.
    empty_frame: Option<FrameBuffer>,
    /// The last batch's buffers, where that did not fail.
    batch: Option<BatchBuffers>,
}

impl GpuTracer {
    /// Takes the best adapter there is: a discrete GPU before an integrated, virtual or other one, then, if
    /// [`AdapterKinds::IncludingSoftware`](super::AdapterKinds::IncludingSoftware), a software renderer. Tens of milliseconds.
    ///
    /// # Errors
    /// [`Error::NoGpu`] names each adapter and why it was not taken: it is software, lacks something, or its driver
    /// cuts long loops short.
    pub fn new(options: &GpuOptions) -> Result<Self> {
        Self::with_context(adapter::open(options)?)
    }

    /// Shares the application's device, so that its windows can show frames where they are.
    ///
    /// Request the device with [`required_limits`](super::required_limits) and, to know the time spent tracing,
    /// [`wanted_features`](super::optional_features).
    ///
    /// # Errors
    /// [`Error::Limit`] names the first limit of the device that is too low; [`Error::NoGpu`] says that its driver
    /// cuts long loops short; [`Error::DeviceLost`], [`Error::OutOfMemory`] and [`Error::Gpu`] that it failed.
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

    /// Walks the arrays in another way than by default: the hits are the same. Takes effect with the next upload, which copies all.
    #[must_use]
    pub fn with_layout(mut self, layout: Traversal) -> Self {
        self.scene = SceneBuffers::new(&self.context, layout);
        self
    }

    /// The device that traces.
    pub fn wgpu_device(&self) -> &wgpu::Device {
        &self.context.device
    }

    /// Its queue.
    pub fn wgpu_queue(&self) -> &wgpu::Queue {
        &self.context.queue
    }

    /// Records into `encoder` that the closest [`HitRecord`] of each ray is found: rays and hits stay on the GPU. The scene is that of
    /// the last upload; other passes of the encoder may write the rays and read the hits. A batch of very many rays may take
    /// longer than a driver lets one submission run (seconds): spread those over several.
    ///
    /// # Errors
    /// [`Error::Limit`] if the buffers are too small for their count or larger than a binding of the device;
    /// [`Error::OutOfRange`] if one is no storage buffer; [`Error::Gpu`] if no scene was uploaded.
    pub fn record_closest_hits(&mut self, encoder: &mut wgpu::CommandEncoder, rays: &RayBuffers<'_>) -> Result<()> {
        self.record(EntryPoint::ClosestHits, size_of::<HitRecord>(), encoder, rays)
    }

    /// As [`record_closest_hits`](Self::record_closest_hits), but each answer is a `u32`: 1 if anything lets no light through, else
    /// 0.
    ///
    /// # Errors
    /// As there.
    pub fn record_any_hits(&mut self, encoder: &mut wgpu::CommandEncoder, rays: &RayBuffers<'_>) -> Result<()> {
        self.record(EntryPoint::AnyHits, size_of::<u32>(), encoder, rays)
    }

    /// The text with which a compute shader of the application's traces rays through the scene that was uploaded. `needs` are what
    /// the scene [was compiled to need](crate::compile::CompileReport::needs); more only costs. While the include stays equal,
    /// pipelines made from it serve.
    pub fn include(&self, group: u32, needs: Needs, surfaces: bool) -> Include {
        Include { group, surfaces, variant: self.scene.variant(needs) }
    }

    /// The layout of the include's bind group, for the pipeline.
    pub fn include_layout(&self, include: &Include) -> wgpu::BindGroupLayout {
        SceneBuffers::include_layout(&self.context, include)
    }

    /// The include's bind group. It holds the buffers that there are: make it anew after each upload, in microseconds.
    ///
    /// # Errors
    /// [`Error::Gpu`] if no scene was uploaded, or its arrays are bound otherwise than when the include was made.
    pub fn include_bind_group(&self, include: &Include) -> Result<wgpu::BindGroup> {
        self.scene.bind_include(&self.context, include)
    }

    /// Bytes of GPU memory held for the scene, the last frame and batches.
    pub fn memory_bytes(&self) -> u64 {
        self.scene.bytes()
            + self.frame.as_ref().map_or(0, FrameTextures::bytes)
            + self.batch.as_ref().map_or(0, BatchBuffers::bytes)
    }

    /// How often the scene's buffers had to be bound anew because one of them was replaced.
    #[doc(hidden)]
    pub fn bind_groups_made(&self) -> u64 {
        self.scene.bind_group_rebuilds()
    }

    /// How many pipelines were compiled, one for each entry point and set of needs.
    #[doc(hidden)]
    pub fn pipelines_made(&self) -> usize {
        self.pipelines.len()
    }

    fn record(
        &mut self,
        entry_point: EntryPoint,
        answer_size: usize,
        encoder: &mut wgpu::CommandEncoder,
        rays: &RayBuffers<'_>,
    ) -> Result<()> {
        let Self { context, scene, pipelines, .. } = self;
        let bound = scene.bind_group()?;
        rays.check(&context.limits, answer_size)?;
        if rays.count == 0 {
            return Ok(());
        }
        let variant = scene.variant(BATCH_NEEDS);
        let (pipeline, _) = pipelines.pipeline(context, scene.layout(), entry_point, variant)?;
        context.with_error_scopes(batch::OPERATION, || {
            rays.record(context, pipelines.batch_layout(), encoder, &pipeline, bound, answer_size);
            Ok(())
        })
    }

    fn answers<T: Pod>(&mut self, entry_point: EntryPoint, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<T>> {
        let Self { context, scene, pipelines, batch, .. } = self;
        let bound = scene.bind_group()?;
        if rays.is_empty() {
            return Ok(Vec::new());
        }
        let variant = scene.variant(BATCH_NEEDS);
        let (pipeline, _) = pipelines.pipeline(context, scene.layout(), entry_point, variant)?;
        let last = batch.take().filter(|batch| batch.can_hold(context, rays.len()));
        let (used, answers) = context.with_error_scopes(batch::OPERATION, || {
            let batch = last.unwrap_or_else(|| BatchBuffers::new(context, pipelines.batch_layout(), rays.len()));
            let answers = batch.trace(context, &pipeline, bound, rays, ray_mask)?;
            Ok((batch, answers))
        })?;
        *batch = Some(used);
        Ok(answers)
    }
}

/// Batches honour whatever may make a hit not count.
const BATCH_NEEDS: Needs = Needs::all();

impl Tracer for GpuTracer {
    fn device(&self) -> &DeviceInfo {
        &self.context.info
    }

    fn upload(&mut self, arrays: &mut DeviceArrays) -> Result<u64> {
        self.scene.upload(&self.context, arrays)
    }

    fn render(&mut self, _: &DeviceArrays, request: &FrameRequest) -> Result<()> {
        let Self { context, scene, pipelines, timer, .. } = self;
        let bound = scene.bind_group()?;
        let size = [request.params.width, request.params.height];
        frame::check_size(size, &context.limits)?;
        if size.contains(&0) {
            self.frame = None;
            self.empty_frame = Some(FrameBuffer::new(size[0], size[1], request.aovs)?);
            return Ok(());
        }
        let entry_point = if request.aovs { EntryPoint::RenderAovs } else { EntryPoint::Render };
        let variant = scene.variant(request.needs);
        let (pipeline, is_new) = pipelines.pipeline(context, scene.layout(), entry_point, variant)?;
        self.empty_frame = None;
        let last = self.frame.take().filter(|frame| frame.serves(size, request.aovs));
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

    fn read_image(&self) -> Result<Image> {
        match (&self.frame, &self.empty_frame) {
            (Some(frame), _) => Ok(frame.read(&self.context)?.into_image()),
            (None, Some(empty)) => Ok(empty.clone().into_image()),
            (None, None) => self.context.with_error_scopes(frame::READING, || {
                // It may have failed because the device was lost, which this says.
                self.context.submit(frame::READING, |_| {})?;
                Err(Error::Gpu { during: frame::READING, message: "the last one failed".into() })
            }),
        }
    }

    fn closest_hits(&mut self, _: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<HitRecord>> {
        self.answers(EntryPoint::ClosestHits, rays, ray_mask)
    }

    fn any_hits(&mut self, _: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<bool>> {
        let answers: Vec<u32> = self.answers(EntryPoint::AnyHits, rays, ray_mask)?;
        Ok(answers.into_iter().map(|answer| answer != 0).collect())
    }
}
