//! One array on the GPU, or one part of an array: only what changed is written.

use std::ops::Range;

use wgpu::BufferUsages;

use super::context::Context;
use super::scene::DURING;
use crate::Result;

/// wgpu keeps a copy of all that it is given to write until the next submission, so there is one this often.
const BYTES_PER_SUBMISSION: usize = 64 << 20;

/// Changes of fewer bytes are gathered into one write.
const SMALL_RANGE: usize = 16 << 10;

/// Changes with fewer bytes between them are written as one, those bytes too.
const SMALL_GAP: usize = 256;

/// A buffer is made smaller when its array needs less than one part in this many.
const SHRINK_FACTOR: u64 = 4;

/// A buffer, which may have room for more.
#[derive(Debug)]
pub(super) struct ArrayBuffer {
    buffer: wgpu::Buffer,
    /// Bytes in use; 0 where there is but a placeholder.
    used: u64,
}

/// What a buffer is to hold.
pub(super) struct Contents<'a> {
    pub(super) what: &'static str,
    pub(super) bytes: &'a [u8],
    /// The ranges of bytes that changed.
    pub(super) dirty: &'a [Range<usize>],
    /// What the buffer of an empty array holds, since no buffer can be empty.
    pub(super) placeholder: &'static [u8],
    /// The most bytes that the buffer may have.
    pub(super) limit: u64,
}

/// What was done.
pub(super) struct UploadOutcome {
    pub(super) bytes: u64,
    pub(super) same_buffer: bool,
}

impl ArrayBuffer {
    pub(super) fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Copies what changed, into a larger or smaller buffer where needed, or all of it where there was nothing.
    pub(super) fn upload(context: &Context, contents: &Contents<'_>, slot: &mut Option<Self>) -> Result<UploadOutcome> {
        let &Contents { what, bytes, dirty, placeholder, limit } = contents;
        let used = bytes.len() as u64;
        let make = |size| {
            let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
            context.buffer(what, size, usage)
        };
        let old = slot.take().filter(|old| (old.used == 0) == bytes.is_empty());
        let Some(old) = old else {
            let contents = if bytes.is_empty() { placeholder } else { bytes };
            let buffer = make(contents.len() as u64);
            write(context, &buffer, contents, 0..contents.len());
            *slot = Some(Self { buffer, used });
            return Ok(UploadOutcome { bytes: used, same_buffer: false });
        };
        let size = old.buffer.size();
        let same_buffer = bytes.is_empty() || (used <= size && used >= size / SHRINK_FACTOR);
        let buffer = if same_buffer {
            old.buffer
        } else {
            let room = if used > size { used.max(size / 2 * 3) } else { used };
            let buffer = make(room.next_multiple_of(16).min(limit / 4 * 4));
            let kept = used.min(old.used);
            context.submit(DURING, |encoder| encoder.copy_buffer_to_buffer(&old.buffer, 0, &buffer, 0, kept))?;
            buffer
        };
        let (small, large): (Vec<_>, Vec<_>) =
            join_near(dirty).into_iter().partition(|range| range.len() < SMALL_RANGE);
        for range in large {
            write(context, &buffer, bytes, range);
        }
        scatter(context, &buffer, bytes, &small)?;
        *slot = Some(Self { buffer, used });
        Ok(UploadOutcome { bytes: dirty.iter().map(|range| range.len() as u64).sum(), same_buffer })
    }
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
}
