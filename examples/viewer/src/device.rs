//! The devices that trace: the device of the window, and the CPU.

use ropewalk::trace::gpu::GpuTracer;
use ropewalk::{DeviceChoice, Renderer, RendererOptions, Result};

/// The device that draws the window.
#[derive(Clone, Debug)]
pub(crate) struct WindowDevice {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
}

/// A renderer, and why it uses the CPU although a GPU is preferred.
pub(crate) struct Opened {
    pub(crate) renderer: Renderer,
    pub(crate) fallback: Option<String>,
}

/// Opens the chosen device: for the GPU the device of the window, so that frames are presented without a copy.
pub(crate) fn open(choice: DeviceChoice, window: Option<&WindowDevice>) -> Result<Opened> {
    let Some(window) = window else { return with_own_device(choice) };
    match choice {
        DeviceChoice::Cpu | DeviceChoice::Emulated => with_own_device(choice),
        DeviceChoice::Gpu => on_window_device(window),
        DeviceChoice::Auto if is_software(window) => {
            let reason = format!("{} is a software renderer", window.device.adapter_info().name);
            with_own_device(DeviceChoice::Cpu).map(|opened| Opened { fallback: Some(reason), ..opened })
        }
        DeviceChoice::Auto => on_window_device(window).or_else(|error| {
            with_own_device(DeviceChoice::Cpu).map(|opened| Opened { fallback: Some(error.to_string()), ..opened })
        }),
    }
}

fn on_window_device(window: &WindowDevice) -> Result<Opened> {
    let tracer = GpuTracer::from_device(window.device.clone(), window.queue.clone())?;
    Ok(Opened { renderer: Renderer::with_tracer(tracer), fallback: None })
}

fn with_own_device(device: DeviceChoice) -> Result<Opened> {
    let renderer = Renderer::new(&RendererOptions::default().with_device(device))?;
    let fallback = renderer.fallback_reason().map(str::to_owned);
    Ok(Opened { renderer, fallback })
}

fn is_software(window: &WindowDevice) -> bool {
    window.device.adapter_info().device_type == wgpu::DeviceType::Cpu
}
