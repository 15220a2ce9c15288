//! Ambient occlusion by the application's own compute shader.

use bytemuck::{Pod, Zeroable};
use ropewalk::device::Needs;
use ropewalk::glam::{DVec3, Vec3};
use ropewalk::trace::gpu::GpuTracer;
use ropewalk::{Renderer, Result, Scene};
use wgpu::BufferUsages;
use wgpu::util::DeviceExt as _;

/// The camera, and how occlusion is measured.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Occlusion {
    pub(crate) eye: DVec3,
    pub(crate) target: DVec3,
    /// Width and height of the image, in pixels.
    pub(crate) size: [u32; 2],
    /// Rays from the surface of each pixel.
    pub(crate) samples: u32,
    /// Only surfaces within this distance occlude, in units of the scene.
    pub(crate) radius: f32,
}

/// `OcclusionParams` of the shader. Positions are relative to the render origin.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct Params {
    pub(crate) eye: Vec3,
    pub(crate) width: u32,
    pub(crate) right: Vec3,
    pub(crate) height: u32,
    pub(crate) up: Vec3,
    pub(crate) samples: u32,
    pub(crate) forward: Vec3,
    pub(crate) radius: f32,
}

impl Occlusion {
    /// The parameters of the shader, for a vertical field of view of 53 degrees.
    pub(crate) fn params(&self, origin: DVec3) -> Params {
        let [width, height] = self.size;
        let forward = (self.target - self.eye).normalize();
        let right = forward.cross(DVec3::Y).normalize();
        let up = right.cross(forward);
        Params {
            eye: (self.eye - origin).as_vec3(),
            width,
            right: (right * 0.5 * f64::from(width) / f64::from(height)).as_vec3(),
            height,
            up: (up * 0.5).as_vec3(),
            samples: self.samples,
            forward: forward.as_vec3(),
            radius: self.radius,
        }
    }

    /// Ambient visibility per pixel, 0 (occluded) to 1 (open), row by row; `None` if the renderer does not use a GPU.
    pub(crate) fn compute(&self, renderer: &mut Renderer, scene: &mut Scene) -> Result<Option<Vec<f32>>> {
        // 1. Upload the scene.
        let needs = renderer.prepare(scene)?.needs;
        let params = self.params(renderer.render_origin());
        let Some(gpu) = renderer.gpu_tracer() else { return Ok(None) };

        // 2. Compile the shader, in which the scene is bind group 1. A program that does this every frame keeps the
        //    pipeline while the include stays equal.
        let device = gpu.wgpu_device().clone();
        let include = gpu.include(needs | Needs::CULLING).in_group(1).with_surfaces();
        let bytes = u64::from(params.width) * u64::from(params.height) * 4;
        let shader = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("occlusion"),
            source: wgpu::ShaderSource::Wgsl((include.source() + include_str!("occlusion.wgsl")).into()),
        });
        let own_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("occlusion"),
            entries: &[
                entry(0, wgpu::BufferBindingType::Uniform),
                entry(1, wgpu::BufferBindingType::Storage { read_only: false }),
            ],
        });
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("occlusion"),
            bind_group_layouts: &[Some(&own_layout), Some(&gpu.include_layout(&include))],
            immediate_size: 0,
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("occlusion"),
            layout: Some(&layout),
            module: &shader,
            entry_point: Some("occlude"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });

        // 3. Bind the parameters and the output.
        let params_buffer = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("occlusion"),
            contents: bytemuck::bytes_of(&params),
            usage: BufferUsages::UNIFORM,
        });
        let buffer = |usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("visibility"),
                size: bytes,
                usage,
                mapped_at_creation: false,
            })
        };
        let visibility = buffer(BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let staging = buffer(BufferUsages::MAP_READ | BufferUsages::COPY_DST);
        let own = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("occlusion"),
            layout: &own_layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: params_buffer.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: visibility.as_entire_binding() },
            ],
        });
        let scene = gpu.include_bind_group(&include)?;

        // 4. Dispatch, and read back.
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &own, &[]);
        pass.set_bind_group(1, &scene, &[]);
        pass.dispatch_workgroups(params.width.div_ceil(8), params.height.div_ceil(8), 1);
        drop(pass);
        encoder.copy_buffer_to_buffer(&visibility, 0, &staging, 0, bytes);
        gpu.wgpu_queue().submit([encoder.finish()]);
        Ok(Some(read(gpu, &staging)))
    }
}

fn entry(binding: u32, ty: wgpu::BufferBindingType) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}

/// Waits for the GPU and copies a buffer of f32; empty if the GPU failed.
fn read(gpu: &GpuTracer, staging: &wgpu::Buffer) -> Vec<f32> {
    staging.slice(..).map_async(wgpu::MapMode::Read, |_| {});
    let done = gpu.wgpu_device().poll(wgpu::PollType::wait_indefinitely());
    let view = staging.slice(..).get_mapped_range();
    match (done, view) {
        (Ok(_), Ok(view)) => bytemuck::pod_collect_to_vec(&view),
        _ => Vec::new(),
    }
}
