//! Batches of rays: written to a buffer, traced, and the answers read back.

use bytemuck::Pod;
use wgpu::BufferUsages;

use super::context::Context;
use super::scene::{largest_buffer, storage_entry};
use crate::Result;
use crate::device::layout::{Hit, Ray, RayBatch};

/// What fails if this does.
pub(super) const DURING: &str = "tracing rays";

/// Rays traced by one dispatch: a small part of a second's work for any GPU, since drivers end longer ones.
const RAYS_PER_DISPATCH: usize = 1 << 18;

/// Rays of a workgroup.
const WORKGROUP_RAYS: u32 = 64;

/// The most workgroups of a dispatch.
pub(super) const MOST_WORKGROUPS: u32 = RAYS_PER_DISPATCH as u32 / WORKGROUP_RAYS;

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
                    has_dynamic_offset: false,
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
fn most_rays(context: &Context) -> usize {
    (largest_buffer(&context.limits) as usize / size_of::<Ray>()).clamp(1, RAYS_PER_DISPATCH)
}

/// The buffers of a batch, as large as the largest yet.
#[derive(Debug)]
pub(super) struct Batch {
    /// Rays that there is room for.
    capacity: usize,
    params: wgpu::Buffer,
    rays: wgpu::Buffer,
    answers: wgpu::Buffer,
    staging: wgpu::Buffer,
    bind_group: wgpu::BindGroup,
}

impl Batch {
    /// Room for `rays` rays, or for as many as one dispatch traces and a buffer holds.
    pub(super) fn new(context: &Context, layout: &wgpu::BindGroupLayout, rays: usize) -> Self {
        let capacity = rays.next_power_of_two().min(most_rays(context));
        let buffer = |label, stride, usage| context.buffer(label, (capacity * stride) as u64, usage);
        let params =
            context.buffer("batch", size_of::<RayBatch>() as u64, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
        let rays = buffer("rays", size_of::<Ray>(), BufferUsages::STORAGE | BufferUsages::COPY_DST);
        let answers = buffer("answers", size_of::<Hit>(), BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let staging = context.staging((capacity * size_of::<Hit>()) as u64);
        let bind_group = context.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("batch"),
            layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: params.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: rays.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 2, resource: answers.as_entire_binding() },
            ],
        });
        Self { capacity, params, rays, answers, staging, bind_group }
    }

    /// Whether a batch of that many rays goes through without waiting more often than it must.
    pub(super) fn serves(&self, context: &Context, rays: usize) -> bool {
        rays.min(most_rays(context)) <= self.capacity
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
        rays: &[Ray],
        ray_mask: u32,
    ) -> Result<Vec<T>> {
        let mut answers = Vec::with_capacity(rays.len());
        for rays in rays.chunks(self.capacity) {
            let count = rays.len() as u32;
            let params = RayBatch { count, ray_mask, _pad: [0; 2] };
            context.queue.write_buffer(&self.params, 0, bytemuck::bytes_of(&params));
            context.queue.write_buffer(&self.rays, 0, bytemuck::cast_slice(rays));
            let bytes = size_of::<T>() as u64 * u64::from(count);
            context.submit(DURING, |encoder| {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
                pass.set_pipeline(pipeline);
                pass.set_bind_group(0, scene, &[]);
                pass.set_bind_group(1, &self.bind_group, &[]);
                pass.dispatch_workgroups(count.div_ceil(WORKGROUP_RAYS), 1, 1);
                drop(pass);
                encoder.copy_buffer_to_buffer(&self.answers, 0, &self.staging, 0, bytes);
            })?;
            context.read(DURING, &self.staging, bytes, |bytes| {
                answers.extend(bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned::<T>));
            })?;
        }
        Ok(answers)
    }
}
