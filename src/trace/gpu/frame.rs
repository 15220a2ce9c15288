//! The textures of a frame, which stay on the GPU until they are read, and the dispatches that write them.

use bytemuck::Pod;
use wgpu::{BufferUsages, TextureFormat, TextureUsages};

use super::context::Context;
use super::timer::Timer;
use crate::Result;
use crate::device::Needs;
use crate::device::layout::FrameParams;
use crate::error::{Resource, require_within};
use crate::trace::FrameRequest;
use crate::trace::frame_buffer::{AovBuffers, FrameBuffer};
use crate::trace::kernel::max_rays_per_pixel;

/// Operation named in errors: tracing a frame.
pub(super) const TRACING: &str = "tracing the frame";
/// Operation named in errors: reading a frame.
pub(super) const READING: &str = "reading the frame";

/// Budget of rays per dispatch: under one second on a GPU with 10 Mray/s, a slow one. Drivers abort dispatches of
/// seconds.
const RAYS_PER_DISPATCH: u64 = 1 << 23;

/// Cap on pixels per dispatch, as rays in large scenes are slow.
const PIXELS_PER_DISPATCH: u64 = 1 << 18;

/// The most dispatches of a frame that run or wait on the GPU where the frame can be cancelled: nothing stops those.
/// One more than the one that runs keeps the GPU busy.
const MAX_DISPATCHES_AHEAD: usize = 2;

/// Rows of pixels per workgroup; a dispatch traces whole workgroups.
const WORKGROUP_ROWS: u32 = 8;

/// Columns of pixels per workgroup.
const WORKGROUP_COLUMNS: u32 = 8;

/// Greatest size of the staging buffer for reading back, in bytes.
const MAX_STAGING_BYTES: u64 = 64 << 20;

/// Bytes per pixel of every output: four 32-bit numbers.
const PIXEL_BYTES: u32 = 16;

/// Size of the count of limited pixels, in bytes.
const COUNTER_BYTES: u64 = size_of::<u32>() as u64;

/// Layout of bind group 1 of the entry points that render: parameters, output textures, and the count of limited
/// pixels.
pub(super) fn layout(context: &Context) -> wgpu::BindGroupLayout {
    let output = |binding, format| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::StorageTexture {
            access: wgpu::StorageTextureAccess::WriteOnly,
            format,
            view_dimension: wgpu::TextureViewDimension::D2,
        },
        count: None,
    };
    context.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("frame"),
        entries: &[
            wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: true,
                    min_binding_size: wgpu::BufferSize::new(size_of::<FrameParams>() as u64),
                },
                count: None,
            },
            output(1, TextureFormat::Rgba32Float),
            output(2, TextureFormat::Rgba32Float),
            output(3, TextureFormat::Rgba32Uint),
            wgpu::BindGroupLayoutEntry {
                binding: 4,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Storage { read_only: false },
                    has_dynamic_offset: false,
                    min_binding_size: wgpu::BufferSize::new(COUNTER_BYTES),
                },
                count: None,
            },
        ],
    })
}

/// Checks a frame's size against the device's limit on textures and the limit on pixels of any image.
pub(super) fn check_size([width, height]: [u32; 2], limits: &wgpu::Limits) -> Result<()> {
    let limit = limits.max_texture_dimension_2d;
    require_within(Resource::ImageWidth, width.into(), limit.into())?;
    require_within(Resource::ImageHeight, height.into(), limit.into())?;
    FrameBuffer::check_size(width, height)?;
    Ok(())
}

/// The output textures of frames of one size, with what their dispatches bind.
#[derive(Debug)]
pub(super) struct FrameTextures {
    width: u32,
    height: u32,
    aovs: bool,
    color: wgpu::Texture,
    normal_depth: wgpu::Texture,
    ids: wgpu::Texture,
    /// Number of pixels that needed more rays than [`FrameParams::max_rays`].
    limited_pixels: wgpu::Buffer,
    /// Parameters of each dispatch, `stride` bytes apart, for the greatest number of dispatches.
    params: wgpu::Buffer,
    stride: usize,
    bind_group: wgpu::BindGroup,
}

/// One dispatch of a frame: a band of rows.
struct Band {
    /// Byte offset of its parameters.
    offset: u32,
    /// Workgroups per row and per column.
    workgroups: [u32; 2],
}

impl FrameTextures {
    /// Allocates the textures; `width` and `height` are not 0; AOV textures are 1 x 1 if not requested.
    pub(super) fn new(
        context: &Context,
        layout: &wgpu::BindGroupLayout,
        [width, height]: [u32; 2],
        aovs: bool,
    ) -> Self {
        let texture = |label, format, size: [u32; 2]| {
            context.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_SRC,
                view_formats: &[],
            })
        };
        // Outputs that are not requested still need a texture to bind.
        let aov_size = if aovs { [width, height] } else { [1, 1] };
        let color = texture("color", TextureFormat::Rgba32Float, [width, height]);
        let normal_depth = texture("normal and depth", TextureFormat::Rgba32Float, aov_size);
        let ids = texture("ids", TextureFormat::Rgba32Uint, aov_size);
        // Make room for the parameters of the lowest possible bands, and of the empty dispatch.
        let stride =
            size_of::<FrameParams>().next_multiple_of(context.limits.min_uniform_buffer_offset_alignment as usize);
        let slots = 1 + height.div_ceil(WORKGROUP_ROWS) as usize;
        let params = context.buffer("frame", (slots * stride) as u64, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
        let counter_usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        let limited_pixels = context.buffer("limited pixels", COUNTER_BYTES, counter_usage);
        // Bind parameters and outputs.
        let view = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let outputs = [&view(&color), &view(&normal_depth), &view(&ids)];
        let bind_group = bind(context, layout, &params, outputs, &limited_pixels);
        Self { width, height, aovs, color, normal_depth, ids, limited_pixels, params, stride, bind_group }
    }

    /// Whether these textures can be reused for such a frame.
    pub(super) fn matches(&self, size: [u32; 2], aovs: bool) -> bool {
        [self.width, self.height] == size && self.aovs == aovs
    }

    pub(super) fn color(&self) -> &wgpu::Texture {
        &self.color
    }

    /// GPU memory of the textures, in bytes.
    pub(super) fn bytes(&self) -> u64 {
        let pixels = |texture: &wgpu::Texture| u64::from(texture.width()) * u64::from(texture.height());
        (pixels(&self.color) + pixels(&self.normal_depth) + pixels(&self.ids)) * u64::from(PIXEL_BYTES)
    }

    /// Dispatches the frame in bands of rows. A new pipeline first gets an empty dispatch, so that driver compilation
    /// is not part of the measured time. With a token, it stays at most [`MAX_DISPATCHES_AHEAD`] bands ahead of the
    /// GPU; without one it submits all bands and does not wait.
    pub(super) fn trace(
        &self,
        context: &Context,
        pipeline: &wgpu::ComputePipeline,
        is_new: bool,
        scene: &wgpu::BindGroup,
        timer: Option<&Timer>,
        request: &FrameRequest,
    ) -> Result<()> {
        let dispatch = |encoder: &mut wgpu::CommandEncoder, band: &Band, timestamp_writes| {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: None, timestamp_writes });
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, scene, &[]);
            pass.set_bind_group(1, &self.bind_group, &[band.offset]);
            pass.dispatch_workgroups(band.workgroups[0], band.workgroups[1], 1);
        };
        // Write the parameters of all dispatches.
        let bands = self.write_params(context, request);
        // Have the driver compile a new pipeline by an empty dispatch.
        if is_new {
            context.submit(TRACING, |encoder| dispatch(encoder, &Band { offset: 0, workgroups: [1, 1] }, None))?;
        }
        // Submit band by band; the first and the last write the timestamps.
        let mut submissions = Vec::with_capacity(bands.len());
        for (i, band) in bands.iter().enumerate() {
            if let Some(cancel) = &context.cancel {
                if let Some(earlier) = i.checked_sub(MAX_DISPATCHES_AHEAD) {
                    context.wait_for(TRACING, wgpu::SubmissionIndex::clone(&submissions[earlier]))?;
                }
                cancel.check()?;
            }
            let [is_first, is_last] = [i == 0, i + 1 == bands.len()];
            submissions.push(context.submit(TRACING, |encoder| {
                dispatch(encoder, band, timer.and_then(|timer| timer.writes(is_first, is_last)));
                if let (true, Some(timer)) = (is_last, timer) {
                    timer.resolve(encoder);
                }
            })?);
        }
        Ok(())
    }

    /// Writes the parameters of each dispatch. Slot 0: an empty dispatch (`first_row` = height); then one slot per
    /// band.
    fn write_params(&self, context: &Context, request: &FrameRequest) -> Vec<Band> {
        // Choose the height of a band by the rays per pixel.
        let rows = band_rows(self.width, max_rays_of_pixel(request));
        let mut bytes = Vec::new();
        let mut add_slot = |first_row| {
            let offset = bytes.len();
            bytes.extend_from_slice(bytemuck::bytes_of(&FrameParams { first_row, ..request.params }));
            bytes.resize(offset + self.stride, 0);
            offset as u32
        };
        // Add the empty dispatch, then the bands.
        add_slot(self.height);
        let bands = (0..self.height).step_by(rows as usize).map(|first_row| {
            let rows = rows.min(self.height - first_row);
            Band {
                offset: add_slot(first_row),
                workgroups: [self.width.div_ceil(WORKGROUP_COLUMNS), rows.div_ceil(WORKGROUP_ROWS)],
            }
        });
        let bands = bands.collect();
        // Upload all slots in one write, and count from 0.
        context.queue.write_buffer(&self.params, 0, &bytes);
        context.queue.write_buffer(&self.limited_pixels, 0, &0_u32.to_le_bytes());
        bands
    }

    /// Reads the frame back; blocks until it is done.
    pub(super) fn read(&self, context: &Context) -> Result<FrameBuffer> {
        let color = self.read_texture(context, &self.color)?;
        let aovs = match self.aovs {
            true => Some(AovBuffers {
                normal_depth: self.read_texture(context, &self.normal_depth)?,
                ids: self.read_texture(context, &self.ids)?,
            }),
            false => None,
        };
        Ok(FrameBuffer { width: self.width, height: self.height, color, aovs, limited_pixels: 0 })
    }

    /// Reads the number of limited pixels back; blocks until the frame is done.
    pub(super) fn read_limited_pixels(&self, context: &Context) -> Result<u64> {
        context.with_error_scopes(READING, || {
            let staging = context.staging(COUNTER_BYTES);
            context.submit(READING, |encoder| {
                encoder.copy_buffer_to_buffer(&self.limited_pixels, 0, &staging, 0, COUNTER_BYTES);
            })?;
            context.read(READING, &staging, COUNTER_BYTES, |bytes| bytemuck::pod_read_unaligned::<u32>(bytes).into())
        })
    }

    /// Reads a texture's pixels, row by row. The GPU pads each row, and a large image is read in parts.
    fn read_texture<T: Pod>(&self, context: &Context, texture: &wgpu::Texture) -> Result<Vec<[T; 4]>> {
        let row_bytes = u64::from(self.width * PIXEL_BYTES);
        let padded_bytes = row_bytes.next_multiple_of(u64::from(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT));
        let rows = (MAX_STAGING_BYTES.min(context.limits.max_buffer_size) / padded_bytes)
            .clamp(1, u64::from(self.height)) as u32;
        // Read as many rows at a time as the staging buffer holds.
        let mut pixels = Vec::with_capacity(self.width as usize * self.height as usize);
        context.with_error_scopes(READING, || {
            let staging = context.staging(padded_bytes * u64::from(rows));
            for y in (0..self.height).step_by(rows as usize) {
                let rows = rows.min(self.height - y);
                context
                    .submit(READING, |encoder| copy_rows(encoder, texture, y, rows, &staging, padded_bytes as u32))?;
                context.read(READING, &staging, padded_bytes * u64::from(rows), |bytes| {
                    // Drop the padding of each row.
                    for row in bytes.chunks_exact(padded_bytes as usize) {
                        pixels.extend(
                            row[..row_bytes as usize]
                                .chunks_exact(PIXEL_BYTES as usize)
                                .map(bytemuck::pod_read_unaligned::<[T; 4]>),
                        );
                    }
                })?;
            }
            Ok(())
        })?;
        Ok(pixels)
    }
}

/// Creates the bind group: parameters (a dynamic offset selects the dispatch), output textures, and the count.
fn bind(
    context: &Context,
    layout: &wgpu::BindGroupLayout,
    params: &wgpu::Buffer,
    outputs: [&wgpu::TextureView; 3],
    limited_pixels: &wgpu::Buffer,
) -> wgpu::BindGroup {
    let size = wgpu::BufferSize::new(size_of::<FrameParams>() as u64);
    let dispatch_params = wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: params, offset: 0, size });
    let outputs = outputs.map(wgpu::BindingResource::TextureView);
    let entries: Vec<_> = (0..)
        .zip(std::iter::once(dispatch_params).chain(outputs).chain([limited_pixels.as_entire_binding()]))
        .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
        .collect();
    context.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some("frame"), layout, entries: &entries })
}

/// Records the copy of `rows` rows of a texture, from row `y` on, to a staging buffer.
fn copy_rows(
    encoder: &mut wgpu::CommandEncoder,
    texture: &wgpu::Texture,
    y: u32,
    rows: u32,
    staging: &wgpu::Buffer,
    bytes_per_row: u32,
) {
    let source = wgpu::TexelCopyTextureInfo {
        texture,
        mip_level: 0,
        origin: wgpu::Origin3d { x: 0, y, z: 0 },
        aspect: wgpu::TextureAspect::All,
    };
    let layout =
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(bytes_per_row), rows_per_image: Some(rows) };
    let size = wgpu::Extent3d { width: texture.width(), height: rows, depth_or_array_layers: 1 };
    encoder.copy_texture_to_buffer(source, wgpu::TexelCopyBufferInfo { buffer: staging, layout }, size);
}

/// Greatest number of rays that a pixel may need: those of its ray tree, and for each a shadow ray to every light.
fn max_rays_of_pixel(request: &FrameRequest) -> u64 {
    let lights = if request.needs.contains(Needs::LIGHTS) { request.params.light_count } else { 0 };
    u64::from(max_rays_per_pixel(&request.params, request.needs)) * (1 + u64::from(lights))
}

/// Rows per dispatch: whole workgroups, and at least one even where that exceeds the budget, as it does for wide images
/// with many lights.
fn band_rows(width: u32, rays_per_pixel: u64) -> u32 {
    let pixels = PIXELS_PER_DISPATCH.min(RAYS_PER_DISPATCH / rays_per_pixel);
    let rows = (pixels / u64::from(width.max(1))) as u32;
    (rows / WORKGROUP_ROWS).max(1) * WORKGROUP_ROWS
}

/// Greatest number of workgroups along one side of a dispatch: those of the largest texture.
pub(super) fn max_workgroups(limits: &wgpu::Limits) -> u32 {
    limits.max_texture_dimension_2d.div_ceil(WORKGROUP_COLUMNS.min(WORKGROUP_ROWS))
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;

    use super::*;

    fn rays(needs: Needs, max_depth: u32, light_count: u32) -> u64 {
        let params = FrameParams { max_depth, light_count, max_rays: 256, ..FrameParams::zeroed() };
        max_rays_of_pixel(&FrameRequest { params, needs, aovs: false })
    }

    #[test]
    fn bands_are_lower_where_pixels_need_more_rays() {
        let mirrors = Needs::REFLECTION | Needs::REFRACTION;
        assert_eq!(rays(Needs::empty(), 3, 9), 1, "lights that are not needed cast no shadows");
        assert_eq!(rays(Needs::LIGHTS, 3, 9), 10);
        assert_eq!(rays(Needs::LIGHTS | Needs::REFLECTION, 3, 4), 4 * 5);
        assert_eq!(rays(mirrors, 3, 0), 2 * (1 + 2 + 4 + 8), "a refracted ray is traced twice");
        assert_eq!(rays(mirrors | Needs::BLEND, 3, 0), 256 + 2 * 19, "the limit, and what is pending then");

        assert_eq!(band_rows(1024, 1), 256);
        assert_eq!(band_rows(1024, 32), 256);
        assert_eq!(band_rows(1024, 256), 32);
        assert_eq!(band_rows(1000, 15 * 5), 104);
        let mut compared = 0;
        for width in [1, 100, 1920, 16384] {
            for rays in [1, 60, 4096, u64::from(u32::MAX) * 256] {
                let rows = band_rows(width, rays);
                assert!(rows >= WORKGROUP_ROWS && rows.is_multiple_of(WORKGROUP_ROWS), "{rows}");
                let within = u64::from(rows) * u64::from(width) * rays <= RAYS_PER_DISPATCH;
                assert!(within || rows == WORKGROUP_ROWS, "{width} {rays}");
                compared += usize::from(within);
            }
        }
        assert!(compared > 4, "{compared}");
    }
}
