//! Batches of rays: written to a buffer, traced, and the answers read back; or from one buffer of the application's to another.

use bytemuck::Pod;
use wgpu::BufferUsages;
use wgpu::util::DeviceExt as _;

use super::context::Context;
use super::scene::{largest_buffer, storage_entry};
use crate::Result;
use crate::device::layout::{HitRecord, RayBatch, RayRecord};
use crate::error::{Resource, require, require_within};

/// What fails if this does.
pub(super) const OPERATION: &str = "tracing rays";

/// Rays traced by one dispatch: a small part of a second's work for any GPU, since drivers end longer ones.
const RAYS_PER_DISPATCH: usize = 1 << 18;

/// Rays of a workgroup.
const WORKGROUP_RAYS: u32 = 64;

/// The most workgroups of a dispatch.
pub(super) const MAX_WORKGROUPS: u32 = RAYS_PER_DISPATCH as u32 / WORKGROUP_RAYS;

/// Where the rays of a batch are bound: group 1 of the entry points `closest_hits` and `any_hits`.
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

/// The most rays of one dispatch: rays and hits are of one size.
fn max_rays_per_dispatch(context: &Context) -> usize {
    (largest_buffer(&context.limits) as usize / size_of::<RayRecord>()).clamp(1, RAYS_PER_DISPATCH)
}

/// The buffers of a batch, as large as the largest yet.
#[derive(Debug)]
pub(super) struct BatchBuffers {
    /// Rays that there is room for.
    capacity: usize,
    params: wgpu::Buffer,
    rays: wgpu::Buffer,
    answers: wgpu::Buffer,
    staging: wgpu::Buffer,
    bind_group: wgpu::BindGroup,
}

impl BatchBuffers {
    /// Room for `rays` rays, or for as many as one dispatch traces and a buffer holds.
    pub(super) fn new(context: &Context, layout: &wgpu::BindGroupLayout, rays: usize) -> Self {
        let capacity = rays.next_power_of_two().min(max_rays_per_dispatch(context));
        let buffer = |label, stride, usage| context.buffer(label, (capacity * stride) as u64, usage);
        let params =
            context.buffer("batch", size_of::<RayBatch>() as u64, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
        let rays = buffer("rays", size_of::<RayRecord>(), BufferUsages::STORAGE | BufferUsages::COPY_DST);
        let answers = buffer("answers", size_of::<HitRecord>(), BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let staging = context.staging((capacity * size_of::<HitRecord>()) as u64);
        let bind_group = bind(context, layout, &params, [rays.as_entire_binding(), answers.as_entire_binding()]);
        Self { capacity, params, rays, answers, staging, bind_group }
    }

    /// Whether a batch of that many rays goes through without waiting more often than it must.
    pub(super) fn can_hold(&self, context: &Context, rays: usize) -> bool {
        rays.min(max_rays_per_dispatch(context)) <= self.capacity
    }

    /// Bytes of GPU memory that the buffers take.
    pub(super) fn bytes(&self) -> u64 {
        [&self.params, &self.rays, &self.answers, &self.staging].into_iter().map(wgpu::Buffer::size).sum()
    }

    /// The answer, a `T`, of `pipeline` to each ray.
    pub(super) fn trace<T: Pod>(
        &self,
        context: &Context,
        pipeline: &wgpu::ComputePipeline,
        scene: &wgpu::BindGroup,
        rays: &[RayRecord],
        ray_mask: u32,
    ) -> Result<Vec<T>> {
        let mut answers = Vec::with_capacity(rays.len());
        for rays in rays.chunks(self.capacity) {
            let count = rays.len() as u32;
            let params = RayBatch::new(0, count, ray_mask);
            context.queue.write_buffer(&self.params, 0, bytemuck::bytes_of(&params));
            context.queue.write_buffer(&self.rays, 0, bytemuck::cast_slice(rays));
            let bytes = size_of::<T>() as u64 * u64::from(count);
            context.submit(OPERATION, |encoder| {
                dispatch(encoder, pipeline, scene, &self.bind_group, [(0, count)]);
                encoder.copy_buffer_to_buffer(&self.answers, 0, &self.staging, 0, bytes);
            })?;
            context.read(OPERATION, &self.staging, bytes, |bytes| {
                answers.extend(bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned::<T>));
            })?;
        }
        Ok(answers)
    }
}

/// Rays and their answers in buffers of the application's, on the device that traces.
#[derive(Clone, Copy, Debug)]
pub struct RayBuffers<'a> {
    /// [`RayRecord`]s, relative to the [render origin](crate::Renderer::render_origin), one after the other. A storage buffer.
    pub rays: &'a wgpu::Buffer,
    /// Where the answers are written, one after the other: a [`HitRecord`] for each ray, or a `u32`. A storage buffer.
    pub results: &'a wgpu::Buffer,
    /// How many rays there are.
    pub count: u32,
    /// Instances whose mask shares no bit with this are not hit.
    pub ray_mask: u32,
}

impl RayBuffers<'_> {
    /// Fails unless both buffers hold what they are said to, and a binding holds that.
    pub(super) fn check(&self, limits: &wgpu::Limits, answer_size: usize) -> Result<()> {
        let limit = largest_buffer(limits);
        for (binding, size, buffer, stride) in [
            (Resource::RayBinding, Resource::RayBuffer, self.rays, size_of::<RayRecord>()),
            (Resource::ResultBinding, Resource::ResultBuffer, self.results, answer_size),
        ] {
            let needed = u64::from(self.count) * stride as u64;
            require_within(binding, needed, limit)?;
            require_within(size, needed, buffer.size())?;
            let is_storage = buffer.usage().contains(BufferUsages::STORAGE);
            require(is_storage, "the usage of a buffer of rays or answers", &buffer.usage(), "STORAGE")?;
        }
        Ok(())
    }

    /// Records that the rays are traced.
    pub(super) fn record(
        &self,
        context: &Context,
        layout: &wgpu::BindGroupLayout,
        encoder: &mut wgpu::CommandEncoder,
        pipeline: &wgpu::ComputePipeline,
        scene: &wgpu::BindGroup,
        answer_size: usize,
    ) {
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
        let whole = |buffer, stride: usize| {
            let size = wgpu::BufferSize::new(u64::from(self.count) * stride as u64);
            wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset: 0, size })
        };
        let bound = [whole(self.rays, size_of::<RayRecord>()), whole(self.results, answer_size)];
        let bind_group = bind(context, layout, &params, bound);
        dispatch(encoder, pipeline, scene, &bind_group, dispatches);
    }
}

/// Binds one dispatch's parameters, which one being told by a dynamic offset, the rays and the answers.
fn bind(
    context: &Context,
    layout: &wgpu::BindGroupLayout,
    params: &wgpu::Buffer,
    [rays, answers]: [wgpu::BindingResource<'_>; 2],
) -> wgpu::BindGroup {
    let size = wgpu::BufferSize::new(size_of::<RayBatch>() as u64);
    let one = wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: params, offset: 0, size });
    let entries: Vec<_> =
        (0..).zip([one, rays, answers]).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
    context.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some("batch"), layout, entries: &entries })
}

/// Records dispatches: of each, where its parameters are and how many rays it traces.
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
