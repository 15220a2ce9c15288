//! Which adapter runs the kernel, and what it must offer.

use wgpu::{AdapterInfo, Backend, DeviceType, DownlevelFlags, TextureFormat, TextureUsages};

use super::context::Context;
use super::scene::STORAGE_BUFFERS;
use super::{batch, frame, probe};
use crate::error::{Resource, require_within};
use crate::{Error, Result};

/// Which kinds of adapter count as a GPU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AdapterKinds {
    /// GPUs only. A software renderer (llvmpipe, WARP) is refused: the `cpu` executor is faster than the
    /// same kernel run through one.
    #[default]
    Hardware,
    /// Software renderers too, where there is no GPU: to check the kernel, not to be fast.
    IncludingSoftware,
}

/// How [`GpuTracer::new`](super::GpuTracer::new) looks for a GPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GpuOptions {
    /// The kinds of adapter that will do.
    pub adapters: AdapterKinds,
    /// The graphics interfaces to look through; none at all finds nothing.
    pub backends: wgpu::Backends,
}

impl Default for GpuOptions {
    /// GPUs only, through every interface that this build has (or those that `WGPU_BACKEND` lists: "vulkan", "gl").
    fn default() -> Self {
        Self { adapters: AdapterKinds::default(), backends: wgpu::Backends::all().with_env() }
    }
}

/// The limits that a device of the application's own must be requested with: what the kernel needs, and as much
/// buffer and texture size as `adapter` has. Combine with the application's needs by
/// [`or_better_values_from`](wgpu::Limits::or_better_values_from).
pub fn required_limits(adapter: &wgpu::Adapter) -> wgpu::Limits {
    let offered = adapter.limits();
    let mut limits = wgpu::Limits::downlevel_defaults().or_worse_values_from(&offered);
    limits.max_storage_buffers_per_shader_stage = offered.max_storage_buffers_per_shader_stage;
    limits.max_storage_textures_per_shader_stage = offered.max_storage_textures_per_shader_stage;
    limits.max_buffers_and_acceleration_structures_per_shader_stage =
        offered.max_buffers_and_acceleration_structures_per_shader_stage;
    limits.max_buffer_size = offered.max_buffer_size;
    limits.max_storage_buffer_binding_size = offered.max_storage_buffer_binding_size;
    limits.max_texture_dimension_2d = offered.max_texture_dimension_2d;
    limits
}

/// The features that Ropewalk uses where `adapter` has them: timestamps, for the time spent tracing. It works without.
pub fn optional_features(adapter: &wgpu::Adapter) -> wgpu::Features {
    adapter.features() & wgpu::Features::TIMESTAMP_QUERY
}

/// The best adapter that serves, as a device of our own.
pub(super) fn open(options: &GpuOptions) -> Result<Context> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
    descriptor.backends = options.backends;
    let mut adapters = pollster::block_on(wgpu::Instance::new(descriptor).enumerate_adapters(options.backends));
    adapters.sort_by_key(|adapter| rank(&adapter.get_info()));
    let mut refusals = Vec::new();
    for adapter in &adapters {
        match open_adapter(adapter, options.adapters) {
            Ok(context) => return Ok(context),
            Err(Error::NoGpu { reason }) => refusals.push(reason),
            Err(other) => refusals.push(format!("{}: {other}", describe(&adapter.get_info()))),
        }
    }
    if refusals.is_empty() {
        refusals.push(format!(
            "no driver offers an adapter through {:?}; install your GPU's Vulkan driver, or mesa-vulkan-drivers for a \
             software one",
            options.backends & wgpu::Instance::enabled_backend_features()
        ));
    }
    Err(Error::NoGpu { reason: refusals.join("; ") })
}

/// The adapter's name, interface and driver on one line.
pub(super) fn describe(info: &AdapterInfo) -> String {
    let driver = format!("{} {}", info.driver, info.driver_info);
    match driver.trim() {
        "" => format!("{} ({:?})", info.name, info.backend),
        driver => format!("{} ({:?}, {driver})", info.name, info.backend),
    }
}

/// Fails, naming it, on the first limit that is too low for the kernel.
pub(super) fn check_limits(limits: &wgpu::Limits) -> Result<()> {
    let workgroups = batch::MAX_WORKGROUPS.max(frame::most_workgroups(limits));
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

/// Best first: real GPUs before software, and GL only where nothing better reaches the same GPU.
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

fn open_adapter(adapter: &wgpu::Adapter, adapters: AdapterKinds) -> Result<Context> {
    let info = adapter.get_info();
    let refuse = |why: String| Error::NoGpu { reason: format!("{}: {why}", describe(&info)) };
    if adapters == AdapterKinds::Hardware && info.device_type == DeviceType::Cpu {
        let reason = format!("{} ({:?}) is a software renderer", info.name, info.backend);
        return Err(Error::NoGpu { reason });
    }
    if !adapter.get_downlevel_capabilities().flags.contains(DownlevelFlags::COMPUTE_SHADERS) {
        return Err(refuse("has no compute shaders".into()));
    }
    for format in [TextureFormat::Rgba32Float, TextureFormat::Rgba32Uint] {
        if !adapter.get_texture_format_features(format).allowed_usages.contains(TextureUsages::STORAGE_BINDING) {
            return Err(refuse(format!("cannot write {format:?} textures")));
        }
    }
    check_limits(&adapter.limits()).map_err(|error| refuse(error.to_string()))?;
    let descriptor = wgpu::DeviceDescriptor {
        label: Some("ropewalk"),
        required_features: optional_features(adapter),
        required_limits: required_limits(adapter),
        ..Default::default()
    };
    let (device, queue) =
        pollster::block_on(adapter.request_device(&descriptor)).map_err(|error| refuse(error.to_string()))?;
    let context = Context::new(device, queue);
    context.install_error_callbacks();
    probe::check_loops(&context)?;
    Ok(context)
}
