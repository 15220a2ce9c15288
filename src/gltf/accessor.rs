//! Accessors: typed arrays in buffers. Every accessor of a file is checked before any is read, so that no read leaves
//! its buffer.

use bytemuck::{Pod, Zeroable};

use super::format::{Component, Format};
use super::{AccessorFault, Budget, Buffers, Document};
use crate::{Error, Result};

/// All accessors of a file, checked.
pub(super) struct Accessors<'a> {
    elements: Vec<AccessorData<'a>>,
}

/// A validated accessor: its format, byte range and sparse substitutions.
#[derive(Clone, Debug)]
pub(super) struct AccessorData<'a> {
    /// The accessor's index in the file.
    index: usize,
    /// Number of elements.
    pub(super) count: usize,
    /// Format of an element; `None` for one that glTF does not define, which cannot be read.
    format: Option<Format>,
    data: Data<'a>,
    sparse: Option<Sparse<'a>>,
}

#[derive(Clone, Copy, Debug)]
enum Data<'a> {
    /// Element `i` starts at byte `i * stride`.
    Strided { bytes: &'a [u8], stride: usize },
    /// There is no buffer view: all elements are zero.
    Zero,
    /// The buffer has no data: nothing can be read.
    Missing,
}

/// Elements that replace those at `indices`, which ascend.
#[derive(Clone, Debug)]
struct Sparse<'a> {
    indices: Vec<u32>,
    values: &'a [u8],
}

/// Which elements to read.
#[derive(Clone, Copy)]
pub(super) enum Selection<'a> {
    All,
    /// Ascending, each below the accessor's count.
    Indices(&'a [u32]),
}

impl Selection<'_> {
    /// The index in the accessor of the selected element at this position.
    pub(super) fn element(self, position: usize) -> usize {
        match self {
            Self::All => position,
            Self::Indices(indices) => indices[position] as usize,
        }
    }
}

impl<'a> Accessors<'a> {
    /// Checks that every accessor lies within its buffer views, and reads the sparse indices.
    /// O(accessors + sparse indices).
    pub(super) fn new(document: &Document, buffers: &'a Buffers, budget: &mut Budget) -> Result<Self> {
        let mut elements = Vec::with_capacity(document.accessors.len());
        for index in 0..document.accessors.len() {
            elements.push(AccessorData::new(document, buffers, budget, index)?);
        }
        Ok(Self { elements })
    }

    /// The elements of an accessor.
    pub(super) fn get(&self, index: usize) -> &AccessorData<'a> {
        &self.elements[index]
    }

    /// For each accessor the first one that reads the same bytes in the same way; itself if there is no other.
    pub(super) fn canonical_indices(&self, document: &Document, buffers: &Buffers) -> Vec<usize> {
        let mut first = std::collections::HashMap::new();
        // The buffer and byte offset of an accessor's data, with equal buffers merged.
        let location = |view: usize, offset: u64| {
            let (buffer, start) = buffers.location_of_view(document, view);
            (buffer, start + offset)
        };
        // Two accessors are equal if their format, count, data and sparse substitutions are.
        let identity = |(i, elements): (usize, &AccessorData)| {
            let accessor = &document.accessors[i];
            let data = accessor.buffer_view.map(|v| location(v.value(), accessor.byte_offset.map_or(0, |o| o.0)));
            let stride = match elements.data {
                Data::Strided { stride, .. } => stride,
                Data::Zero | Data::Missing => 0,
            };
            let sparse = accessor.sparse.as_ref().map(|sparse| {
                let indices = location(sparse.indices.buffer_view.value(), sparse.indices.byte_offset.0);
                let values = location(sparse.values.buffer_view.value(), sparse.values.byte_offset.0);
                (sparse.count.0, indices, Component::of_indices(&sparse.indices.component_type), values)
            });
            // An accessor of unknown format equals no other.
            let unknown = elements.format.is_none().then_some(i);
            *first.entry((unknown, elements.format, elements.count, data, stride, sparse)).or_insert(i)
        };
        self.elements.iter().enumerate().map(identity).collect()
    }
}

impl<'a> AccessorData<'a> {
    fn new(document: &Document, buffers: &'a Buffers, budget: &mut Budget, index: usize) -> Result<Self> {
        let accessor = &document.accessors[index];
        let error = |fault: AccessorFault| document.error_at(format!("/accessors/{index}"), fault);
        let count = usize::try_from(accessor.count.0).map_err(|_| error(AccessorFault::CountTooLarge))?;
        let mut elements = Self { index, count, format: Format::of(accessor), data: Data::Zero, sparse: None };
        // The size of an unknown format is not known, so nothing is checked here; reading such an accessor is an error.
        let Some(format) = elements.format else { return Ok(elements) };

        // Check that the elements lie within their buffer view, and find their bytes.
        if let Some(view) = accessor.buffer_view {
            let view = view.value();
            let stride = document.views[view].byte_stride.map_or(format.stride(), |s| s.0);
            let offset = accessor.byte_offset.map_or(0, |o| o.0);
            check_extent(document, view, offset, count, stride, format.size()).map_err(error)?;
            if buffers.has_data(document, view) {
                // The extent fits into the view, so the offset fits into memory.
                let bytes = &buffers.view(document, view)?[offset as usize..];
                elements.data = Data::Strided { bytes, stride };
            } else {
                elements.data = Data::Missing;
            }
        }
        elements.add_sparse(document, buffers, budget, format)?;
        Ok(elements)
    }

    /// Checks and reads the sparse indices, if there are any, and checks the range of the values.
    fn add_sparse(
        &mut self,
        document: &Document,
        buffers: &'a Buffers,
        budget: &mut Budget,
        format: Format,
    ) -> Result<()> {
        let Some(sparse) = &document.accessors[self.index].sparse else { return Ok(()) };
        let pointer = || format!("/accessors/{}/sparse", self.index);
        let error = |fault: AccessorFault| document.error_at(pointer(), fault);

        // 1. Check the count, the type of the indices, and the ranges in the buffer views.
        let count = usize::try_from(sparse.count.0).ok().filter(|&c| c <= self.count);
        let Some(count) = count else {
            return Err(error(AccessorFault::SparseCount { count: sparse.count.0, accessor_count: self.count }));
        };
        let Some(component) = Component::of_indices(&sparse.indices.component_type) else {
            return Err(error(AccessorFault::SparseIndexType));
        };
        let (indices, values) = (sparse.indices.buffer_view.value(), sparse.values.buffer_view.value());
        let (index_offset, value_offset) = (sparse.indices.byte_offset.0, sparse.values.byte_offset.0);
        let index_size = component.size();
        check_extent(document, indices, index_offset, count, index_size, index_size).map_err(error)?;
        check_extent(document, values, value_offset, count, format.stride(), format.size()).map_err(error)?;
        // Without the data of both, the whole accessor cannot be read.
        if !buffers.has_data(document, indices) || !buffers.has_data(document, values) {
            self.data = Data::Missing;
            return Ok(());
        }

        // 2. Read the indices.
        budget.charge(count, size_of::<u32>(), document, pointer)?;
        let bytes = &buffers.view(document, indices)?[index_offset as usize..];
        let indices: Vec<u32> = match component {
            Component::U8 => bytes[..count].iter().map(|&b| b.into()).collect(),
            Component::U16 => components(bytes, |b| u16::from_le_bytes(b).into()).take(count).collect(),
            _ => components(bytes, u32::from_le_bytes).take(count).collect(),
        };

        // 3. Check that they ascend and stay below the accessor's count.
        if let Some(&element) = indices.last().filter(|&&last| last as usize >= self.count) {
            return Err(error(AccessorFault::SparseIndexOutOfRange { element, accessor_count: self.count }));
        }
        if !indices.is_sorted_by(|a, b| a < b) {
            return Err(error(AccessorFault::SparseOrder));
        }
        self.sparse = Some(Sparse { indices, values: &buffers.view(document, values)?[value_offset as usize..] });
        Ok(())
    }

    /// Checks that the format is one that the use of the accessor allows. `role` is that use, such as "POSITION", and
    /// `expected` names the formats in words.
    pub(super) fn require_format(
        &self,
        document: &Document,
        role: &'static str,
        expected: &'static str,
        accepts: impl FnOnce(Format) -> bool,
    ) -> Result<Format> {
        match self.format {
            Some(format) if accepts(format) => Ok(format),
            Some(format) => {
                Err(self.error(document, AccessorFault::Format { found: format.to_string(), role, expected }))
            }
            None => Err(self.error(document, AccessorFault::UnknownFormat)),
        }
    }

    /// Whether it can be read; false if the buffer is a placeholder for data decompressed by an unsupported extension.
    pub(super) fn has_data(&self) -> bool {
        !matches!(self.data, Data::Missing)
    }

    /// The largest value of its component type, for unsigned integers.
    pub(super) fn largest_integer(&self) -> Option<u32> {
        match self.format?.component {
            Component::U8 => Some(u8::MAX.into()),
            Component::U16 => Some(u16::MAX.into()),
            Component::U32 => Some(u32::MAX),
            _ => None,
        }
    }

    /// The selected elements as vectors of f32; all finite. Charge the budget first.
    pub(super) fn floats<T, const N: usize>(&self, document: &Document, selection: Selection) -> Result<Vec<T>>
    where
        T: Pod + From<[f32; N]>,
    {
        let out = self.any_floats::<T, N>(document, selection)?;
        self.check_finite::<T, N>(document, selection, &out)?;
        Ok(out)
    }

    /// As [`floats`](Self::floats), but the numbers may be infinite or NaN.
    pub(super) fn any_floats<T, const N: usize>(&self, document: &Document, selection: Selection) -> Result<Vec<T>>
    where
        T: Pod + From<[f32; N]>,
    {
        // Check that there is data, of `N` components for each element.
        let format = self.checked_format::<N>(document)?;
        let (bytes, shorts) = (f32::from(u8::MAX), f32::from(u16::MAX));
        let (signed_bytes, signed_shorts) = (f32::from(i8::MAX), f32::from(i16::MAX));
        // Decode by component type. Normalized integers are divided by the largest value of their type.
        Ok(match (format.component, format.normalized) {
            (Component::F32, _) => self.gather(selection, f32::from_le_bytes),
            (Component::U8, true) => self.gather(selection, |[b]: [u8; 1]| f32::from(b) / bytes),
            (Component::U8, false) => self.gather(selection, |[b]: [u8; 1]| f32::from(b)),
            // The smallest signed integer would become less than -1.
            (Component::I8, true) => {
                self.gather(selection, |b| (f32::from(i8::from_le_bytes(b)) / signed_bytes).max(-1.0))
            }
            (Component::I8, false) => self.gather(selection, |b| f32::from(i8::from_le_bytes(b))),
            (Component::U16, true) => self.gather(selection, |b| f32::from(u16::from_le_bytes(b)) / shorts),
            (Component::U16, false) => self.gather(selection, |b| f32::from(u16::from_le_bytes(b))),
            (Component::I16, true) => {
                self.gather(selection, |b| (f32::from(i16::from_le_bytes(b)) / signed_shorts).max(-1.0))
            }
            (Component::I16, false) => self.gather(selection, |b| f32::from(i16::from_le_bytes(b))),
            // glTF has unsigned ints as vertex indices only.
            (Component::U32, _) => return Err(self.error(document, AccessorFault::IntegerCoordinates)),
        })
    }

    /// The selected elements as unsigned integers. Charge the budget first.
    pub(super) fn integers<T, const N: usize>(&self, document: &Document, selection: Selection) -> Result<Vec<T>>
    where
        T: Pod + From<[u32; N]>,
    {
        match self.checked_format::<N>(document)?.component {
            Component::U8 => Ok(self.gather(selection, |[b]: [u8; 1]| u32::from(b))),
            Component::U16 => Ok(self.gather(selection, |b| u32::from(u16::from_le_bytes(b)))),
            Component::U32 => Ok(self.gather(selection, u32::from_le_bytes)),
            _ => Err(self.error(document, AccessorFault::NotUnsigned)),
        }
    }

    /// The format; an error unless it has `N` components and there is data, or if the import was cancelled.
    fn checked_format<const N: usize>(&self, document: &Document) -> Result<Format> {
        document.cancel.check()?;
        let fault = match self.format {
            _ if !self.has_data() => AccessorFault::NoData,
            Some(format) if format.shape.components() == N => return Ok(format),
            Some(format) => AccessorFault::ComponentCount { found: format.to_string(), expected: N },
            None => AccessorFault::UnknownFormat,
        };
        Err(self.error(document, fault))
    }

    /// Decodes elements of `N` components of `S` bytes each. The format has been checked to have such elements.
    fn gather<T, V, const N: usize, const S: usize>(
        &self,
        selection: Selection,
        component: impl Fn([u8; S]) -> V + Copy,
    ) -> Vec<T>
    where
        T: Copy + Zeroable + From<[V; N]>,
        V: Copy + Zeroable,
    {
        let element = |bytes: &[u8]| {
            let mut values = [V::zeroed(); N];
            values.iter_mut().zip(components(bytes, component)).for_each(|(value, decoded)| *value = decoded);
            T::from(values)
        };
        // 1. Read the dense elements, or zeros if there is no buffer view.
        let mut out: Vec<T> = match (self.data, selection) {
            (Data::Strided { bytes, stride }, Selection::All) => {
                bytes.chunks(stride).take(self.count).map(element).collect()
            }
            (Data::Strided { bytes, stride }, Selection::Indices(indices)) => {
                indices.iter().map(|&i| element(&bytes[i as usize * stride..])).collect()
            }
            (_, selection) => vec![T::zeroed(); self.selected_count(selection)],
        };

        // 2. Substitute the sparse elements that are selected.
        if let Some(sparse) = &self.sparse {
            for (&i, value) in sparse.indices.iter().zip(sparse.values.chunks(N * S)) {
                // Find the element's position in the result; there is none if it is not selected.
                let position = match selection {
                    Selection::All => Ok(i as usize),
                    Selection::Indices(indices) => indices.binary_search(&i),
                };
                if let Ok(position) = position {
                    out[position] = element(value);
                }
            }
        }
        out
    }

    /// The number of elements of a selection.
    pub(super) fn selected_count(&self, selection: Selection) -> usize {
        match selection {
            Selection::All => self.count,
            Selection::Indices(indices) => indices.len(),
        }
    }

    fn check_finite<T: Pod, const N: usize>(&self, document: &Document, selection: Selection, out: &[T]) -> Result<()> {
        let Some(i) = bytemuck::cast_slice::<T, f32>(out).iter().position(|x| !x.is_finite()) else { return Ok(()) };
        // The message names the element by its index in the accessor, not in the selection.
        Err(self.error(document, AccessorFault::NotFinite { element: selection.element(i / N) }))
    }

    /// The error about this accessor.
    pub(super) fn error(&self, document: &Document, fault: AccessorFault) -> Error {
        document.error_at(format!("/accessors/{}", self.index), fault)
    }
}

/// Decodes consecutive components of `S` bytes.
fn components<V, const S: usize>(bytes: &[u8], decode: impl Fn([u8; S]) -> V) -> impl Iterator<Item = V> {
    bytes.as_chunks::<S>().0.iter().map(move |chunk| decode(*chunk))
}

/// Checks that elements lie within a buffer view. No number in the file can overflow the check.
fn check_extent(
    document: &Document,
    view: usize,
    offset: u64,
    count: usize,
    stride: usize,
    size: usize,
) -> Result<(), AccessorFault> {
    let available = document.views[view].byte_length.0;
    // Elements may not overlap.
    if stride < size {
        return Err(AccessorFault::StrideTooSmall { view, stride, size });
    }
    // Compute the length in bytes: a stride for each element but the last, of which only the size counts.
    let length =
        count.checked_sub(1).map_or(Some(0), |n| (n as u64).checked_mul(stride as u64)?.checked_add(size as u64));
    // Compare the end of the last element with that of the view.
    match length.and_then(|length| offset.checked_add(length)) {
        Some(end) if end <= available => Ok(()),
        _ => Err(AccessorFault::OutOfRange { count, size, stride, offset, available, view }),
    }
}
