//! The GPU's copy of the device arrays: one buffer each, of which only what changed is written.

use std::ops::Range;

use bytemuck::Pod;
use wgpu::BufferUsages;

use super::context::Context;
use crate::device::{DeviceArrays, DeviceBuffer};
use crate::{Error, Result};

/// How many arrays there are.
const ARRAY_COUNT: usize = 13;

/// What fails if an upload does.
const DURING: &str = "the upload of the scene";

/// wgpu keeps a copy of all that it is given to write until the next submission, so there is one this often.
const BYTES_PER_SUBMISSION: usize = 64 << 20;

/// Changes of fewer bytes are gathered into one write.
const SMALL_RANGE: usize = 16 << 10;

/// Changes with fewer bytes between them are written as one, those bytes too.
const SMALL_GAP: usize = 256;

/// A buffer is made smaller when its array needs less than one part in this many.
const SHRINK: u64 = 4;

/// The buffers of the scene's arrays, in the order of their bindings, and the bind group of them all.
#[derive(Debug)]
pub(super) struct SceneBuffers {
    layout: wgpu::BindGroupLayout,
    buffers: [Option<ArrayBuffer>; ARRAY_COUNT],
    bind_group: Option<wgpu::BindGroup>,
    bind_groups_made: u64,
}

impl SceneBuffers {
    pub(super) fn new(context: &Context) -> Self {
        let entries: Vec<_> = (0..ARRAY_COUNT as u32).map(|binding| storage_entry(binding, true)).collect();
        let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some("scene"), entries: &entries };
        let layout = context.device.create_bind_group_layout(&descriptor);
        Self { layout, buffers: Default::default(), bind_group: None, bind_groups_made: 0 }
    }

    pub(super) fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    /// All arrays, for group 0; none before the first upload.
    pub(super) fn bind_group(&self) -> Option<&wgpu::BindGroup> {
        self.bind_group.as_ref()
    }

    /// How often a buffer came or went, so that all had to be bound anew.
    pub(super) fn bind_groups_made(&self) -> u64 {
        self.bind_groups_made
    }

    /// Bytes of GPU memory that the buffers take.
    pub(super) fn bytes(&self) -> u64 {
        self.buffers.iter().flatten().map(|array| array.buffer.size()).sum()
    }

    /// Copies what changed and returns how many bytes did. Fails before anything is written if an array is too large for
    /// a buffer of this device; after any other failure the next call copies everything.
    pub(super) fn upload(&mut self, context: &Context, arrays: &mut DeviceArrays) -> Result<u64> {
        let mut sources = sources(arrays);
        for source in &sources {
            check_size(source.what, source.array.bytes().len() as u64, &context.limits)?;
        }
        let outcome = context.scoped(DURING, || {
            let mut bytes = 0;
            let mut same = self.bind_group.is_some();
            for (source, slot) in sources.iter_mut().zip(&mut self.buffers) {
                let copied = upload_array(context, source, slot)?;
                bytes += copied.bytes;
                same &= copied.same_buffer;
            }
            if !same {
                self.bind_group = Some(bind(context, &self.layout, &self.buffers));
                self.bind_groups_made += 1;
            }
            if bytes > 0 {
                context.submit(DURING, |_| {})?;
            }
            Ok(bytes)
        });
        if outcome.is_err() {
            self.buffers = Default::default();
            self.bind_group = None;
        }
        outcome
    }
}

/// A storage buffer of a compute shader, for a bind group layout.
pub(super) fn storage_entry(binding: u32, read_only: bool) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Storage { read_only },
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    }
}

/// The most bytes that one storage buffer of a device can have.
pub(super) fn largest_buffer(limits: &wgpu::Limits) -> u64 {
    limits.max_buffer_size.min(limits.max_storage_buffer_binding_size)
}

/// One array on the GPU. The buffer may have room for more.
#[derive(Debug)]
struct ArrayBuffer {
    buffer: wgpu::Buffer,
    /// Bytes in use; 0 where there is but a placeholder.
    used: u64,
}

struct Copied {
    bytes: u64,
    same_buffer: bool,
}

/// Copies what changed of one array, into a larger or smaller buffer where needed.
fn upload_array(context: &Context, source: &mut Source, slot: &mut Option<ArrayBuffer>) -> Result<Copied> {
    let dirty = source.array.take_dirty();
    let bytes = source.array.bytes();
    let used = bytes.len() as u64;
    let make = |size| {
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        context.buffer(source.what, size, usage)
    };
    let old = slot.take().filter(|old| (old.used == 0) == bytes.is_empty());
    let Some(old) = old else {
        let contents = if bytes.is_empty() { source.placeholder } else { bytes };
        let buffer = make(contents.len() as u64);
        write(context, &buffer, contents, 0..contents.len());
        *slot = Some(ArrayBuffer { buffer, used });
        return Ok(Copied { bytes: used, same_buffer: false });
    };
    let size = old.buffer.size();
    let same_buffer = bytes.is_empty() || (used <= size && used >= size / SHRINK);
    let buffer = if same_buffer {
        old.buffer
    } else {
        let room = if used > size { used.max(size / 2 * 3) } else { used };
        let buffer = make(room.next_multiple_of(16).min(largest_buffer(&context.limits) / 4 * 4));
        let kept = used.min(old.used);
        context.submit(DURING, |encoder| encoder.copy_buffer_to_buffer(&old.buffer, 0, &buffer, 0, kept))?;
        buffer
    };
    let (small, large): (Vec<_>, Vec<_>) = join_near(&dirty).into_iter().partition(|range| range.len() < SMALL_RANGE);
    for range in large {
        write(context, &buffer, bytes, range);
    }
    scatter(context, &buffer, bytes, &small)?;
    *slot = Some(ArrayBuffer { buffer, used });
    Ok(Copied { bytes: dirty.iter().map(|range| range.len() as u64).sum(), same_buffer })
}

fn write(context: &Context, buffer: &wgpu::Buffer, bytes: &[u8], range: Range<usize>) {
    for start in range.clone().step_by(BYTES_PER_SUBMISSION) {
        let end = range.end.min(start + BYTES_PER_SUBMISSION);
        context.queue.write_buffer(buffer, start as u64, &bytes[start..end]);
        if end - start == BYTES_PER_SUBMISSION {
            context.queue.submit([]);
        }
    }
}

/// Joins those of the sorted `ranges` that have little between them.
fn join_near(ranges: &[Range<usize>]) -> Vec<Range<usize>> {
    let is_near = |a: &Range<usize>, b: &Range<usize>| b.start - a.end < SMALL_GAP;
    ranges.chunk_by(is_near).map(|near| near[0].start..near[near.len() - 1].end).collect()
}

/// Writes many small ranges at the cost of one write and as many copies on the GPU: a write of its own for each takes ten
/// times as long.
fn scatter(context: &Context, buffer: &wgpu::Buffer, bytes: &[u8], ranges: &[Range<usize>]) -> Result<()> {
    for ranges in ranges.chunks(BYTES_PER_SUBMISSION / SMALL_RANGE) {
        if let [range] = ranges {
            write(context, buffer, bytes, range.clone());
            continue;
        }
        let mut gathered = Vec::with_capacity(ranges.iter().map(ExactSizeIterator::len).sum());
        for range in ranges {
            gathered.extend_from_slice(&bytes[range.clone()]);
        }
        let usage = BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let scratch = context.buffer("changes", gathered.len() as u64, usage);
        write(context, &scratch, &gathered, 0..gathered.len());
        context.submit(DURING, |encoder| {
            let mut from = 0;
            for range in ranges {
                let size = range.len() as u64;
                encoder.copy_buffer_to_buffer(&scratch, from, buffer, range.start as u64, size);
                from += size;
            }
        })?;
    }
    Ok(())
}

fn bind(
    context: &Context,
    layout: &wgpu::BindGroupLayout,
    buffers: &[Option<ArrayBuffer>; ARRAY_COUNT],
) -> wgpu::BindGroup {
    let entries: Vec<_> = (0..)
        .zip(buffers.iter().flatten())
        .map(|(binding, array)| wgpu::BindGroupEntry { binding, resource: array.buffer.as_entire_binding() })
        .collect();
    context.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some("scene"), layout, entries: &entries })
}

fn check_size(what: &'static str, needed: u64, limits: &wgpu::Limits) -> Result<()> {
    let limit = largest_buffer(limits);
    if needed > limit {
        let hint = "; share geometry between nodes, or use the cpu executor";
        return Err(Error::Limit { what, needed, limit, hint });
    }
    Ok(())
}

/// An array to copy from.
struct Source<'a> {
    what: &'static str,
    array: &'a mut dyn Array,
    /// What the buffer of an empty array holds, since no buffer can be empty.
    placeholder: &'static [u8],
}

/// A [`DeviceBuffer`] of any element type.
trait Array {
    fn bytes(&self) -> &[u8];

    /// The ranges of bytes that changed since the last call.
    fn take_dirty(&mut self) -> Vec<Range<usize>>;
}

impl<T: Pod + PartialEq> Array for DeviceBuffer<T> {
    fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(self)
    }

    fn take_dirty(&mut self) -> Vec<Range<usize>> {
        let ranges = DeviceBuffer::take_dirty(self).into_iter();
        ranges.map(|range| range.start * size_of::<T>()..range.end * size_of::<T>()).collect()
    }
}

/// All arrays in the order of their bindings in `shaders/shared/types.wgsl`.
fn sources(arrays: &mut DeviceArrays) -> [Source<'_>; ARRAY_COUNT] {
    [
        source("tlas_nodes (bytes)", &mut arrays.tlas_nodes),
        source("instances (bytes)", &mut arrays.instances),
        source("blas_nodes (bytes)", &mut arrays.blas_nodes),
        source("triangles (bytes)", &mut arrays.triangles),
        source("geometries (bytes)", &mut arrays.geometries),
        source("indices (bytes)", &mut arrays.indices),
        source("normals (bytes)", &mut arrays.normals),
        source("tex_coords (bytes)", &mut arrays.tex_coords),
        source("colors (bytes)", &mut arrays.colors),
        source("materials (bytes)", &mut arrays.materials),
        source("texture_infos (bytes)", &mut arrays.texture_infos),
        source("texels (bytes)", &mut arrays.texels),
        source("lights (bytes)", &mut arrays.lights),
    ]
}

fn source<'a, T: Pod + PartialEq>(what: &'static str, array: &'a mut DeviceBuffer<T>) -> Source<'a> {
    Source { what, array, placeholder: &ZEROS[..size_of::<T>()] }
}

/// As large as the largest element. In place of nodes they are what the kernel takes for no hierarchy.
static ZEROS: [u8; 128] = [0; 128];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_ranges_are_joined_and_far_ones_are_not() {
        let near = SMALL_GAP - 4;
        let ranges = [0..4, 4 + near..600, 600 + SMALL_GAP..1000, 1000 + near..2000, 5000..5004];
        assert_eq!(join_near(&ranges), [0..600, 600 + SMALL_GAP..2000, 5000..5004]);
        assert_eq!(join_near(&[]), []);
    }

    /// The arrays are bound by position: each must stand where the shader declares it.
    #[test]
    fn arrays_are_in_the_order_of_the_shader() {
        let module = naga::front::wgsl::parse_str(include_str!("../../../shaders/shared/types.wgsl")).unwrap();
        let mut arrays = DeviceArrays::default();
        let sources = sources(&mut arrays);
        let mut compared = 0;
        for (_, variable) in module.global_variables.iter() {
            let binding = variable.binding.as_ref().unwrap();
            assert_eq!(binding.group, 0);
            let declared = format!("{} (bytes)", variable.name.as_deref().unwrap());
            assert_eq!(sources[binding.binding as usize].what, declared);
            compared += 1;
        }
        assert_eq!(compared, ARRAY_COUNT);
    }
}
