//! The devices that can trace: the window's own, and the CPU.

use ropewalk::trace::gpu::GpuTracer;
use ropewalk::{DeviceChoice, Renderer, RendererOptions, Result};

/// The device that draws the window, where there is a window.
#[derive(Clone, Debug)]
pub(crate) struct WindowDevice {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
}

/// A renderer, and why it is not on the GPU where that was to be expected.
pub(crate) struct Opened {
    pub(crate) renderer: Renderer,
    pub(crate) fallback: Option<String>,
}

/// Opens what was chosen: for the GPU the window's device, so that frames are shown where they are.
pub(crate) fn open(choice: DeviceChoice, window: Option<&WindowDevice>) -> Result<Opened> {
    let Some(window) = window else { return own(choice) };
    match choice {
        DeviceChoice::Cpu | DeviceChoice::Emulated => own(choice),
        DeviceChoice::Gpu => shared(window),
        DeviceChoice::Auto if is_software(window) => {
            let reason = format!("{} is a software renderer", window.device.adapter_info().name);
            own(DeviceChoice::Cpu).map(|opened| Opened { fallback: Some(reason), ..opened })
        }
        DeviceChoice::Auto => shared(window).or_else(|error| {
            own(DeviceChoice::Cpu).map(|opened| Opened { fallback: Some(error.to_string()), ..opened })
        }),
    }
}

fn shared(window: &WindowDevice) -> Result<Opened> {
    let tracer = GpuTracer::from_device(window.device.clone(), window.queue.clone())?;
    Ok(Opened { renderer: Renderer::with_tracer(tracer), fallback: None })
}

fn own(device: DeviceChoice) -> Result<Opened> {
    let renderer = Renderer::new(&RendererOptions::default().with_device(device))?;
    let fallback = renderer.fallback_reason().map(str::to_owned);
    Ok(Opened { renderer, fallback })
}

fn is_software(window: &WindowDevice) -> bool {
    window.device.adapter_info().device_type == wgpu::DeviceType::Cpu
}
