//! The GPU buffer of one device array, or of one part of a split array. Uploads write only the dirty ranges.

use std::ops::Range;

use wgpu::BufferUsages;

use super::context::Context;
use super::scene::UPLOADING;
use crate::Result;

/// Submit after this many bytes of writes: wgpu holds staged copies until the next submission.
const BYTES_PER_SUBMISSION: usize = 64 << 20;

/// Dirty ranges of fewer bytes are gathered into one write.
const SMALL_RANGE_BYTES: usize = 16 << 10;

/// Dirty ranges with fewer bytes between them are written as one, with those bytes.
const SMALL_GAP_BYTES: usize = 256;

/// Shrink a buffer when less than 1/`SHRINK_FACTOR` of it is used.
const SHRINK_FACTOR: u64 = 4;

/// A buffer, which may be larger than the array in it.
#[derive(Debug)]
pub(super) struct ArrayBuffer {
    buffer: wgpu::Buffer,
    /// Bytes in use; 0 if the buffer holds only the placeholder of an empty array.
    used: u64,
}

/// The contents that a buffer is to have.
pub(super) struct Contents<'a> {
    /// Name of the array, in labels and errors.
    pub(super) what: &'static str,
    pub(super) bytes: &'a [u8],
    /// Dirty byte ranges, sorted.
    pub(super) dirty: &'a [Range<usize>],
    /// Contents of the buffer of an empty array, since no buffer can be empty.
    pub(super) placeholder: &'static [u8],
    /// Greatest size of the buffer, in bytes.
    pub(super) limit: u64,
}

/// Bytes copied, and whether the buffer was kept (else it must be rebound).
pub(super) struct UploadOutcome {
    pub(super) bytes: u64,
    pub(super) kept_buffer: bool,
}

impl ArrayBuffer {
    pub(super) fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Uploads the dirty ranges, resizing the buffer first if needed; uploads everything into a new buffer.
    pub(super) fn upload(context: &Context, contents: &Contents<'_>, slot: &mut Option<Self>) -> Result<UploadOutcome> {
        let &Contents { what, bytes, dirty, placeholder, limit } = contents;
        let used = bytes.len() as u64;
        let new_buffer = |size| {
            let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
            context.buffer(what, size, usage)
        };
        // New buffer, or one that was empty or becomes so: write all.
        let old = slot.take().filter(|old| (old.used == 0) == bytes.is_empty());
        let Some(old) = old else {
            let contents = if bytes.is_empty() { placeholder } else { bytes };
            let buffer = new_buffer(contents.len() as u64);
            write(context, &buffer, contents, 0..contents.len());
            *slot = Some(Self { buffer, used });
            return Ok(UploadOutcome { bytes: used, kept_buffer: false });
        };
        // Resize to what is used, with room to grow by half; copy what is kept.
        let size = old.buffer.size();
        let kept_buffer = bytes.is_empty() || (used <= size && used >= size / SHRINK_FACTOR);
        let buffer = if kept_buffer {
            old.buffer
        } else {
            let new_size = if used > size { used.max(size / 2 * 3) } else { used };
            let buffer = new_buffer(new_size.next_multiple_of(16).min(limit / 4 * 4));
            let kept = used.min(old.used);
            context.submit(UPLOADING, |encoder| encoder.copy_buffer_to_buffer(&old.buffer, 0, &buffer, 0, kept))?;
            buffer
        };
        // Large ranges: direct writes.
        let (small, large): (Vec<_>, Vec<_>) =
            join_near(dirty).into_iter().partition(|range| range.len() < SMALL_RANGE_BYTES);
        for range in large {
            write(context, &buffer, bytes, range);
        }
        // Small ranges: one gathered write and GPU copies.
        scatter(context, &buffer, bytes, &small)?;
        *slot = Some(Self { buffer, used });
        Ok(UploadOutcome { bytes: dirty.iter().map(|range| range.len() as u64).sum(), kept_buffer })
    }
}

/// Writes `bytes[range]` to the same place in `buffer`, submitting often enough to bound staging memory.
fn write(context: &Context, buffer: &wgpu::Buffer, bytes: &[u8], range: Range<usize>) {
    for start in range.clone().step_by(BYTES_PER_SUBMISSION) {
        let end = range.end.min(start + BYTES_PER_SUBMISSION);
        context.queue.write_buffer(buffer, start as u64, &bytes[start..end]);
        if end - start == BYTES_PER_SUBMISSION {
            context.queue.submit([]);
        }
    }
}

/// Joins sorted ranges with fewer than [`SMALL_GAP_BYTES`] between them.
fn join_near(ranges: &[Range<usize>]) -> Vec<Range<usize>> {
    let is_near = |a: &Range<usize>, b: &Range<usize>| b.start - a.end < SMALL_GAP_BYTES;
    ranges.chunk_by(is_near).map(|near| near[0].start..near[near.len() - 1].end).collect()
}

/// Writes many small ranges by one write to a scratch buffer and one GPU copy per range, which takes a tenth of the
/// time of one write per range.
fn scatter(context: &Context, buffer: &wgpu::Buffer, bytes: &[u8], ranges: &[Range<usize>]) -> Result<()> {
    for ranges in ranges.chunks(BYTES_PER_SUBMISSION / SMALL_RANGE_BYTES) {
        // A single range needs no scratch buffer.
        if let [range] = ranges {
            write(context, buffer, bytes, range.clone());
            continue;
        }
        // Gather the bytes in a scratch buffer.
        let mut gathered = Vec::with_capacity(ranges.iter().map(ExactSizeIterator::len).sum());
        for range in ranges {
            gathered.extend_from_slice(&bytes[range.clone()]);
        }
        let usage = BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let scratch = context.buffer("changes", gathered.len() as u64, usage);
        write(context, &scratch, &gathered, 0..gathered.len());
        // Copy each range to its place on the GPU.
        context.submit(UPLOADING, |encoder| {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_ranges_are_joined_and_far_ones_are_not() {
        let near = SMALL_GAP_BYTES - 4;
        let ranges = [0..4, 4 + near..600, 600 + SMALL_GAP_BYTES..1000, 1000 + near..2000, 5000..5004];
        assert_eq!(join_near(&ranges), [0..600, 600 + SMALL_GAP_BYTES..2000, 5000..5004]);
        assert_eq!(join_near(&[]), []);
    }
}
