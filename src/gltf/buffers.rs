//! The binary data of a glTF file.

use std::borrow::Cow;
use std::collections::HashMap;

use super::files::{ExternalFiles, UriTarget};
use super::uri::spelling_fault;
use super::warnings::Warnings;
use super::{Budget, BufferFault, Document};
use crate::Result;

/// The bytes of every buffer, and the check that buffer views lie within them.
pub(super) struct Buffers<'a> {
    /// The data of each buffer, at least as long as declared; `None` for a buffer that has none, or whose canonical
    /// buffer is another one.
    data: Vec<Option<Cow<'a, [u8]>>>,
    /// For each buffer the first one with the same URI target, which has the same data.
    canonical_buffer: Vec<usize>,
}

impl<'a> Buffers<'a> {
    /// Reads every buffer, each file once. `bin` is the binary chunk of a GLB file. The budget grows with what is read.
    pub(super) fn load(
        document: &Document,
        files: &ExternalFiles,
        bin: Option<&'a [u8]>,
        budget: &mut Budget,
        warnings: &mut Warnings,
    ) -> Result<Self> {
        let mut buffers = Self { data: Vec::new(), canonical_buffer: Vec::new() };
        // 1. Merge buffers with the same target, and find the length to read.
        let mut needed: HashMap<UriTarget, (usize, u64)> = HashMap::new();
        for (i, buffer) in document.buffers.iter().enumerate() {
            let Some(uri) = &buffer.uri else {
                buffers.canonical_buffer.push(i);
                continue;
            };
            let target = files
                .resolve(uri)
                .map_err(|fault| document.error_at(format!("/buffers/{i}"), BufferFault::Uri(fault)))?;
            if let Some(fault) = spelling_fault(uri) {
                let fallback = format!("{fault}: read as if it had not");
                let error = document.error_at(format!("/buffers/{i}/uri"), BufferFault::Uri(fault));
                warnings.forgive(&document.value, "URI", fallback, error)?;
            }
            // Read as many bytes as the longest of the buffers with this target declares.
            let (first, length) = needed.entry(target).or_insert((i, 0));
            *length = buffer.byte_length.0.max(*length);
            buffers.canonical_buffer.push(*first);
        }

        // 2. Read each target once. A buffer may have no data: extensions use it as a placeholder for what they
        //    decompress.
        buffers.data.resize(document.buffers.len(), None);
        // A first buffer without a URI is the binary chunk of a GLB file.
        if let Some(data) = buffers.data.first_mut().filter(|_| document.buffers[0].uri.is_none()) {
            *data = bin.map(Cow::Borrowed);
        }
        for (target, (i, length)) in needed {
            document.cancel.check()?;
            let data = files
                .read(&target, length)
                .map_err(|fault| document.error_at(format!("/buffers/{i}"), BufferFault::Uri(fault)))?;
            budget.add_data(data.len() as u64);
            buffers.data[i] = Some(Cow::Owned(data));
        }

        // 3. Check the lengths of buffers and the ranges of buffer views.
        (0..document.buffers.len()).try_for_each(|i| buffers.check_length(document, i))?;
        (0..document.views.len()).try_for_each(|i| buffers.check_view(document, i))?;
        Ok(buffers)
    }

    fn check_length(&self, document: &Document, index: usize) -> Result<()> {
        let declared = document.buffers[index].byte_length.0;
        match self.data[self.canonical_buffer[index]].as_deref() {
            Some(data) if (data.len() as u64) < declared => {
                let fault = BufferFault::TooShort { found: data.len(), declared };
                Err(document.error_at(format!("/buffers/{index}"), fault))
            }
            _ => Ok(()),
        }
    }

    fn check_view(&self, document: &Document, index: usize) -> Result<()> {
        let view = &document.views[index];
        let (offset, length) = (view.byte_offset.map_or(0, |o| o.0), view.byte_length.0);
        // The declared length counts, even if there is more data.
        let available = document.buffers[view.buffer.value()].byte_length.0;
        if offset.checked_add(length).is_some_and(|end| end <= available) {
            return Ok(());
        }
        let fault = BufferFault::ViewOutOfRange { length, offset, available };
        Err(document.error_at(format!("/bufferViews/{index}"), fault))
    }

    /// The bytes of a view; an error if its buffer has no data.
    pub(super) fn view(&self, document: &Document, index: usize) -> Result<&[u8]> {
        let view = &document.views[index];
        let buffer = self.canonical_buffer[view.buffer.value()];
        let Some(data) = &self.data[buffer] else {
            return Err(document.error_at(format!("/buffers/{buffer}"), BufferFault::NoData));
        };
        // `load` has checked that both lie within the data, which fits into memory.
        let offset = view.byte_offset.map_or(0, |o| o.0) as usize;
        Ok(&data[offset..offset + view.byte_length.0 as usize])
    }

    /// The buffer and the byte offset of a view, with equal buffers merged: views at equal locations share their data.
    pub(super) fn location_of_view(&self, document: &Document, index: usize) -> (usize, u64) {
        let view = &document.views[index];
        (self.canonical_buffer[view.buffer.value()], view.byte_offset.map_or(0, |o| o.0))
    }

    /// Whether the buffer of a view has data.
    pub(super) fn has_data(&self, document: &Document, view: usize) -> bool {
        self.data[self.canonical_buffer[document.views[view].buffer.value()]].is_some()
    }
}
