//! Choice of the adapter that runs the kernel, and the features and limits that it must have.

use wgpu::{AdapterInfo, Backend, DeviceType, DownlevelFlags, TextureFormat, TextureUsages};

use super::context::Context;
use super::scene::STORAGE_BUFFERS;
use super::{batch, frame, probe};
use crate::error::{Resource, require_within};
use crate::{Error, Result};

/// Which kinds of adapter count as a GPU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum AdapterKinds {
    /// GPUs only. Software renderers (llvmpipe, WARP) are refused: the `cpu` executor is faster than the GPU kernel on
    /// one of them.
    #[default]
    Hardware,
    /// Software renderers too, where there is no GPU. For testing the kernel; slow.
    IncludingSoftware,
}

/// How [`GpuTracer::new`](super::GpuTracer::new) looks for a GPU. Start from the default and change what matters:
///
/// ```
/// use ropewalk::trace::gpu::{AdapterKinds, GpuOptions};
///
/// let options = GpuOptions::default().with_adapters(AdapterKinds::IncludingSoftware);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct GpuOptions {
    /// The kinds of adapter to accept.
    pub adapters: AdapterKinds,
    /// The graphics interfaces to search. An empty set finds no adapter.
    pub backends: wgpu::Backends,
}

impl Default for GpuOptions {
    /// GPUs only, through every interface that this build supports, or those listed by the environment variable
    /// `WGPU_BACKEND` ("vulkan", "gl").
    fn default() -> Self {
        Self { adapters: AdapterKinds::default(), backends: wgpu::Backends::all().with_env() }
    }
}

impl GpuOptions {
    /// Accepts adapters of these kinds.
    #[must_use]
    pub fn with_adapters(self, adapters: AdapterKinds) -> Self {
        Self { adapters, ..self }
    }

    /// Searches these graphics interfaces.
    #[must_use]
    pub fn with_backends(self, backends: wgpu::Backends) -> Self {
        Self { backends, ..self }
    }
}

/// The limits with which an application must request a device that it passes to
/// [`GpuTracer::from_device`](super::GpuTracer::from_device): the kernel's own, and the greatest buffer and texture
/// sizes of `adapter`. Combine them with the application's own limits by
/// [`or_better_values_from`](wgpu::Limits::or_better_values_from).
pub fn required_limits(adapter: &wgpu::Adapter) -> wgpu::Limits {
    let offered = adapter.limits();
    // Start from wgpu's downlevel defaults, or less where the adapter offers less.
    let mut limits = wgpu::Limits::downlevel_defaults().or_worse_values_from(&offered);
    // Take all the storage bindings and the greatest sizes that it offers.
    limits.max_storage_buffers_per_shader_stage = offered.max_storage_buffers_per_shader_stage;
    limits.max_storage_textures_per_shader_stage = offered.max_storage_textures_per_shader_stage;
    limits.max_buffers_and_acceleration_structures_per_shader_stage =
        offered.max_buffers_and_acceleration_structures_per_shader_stage;
    limits.max_buffer_size = offered.max_buffer_size;
    limits.max_storage_buffer_binding_size = offered.max_storage_buffer_binding_size;
    limits.max_texture_dimension_2d = offered.max_texture_dimension_2d;
    limits
}

/// The optional features that `adapter` has: timestamp queries, without which
/// [`trace_time`](crate::trace::Tracer::trace_time) is `None`.
pub fn optional_features(adapter: &wgpu::Adapter) -> wgpu::Features {
    adapter.features() & wgpu::Features::TIMESTAMP_QUERY
}

/// Opens a device on the best adapter that meets the kernel's requirements.
pub(super) fn open(options: &GpuOptions) -> Result<Context> {
    // Sort all adapters, best first.
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
    descriptor.backends = options.backends;
    let mut adapters = pollster::block_on(wgpu::Instance::new(descriptor).enumerate_adapters(options.backends));
    adapters.sort_by_key(|adapter| rank(&adapter.get_info()));
    // Take the first that can be opened; keep the others' reasons.
    let mut refusals = Vec::new();
    for adapter in &adapters {
        match open_adapter(adapter, options.adapters) {
            Ok(context) => return Ok(context),
            Err(Error::NoGpu { reason }) => refusals.push(reason),
            Err(other) => refusals.push(format!("{}: {other}", describe(&adapter.get_info()))),
        }
    }
    // No adapter at all: say what to install.
    if refusals.is_empty() {
        refusals.push(format!(
            "no driver offers an adapter through {:?}; install your GPU's Vulkan driver, or mesa-vulkan-drivers for a \
             software one",
            options.backends & wgpu::Instance::enabled_backend_features()
        ));
    }
    Err(Error::NoGpu { reason: refusals.join("; ") })
}

/// Formats an adapter's name, interface and driver as one line.
pub(super) fn describe(info: &AdapterInfo) -> String {
    let driver = format!("{} {}", info.driver, info.driver_info);
    match driver.trim() {
        "" => format!("{} ({:?})", info.name, info.backend),
        driver => format!("{} ({:?}, {driver})", info.name, info.backend),
    }
}

/// Checks the limits of a device; the error names the first that is too low for the kernel.
pub(super) fn check_limits(limits: &wgpu::Limits) -> Result<()> {
    let workgroups = batch::MAX_WORKGROUPS.max(frame::max_workgroups(limits));
    // Compare each limit with what the kernel uses.
    for (resource, needed, limit) in [
        (Resource::StorageBuffers, STORAGE_BUFFERS, limits.max_storage_buffers_per_shader_stage),
        (Resource::StorageTextures, 3, limits.max_storage_textures_per_shader_stage),
        (Resource::UniformBuffers, 1, limits.max_uniform_buffers_per_shader_stage),
        (Resource::BindGroups, 2, limits.max_bind_groups),
        (Resource::DynamicUniformBuffers, 1, limits.max_dynamic_uniform_buffers_per_pipeline_layout),
        (Resource::WorkgroupInvocations, 64, limits.max_compute_invocations_per_workgroup),
        (Resource::WorkgroupWidth, 64, limits.max_compute_workgroup_size_x),
        (Resource::WorkgroupHeight, 8, limits.max_compute_workgroup_size_y),
        (Resource::Workgroups, workgroups, limits.max_compute_workgroups_per_dimension),
    ] {
        require_within(resource, needed.into(), limit.into())?;
    }
    Ok(())
}

/// Sort key of adapters, best first: discrete GPUs first and software last; of the same kind, GL last.
fn rank(info: &AdapterInfo) -> (u32, bool) {
    let kind = match info.device_type {
        DeviceType::DiscreteGpu => 0,
        DeviceType::IntegratedGpu => 1,
        DeviceType::VirtualGpu => 2,
        DeviceType::Other => 3,
        DeviceType::Cpu => 4,
    };
    (kind, info.backend == Backend::Gl)
}

/// Opens a device on one adapter; the error says why the adapter was refused.
fn open_adapter(adapter: &wgpu::Adapter, adapters: AdapterKinds) -> Result<Context> {
    let info = adapter.get_info();
    let refuse = |why: String| Error::NoGpu { reason: format!("{}: {why}", describe(&info)) };
    // Refuse software renderers, unless they are asked for.
    if adapters == AdapterKinds::Hardware && info.device_type == DeviceType::Cpu {
        let reason = format!("{} ({:?}) is a software renderer", info.name, info.backend);
        return Err(Error::NoGpu { reason });
    }
    // Check for compute shaders.
    if !adapter.get_downlevel_capabilities().flags.contains(DownlevelFlags::COMPUTE_SHADERS) {
        return Err(refuse("has no compute shaders".into()));
    }
    // Check the storage texture formats of frames.
    for format in [TextureFormat::Rgba32Float, TextureFormat::Rgba32Uint] {
        if !adapter.get_texture_format_features(format).allowed_usages.contains(TextureUsages::STORAGE_BINDING) {
            return Err(refuse(format!("cannot write {format:?} textures")));
        }
    }
    // Check the limits.
    check_limits(&adapter.limits()).map_err(|error| refuse(error.to_string()))?;
    // Open the device.
    let descriptor = wgpu::DeviceDescriptor {
        label: Some("ropewalk"),
        required_features: optional_features(adapter),
        required_limits: required_limits(adapter),
        ..Default::default()
    };
    let (device, queue) =
        pollster::block_on(adapter.request_device(&descriptor)).map_err(|error| refuse(error.to_string()))?;
    // Test that its driver runs long loops to their end.
    let context = Context::new(device, queue);
    context.install_error_callbacks();
    probe::check_loops(&context)?;
    Ok(context)
}
