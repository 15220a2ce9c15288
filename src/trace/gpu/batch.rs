//! Ray batches: upload, trace, read back; or trace between two buffers of the application.

use bytemuck::Pod;
use wgpu::BufferUsages;
use wgpu::util::DeviceExt as _;

use super::context::Context;
use super::scene::{largest_buffer, storage_entry};
use crate::device::layout::{HitRecord, RayBatch, RayRecord};
use crate::error::{Resource, require, require_within};
use crate::{Cancel, Result};

/// Operation named in errors.
pub(super) const OPERATION: &str = "tracing rays";

/// Rays per dispatch, so that it stays far below the driver's watchdog timeout (about 2 s).
const RAYS_PER_DISPATCH: usize = 1 << 18;

/// Rays per workgroup, as in `closest_hits.wgsl` and `any_hits.wgsl`.
const WORKGROUP_RAYS: u32 = 64;

/// Greatest number of workgroups per dispatch.
pub(super) const MAX_WORKGROUPS: u32 = RAYS_PER_DISPATCH as u32 / WORKGROUP_RAYS;

/// Layout of bind group 1 of the entry points `closest_hits` and `any_hits`: parameters, rays, results.
pub(super) fn layout(context: &Context) -> wgpu::BindGroupLayout {
    context.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("batch"),
        entries: &[
            wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: true,
                    min_binding_size: wgpu::BufferSize::new(size_of::<RayBatch>() as u64),
                },
                count: None,
            },
            storage_entry(1, true),
            storage_entry(2, false),
        ],
    })
}

/// Greatest number of rays per dispatch whose rays, and hits of the same size, fit a binding.
fn max_rays_per_dispatch(context: &Context) -> usize {
    (largest_buffer(&context.limits) as usize / size_of::<RayRecord>()).clamp(1, RAYS_PER_DISPATCH)
}

/// The buffers of a batch. Grown to the largest batch so far.
#[derive(Debug)]
pub(super) struct BatchBuffers {
    /// Capacity in rays.
    capacity: usize,
    params: wgpu::Buffer,
    rays: wgpu::Buffer,
    results: wgpu::Buffer,
    staging: wgpu::Buffer,
    bind_group: wgpu::BindGroup,
}

impl BatchBuffers {
    /// Allocates buffers for `rays` rays, or for as many as one dispatch traces.
    pub(super) fn new(context: &Context, layout: &wgpu::BindGroupLayout, rays: usize) -> Self {
        let capacity = rays.next_power_of_two().min(max_rays_per_dispatch(context));
        let buffer = |label, stride, usage| context.buffer(label, (capacity * stride) as u64, usage);
        let params =
            context.buffer("batch", size_of::<RayBatch>() as u64, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
        let rays = buffer("rays", size_of::<RayRecord>(), BufferUsages::STORAGE | BufferUsages::COPY_DST);
        let results = buffer("results", size_of::<HitRecord>(), BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let staging = context.staging((capacity * size_of::<HitRecord>()) as u64);
        let bind_group = bind(context, layout, &params, [rays.as_entire_binding(), results.as_entire_binding()]);
        Self { capacity, params, rays, results, staging, bind_group }
    }

    /// Whether the buffers are large enough to trace `rays` rays in the fewest submissions.
    pub(super) fn can_hold(&self, context: &Context, rays: usize) -> bool {
        rays.min(max_rays_per_dispatch(context)) <= self.capacity
    }

    /// GPU memory of the buffers, in bytes.
    pub(super) fn bytes(&self) -> u64 {
        [&self.params, &self.rays, &self.results, &self.staging].into_iter().map(wgpu::Buffer::size).sum()
    }

    /// Traces rays and reads back one `T` per ray.
    pub(super) fn trace<T: Pod>(
        &self,
        context: &Context,
        pipeline: &wgpu::ComputePipeline,
        scene: &wgpu::BindGroup,
        rays: &[RayRecord],
        ray_mask: u32,
    ) -> Result<Vec<T>> {
        let mut results = Vec::with_capacity(rays.len());
        for rays in rays.chunks(self.capacity) {
            context.cancel.as_ref().map_or(Ok(()), Cancel::check)?;
            // Write the parameters and the rays.
            let count = rays.len() as u32;
            let params = RayBatch::new(0, count, ray_mask);
            context.queue.write_buffer(&self.params, 0, bytemuck::bytes_of(&params));
            context.queue.write_buffer(&self.rays, 0, bytemuck::cast_slice(rays));
            // Trace, and copy the results to the staging buffer.
            let bytes = size_of::<T>() as u64 * u64::from(count);
            context.submit(OPERATION, |encoder| {
                dispatch(encoder, pipeline, scene, &self.bind_group, [(0, count)]);
                encoder.copy_buffer_to_buffer(&self.results, 0, &self.staging, 0, bytes);
            })?;
            // Wait, and read the results.
            context.read(OPERATION, &self.staging, bytes, |bytes| {
                results.extend(bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned::<T>));
            })?;
        }
        Ok(results)
    }
}

/// Rays and their results in buffers of the application, on the device that traces
/// ([`wgpu_device`](super::GpuTracer::wgpu_device)). Made by [`new`](Self::new).
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct RayBuffers<'a> {
    /// `count` tightly packed [`RayRecord`]s from offset 0, positions relative to the
    /// [render origin](crate::Renderer::render_origin). Needs the usage `STORAGE`.
    pub rays: &'a wgpu::Buffer,
    /// Written from offset 0: a [`HitRecord`] per ray for closest hits, a `u32` per ray for any hits. Needs the usage
    /// `STORAGE`.
    pub results: &'a wgpu::Buffer,
    /// Number of rays.
    pub count: u32,
    /// Instances whose mask shares no bit with this are not hit.
    pub ray_mask: u32,
}

impl<'a> RayBuffers<'a> {
    /// `count` rays, and a buffer for as many results. They can hit all instances but those whose mask is 0.
    pub fn new(rays: &'a wgpu::Buffer, results: &'a wgpu::Buffer, count: u32) -> Self {
        Self { rays, results, count, ray_mask: u32::MAX }
    }

    /// Lets the rays hit only instances whose mask shares a bit with `ray_mask`.
    #[must_use]
    pub fn with_ray_mask(self, ray_mask: u32) -> Self {
        Self { ray_mask, ..self }
    }

    /// Checks buffer sizes, usages and the binding limit.
    pub(super) fn check(&self, limits: &wgpu::Limits, result_size: usize) -> Result<()> {
        let limit = largest_buffer(limits);
        for (binding, size, buffer, stride) in [
            (Resource::RayBinding, Resource::RayBuffer, self.rays, size_of::<RayRecord>()),
            (Resource::ResultBinding, Resource::ResultBuffer, self.results, result_size),
        ] {
            // Require room for every ray, within one binding, in a storage buffer.
            let needed = u64::from(self.count) * stride as u64;
            require_within(binding, needed, limit)?;
            require_within(size, needed, buffer.size())?;
            let is_storage = buffer.usage().contains(BufferUsages::STORAGE);
            require(is_storage, "the usage of a buffer of rays or results", &buffer.usage(), "STORAGE")?;
        }
        Ok(())
    }

    /// Records dispatches that trace the rays.
    pub(super) fn record(
        &self,
        context: &Context,
        layout: &wgpu::BindGroupLayout,
        encoder: &mut wgpu::CommandEncoder,
        pipeline: &wgpu::ComputePipeline,
        scene: &wgpu::BindGroup,
        result_size: usize,
    ) {
        // Lay out the parameters of each dispatch, a stride apart.
        let stride =
            size_of::<RayBatch>().next_multiple_of(context.limits.min_uniform_buffer_offset_alignment as usize);
        let (mut contents, mut dispatches) = (Vec::new(), Vec::new());
        for first in (0..self.count).step_by(RAYS_PER_DISPATCH) {
            let count = (self.count - first).min(RAYS_PER_DISPATCH as u32);
            dispatches.push((contents.len() as u32, count));
            contents.extend_from_slice(bytemuck::bytes_of(&RayBatch::new(first, count, self.ray_mask)));
            contents.resize(contents.len().next_multiple_of(stride), 0);
        }
        let params = context.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("batch"),
            contents: &contents,
            usage: BufferUsages::UNIFORM,
        });
        // Bind the parts of the buffers that are in use, and dispatch.
        let whole = |buffer, stride: usize| {
            let size = wgpu::BufferSize::new(u64::from(self.count) * stride as u64);
            wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset: 0, size })
        };
        let bound = [whole(self.rays, size_of::<RayRecord>()), whole(self.results, result_size)];
        let bind_group = bind(context, layout, &params, bound);
        dispatch(encoder, pipeline, scene, &bind_group, dispatches);
    }
}

/// Creates the bind group: parameters (a dynamic offset selects the dispatch), rays, results.
fn bind(
    context: &Context,
    layout: &wgpu::BindGroupLayout,
    params: &wgpu::Buffer,
    [rays, results]: [wgpu::BindingResource<'_>; 2],
) -> wgpu::BindGroup {
    let size = wgpu::BufferSize::new(size_of::<RayBatch>() as u64);
    let dispatch_params = wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: params, offset: 0, size });
    let entries: Vec<_> = (0..)
        .zip([dispatch_params, rays, results])
        .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
        .collect();
    context.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some("batch"), layout, entries: &entries })
}

/// Records dispatches, each given by the offset of its parameters and its number of rays.
fn dispatch(
    encoder: &mut wgpu::CommandEncoder,
    pipeline: &wgpu::ComputePipeline,
    scene: &wgpu::BindGroup,
    batch: &wgpu::BindGroup,
    dispatches: impl IntoIterator<Item = (u32, u32)>,
) {
    let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, scene, &[]);
    for (offset, count) in dispatches {
        pass.set_bind_group(1, batch, &[offset]);
        pass.dispatch_workgroups(count.div_ceil(WORKGROUP_RAYS), 1, 1);
    }
}
