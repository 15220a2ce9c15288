//! How much memory and work an import may cost: in proportion to the file, whatever its numbers claim.

use super::Document;
use crate::Result;

/// Allowed to any file, so that small ones may multiply.
const BASE_BYTES: u64 = 16 << 20;
/// Allowed for each byte that was read. Sharing makes honest files grow by 40 times and more (one sphere shown by 98 nodes, an
/// instance for 4 bytes of translation); a file that grows by more than this is made to.
const MAX_EXPANSION: u64 = 256;

/// What is left of the memory that an import may allocate.
///
/// Everything whose size comes from a number in the file (and not from data present in it) is charged before it is allocated.
/// Accessors may overlap, be used many times, or have no data at all, so that checking each one against its buffer does
/// not bound their sum.
pub(super) struct Budget {
    left: u64,
    limit: u64,
}

impl Budget {
    /// The budget of an import that has read this many bytes, all files together.
    pub(super) fn new(bytes_read: u64) -> Self {
        let limit = BASE_BYTES.saturating_add(bytes_read.saturating_mul(MAX_EXPANSION));
        Self { left: limit, limit }
    }

    /// Takes `count` times `size` bytes for the object at a JSON pointer.
    pub(super) fn charge(
        &mut self,
        count: usize,
        size: usize,
        document: &Document,
        object: impl FnOnce() -> String,
    ) -> Result<()> {
        match self.left.checked_sub((count as u64).saturating_mul(size as u64)) {
            Some(left) => self.left = left,
            None => {
                let cause = format!(
                    "the file unpacks to more than {} MiB, out of proportion to its size: it is damaged, or made to exhaust memory",
                    self.limit >> 20
                );
                return Err(document.fault(object(), cause));
            }
        }
        Ok(())
    }
}
