//! The window: its surface, the picture, and egui over it.

use std::sync::{Arc, Mutex, PoisonError};

use egui_wgpu::{RendererOptions, ScreenDescriptor};
use ropewalk::trace::gpu::{optional_features, required_limits};
use winit::dpi::PhysicalSize;

use crate::device::WindowDevice;
use crate::present::Presenter;
use crate::theme;
use crate::viewport::Viewport;

/// A window that can be drawn to.
pub(crate) struct Window {
    pub(crate) handle: Arc<winit::window::Window>,
    pub(crate) gpu: WindowDevice,
    pub(crate) presenter: Presenter,
    surface: wgpu::Surface<'static>,
    configuration: wgpu::SurfaceConfiguration,
    egui: egui_wgpu::Renderer,
    /// Errors that wgpu reported outside of any call.
    device_errors: Arc<Mutex<Vec<String>>>,
}

/// The output of egui, ready to be drawn.
pub(crate) struct EguiOutput {
    pub(crate) jobs: Vec<egui::ClippedPrimitive>,
    pub(crate) textures: egui::TexturesDelta,
    pub(crate) pixels_per_point: f32,
}

impl Window {
    /// Makes the surface of a window, and the best device that can draw to it.
    pub(crate) fn new(
        handle: winit::window::Window,
        display: winit::event_loop::OwnedDisplayHandle,
    ) -> Result<Self, String> {
        let handle = Arc::new(handle);
        let instance =
            wgpu::Instance::new(wgpu::InstanceDescriptor::new_with_display_handle_from_env(Box::new(display)));
        let surface = instance.create_surface(Arc::clone(&handle)).map_err(|error| error.to_string())?;
        let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: Some(&surface),
            ..Default::default()
        }))
        .map_err(|error| format!("no GPU, or software for one, can draw to a window here: {error}"))?;
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("viewer"),
            required_features: optional_features(&adapter),
            required_limits: required_limits(&adapter),
            ..Default::default()
        }))
        .map_err(|error| error.to_string())?;
        let device_errors = collect_errors(&device);

        let size = handle.inner_size();
        let mut configuration = surface
            .get_default_config(&adapter, size.width.max(1), size.height.max(1))
            .ok_or("the GPU cannot draw to this window")?;
        // Both passes, ours and egui's, encode sRGB themselves.
        configuration.format = configuration.format.remove_srgb_suffix();
        configuration.view_formats = Vec::new();
        surface.configure(&device, &configuration);
        let presenter = Presenter::new(&device, configuration.format);
        let egui = egui_wgpu::Renderer::new(&device, configuration.format, RendererOptions::default());
        let gpu = WindowDevice { device, queue };
        Ok(Self { handle, gpu, presenter, surface, configuration, egui, device_errors })
    }

    pub(crate) fn resize(&mut self, size: PhysicalSize<u32>) {
        (self.configuration.width, self.configuration.height) = (size.width, size.height);
        self.configure();
    }

    /// The largest texture dimension.
    pub(crate) fn max_texture_side(&self) -> usize {
        self.gpu.device.limits().max_texture_dimension_2d as usize
    }

    /// The errors that wgpu reported since the last call.
    pub(crate) fn take_device_errors(&self) -> Vec<String> {
        std::mem::take(&mut *self.device_errors.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Draws the picture and the output of egui; returns whether it was presented.
    pub(crate) fn draw(&mut self, mut output: EguiOutput, viewport: Viewport) -> bool {
        let WindowDevice { device, queue } = &self.gpu;
        for (id, deltas) in output.textures.set.drain() {
            for delta in deltas {
                self.egui.update_texture(device, queue, id, &delta);
            }
        }
        let presented = self.draw_frame(&output, viewport);
        for id in output.textures.free.drain() {
            self.egui.free_texture(&id);
        }
        presented
    }

    fn draw_frame(&mut self, output: &EguiOutput, viewport: Viewport) -> bool {
        let Some(target) = self.target() else { return false };
        let WindowDevice { device, queue } = &self.gpu;
        let screen = ScreenDescriptor {
            size_in_pixels: [self.configuration.width, self.configuration.height],
            pixels_per_point: output.pixels_per_point,
        };
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut commands = self.egui.update_buffers(device, queue, &mut encoder, &output.jobs, &screen);
        let view = target.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let background = egui::Rgba::from(theme::PANEL);
        let [r, g, b] = [background.r(), background.g(), background.b()].map(f64::from);
        {
            let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("window"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color { r, g, b, a: 1.0 }),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            });
            let mut pass = pass.forget_lifetime();
            self.presenter.draw(queue, &mut pass, viewport.within(screen.size_in_pixels));
            self.egui.render(&mut pass, &output.jobs, &screen);
        }
        commands.push(encoder.finish());
        queue.submit(commands);
        self.handle.pre_present_notify();
        queue.present(target);
        true
    }

    /// The next texture of the surface; `None` while the window is not visible.
    fn target(&mut self) -> Option<wgpu::SurfaceTexture> {
        if self.configuration.width == 0 || self.configuration.height == 0 {
            return None;
        }
        match self.surface.get_current_texture() {
            wgpu::CurrentSurfaceTexture::Success(target) => Some(target),
            wgpu::CurrentSurfaceTexture::Suboptimal(target) => {
                drop(target);
                self.retry()
            }
            wgpu::CurrentSurfaceTexture::Outdated | wgpu::CurrentSurfaceTexture::Lost => self.retry(),
            _ => None,
        }
    }

    fn retry(&mut self) -> Option<wgpu::SurfaceTexture> {
        self.configure();
        match self.surface.get_current_texture() {
            wgpu::CurrentSurfaceTexture::Success(target) | wgpu::CurrentSurfaceTexture::Suboptimal(target) => {
                Some(target)
            }
            _ => None,
        }
    }

    fn configure(&self) {
        if self.configuration.width > 0 && self.configuration.height > 0 {
            self.surface.configure(&self.gpu.device, &self.configuration);
        }
    }
}

/// Collects the errors for which wgpu would panic by default.
fn collect_errors(device: &wgpu::Device) -> Arc<Mutex<Vec<String>>> {
    let device_errors = Arc::<Mutex<Vec<String>>>::default();
    let errors = Arc::clone(&device_errors);
    device.on_uncaptured_error(Arc::new(move |error| {
        errors.lock().unwrap_or_else(PoisonError::into_inner).push(error.to_string());
    }));
    let losses = Arc::clone(&device_errors);
    device.set_device_lost_callback(move |_, message| {
        losses.lock().unwrap_or_else(PoisonError::into_inner).push(format!("The GPU was lost: {message}"));
    });
    device_errors
}
