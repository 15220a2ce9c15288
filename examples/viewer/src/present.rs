//! Presentation of traced frames: a pass that filters, tone maps and encodes them for the window.

use ropewalk::image::Image;
use wgpu::util::DeviceExt as _;

use crate::drawing::Picture;
use crate::viewport::Viewport;

/// The pass, and the bind group of the frame that it shows.
pub(crate) struct Presenter {
    pipeline: wgpu::RenderPipeline,
    viewport: wgpu::Buffer,
    shown: Option<wgpu::BindGroup>,
}

impl Presenter {
    /// A presenter for windows of this format, which must not be an sRGB format: the pass encodes.
    pub(crate) fn new(device: &wgpu::Device, format: wgpu::TextureFormat) -> Self {
        let shader = device.create_shader_module(wgpu::include_wgsl!("present.wgsl"));
        let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("present"),
            layout: Some(&pipeline_layout(device)),
            vertex: wgpu::VertexState {
                module: &shader,
                entry_point: Some("vertex"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &shader,
                entry_point: Some("fragment"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(format.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        let viewport = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("viewport"),
            size: size_of::<[f32; 4]>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Self { pipeline, viewport, shown: None }
    }

    /// Sets the frame that is shown.
    pub(crate) fn set_picture(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, picture: &Picture) {
        let texture = match picture {
            Picture::Texture(texture) => texture,
            Picture::Image(image) => &upload(device, queue, image),
        };
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        self.shown = Some(device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("present"),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&view) },
                wgpu::BindGroupEntry { binding: 1, resource: self.viewport.as_entire_binding() },
            ],
        }));
    }

    /// Draws the frame.
    pub(crate) fn draw(&self, queue: &wgpu::Queue, pass: &mut wgpu::RenderPass<'_>, viewport: Viewport) {
        let Some(shown) = self.shown.as_ref().filter(|_| viewport.width > 0 && viewport.height > 0) else { return };
        let [x, y, width, height] = [viewport.x, viewport.y, viewport.width, viewport.height];
        let numbers = [x, y, width, height].map(|pixels| pixels as f32);
        queue.write_buffer(&self.viewport, 0, bytemuck::bytes_of(&numbers));
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, shown, &[]);
        pass.set_scissor_rect(x, y, width, height);
        pass.draw(0..3, 0..1);
    }
}

fn pipeline_layout(device: &wgpu::Device) -> wgpu::PipelineLayout {
    let entry =
        |binding, ty| wgpu::BindGroupLayoutEntry { binding, visibility: wgpu::ShaderStages::FRAGMENT, ty, count: None };
    let frame = wgpu::BindingType::Texture {
        // Not every device can filter a format of 32 bits a channel.
        sample_type: wgpu::TextureSampleType::Float { filterable: false },
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let viewport = wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    let group = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("present"),
        entries: &[entry(0, frame), entry(1, viewport)],
    });
    device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("present"),
        bind_group_layouts: &[Some(&group)],
        immediate_size: 0,
    })
}

/// Uploads an image to a texture of the format that a GPU traces to.
fn upload(device: &wgpu::Device, queue: &wgpu::Queue, image: &Image) -> wgpu::Texture {
    let size = wgpu::Extent3d { width: image.width, height: image.height, depth_or_array_layers: 1 };
    let descriptor = wgpu::TextureDescriptor {
        label: Some("image"),
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba32Float,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    };
    // As a GPU writes it: alpha is 1 plus the unlit share.
    let mut texels = image.color.clone();
    texels.iter_mut().zip(&image.unlit).for_each(|(texel, share)| texel[3] += share);
    let order = wgpu::util::TextureDataOrder::LayerMajor;
    device.create_texture_with_data(queue, &descriptor, order, bytemuck::cast_slice(&texels))
}
