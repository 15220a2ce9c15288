//! The renderer: one call a frame.

mod report;
mod view;

use std::time::{Duration, Instant};

use serde::Serialize;

pub use report::FrameReport;
pub use view::{Sky, View};

use crate::Result;
use crate::compile::Compiler;
use crate::graph::Scene;
use crate::image::Image;
use crate::query::{Hit, Queries};
#[cfg(feature = "gpu")]
use crate::trace::gpu::{Adapters, GpuOptions, GpuTracer};
use crate::trace::kernel::camera_ray;
use crate::trace::{Cpu, DeviceInfo, Emulated, FrameRequest, Tracer};

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
    tracer: Box<dyn Tracer>,
    fallback: Option<String>,
}

/// How a [`Renderer`] is set up.
#[derive(Clone, Debug, Default)]
pub struct RendererOptions {
    /// What traces.
    pub device: DeviceChoice,
}

/// What traces the rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DeviceChoice {
    /// A hardware GPU if there is one, else the CPU.
    #[default]
    Auto,
    /// A GPU, or a software implementation of one; an error if there is neither.
    Gpu,
    /// All CPU cores.
    Cpu,
    /// The GPU kernel line for line on one CPU thread: the paper's "Emulated".
    Emulated,
}

impl Renderer {
    /// A renderer with its own device.
    ///
    /// # Errors
    /// [`Error::NoGpu`](crate::Error::NoGpu) if [`DeviceChoice::Gpu`] was asked for and there is none, naming each adapter and what is wrong
    /// with it. [`DeviceChoice::Auto`] falls back to the CPU instead: see [`fallback`](Self::fallback).
    pub fn new(options: &RendererOptions) -> Result<Self> {
        let (tracer, fallback): (Box<dyn Tracer>, _) = match options.device {
            DeviceChoice::Cpu => (Box::new(Cpu::default()), None),
            DeviceChoice::Emulated => (Box::new(Emulated::default()), None),
            DeviceChoice::Gpu => (open_gpu(options.device)?, None),
            DeviceChoice::Auto => match open_gpu(options.device) {
                Ok(gpu) => (gpu, None),
                Err(reason) => (Box::new(Cpu::default()), Some(reason.to_string())),
            },
        };
        Ok(Self { compiler: Compiler::new(), tracer, fallback })
    }

    /// A renderer with an executor of the application's: a `trace::gpu::GpuTracer` on the
    /// application's own device, say.
    pub fn with_tracer(tracer: impl Tracer + 'static) -> Self {
        Self { compiler: Compiler::new(), tracer: Box::new(tracer), fallback: None }
    }

    /// Why [`DeviceChoice::Auto`] came down to the CPU; `None` if it did not.
    pub fn fallback(&self) -> Option<&str> {
        self.fallback.as_deref()
    }

    /// What traces.
    pub fn device(&self) -> &DeviceInfo {
        self.tracer.device()
    }

    /// Draws the scene as it is now: finds what changed since the last call, updates what depends on it, traces.
    /// The frame stays on the device; [`Frame::image`] reads it back.
    ///
    /// # Errors
    /// As [`View::validate`]; [`Error::Limit`](crate::Error::Limit) if scene or image are too large for the device, [`Error::Gpu`](crate::Error::Gpu) if the driver fails.
    pub fn render(&mut self, scene: &mut Scene, view: &View) -> Result<Frame<'_>> {
        let start = Instant::now();
        view.validate()?;

        // 1. Catch up with the scene.
        let compile = self.compiler.compile(scene, view.observer())?;

        // 2. Copy what changed.
        let upload_start = Instant::now();
        let uploaded_bytes = self.tracer.upload(self.compiler.arrays_mut())?;
        let upload_time = upload_start.elapsed();

        // 3. Trace.
        let trace_start = Instant::now();
        let arrays = self.compiler.arrays();
        let params = view.params(self.compiler.origin(), arrays.lights.len() as u32);
        let request = FrameRequest { params, needs: compile.needs, aovs: view.aovs };
        self.tracer.render(arrays, &request)?;
        let trace_time = trace_start.elapsed();

        let report = FrameReport {
            device: self.tracer.device().clone(),
            compile,
            uploaded_bytes,
            upload_time,
            trace_time,
            total_time: start.elapsed(),
        };
        Ok(Frame { tracer: &*self.tracer, report })
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
        self.compiler.compile(scene, view.observer())?;
        let ray = camera_ray(&view.params(self.compiler.origin(), 0), x, y);
        Ok(Queries::compiled(&self.compiler, scene)?.with_mask(view.ray_mask).closest_drawn(&ray))
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
    tracer: &'r dyn Tracer,
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
    /// [`Error::Gpu`](crate::Error::Gpu) if the driver fails.
    pub fn image(&self) -> Result<Image> {
        self.tracer.read()
    }

    /// The frame's linear colour where it is, to be drawn to a window: an `Rgba32Float` texture on the renderer's device, to be bound
    /// (unfiltered) or copied from. `None` if no GPU traced it.
    #[cfg(feature = "gpu")]
    pub fn texture(&self) -> Option<&wgpu::Texture> {
        self.tracer.texture()
    }

    /// How long the GPU took by its own clock; `None` on a CPU, and where the device has no clock. Waits for the frame.
    pub fn gpu_time(&self) -> Option<Duration> {
        self.tracer.trace_time()
    }
}

/// A GPU; where it was asked for by name, a software one too.
#[cfg(feature = "gpu")]
fn open_gpu(choice: DeviceChoice) -> Result<Box<dyn Tracer>> {
    let adapters = if choice == DeviceChoice::Gpu { Adapters::Any } else { Adapters::Hardware };
    Ok(Box::new(GpuTracer::new(&GpuOptions { adapters, ..GpuOptions::default() })?))
}

#[cfg(not(feature = "gpu"))]
fn open_gpu(_: DeviceChoice) -> Result<Box<dyn Tracer>> {
    Err(crate::Error::NoGpu { reason: "Ropewalk was built without its `gpu` feature".to_owned() })
}
