//! The renderer: compiles the scene, uploads what changed and traces one frame a call.

mod active_tracer;
mod ray_batches;
mod report;
mod view;

use std::fmt;
use std::time::{Duration, Instant};

pub use active_tracer::DeviceChoice;
pub use ray_batches::{BatchOptions, ClosestHits, Precision, RayMask};
pub use report::FrameReport;
pub use view::{Sky, View};

use glam::DVec3;

use active_tracer::ActiveTracer;

use crate::compile::{CompileReport, Compiler};
use crate::graph::Scene;
use crate::image::Image;
use crate::query::{Hit, Queries};
#[cfg(feature = "gpu")]
use crate::trace::gpu::GpuTracer;
use crate::trace::kernel::camera_ray;
use crate::trace::{DeviceInfo, FrameRequest, Tracer};
use crate::{Cancel, Result};

/// Renders scenes by ray tracing, in the manner of Whitted: shadows, reflections, refractions.
///
/// ```
/// use glam::{DVec3, Vec3};
/// use ropewalk::graph::{Camera, Core, Geometry, Material, Scene};
/// use ropewalk::{DeviceChoice, Renderer, RendererOptions, View};
///
/// let mut scene = Scene::new();
/// let triangle = Geometry::new([Vec3::NEG_X, Vec3::X, Vec3::Y], [[0, 1, 2]]);
/// let geometry = scene.add_geometry(triangle)?;
/// let material = scene.add_material(Material::diffuse(Vec3::X))?;
/// scene.add(scene.root(), Core::Geometry { geometry, material })?;
///
/// let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu))?;
/// let view = View::framing(&mut scene, 64, 48)?;
/// let frame = renderer.render(&mut scene, &view)?;
/// assert_eq!(frame.report().compile.blas_built, 1);
/// assert_eq!(frame.image()?.color.len(), 64 * 48);
///
/// // Nothing changed: nothing is built.
/// assert_eq!(renderer.render(&mut scene, &view)?.report().compile.blas_built, 0);
/// # Ok::<(), ropewalk::Error>(())
/// ```
pub struct Renderer {
    compiler: Compiler,
    device: ActiveTracer,
}

impl fmt::Debug for Renderer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Renderer").field("device", self.device_info()).finish_non_exhaustive()
    }
}

/// How a [`Renderer`] is set up: start from the default and change what differs, as in
/// `RendererOptions::default().with_device(DeviceChoice::Cpu)`.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct RendererOptions {
    /// Whether a GPU or the CPU traces.
    pub device: DeviceChoice,
}

impl RendererOptions {
    /// The same options with another device.
    #[must_use]
    pub fn with_device(self, device: DeviceChoice) -> Self {
        Self { device, ..self }
    }
}

impl Renderer {
    /// A renderer with its own device.
    ///
    /// # Errors
    /// [`Error::NoGpu`](crate::Error::NoGpu) if [`DeviceChoice::Gpu`] was asked for and there is none, naming each
    /// adapter and what is wrong with it. [`DeviceChoice::Auto`] falls back to the CPU instead: see
    /// [`fallback_reason`](Self::fallback_reason).
    pub fn new(options: &RendererOptions) -> Result<Self> {
        Ok(Self { compiler: Compiler::new(), device: ActiveTracer::open(options.device)? })
    }

    /// A renderer that uses a tracer of the application's, for example a `trace::gpu::GpuTracer` on the application's
    /// own device. Should that device be lost, every call fails with [`Error::DeviceLost`](crate::Error::DeviceLost)
    /// until [`set_tracer`](Self::set_tracer).
    pub fn with_tracer(tracer: impl Tracer + 'static) -> Self {
        Self { compiler: Compiler::new(), device: ActiveTracer::from_tracer(Box::new(tracer)) }
    }

    /// Replaces the tracer, for example after its device was lost. The next call uploads the whole compiled scene to
    /// it; no acceleration structure is built again.
    pub fn set_tracer(&mut self, tracer: impl Tracer + 'static) {
        self.device.set_tracer(Box::new(tracer));
    }

    /// Sets the token by which another thread stops [`render`](Self::render), [`prepare`](Self::prepare) and the other
    /// calls that compile or trace; `None`, the default, for none. The calls then return
    /// [`Error::Cancelled`](crate::Error::Cancelled), and what they have built until then is kept for the next call.
    ///
    /// On a GPU a frame with a token is submitted in step with its being traced, so that `render` returns when most of
    /// it is done; without a token it returns at once.
    pub fn set_cancel(&mut self, cancel: impl Into<Option<Cancel>>) {
        let cancel = cancel.into();
        self.compiler.set_cancel(cancel.clone());
        self.device.set_cancel(cancel);
    }

    /// Why [`DeviceChoice::Auto`] uses the CPU; `None` while it uses a GPU, and for any other choice.
    pub fn fallback_reason(&self) -> Option<&str> {
        self.device.fallback()
    }

    /// The tracer in use: its executor and the name of its device.
    pub fn device_info(&self) -> &DeviceInfo {
        self.device.tracer().device()
    }

    /// The GPU tracer, for passes of the application's own on its device; `None` if the CPU traces. It holds the scene
    /// as of the last [`prepare`](Self::prepare) or [`render`](Self::render). After its device was lost the next call
    /// replaces the tracer: keep no handle to the old device.
    #[cfg(feature = "gpu")]
    pub fn gpu_tracer(&mut self) -> Option<&mut GpuTracer> {
        self.device.tracer_mut().as_gpu()
    }

    /// Compiles the scene and uploads what changed, without tracing a frame: for applications that trace rays of their
    /// own on the [GPU](Self::gpu_tracer). Costs what [`Compiler::compile_from_last_viewpoint`] and the upload of the
    /// changed ranges cost.
    ///
    /// # Errors
    /// As [`render`](Self::render).
    pub fn prepare(&mut self, scene: &mut Scene) -> Result<CompileReport> {
        self.prepare_by(scene, Compiler::compile_from_last_viewpoint)
    }

    /// Compiles the scene in this way, and uploads it.
    fn prepare_by(
        &mut self,
        scene: &mut Scene,
        compile: impl FnOnce(&mut Compiler, &mut Scene) -> Result<CompileReport>,
    ) -> Result<CompileReport> {
        self.device.recover()?;
        let report = compile(&mut self.compiler, scene)?;
        let uploaded = self.device.tracer_mut().upload(self.compiler.arrays_mut());
        self.device.record_failure(uploaded)?;
        Ok(report)
    }

    /// The render origin, in world space: positions on the device are f32 and relative to it. It follows the camera, so
    /// that positions near the eye have the full resolution of f32, and may move with each [`prepare`](Self::prepare)
    /// and [`render`](Self::render).
    pub fn render_origin(&self) -> DVec3 {
        self.compiler.origin()
    }

    /// Renders the scene: compiles what changed since the last call, uploads that, traces one frame. The frame stays in
    /// device memory; [`Frame::image`] reads it back.
    ///
    /// # Errors
    /// As [`View::validate`]; [`Error::Limit`](crate::Error::Limit) if scene or image are too large for the device;
    /// [`Error::DeviceLost`](crate::Error::DeviceLost) and [`Error::OutOfMemory`](crate::Error::OutOfMemory), after
    /// which the next call recovers as [`DeviceChoice`] describes; [`Error::Gpu`](crate::Error::Gpu) if the driver
    /// fails otherwise; [`Error::Cancelled`](crate::Error::Cancelled) if the [token](Self::set_cancel) stopped it.
    pub fn render(&mut self, scene: &mut Scene, view: &View) -> Result<Frame<'_>> {
        let start = Instant::now();
        view.validate()?;
        self.device.recover()?;

        // 1. Compile what changed in the scene.
        let compile = self.compiler.compile(scene, view.viewpoint())?;

        // 2. Upload the changed ranges.
        let upload_start = Instant::now();
        let uploaded = self.device.tracer_mut().upload(self.compiler.arrays_mut());
        let uploaded_bytes = self.device.record_failure(uploaded)?;
        let upload_time = upload_start.elapsed();

        // 3. Trace the frame.
        let trace_start = Instant::now();
        let arrays = self.compiler.arrays();
        let params = view.frame_params(self.compiler.origin(), arrays.lights.len() as u32);
        let request = FrameRequest { params, needs: compile.needs, aovs: view.aovs };
        let traced = self.device.tracer_mut().render(arrays, &request);
        self.device.record_failure(traced)?;
        let trace_time = trace_start.elapsed();

        let report = FrameReport {
            device: self.device_info().clone(),
            compile,
            uploaded_bytes,
            upload_time,
            trace_time,
            total_time: start.elapsed(),
        };
        Ok(Frame { device: &self.device, report })
    }
}

/// Picking and queries.
impl Renderer {
    /// The closest hit of the camera ray through the centre of a pixel, given as column and row counted from the upper
    /// left: the node, triangle and point that a frame of the scene would show there. `None` if the ray hits nothing.
    /// Compiles the scene as [`render`](Self::render) does, then traces one ray on the CPU, whatever the tracer.
    ///
    /// ```
    /// use glam::{DVec3, Vec3};
    /// use ropewalk::{Camera, Core, DeviceChoice, Geometry, Material, Renderer, RendererOptions, Scene, View};
    ///
    /// let mut scene = Scene::new();
    /// let geometry = scene.add_geometry(Geometry::new([Vec3::NEG_X, Vec3::X, Vec3::Y], [[0, 1, 2]]))?;
    /// let material = scene.add_material(Material::default())?;
    /// let triangle = scene.add(scene.root(), Core::Geometry { geometry, material })?;
    ///
    /// let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu))?;
    /// let (eye, target) = (DVec3::new(0.0, 0.5, 3.0), DVec3::new(0.0, 0.5, 0.0));
    /// let view = View::look_at(eye, target, DVec3::Y, Camera::default(), 64, 48);
    /// let hit = renderer.pick(&mut scene, &view, [32, 24])?.unwrap();
    /// assert_eq!((hit.path.node, hit.triangle), (triangle, 0));
    /// assert!(hit.position.distance(DVec3::new(0.0, 0.5, 0.0)) < 0.05);
    /// assert!(renderer.pick(&mut scene, &view, [0, 0])?.is_none());
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) for a pixel outside the image, and as [`View::validate`];
    /// [`Error::Limit`](crate::Error::Limit) if the scene is too large.
    pub fn pick(&mut self, scene: &mut Scene, view: &View, [x, y]: [u32; 2]) -> Result<Option<Hit>> {
        view.validate()?;
        view.check_pixels(x..x.saturating_add(1), y..y.saturating_add(1))?;
        self.compiler.compile(scene, view.viewpoint())?;
        // Trace the same ray as a frame's kernel does for this pixel; it needs no lights.
        let ray = camera_ray(&view.frame_params(self.compiler.origin(), 0), x, y);
        Ok(Queries::of_compiled_scene(&self.compiler, scene)?.with_ray_mask(view.ray_mask).hit_of_pixel(&ray))
    }

    /// Queries by ray, region and point, on the CPU. Compiles the scene first if it changed.
    ///
    /// # Errors
    /// As [`Queries::new`].
    pub fn queries<'a>(&'a mut self, scene: &'a mut Scene) -> Result<Queries<'a>> {
        Queries::new(&mut self.compiler, scene)
    }
}

/// The frame that was rendered last, in device memory: valid until the next call on the renderer.
pub struct Frame<'r> {
    device: &'r ActiveTracer,
    report: FrameReport,
}

impl fmt::Debug for Frame<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Frame").field("report", &self.report).finish_non_exhaustive()
    }
}

impl Frame<'_> {
    /// What this frame took: structures built and updated, uploads and times, with the reasons.
    pub fn report(&self) -> &FrameReport {
        &self.report
    }

    /// Copies the frame to main memory.
    ///
    /// # Errors
    /// [`Error::DeviceLost`](crate::Error::DeviceLost), [`Error::OutOfMemory`](crate::Error::OutOfMemory) or
    /// [`Error::Gpu`](crate::Error::Gpu) if the driver fails.
    pub fn image(&self) -> Result<Image> {
        self.device.record_failure(self.device.tracer().read_image())
    }

    /// How many pixels needed more rays than [`View::max_rays`], and show the nearest opaque surfaces instead of what
    /// the rest of their rays would have met. On a GPU this blocks until the frame is complete.
    ///
    /// # Errors
    /// As [`image`](Self::image).
    pub fn limited_pixels(&self) -> Result<u64> {
        self.device.record_failure(self.device.tracer().limited_pixels())
    }

    /// The frame's linear radiance as an `Rgba32Float` texture on the renderer's device, for example to present it:
    /// bind it without filtering, or copy from it. `None` if the CPU traced the frame.
    ///
    /// Alpha is 1 plus the share of the radiance that came from unlit surfaces ([`Image::unlit`]). To show a pixel, mix
    /// its tone mapped colour with its colour by that share, as `examples/viewer/src/present.wgsl` does, and write an
    /// alpha of 1.
    #[cfg(feature = "gpu")]
    pub fn texture(&self) -> Option<&wgpu::Texture> {
        self.device.tracer().texture()
    }

    /// Time that the GPU took for the frame, by timestamp queries; `None` on a CPU, and on a device without them.
    /// Blocks until the frame is complete.
    pub fn gpu_time(&self) -> Option<Duration> {
        self.device.tracer().trace_time()
    }
}
