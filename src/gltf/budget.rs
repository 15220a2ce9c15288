//! The memory budget of an import, proportional to the bytes read.

use super::{Document, GltfFault};
use crate::Result;

/// Bytes allowed for any file.
const BASE_BYTES: u64 = 16 << 20;
/// Bytes allowed in addition for each byte read. Legitimate files expand 40 times and more through sharing (one sphere
/// shown by 98 nodes, an instance for 4 bytes of translation); more than 256 times indicates a malicious file.
const MAX_EXPANSION: u64 = 256;

/// The memory that an import may still allocate.
///
/// Everything whose size comes from a number in the file (and not from data present in it) is charged before it is
/// allocated. Accessors may overlap, be used many times, or have no data at all, so that checking each one against its
/// buffer does not bound their sum.
pub(super) struct Budget {
    remaining: u64,
    limit: u64,
}

impl Budget {
    /// The budget of an import that has read this many bytes, all files together.
    pub(super) fn new(bytes_read: u64) -> Self {
        let limit = BASE_BYTES.saturating_add(bytes_read.saturating_mul(MAX_EXPANSION));
        Self { remaining: limit, limit }
    }

    /// Takes `count` times `size` bytes, for the object at a JSON pointer.
    pub(super) fn charge(
        &mut self,
        count: usize,
        size: usize,
        document: &Document,
        pointer: impl FnOnce() -> String,
    ) -> Result<()> {
        match self.remaining.checked_sub((count as u64).saturating_mul(size as u64)) {
            Some(remaining) => {
                self.remaining = remaining;
                Ok(())
            }
            None => Err(document.error_at(pointer(), GltfFault::Budget { limit_bytes: self.limit })),
        }
    }
}
