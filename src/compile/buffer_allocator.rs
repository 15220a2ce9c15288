//! Allocation of element ranges in a device buffer.

use std::fmt;
use std::ops::Range;

use bytemuck::Pod;
use range_alloc::RangeAllocator;

use crate::device::DeviceBuffer;
use crate::error::Resource;
use crate::{Error, Result};

/// Allocates ranges of one [`DeviceBuffer`], best fit first; released ranges are reused.
pub(super) struct BufferAllocator {
    /// What errors call the buffer.
    array_name: &'static str,
    allocator: RangeAllocator<u32>,
}

impl BufferAllocator {
    /// An allocator for an empty buffer, which errors call `array_name`.
    pub(super) fn new(array_name: &'static str) -> Self {
        // The last index is never allocated: it is `layout::NONE`.
        Self { array_name, allocator: RangeAllocator::new(0..u32::MAX) }
    }

    /// Copies `values` into a newly allocated range of the buffer and returns the range; `0..0` for no values.
    ///
    /// # Errors
    /// [`Error::Limit`] beyond 2^32 - 1 elements: an index has 32 bits.
    pub(super) fn store<T: Pod>(&mut self, buffer: &mut DeviceBuffer<T>, values: &[T]) -> Result<Range<u32>> {
        if values.is_empty() {
            return Ok(0..0);
        }
        let limit = |needed| Error::limit(Resource::DeviceArray(self.array_name), needed, u32::MAX.into());
        let count = u32::try_from(values.len()).map_err(|_| limit(values.len() as u64))?;
        let Ok(range) = self.allocator.allocate_range(count) else {
            return Err(limit(u64::from(count) + buffer.len() as u64));
        };
        buffer.write(range.start as usize, values);
        Ok(range)
    }

    /// Replaces the values in `range`: in place if the length is the same, else in a new range.
    ///
    /// # Errors
    /// As [`store`](Self::store); then the range is empty.
    pub(super) fn replace<T: Pod>(
        &mut self,
        buffer: &mut DeviceBuffer<T>,
        range: &mut Range<u32>,
        values: &[T],
    ) -> Result<()> {
        if range.len() == values.len() {
            buffer.write(range.start as usize, values);
        } else {
            self.release(buffer, std::mem::take(range));
            *range = self.store(buffer, values)?;
        }
        Ok(())
    }

    /// Releases a range. The buffer is truncated to the end of the last range in use.
    pub(super) fn release<T: Pod>(&mut self, buffer: &mut DeviceBuffer<T>, range: Range<u32>) {
        if range.is_empty() {
            return;
        }
        let at_end = range.end as usize >= buffer.len();
        self.allocator.free_range(range);
        if at_end {
            buffer.truncate(self.allocator.allocated_ranges().last().map_or(0, |r| r.end as usize));
        }
    }
}

/// Mutable slices of `values` for disjoint ranges, in the order of `ranges`. O(n log n) for n ranges.
///
/// # Panics
/// If two ranges overlap.
pub(super) fn disjoint_mut<'a, T>(values: &'a mut [T], ranges: &[Range<usize>]) -> Vec<&'a mut [T]> {
    // Visit the ranges in ascending order.
    let mut order: Vec<usize> = (0..ranges.len()).collect();
    order.sort_unstable_by_key(|&i| ranges[i].start);
    let mut parts: Vec<&mut [T]> = Vec::new();
    parts.resize_with(ranges.len(), Default::default);
    let (mut rest, mut rest_start) = (values, 0);
    for i in order.into_iter().filter(|&i| !ranges[i].is_empty()) {
        let range = &ranges[i];
        // Skip the gap before the range, and split the range off.
        let _gap = rest.split_off_mut(..range.start - rest_start);
        parts[i] = rest.split_off_mut(..range.len()).unwrap_or_default();
        rest_start = range.end;
    }
    parts
}

impl fmt::Debug for BufferAllocator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("BufferAllocator").field("array_name", &self.array_name).finish_non_exhaustive()
    }
}
