//! The memory budget of an import, proportional to the bytes read.

use super::{Document, GltfFault};
use crate::Result;

/// Bytes allowed for any file.
const BASE_BYTES: u64 = 48 << 20;
/// Bytes allowed for the images of any file besides: PNG compresses an 8192 x 8192 image of one colour to a few hundred
/// kB.
const BASE_TEXEL_BYTES: u64 = 256 << 20;
/// Bytes allowed in addition for each byte of JSON. A node that shows a mesh takes 35 bytes of text or more, and 2.5 kB
/// as JSON value, typed object, planned node and two nodes of the scene.
const MAX_JSON_EXPANSION: u64 = 80;
/// Bytes allowed in addition for each other byte read. Legitimate files expand 40 times and more through sharing (one
/// sphere shown by 98 nodes, an instance for 12 bytes of translation); more than 256 times indicates a malicious file.
const MAX_DATA_EXPANSION: u64 = 256;

/// The memory that an import may still allocate.
///
/// Everything that an import makes of the bytes of the files is charged before it is allocated: JSON values and
/// objects by [`json_cost`](super::json_cost), geometry, instances and images by the numbers in the file, nodes,
/// materials and warnings one by one. Accessors may overlap, be used many times, or have no data at all, so that
/// checking each one against its buffer does not bound their sum. Nothing is given back: the sum of all charges bounds
/// the peak.
pub(super) struct Budget {
    spent: u64,
    /// What the bytes read so far justify.
    justified: u64,
    /// What the application allows at most.
    cap: u64,
    /// What is left of that allowed for images only.
    texels: u64,
}

impl Budget {
    /// The budget of an import that has read so many bytes of JSON and so many others. `cap` is what the application
    /// allows at most.
    pub(super) fn new(json_bytes: u64, data_bytes: u64, cap: Option<u64>) -> Self {
        let justified = BASE_BYTES.saturating_add(json_bytes.saturating_mul(MAX_JSON_EXPANSION));
        let mut budget = Self { spent: 0, justified, cap: cap.unwrap_or(u64::MAX), texels: BASE_TEXEL_BYTES };
        budget.add_data(data_bytes);
        budget
    }

    /// Allows for so many more bytes that were read.
    pub(super) fn add_data(&mut self, bytes: u64) {
        self.justified = self.justified.saturating_add(bytes.saturating_mul(MAX_DATA_EXPANSION));
    }

    /// The bytes that are left.
    pub(super) fn remaining(&self) -> u64 {
        self.limit().saturating_sub(self.spent)
    }

    /// Takes bytes, if there are as many left; returns whether there were.
    pub(super) fn try_take(&mut self, bytes: u64) -> bool {
        let fits = bytes <= self.remaining();
        if fits {
            self.spent += bytes;
        }
        fits
    }

    /// As [`try_take`](Self::try_take), for texels of images.
    pub(super) fn try_take_texels(&mut self, bytes: u64) -> bool {
        // What is allowed for images only is justified by there being images.
        let for_images = bytes.min(self.texels);
        self.justified = self.justified.saturating_add(for_images);
        let fits = self.try_take(bytes);
        if fits {
            self.texels -= for_images;
        } else {
            self.justified -= for_images;
        }
        fits
    }

    /// Takes `count` times `size` bytes, for the object at a JSON pointer.
    pub(super) fn charge(
        &mut self,
        count: usize,
        size: usize,
        document: &Document,
        pointer: impl FnOnce() -> String,
    ) -> Result<()> {
        if self.try_take((count as u64).saturating_mul(size as u64)) {
            return Ok(());
        }
        Err(document.error_at(pointer(), self.fault()))
    }

    /// The fault that the budget is exceeded.
    pub(super) fn fault(&self) -> GltfFault {
        GltfFault::Budget { limit_bytes: self.limit() }
    }

    fn limit(&self) -> u64 {
        self.justified.min(self.cap)
    }
}
