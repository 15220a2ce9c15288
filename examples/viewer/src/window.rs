//! The window on the GPU: its surface, the picture, and egui over it.

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
    pub(crate) on: WindowDevice,
    pub(crate) presenter: Presenter,
    surface: wgpu::Surface<'static>,
    configuration: wgpu::SurfaceConfiguration,
    egui: egui_wgpu::Renderer,
    /// What the driver said outside of any call.
    complaints: Arc<Mutex<Vec<String>>>,
}

/// What egui wants drawn.
pub(crate) struct Painted {
    pub(crate) jobs: Vec<egui::ClippedPrimitive>,
    pub(crate) textures: egui::TexturesDelta,
    pub(crate) pixels_per_point: f32,
}

impl Window {
    /// Makes the window's surface and the best device that can draw to it.
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
        let complaints = listen(&device);

        let size = handle.inner_size();
        let mut configuration = surface
            .get_default_config(&adapter, size.width.max(1), size.height.max(1))
            .ok_or("the GPU cannot draw to this window")?;
        // The picture is encoded by our own pass, egui's colours by its own.
        configuration.format = configuration.format.remove_srgb_suffix();
        configuration.view_formats = Vec::new();
        surface.configure(&device, &configuration);
        let presenter = Presenter::new(&device, configuration.format);
        let egui = egui_wgpu::Renderer::new(&device, configuration.format, RendererOptions::default());
        let on = WindowDevice { device, queue };
        Ok(Self { handle, on, presenter, surface, configuration, egui, complaints })
    }

    pub(crate) fn resize(&mut self, size: PhysicalSize<u32>) {
        (self.configuration.width, self.configuration.height) = (size.width, size.height);
        self.configure();
    }

    /// The longest side that a texture may have.
    pub(crate) fn most_texels(&self) -> usize {
        self.on.device.limits().max_texture_dimension_2d as usize
    }

    /// What the driver said since the last call.
    pub(crate) fn take_complaints(&self) -> Vec<String> {
        std::mem::take(&mut *self.complaints.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Draws the picture and what egui has painted; whether it is on its way to the screen.
    pub(crate) fn draw(&mut self, mut painted: Painted, viewport: Viewport) -> bool {
        let WindowDevice { device, queue } = &self.on;
        for (id, deltas) in painted.textures.set.drain() {
            for delta in deltas {
                self.egui.update_texture(device, queue, id, &delta);
            }
        }
        let presented = self.draw_frame(&painted, viewport);
        for id in painted.textures.free.drain() {
            self.egui.free_texture(&id);
        }
        presented
    }

    fn draw_frame(&mut self, painted: &Painted, viewport: Viewport) -> bool {
        let Some(target) = self.target() else { return false };
        let WindowDevice { device, queue } = &self.on;
        let screen = ScreenDescriptor {
            size_in_pixels: [self.configuration.width, self.configuration.height],
            pixels_per_point: painted.pixels_per_point,
        };
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut commands = self.egui.update_buffers(device, queue, &mut encoder, &painted.jobs, &screen);
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
            self.egui.render(&mut pass, &painted.jobs, &screen);
        }
        commands.push(encoder.finish());
        queue.submit(commands);
        self.handle.pre_present_notify();
        queue.present(target);
        true
    }

    /// What to draw to; `None` while there is nothing to be seen.
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
            self.surface.configure(&self.on.device, &self.configuration);
        }
    }
}

/// Hears what wgpu would otherwise panic about.
fn listen(device: &wgpu::Device) -> Arc<Mutex<Vec<String>>> {
    let complaints = Arc::<Mutex<Vec<String>>>::default();
    let errors = Arc::clone(&complaints);
    device.on_uncaptured_error(Arc::new(move |error| {
        errors.lock().unwrap_or_else(PoisonError::into_inner).push(error.to_string());
    }));
    let losses = Arc::clone(&complaints);
    device.set_device_lost_callback(move |_, message| {
        losses.lock().unwrap_or_else(PoisonError::into_inner).push(format!("The GPU was lost: {message}"));
    });
    complaints
}
