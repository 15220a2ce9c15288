//! The arrays of a compiled scene, each with the ranges that changed since an executor last copied it.

use std::ops::Range;

use bytemuck::Pod;

use super::layout::{
    GeometryRecord, InstanceRecord, LightRecord, MaterialRecord, Node, TextureInfo, Triangle, WideNode,
};

/// A compiled scene: what the traversal kernel reads. Indices in one array refer to another as
/// [`layout`](super::layout) says.
#[derive(Debug, Default)]
pub struct DeviceArrays {
    /// The top-level hierarchy over `instances`.
    pub tlas_nodes: DeviceBuffer<Node>,
    /// Instances of bottom-level structures. Records of removed instances are zero, and no leaf of the top level refers
    /// to them.
    pub instances: DeviceBuffer<InstanceRecord>,
    /// The bottom-level hierarchies as binary nodes, one after the other.
    pub blas_nodes: DeviceBuffer<Node>,
    /// The bottom-level hierarchies as 8-wide nodes.
    pub wide_nodes: DeviceBuffer<WideNode>,
    /// The triangles of the bottom-level structures, in leaf order.
    pub triangles: DeviceBuffer<Triangle>,
    /// One element per geometry.
    pub geometries: DeviceBuffer<GeometryRecord>,
    /// Vertex indices, three per triangle in the geometry's own order.
    pub indices: DeviceBuffer<u32>,
    /// Vertex normals, three numbers each.
    pub normals: DeviceBuffer<f32>,
    /// Texture coordinates.
    pub tex_coords: DeviceBuffer<[f32; 2]>,
    /// Vertex colours, four 16-bit unorms each.
    pub colors: DeviceBuffer<[u32; 2]>,
    /// One element per material.
    pub materials: DeviceBuffer<MaterialRecord>,
    /// One element per texture reference of a material.
    pub texture_infos: DeviceBuffer<TextureInfo>,
    /// Texels of all textures, row by row: RGBA8 with red in the lowest byte.
    pub texels: DeviceBuffer<u32>,
    /// One element per visible light node.
    pub lights: DeviceBuffer<LightRecord>,
}

impl DeviceArrays {
    /// The size of all arrays together, in bytes.
    pub fn byte_count(&self) -> u64 {
        fn bytes<T>(array: &[T]) -> u64 {
            size_of_val(array) as u64
        }
        bytes(&self.tlas_nodes)
            + bytes(&self.instances)
            + bytes(&self.blas_nodes)
            + bytes(&self.wide_nodes)
            + bytes(&self.triangles)
            + bytes(&self.geometries)
            + bytes(&self.indices)
            + bytes(&self.normals)
            + bytes(&self.tex_coords)
            + bytes(&self.colors)
            + bytes(&self.materials)
            + bytes(&self.texture_infos)
            + bytes(&self.texels)
            + bytes(&self.lights)
    }

    /// Empties the list of changed ranges of every array, for executors that read the arrays in place.
    pub fn clear_dirty(&mut self) {
        self.tlas_nodes.dirty_ranges.clear();
        self.instances.dirty_ranges.clear();
        self.blas_nodes.dirty_ranges.clear();
        self.wide_nodes.dirty_ranges.clear();
        self.triangles.dirty_ranges.clear();
        self.geometries.dirty_ranges.clear();
        self.indices.dirty_ranges.clear();
        self.normals.dirty_ranges.clear();
        self.tex_coords.dirty_ranges.clear();
        self.colors.dirty_ranges.clear();
        self.materials.dirty_ranges.clear();
        self.texture_infos.dirty_ranges.clear();
        self.texels.dirty_ranges.clear();
        self.lights.dirty_ranges.clear();
    }
}

/// An array with the ranges that changed since they were last taken.
#[derive(Debug)]
pub struct DeviceBuffer<T> {
    data: Vec<T>,
    dirty_ranges: Vec<Range<usize>>,
}

impl<T> Default for DeviceBuffer<T> {
    fn default() -> Self {
        Self { data: Vec::new(), dirty_ranges: Vec::new() }
    }
}

impl<T> std::ops::Deref for DeviceBuffer<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.data
    }
}

impl<T: Pod> DeviceBuffer<T> {
    /// Writes `values` from index `first` on, zero-filling a gap beyond the current end. Leading and trailing elements
    /// that are bitwise equal to the current ones are not marked as changed.
    pub fn write(&mut self, first: usize, values: &[T]) {
        if values.is_empty() {
            return;
        }
        // 1. Grow.
        let end = first + values.len();
        let old_len = self.data.len();
        if end > old_len {
            self.data.resize(end, T::zeroed());
        }
        // 2. Find the first and the last element that differs.
        let current = &mut self.data[first..end];
        let changed =
            |&i: &usize| first + i >= old_len || bytemuck::bytes_of(&current[i]) != bytemuck::bytes_of(&values[i]);
        let (Some(from), Some(last)) = ((0..values.len()).find(changed), (0..values.len()).rfind(changed)) else {
            return;
        };
        // 3. Copy and mark only what lies between them.
        current[from..=last].copy_from_slice(&values[from..=last]);
        // A gap between the old end and `first` was zero-filled, so an executor must copy it too.
        self.mark_dirty((first + from).min(old_len)..first + last + 1);
    }

    /// Replaces the whole array.
    pub fn replace(&mut self, values: &[T]) {
        self.truncate(values.len());
        self.write(0, values);
    }

    /// Overwrites the element at `index`, which must exist, and marks it as changed unless it is bitwise equal.
    pub(crate) fn set(&mut self, index: usize, value: T) {
        if bytemuck::bytes_of(&self.data[index]) != bytemuck::bytes_of(&value) {
            self.data[index] = value;
            self.mark_dirty(index..index + 1);
        }
    }

    /// Resizes the array to `len` elements and marks all as changed; their contents are unspecified, and the caller
    /// must overwrite them.
    pub(crate) fn resize_for_overwrite(&mut self, len: usize) -> &mut [T] {
        self.truncate(len);
        if self.data.capacity() < len {
            // Zeroed pages from the allocator are mapped lazily, by the threads that write them, so a fresh allocation
            // is cheaper than growing the old one.
            self.data = bytemuck::zeroed_vec(len);
        }
        self.data.resize(len, T::zeroed());
        // One range of everything replaces those marked before.
        self.dirty_ranges.clear();
        if len > 0 {
            self.mark_dirty(0..len);
        }
        &mut self.data
    }

    /// Mutable access that marks nothing: the caller must [mark](Self::mark_dirty) every range that it changes.
    pub(crate) fn as_mut_slice_without_marking(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// Drops all elements from index `len` on.
    pub fn truncate(&mut self, len: usize) {
        self.data.truncate(len);
        // Give memory back once less than a quarter of it is used.
        if self.data.capacity() > 4 * len {
            self.data.shrink_to(2 * len);
        }
    }

    /// The ranges that changed since the last call, sorted and disjoint, none beyond the array's end.
    pub fn take_dirty(&mut self) -> Vec<Range<usize>> {
        // Sort, clip to the array, and merge ranges that touch.
        let mut ranges = std::mem::take(&mut self.dirty_ranges);
        ranges.sort_unstable_by_key(|r| r.start);
        let mut merged: Vec<Range<usize>> = Vec::with_capacity(ranges.len());
        for range in ranges {
            let range = range.start..range.end.min(self.data.len());
            match merged.last_mut() {
                Some(last) if range.start <= last.end => last.end = last.end.max(range.end),
                _ if range.is_empty() => {}
                _ => merged.push(range),
            }
        }
        merged
    }

    /// Marks a range as changed. O(1): ranges are sorted and merged when they are taken.
    pub(crate) fn mark_dirty(&mut self, range: Range<usize>) {
        // Extend the last range if the new one touches it: consecutive writes then make one range.
        match self.dirty_ranges.last_mut() {
            Some(last) if range.start <= last.end && range.end >= last.start => {
                *last = last.start.min(range.start)..last.end.max(range.end);
            }
            _ => self.dirty_ranges.push(range),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Updates a copy as an executor does, by copying the dirty ranges only. Returns how many elements were copied.
    fn catch_up(copy: &mut Vec<u32>, buffer: &mut DeviceBuffer<u32>) -> usize {
        copy.resize(buffer.len(), u32::MAX);
        let dirty = buffer.take_dirty();
        assert!(dirty.windows(2).all(|pair| pair[0].end < pair[1].start), "{dirty:?} is not sorted and disjoint");
        for range in &dirty {
            copy[range.clone()].copy_from_slice(&buffer[range.clone()]);
        }
        dirty.iter().map(ExactSizeIterator::len).sum()
    }

    #[test]
    fn copying_dirty_ranges_keeps_a_copy_equal() {
        let (mut buffer, mut copy) = (DeviceBuffer::default(), Vec::new());
        let mut generator = fastrand::Rng::with_seed(1);
        let mut random = |end: u32| generator.u32(..end);
        let mut compared = 0;
        for _ in 0..10_000 {
            match random(8) {
                0 => buffer.truncate(random(50) as usize),
                1 => buffer.replace(&vec![random(3); random(40) as usize]),
                _ => buffer.write(random(60) as usize, &vec![random(3); random(6) as usize]),
            }
            if random(4) == 0 {
                catch_up(&mut copy, &mut buffer);
                assert_eq!(copy, *buffer);
                compared += copy.len();
            }
        }
        assert!(compared > 10_000);
    }

    #[test]
    fn equal_elements_are_not_copied_again() {
        let (mut buffer, mut copy) = (DeviceBuffer::default(), Vec::new());
        buffer.write(0, &[1, 2, 3, 4]);
        assert_eq!(catch_up(&mut copy, &mut buffer), 4);
        buffer.write(0, &[1, 2, 9, 4]);
        assert_eq!(catch_up(&mut copy, &mut buffer), 1);
        buffer.write(0, &[1, 2, 9, 4]);
        assert_eq!(catch_up(&mut copy, &mut buffer), 0);
    }

    #[test]
    fn signs_of_zero_are_told_apart() {
        let mut buffer = DeviceBuffer::default();
        buffer.write(0, &[0.0f32]);
        buffer.write(0, &[-0.0f32]);
        assert!(buffer[0].is_sign_negative());
    }
}
