//! The vertex streams of geometries in the device arrays: what shading interpolates between vertices.

use std::ops::Range;
use std::sync::Arc;

use super::buffer_allocator::BufferAllocator;
use super::pack;
use crate::Result;
use crate::device::DeviceArrays;
use crate::device::layout::{GeometryRecord, NONE};
use crate::graph::Geometry;

/// Allocates and writes vertex streams in the device arrays.
#[derive(Debug)]
pub(super) struct VertexStreamTable {
    records: BufferAllocator,
    indices: BufferAllocator,
    normals: BufferAllocator,
    tex_coords: BufferAllocator,
    colors: BufferAllocator,
}

/// The ranges of one geometry's streams in the device arrays; empty by default.
#[derive(Clone, Debug, Default)]
pub(super) struct StreamRanges {
    /// The range in `geometries`: one element.
    pub(super) record: Range<u32>,
    indices: Range<u32>,
    normals: Range<u32>,
    tex_coords: [Range<u32>; 2],
    colors: Range<u32>,
}

impl VertexStreamTable {
    pub(super) fn new() -> Self {
        Self {
            records: BufferAllocator::new("the geometries array"),
            indices: BufferAllocator::new("the vertex indices array"),
            normals: BufferAllocator::new("the normals array"),
            tex_coords: BufferAllocator::new("the texture coordinates array"),
            colors: BufferAllocator::new("the vertex colours array"),
        }
    }

    /// Writes the streams of `geometry`, replacing those of `old` at `ranges`. A stream that both share (`Arc`) is left
    /// untouched, and one of the same length is overwritten in place. The geometry's record also holds the offset of
    /// its wide nodes.
    pub(super) fn write(
        &mut self,
        ranges: &mut StreamRanges,
        old: &Geometry,
        geometry: &Geometry,
        wide_nodes: &Range<u32>,
        arrays: &mut DeviceArrays,
    ) -> Result<()> {
        // Vertex indices are needed only to look up streams.
        let indices = |of: &Geometry| has_streams(of).then(|| of.indices.clone());
        if !is_shared(&indices(old), &indices(geometry)) {
            let indices = indices(geometry).unwrap_or_default();
            self.indices.replace(&mut arrays.indices, &mut ranges.indices, bytemuck::cast_slice(&indices))?;
        }
        if !is_shared(&old.normals, &geometry.normals) {
            let normals = geometry.normals.as_deref().unwrap_or_default();
            self.normals.replace(&mut arrays.normals, &mut ranges.normals, bytemuck::cast_slice(normals))?;
        }
        for (set, range) in ranges.tex_coords.iter_mut().enumerate() {
            if !is_shared(&old.tex_coords[set], &geometry.tex_coords[set]) {
                let stream = geometry.tex_coords[set].as_deref().unwrap_or_default();
                self.tex_coords.replace(&mut arrays.tex_coords, range, bytemuck::cast_slice(stream))?;
            }
        }
        if !is_shared(&old.colors, &geometry.colors) {
            let colors = geometry.colors.as_deref().unwrap_or_default();
            let colors: Vec<[u32; 2]> = colors.iter().map(|c| pack::pack_color(*c)).collect();
            self.colors.replace(&mut arrays.colors, &mut ranges.colors, &colors)?;
        }
        // The record, with the new offsets.
        let record = GeometryRecord {
            first_index: first_or_none(&ranges.indices),
            first_normal: first_or_none(&ranges.normals),
            first_tex_coord_0: first_or_none(&ranges.tex_coords[0]),
            first_tex_coord_1: first_or_none(&ranges.tex_coords[1]),
            first_color: first_or_none(&ranges.colors),
            first_wide_node: first_or_none(wide_nodes),
            _pad: [0; 2],
        };
        self.records.replace(&mut arrays.geometries, &mut ranges.record, &[record])
    }

    /// Releases all ranges of a geometry.
    pub(super) fn release(&mut self, ranges: StreamRanges, arrays: &mut DeviceArrays) {
        self.records.release(&mut arrays.geometries, ranges.record);
        self.indices.release(&mut arrays.indices, ranges.indices);
        self.normals.release(&mut arrays.normals, ranges.normals);
        for range in ranges.tex_coords {
            self.tex_coords.release(&mut arrays.tex_coords, range);
        }
        self.colors.release(&mut arrays.colors, ranges.colors);
    }
}

fn has_streams(geometry: &Geometry) -> bool {
    geometry.normals.is_some() || geometry.colors.is_some() || geometry.tex_coords.iter().any(Option::is_some)
}

/// Whether two optional streams are the same array, or both absent.
fn is_shared<T>(a: &Option<Arc<[T]>>, b: &Option<Arc<[T]>>) -> bool {
    match (a, b) {
        (Some(a), Some(b)) => Arc::ptr_eq(a, b),
        (a, b) => a.is_none() && b.is_none(),
    }
}

fn first_or_none(range: &Range<u32>) -> u32 {
    if range.is_empty() { NONE } else { range.start }
}
