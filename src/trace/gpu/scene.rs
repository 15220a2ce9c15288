//! The GPU's copy of the device arrays: one buffer each, or several where a binding cannot hold one.

use std::ops::Range;

use bytemuck::Pod;

use super::array::{ArrayBuffer, Contents, UploadOutcome};
use super::context::Context;
use crate::device::Needs;
use crate::device::{DeviceArrays, DeviceBuffer};
use crate::error::{Resource, require_within};
use crate::trace::Traversal;
use crate::trace::shader::{ARRAY_COUNT, ArraySplit, ArraySplits, Include, KernelVariant};
use crate::{Error, Result};

/// What fails if an upload does.
pub(super) const DURING: &str = "the upload of the scene";

/// Storage buffers that a kernel reads and writes: the arrays, and the rays and answers of a batch.
pub(super) const STORAGE_BUFFERS: u32 = ARRAY_COUNT + 2;

/// The array that depends on the layout.
const BLAS_BINDING: usize = 2;

/// Uniform buffers that it reads.
const UNIFORM_BUFFERS: u32 = 1;

/// The buffers of the scene's arrays, in the order of their bindings, and the bind group of them all.
#[derive(Debug)]
pub(super) struct SceneBuffers {
    requested_traversal: Traversal,
    bound_traversal: Traversal,
    /// Of each array its parts: one, unless it is split.
    arrays: [Vec<Option<ArrayBuffer>>; ARRAY_COUNT as usize],
    splits: ArraySplits,
    layout: wgpu::BindGroupLayout,
    bind_group: Option<wgpu::BindGroup>,
    bind_groups_made: u64,
}

impl SceneBuffers {
    pub(super) fn new(context: &Context, wanted: Traversal) -> Self {
        let splits = ArraySplits::default();
        Self {
            requested_traversal: wanted,
            bound_traversal: wanted,
            arrays: Default::default(),
            splits,
            layout: layout(context, all_bindings(splits)),
            bind_group: None,
            bind_groups_made: 0,
        }
    }

    /// The kernel that reads the arrays as they are bound.
    pub(super) fn variant(&self, needs: Needs) -> KernelVariant {
        KernelVariant { needs, traversal: self.bound_traversal, splits: self.splits }
    }

    pub(super) fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    /// All arrays, for group 0.
    ///
    /// # Errors
    /// [`Error::Gpu`] before the first upload.
    pub(super) fn bind_group(&self) -> Result<&wgpu::BindGroup> {
        let missing = || Error::Gpu { during: "tracing", message: "no scene was uploaded".into() };
        self.bind_group.as_ref().ok_or_else(missing)
    }

    /// Where the scene is bound for an application's shader.
    pub(super) fn include_layout(context: &Context, include: &Include) -> wgpu::BindGroupLayout {
        layout(context, include.bindings().into_iter())
    }

    /// The scene for an application's shader.
    ///
    /// # Errors
    /// [`Error::Gpu`] before the first upload, and where the arrays are bound as they were not when the shader was made.
    pub(super) fn bind_include(&self, context: &Context, include: &Include) -> Result<wgpu::BindGroup> {
        self.bind_group()?;
        if include.variant != self.variant(include.variant.needs) {
            let message = "the scene's arrays lie in other bindings now: make the shader anew".into();
            return Err(Error::Gpu { during: "binding the scene", message });
        }
        let layout = Self::include_layout(context, include);
        context
            .with_error_scopes("binding the scene", || Ok(self.bind(context, &layout, include.bindings().into_iter())))
    }

    /// Binds the arrays that have these numbers: each array's first part, then the other parts.
    fn bind(
        &self,
        context: &Context,
        layout: &wgpu::BindGroupLayout,
        bindings: impl Iterator<Item = u32>,
    ) -> wgpu::BindGroup {
        let first = self.arrays.iter().filter_map(|parts| parts.first());
        let others = self.arrays.iter().flat_map(|parts| parts.iter().skip(1));
        let buffers: Vec<_> = first.chain(others).flatten().map(ArrayBuffer::buffer).collect();
        let entries: Vec<_> = bindings
            .map(|binding| wgpu::BindGroupEntry { binding, resource: buffers[binding as usize].as_entire_binding() })
            .collect();
        context.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some("scene"), layout, entries: &entries })
    }

    /// How often a buffer came or went, so that all had to be bound anew.
    pub(super) fn bind_group_rebuilds(&self) -> u64 {
        self.bind_groups_made
    }

    /// Bytes of GPU memory that the buffers take.
    pub(super) fn bytes(&self) -> u64 {
        self.arrays.iter().flatten().flatten().map(|part| part.buffer().size()).sum()
    }

    /// Copies what changed and returns how many bytes did. Fails before anything is written if an array is too large for
    /// this device; after any other failure the next call copies everything.
    pub(super) fn upload(&mut self, context: &Context, arrays: &mut DeviceArrays) -> Result<u64> {
        let walked = self.requested_traversal.supported_by(arrays);
        let mut sources = sources(arrays, walked);
        let splits = plan_splits(&sources, &context.limits)?;
        let outcome = context.with_error_scopes(DURING, || {
            if walked != self.bound_traversal {
                self.bound_traversal = walked;
                self.arrays[BLAS_BINDING].clear();
            }
            if splits != self.splits {
                self.layout = layout(context, all_bindings(splits));
                self.splits = splits;
                self.bind_group = None;
            }
            let mut bytes = 0;
            let mut same = self.bind_group.is_some();
            for (source, parts) in sources.iter_mut().zip(&mut self.arrays) {
                let split = source.split.map_or(ArraySplit::WHOLE, |split| *split(&mut self.splits));
                let copied = upload_array(context, source, split, parts)?;
                bytes += copied.bytes;
                same &= copied.same_buffer;
            }
            if !same {
                self.bind_group = Some(self.bind(context, &self.layout, all_bindings(splits)));
                self.bind_groups_made += 1;
            }
            if bytes > 0 {
                context.submit(DURING, |_| {})?;
            }
            Ok(bytes)
        });
        if outcome.is_err() {
            *self = Self { bind_groups_made: self.bind_groups_made, ..Self::new(context, self.requested_traversal) };
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

/// Where arrays are bound, by number: each, then the parts of those that are split.
fn layout(context: &Context, bindings: impl Iterator<Item = u32>) -> wgpu::BindGroupLayout {
    let entries: Vec<_> = bindings.map(|binding| storage_entry(binding, true)).collect();
    let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some("scene"), entries: &entries };
    context.device.create_bind_group_layout(&descriptor)
}

fn all_bindings(splits: ArraySplits) -> std::ops::Range<u32> {
    0..ARRAY_COUNT + splits.extra_bindings()
}

/// How the arrays must be split to fit the device.
fn plan_splits(sources: &[Source<'_>], limits: &wgpu::Limits) -> Result<ArraySplits> {
    let largest = largest_buffer(limits);
    let most = limits.max_storage_buffers_per_shader_stage;
    let most =
        most.min(limits.max_buffers_and_acceleration_structures_per_shader_stage.saturating_sub(UNIFORM_BUFFERS));
    let mut spare = u64::from(most.saturating_sub(STORAGE_BUFFERS));
    let mut splits = ArraySplits::default();
    for source in sources {
        let (needed, stride) = (source.array.bytes().len() as u64, source.placeholder.len() as u64);
        let fits = |limit| require_within(Resource::GpuArray(source.what), needed, limit);
        let Some(split) = source.split else {
            fits(largest)?;
            continue;
        };
        let found = ArraySplit::new(needed / stride, largest / stride);
        if let Some(part_len) = found.part_len() {
            fits(largest.max((1 + spare) * part_len * stride))?;
        }
        spare -= u64::from(found.parts() - 1);
        *split(&mut splits) = found;
    }
    Ok(splits)
}

/// Copies what changed of one array; all of it, where it is split as it was not before.
fn upload_array(
    context: &Context,
    source: &mut Source<'_>,
    split: ArraySplit,
    parts: &mut Vec<Option<ArrayBuffer>>,
) -> Result<UploadOutcome> {
    let dirty = source.array.take_dirty();
    let bytes = source.array.bytes();
    if parts.len() != split.parts() as usize {
        *parts = (0..split.parts()).map(|_| None).collect();
    }
    let largest = largest_buffer(&context.limits);
    let part_size = split.part_len().map_or(largest, |len| len * source.placeholder.len() as u64) as usize;
    let mut all = UploadOutcome { bytes: 0, same_buffer: true };
    for (part, slot) in parts.iter_mut().enumerate() {
        let start = part * part_size;
        let end = bytes.len().min(start.saturating_add(part_size));
        let within = |range: &Range<usize>| range.start.max(start) - start..range.end.min(end).max(start) - start;
        let dirty: Vec<_> = dirty.iter().map(within).filter(|range| !range.is_empty()).collect();
        let contents = Contents {
            what: source.what,
            bytes: &bytes[start..end],
            dirty: &dirty,
            placeholder: source.placeholder,
            limit: part_size as u64,
        };
        let copied = ArrayBuffer::upload(context, &contents, slot)?;
        all = UploadOutcome { bytes: all.bytes + copied.bytes, same_buffer: all.same_buffer && copied.same_buffer };
    }
    Ok(all)
}

/// An array to copy from.
struct Source<'a> {
    what: &'static str,
    array: &'a mut dyn Array,
    /// How it is split, of an array that can be.
    split: Option<fn(&mut ArraySplits) -> &mut ArraySplit>,
    /// A zero element: what the buffer of an empty array holds, since no buffer can be empty.
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
fn sources(arrays: &mut DeviceArrays, layout: Traversal) -> [Source<'_>; ARRAY_COUNT as usize] {
    // What is not walked is not copied, and needs no list of what changed.
    let nodes = match layout {
        Traversal::Rope => {
            arrays.wide_nodes.take_dirty();
            source("blas_nodes", &mut arrays.blas_nodes)
        }
        Traversal::Wide => {
            arrays.blas_nodes.take_dirty();
            source("wide_nodes", &mut arrays.wide_nodes)
        }
    };
    [
        source("tlas_nodes", &mut arrays.tlas_nodes),
        source("instances", &mut arrays.instances),
        Source { split: Some(|s| &mut s.nodes), ..nodes },
        Source { split: Some(|s| &mut s.triangles), ..source("triangles", &mut arrays.triangles) },
        source("geometries", &mut arrays.geometries),
        source("indices", &mut arrays.indices),
        source("normals", &mut arrays.normals),
        source("tex_coords", &mut arrays.tex_coords),
        source("colors", &mut arrays.colors),
        source("materials", &mut arrays.materials),
        source("texture_infos", &mut arrays.texture_infos),
        source("texels", &mut arrays.texels),
        source("lights", &mut arrays.lights),
    ]
}

fn source<'a, T: Pod + PartialEq>(what: &'static str, array: &'a mut DeviceBuffer<T>) -> Source<'a> {
    Source { what, array, split: None, placeholder: &ZEROS[..size_of::<T>()] }
}

/// As large as the largest element. In place of nodes they are what the kernel takes for no hierarchy.
static ZEROS: [u8; 128] = [0; 128];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::shader::EntryPoint;

    /// The arrays are bound by position: each must stand where the shader declares it.
    #[test]
    fn arrays_are_in_the_order_of_the_shader() {
        for layout in [Traversal::Rope, Traversal::Wide] {
            let source =
                EntryPoint::ClosestHits.source(KernelVariant { traversal: layout, ..KernelVariant::default() });
            let module = naga::front::wgsl::parse_str(&source).unwrap();
            let mut arrays = DeviceArrays::default();
            let sources = sources(&mut arrays, layout);
            let mut compared = 0;
            for (_, variable) in module.global_variables.iter() {
                let binding = variable.binding.as_ref().unwrap();
                if binding.group == 0 {
                    let declared = variable.name.as_deref().unwrap();
                    assert_eq!(sources[binding.binding as usize].what, declared);
                    compared += 1;
                }
            }
            assert_eq!(compared, ARRAY_COUNT);
        }
    }
}
