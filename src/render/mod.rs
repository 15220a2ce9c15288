//! The renderer: one call a frame.

mod active_tracer;
mod ray_batches;
mod report;
mod view;

use std::time::{Duration, Instant};

pub use active_tracer::DeviceChoice;
pub use ray_batches::ClosestHits;
pub use report::FrameReport;
pub use view::{Sky, View};

use glam::DVec3;

use active_tracer::ActiveTracer;

use crate::Result;
use crate::compile::{CompileReport, Compiler};
use crate::graph::Scene;
use crate::image::Image;
use crate::query::{Hit, Queries};
#[cfg(feature = "gpu")]
use crate::trace::gpu::GpuTracer;
use crate::trace::kernel::camera_ray;
use crate::trace::{DeviceInfo, FrameRequest, Tracer};

/// Draws scenes by ray tracing.
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
/// let mut renderer = Renderer::new(&RendererOptions { device: DeviceChoice::Cpu })?;
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

/// How a [`Renderer`] is set up.
#[derive(Clone, Debug, Default)]
pub struct RendererOptions {
    /// What traces.
    pub device: DeviceChoice,
}

impl Renderer {
    /// A renderer with its own device.
    ///
    /// # Errors
    /// [`Error::NoGpu`](crate::Error::NoGpu) if [`DeviceChoice::Gpu`] was asked for and there is none, naming each adapter and what is wrong
    /// with it. [`DeviceChoice::Auto`] falls back to the CPU instead: see [`fallback_reason`](Self::fallback_reason).
    pub fn new(options: &RendererOptions) -> Result<Self> {
        Ok(Self { compiler: Compiler::new(), device: ActiveTracer::open(options.device)? })
    }

    /// A renderer with an executor of the application's: a `trace::gpu_tracer::GpuTracer` on the
    /// application's own device, say. Should that device be lost, every call fails with
    /// [`Error::DeviceLost`](crate::Error::DeviceLost) until [`set_tracer`](Self::set_tracer).
    pub fn with_tracer(tracer: impl Tracer + 'static) -> Self {
        Self { compiler: Compiler::new(), device: ActiveTracer::from_tracer(Box::new(tracer)) }
    }

    /// Goes on with another executor of the application's, which is then given the scene as it was compiled: nothing is built
    /// again. On a new device after the old one was lost, say.
    pub fn set_tracer(&mut self, tracer: impl Tracer + 'static) {
        self.device = ActiveTracer::from_tracer(Box::new(tracer));
    }

    /// Why [`DeviceChoice::Auto`] came down to the CPU; `None` if it did not.
    pub fn fallback_reason(&self) -> Option<&str> {
        self.device.fallback()
    }

    /// What traces.
    pub fn device_info(&self) -> &DeviceInfo {
        self.device.tracer().device()
    }

    /// The GPU that traces, for work of the application's own on its device; `None` if none does. It has the scene as of the
    /// last [`prepare`](Self::prepare) or [`render`](Self::render). When its device is lost the next call replaces it.
    #[cfg(feature = "gpu")]
    pub fn gpu_tracer(&mut self) -> Option<&mut GpuTracer> {
        self.device.tracer_mut().as_gpu()
    }

    /// Brings the device up to date with the scene and draws nothing: for rays of the application's own on the
    /// [GPU](Self::gpu_tracer). Costs what [`Compiler::compile_from_last_viewpoint`] and the copy of what changed cost.
    ///
    /// # Errors
    /// As [`render`](Self::render).
    pub fn prepare(&mut self, scene: &mut Scene) -> Result<CompileReport> {
        self.device.recover()?;
        let report = self.compiler.compile_from_last_viewpoint(scene)?;
        let uploaded = self.device.tracer_mut().upload(self.compiler.arrays_mut());
        self.device.record_failure(uploaded)?;
        Ok(report)
    }

    /// The point of the world that is (0, 0, 0) on the device, where numbers are f32: it follows the camera. It may move with each
    /// [`prepare`](Self::prepare) and [`render`](Self::render).
    pub fn render_origin(&self) -> DVec3 {
        self.compiler.origin()
    }

    /// Draws the scene as it is now: finds what changed since the last call, updates what depends on it, traces.
    /// The frame stays on the device; [`Frame::image`] reads it back.
    ///
    /// # Errors
    /// As [`View::validate`]; [`Error::Limit`](crate::Error::Limit) if scene or image are too large for the device;
    /// [`Error::DeviceLost`](crate::Error::DeviceLost) and [`Error::OutOfMemory`](crate::Error::OutOfMemory), after which the next call
    /// does as [`DeviceChoice`] says; [`Error::Gpu`](crate::Error::Gpu) if the driver fails otherwise.
    pub fn render(&mut self, scene: &mut Scene, view: &View) -> Result<Frame<'_>> {
        let start = Instant::now();
        view.validate()?;
        self.device.recover()?;

        // 1. Catch up with the scene.
        let compile = self.compiler.compile(scene, view.viewpoint())?;

        // 2. Copy what changed.
        let upload_start = Instant::now();
        let uploaded = self.device.tracer_mut().upload(self.compiler.arrays_mut());
        let uploaded_bytes = self.device.record_failure(uploaded)?;
        let upload_time = upload_start.elapsed();

        // 3. Trace.
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

/// Asking what is seen.
impl Renderer {
    /// What is seen at a pixel of the view, column and row counted from the upper left one: the node, triangle and point that a
    /// frame of the scene as it is now would show there. `None` for the sky. Catches up with the scene as
    /// [`render`](Self::render) does, then traces one ray, in main memory whatever the device.
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
    /// let mut renderer = Renderer::new(&RendererOptions { device: DeviceChoice::Cpu })?;
    /// let view = View::look_at(DVec3::new(0.0, 0.5, 3.0), DVec3::new(0.0, 0.5, 0.0), DVec3::Y, Camera::default(), 64, 48);
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
        let ray = camera_ray(&view.frame_params(self.compiler.origin(), 0), x, y);
        Ok(Queries::of_compiled_scene(&self.compiler, scene)?.with_ray_mask(view.ray_mask).closest_hit_of_kernel(&ray))
    }

    /// Questions to the scene as it is now, by ray, region or point. Catches up with it first.
    ///
    /// # Errors
    /// As [`Queries::new`].
    pub fn queries<'a>(&'a mut self, scene: &'a mut Scene) -> Result<Queries<'a>> {
        Queries::new(&mut self.compiler, scene)
    }
}

/// A rendered frame, on the device that made it, until the next one.
pub struct Frame<'r> {
    device: &'r ActiveTracer,
    report: FrameReport,
}

impl Frame<'_> {
    /// What was done for it, and why.
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

    /// The frame's linear colour where it is, to be drawn to a window: an `Rgba32Float` texture on the renderer's device, to be bound
    /// (unfiltered) or copied from. `None` if no GPU traced it.
    #[cfg(feature = "gpu")]
    pub fn texture(&self) -> Option<&wgpu::Texture> {
        self.device.tracer().texture()
    }

    /// How long the GPU took by its own clock; `None` on a CPU, and where the device has no clock. Waits for the frame.
    pub fn gpu_time(&self) -> Option<Duration> {
        self.device.tracer().trace_time()
    }
}
