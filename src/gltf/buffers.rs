//! The binary data of a glTF file.

use std::borrow::Cow;
use std::collections::HashMap;

use super::Document;
use super::uri::{self, UriTarget};
use crate::Result;

/// The bytes of every buffer, and the check that buffer views lie within them.
pub(super) struct Buffers<'a> {
    /// The data of each buffer, at least as long as declared; `None` for a buffer that has none, or shares that of another.
    data: Vec<Option<Cow<'a, [u8]>>>,
    /// The first buffer at the same location, for each buffer: the same data under two numbers.
    same_as: Vec<usize>,
    /// Bytes read from files beside the glTF file.
    pub(super) external_bytes: u64,
}

impl<'a> Buffers<'a> {
    /// Reads every buffer, each file once. `bin` is the binary chunk of a GLB file.
    pub(super) fn load(document: &Document, bin: Option<&'a [u8]>) -> Result<Self> {
        let mut buffers = Self { data: Vec::new(), same_as: Vec::new(), external_bytes: 0 };
        // 1. Which are the same, and how much of each is needed.
        let mut needed: HashMap<UriTarget, (usize, u64)> = HashMap::new();
        for (i, buffer) in document.buffers.iter().enumerate() {
            let Some(uri) = &buffer.uri else {
                buffers.same_as.push(i);
                continue;
            };
            let location = uri::resolve(uri, document.path).map_err(|e| document.fault(format!("/buffers/{i}"), e))?;
            let (first, length) = needed.entry(location).or_insert((i, 0));
            *length = buffer.byte_length.0.max(*length);
            buffers.same_as.push(*first);
        }

        // 2. The data. Extensions leave buffers without, as a place for what they decompress.
        buffers.data.resize(document.buffers.len(), None);
        if let Some(data) = buffers.data.first_mut().filter(|_| document.buffers[0].uri.is_none()) {
            *data = bin.map(Cow::Borrowed);
        }
        for (location, (i, length)) in needed {
            let data = location.read(length).map_err(|e| document.fault(format!("/buffers/{i}"), e))?;
            buffers.external_bytes += data.len() as u64;
            buffers.data[i] = Some(Cow::Owned(data));
        }

        // 3. That everything lies within it.
        (0..document.buffers.len()).try_for_each(|i| buffers.check_length(document, i))?;
        (0..document.views.len()).try_for_each(|i| buffers.check_view(document, i))?;
        Ok(buffers)
    }

    fn check_length(&self, document: &Document, index: usize) -> Result<()> {
        let want = document.buffers[index].byte_length.0;
        match self.data[self.same_as[index]].as_deref() {
            Some(data) if (data.len() as u64) < want => {
                let cause = format!("has {} bytes, but its byteLength is {want}: was the file cut short?", data.len());
                Err(document.fault(format!("/buffers/{index}"), cause))
            }
            _ => Ok(()),
        }
    }

    fn check_view(&self, document: &Document, index: usize) -> Result<()> {
        let view = &document.views[index];
        let (offset, length) = (view.byte_offset.map_or(0, |o| o.0), view.byte_length.0);
        let available = document.buffers[view.buffer.value()].byte_length.0;
        if offset.checked_add(length).is_some_and(|end| end <= available) {
            return Ok(());
        }
        let cause = format!("its {length} bytes from {offset} do not fit into a buffer of {available}");
        Err(document.fault(format!("/bufferViews/{index}"), cause))
    }

    /// The bytes of a view; an error if its buffer has no data.
    pub(super) fn view(&self, document: &Document, index: usize) -> Result<&[u8]> {
        let view = &document.views[index];
        let buffer = self.same_as[view.buffer.value()];
        let Some(data) = &self.data[buffer] else {
            let cause = "has no URI, and there is no binary GLB chunk for it: its data is missing";
            return Err(document.fault(format!("/buffers/{buffer}"), cause));
        };
        // The checks of load have shown that both lie within the data, which fits into memory.
        let offset = view.byte_offset.map_or(0, |o| o.0) as usize;
        Ok(&data[offset..offset + view.byte_length.0 as usize])
    }

    /// Where a view's bytes are: views with equal answers share their data.
    pub(super) fn location_of_view(&self, document: &Document, index: usize) -> (usize, u64) {
        let view = &document.views[index];
        (self.same_as[view.buffer.value()], view.byte_offset.map_or(0, |o| o.0))
    }

    /// Whether the buffer of a view has data.
    pub(super) fn has_data(&self, document: &Document, view: usize) -> bool {
        self.data[self.same_as[document.views[view].buffer.value()]].is_some()
    }
}
