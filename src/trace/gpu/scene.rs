//! The GPU's copy of the device arrays: one buffer per array, or several for an array larger than a binding.

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

/// Operation named in errors.
pub(super) const UPLOADING: &str = "the upload of the scene";

/// Storage buffers of a kernel: the arrays, and the rays and results of a batch.
pub(super) const STORAGE_BUFFERS: u32 = ARRAY_COUNT + 2;

/// Binding of the BLAS nodes (rope or wide).
const BLAS_BINDING: usize = 2;

/// Uniform buffers of a kernel.
const UNIFORM_BUFFERS: u32 = 1;

/// The buffers of the scene's arrays, in the order of their bindings, and the bind group of them all.
#[derive(Debug)]
pub(super) struct SceneBuffers {
    /// As set by the user.
    requested_traversal: Traversal,
    /// The one whose nodes are bound: `Rope` if the arrays have no wide nodes.
    bound_traversal: Traversal,
    /// Buffers of each array: one, or one per part.
    arrays: [Vec<Option<ArrayBuffer>>; ARRAY_COUNT as usize],
    splits: ArraySplits,
    layout: wgpu::BindGroupLayout,
    bind_group: Option<wgpu::BindGroup>,
    bind_group_rebuilds: u64,
}

impl SceneBuffers {
    pub(super) fn new(context: &Context, traversal: Traversal) -> Self {
        let splits = ArraySplits::default();
        Self {
            requested_traversal: traversal,
            bound_traversal: traversal,
            arrays: Default::default(),
            splits,
            layout: layout(context, all_bindings(splits)),
            bind_group: None,
            bind_group_rebuilds: 0,
        }
    }

    /// The variant of a kernel that reads the arrays as they are bound now.
    pub(super) fn variant(&self, needs: Needs) -> KernelVariant {
        KernelVariant::from(needs).with_traversal(self.bound_traversal).with_splits(self.splits)
    }

    pub(super) fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    /// The bind group of all arrays, group 0 of every kernel.
    ///
    /// # Errors
    /// [`Error::Gpu`] before the first upload.
    pub(super) fn bind_group(&self) -> Result<&wgpu::BindGroup> {
        let missing = || Error::Gpu { during: "tracing", message: "no scene was uploaded".into() };
        self.bind_group.as_ref().ok_or_else(missing)
    }

    /// Layout of the scene's bind group for an application's shader.
    pub(super) fn include_layout(context: &Context, include: &Include) -> wgpu::BindGroupLayout {
        layout(context, include.bindings().into_iter())
    }

    /// The scene's bind group for an application's shader.
    ///
    /// # Errors
    /// [`Error::Gpu`] before the first upload, and if the include no longer matches the scene's bindings.
    pub(super) fn bind_include(&self, context: &Context, include: &Include) -> Result<wgpu::BindGroup> {
        self.bind_group()?;
        // Refuse an include that was made for other bindings.
        if include.variant != self.variant(include.variant.needs) {
            let message = "the scene's bindings changed; call include() again and rebuild the shader".into();
            return Err(Error::Gpu { during: "binding the scene", message });
        }
        let layout = Self::include_layout(context, include);
        context
            .with_error_scopes("binding the scene", || Ok(self.bind(context, &layout, include.bindings().into_iter())))
    }

    /// Creates a bind group of these bindings. The numbers are those of `all_bindings`: the first part of each array,
    /// then the other parts.
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

    /// Number of times the bind group was recreated.
    pub(super) fn bind_group_rebuilds(&self) -> u64 {
        self.bind_group_rebuilds
    }

    /// GPU memory of the buffers, in bytes.
    pub(super) fn bytes(&self) -> u64 {
        self.arrays.iter().flatten().flatten().map(|part| part.buffer().size()).sum()
    }

    /// Uploads the dirty ranges and returns their size in bytes. Fails before anything is written if an array is too
    /// large for this device; after any other failure the next call uploads everything.
    pub(super) fn upload(&mut self, context: &Context, arrays: &mut DeviceArrays) -> Result<u64> {
        // 1. Choose the traversal that the arrays support.
        let traversal = self.requested_traversal.supported_by(arrays);
        let mut sources = sources(arrays, traversal);
        // 2. Plan the splits; fail before anything is written.
        let splits = plan_splits(&sources, &context.limits)?;
        let outcome = context.with_error_scopes(UPLOADING, || {
            // 3. Drop what another traversal or other splits make useless.
            if traversal != self.bound_traversal {
                self.bound_traversal = traversal;
                self.arrays[BLAS_BINDING].clear();
            }
            if splits != self.splits {
                self.layout = layout(context, all_bindings(splits));
                self.splits = splits;
                self.bind_group = None;
            }
            // 4. Upload each array.
            let mut bytes = 0;
            let mut is_bound = self.bind_group.is_some();
            for (source, parts) in sources.iter_mut().zip(&mut self.arrays) {
                let split = source.split.map_or(ArraySplit::WHOLE, |split| *split(&mut self.splits));
                let uploaded = upload_array(context, source, split, parts)?;
                bytes += uploaded.bytes;
                is_bound &= uploaded.kept_buffer;
            }
            // 5. Rebind if a buffer was replaced.
            if !is_bound {
                self.bind_group = Some(self.bind(context, &self.layout, all_bindings(splits)));
                self.bind_group_rebuilds += 1;
            }
            if bytes > 0 {
                context.submit(UPLOADING, |_| {})?;
            }
            Ok(bytes)
        });
        // 6. After an error forget everything, so that the next call uploads everything.
        if outcome.is_err() {
            *self =
                Self { bind_group_rebuilds: self.bind_group_rebuilds, ..Self::new(context, self.requested_traversal) };
        }
        outcome
    }
}

/// Bind group layout entry of a storage buffer in a compute shader.
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

/// Greatest size of one storage buffer of a device, in bytes.
pub(super) fn largest_buffer(limits: &wgpu::Limits) -> u64 {
    limits.max_buffer_size.min(limits.max_storage_buffer_binding_size)
}

/// Layout of a bind group of read-only storage buffers with these bindings.
fn layout(context: &Context, bindings: impl Iterator<Item = u32>) -> wgpu::BindGroupLayout {
    let entries: Vec<_> = bindings.map(|binding| storage_entry(binding, true)).collect();
    let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some("scene"), entries: &entries };
    context.device.create_bind_group_layout(&descriptor)
}

/// Bindings of all arrays: one each, then the further parts of those that are split.
fn all_bindings(splits: ArraySplits) -> std::ops::Range<u32> {
    0..ARRAY_COUNT + splits.extra_bindings()
}

/// Decides how the arrays are split to fit the device.
fn plan_splits(sources: &[Source<'_>], limits: &wgpu::Limits) -> Result<ArraySplits> {
    // Storage buffers that the kernel leaves for further parts.
    let largest = largest_buffer(limits);
    let max_buffers = limits.max_storage_buffers_per_shader_stage;
    let max_buffers = max_buffers
        .min(limits.max_buffers_and_acceleration_structures_per_shader_stage.saturating_sub(UNIFORM_BUFFERS));
    let mut spare = u64::from(max_buffers.saturating_sub(STORAGE_BUFFERS));
    let mut splits = ArraySplits::default();
    for source in sources {
        let (needed, stride) = (source.array.bytes().len() as u64, source.placeholder.len() as u64);
        let check_fits = |limit| require_within(Resource::GpuArray(source.what), needed, limit);
        // Array that cannot be split: it must fit a binding.
        let Some(split) = source.split else {
            check_fits(largest)?;
            continue;
        };
        // Array that can be: as few parts as possible, which must not exceed the spare bindings.
        let planned = ArraySplit::new(needed / stride, largest / stride);
        if let Some(part_len) = planned.part_len() {
            check_fits(largest.max((1 + spare) * part_len * stride))?;
        }
        // The further parts use up spare bindings.
        spare -= u64::from(planned.parts() - 1);
        *split(&mut splits) = planned;
    }
    Ok(splits)
}

/// Uploads an array's dirty ranges, or all of it if its split changed.
fn upload_array(
    context: &Context,
    source: &mut Source<'_>,
    split: ArraySplit,
    parts: &mut Vec<Option<ArrayBuffer>>,
) -> Result<UploadOutcome> {
    let dirty = source.array.take_dirty();
    let bytes = source.array.bytes();
    // Another number of parts: start with no buffers, so that each part is uploaded whole.
    if parts.len() != split.parts() as usize {
        *parts = (0..split.parts()).map(|_| None).collect();
    }
    // Size of a part in bytes; the placeholder is one element.
    let largest = largest_buffer(&context.limits);
    let part_size = split.part_len().map_or(largest, |len| len * source.placeholder.len() as u64) as usize;
    let mut total = UploadOutcome { bytes: 0, kept_buffer: true };
    for (part, slot) in parts.iter_mut().enumerate() {
        // Bytes of this part, and the dirty ranges clipped to it.
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
        // Upload it.
        let part = ArrayBuffer::upload(context, &contents, slot)?;
        total = UploadOutcome { bytes: total.bytes + part.bytes, kept_buffer: total.kept_buffer && part.kept_buffer };
    }
    Ok(total)
}

/// A device array to upload.
struct Source<'a> {
    /// Name of the array, in labels and errors.
    what: &'static str,
    array: &'a mut dyn Array,
    /// Its member of [`ArraySplits`], if it can be split.
    split: Option<fn(&mut ArraySplits) -> &mut ArraySplit>,
    /// A zero element: contents of the buffer of an empty array, since no buffer can be empty.
    placeholder: &'static [u8],
}

/// A [`DeviceBuffer`] of any element type.
trait Array {
    fn bytes(&self) -> &[u8];

    /// The byte ranges that changed since the last call.
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
fn sources(arrays: &mut DeviceArrays, traversal: Traversal) -> [Source<'_>; ARRAY_COUNT as usize] {
    // The nodes of the other traversal are not uploaded, so their list of changes is dropped.
    let nodes = match traversal {
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

/// An array that cannot be split.
fn source<'a, T: Pod + PartialEq>(what: &'static str, array: &'a mut DeviceBuffer<T>) -> Source<'a> {
    Source { what, array, split: None, placeholder: &ZEROS[..size_of::<T>()] }
}

/// As large as the largest element. A zeroed node is an empty hierarchy to the kernel.
static ZEROS: [u8; 128] = [0; 128];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::shader::EntryPoint;

    /// The arrays are bound by position: each must stand where the shader declares it.
    #[test]
    fn arrays_are_in_the_order_of_the_shader() {
        for traversal in [Traversal::Rope, Traversal::Wide] {
            let source = EntryPoint::ClosestHits.source(KernelVariant::default().with_traversal(traversal));
            let module = naga::front::wgsl::parse_str(&source).unwrap();
            let mut arrays = DeviceArrays::default();
            let sources = sources(&mut arrays, traversal);
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
