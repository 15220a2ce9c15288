//! Images: embedded, in data URIs, or in files; PNG or JPEG. One that cannot be had is replaced by a checkerboard.

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::Cursor;

use ::image::{ImageFormat, ImageReader, Limits};
use rayon::prelude::*;

use super::uri::{self, UriTarget};
use super::warnings::Warnings;
use super::{Buffers, Document};
use crate::Result;
use crate::graph::Texture;

/// The largest width and height that are decoded.
const MAX_SIDE: u32 = 1 << 14;
/// Bytes of texels, as they are kept, that are allowed to any file, and for each byte of it: an 8192 x 8192 image of one colour takes a few hundred kB.
const BASE_TEXEL_BYTES: u64 = 256 << 20;
const MAX_TEXEL_EXPANSION: u64 = 64;
/// Bytes that an image's metadata may unpack to: a colour profile has some kB, seldom a few MB.
const METADATA_BYTES: u64 = 16 << 20;
/// The largest image file that is read.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// The images that the imported materials use, each once.
#[derive(Default)]
pub(super) struct ImageRequests<'d> {
    /// Index of the image in the file, and of its texture in what [`decode`](Self::decode) returns.
    wanted: Vec<Option<usize>>,
    slots: HashMap<ImageSource<'d>, usize>,
}

/// Where an image is: images with equal sources are one texture.
#[derive(PartialEq, Eq, Hash)]
enum ImageSource<'d> {
    View(usize),
    Location(UriTarget<'d>),
    UnresolvedUri(usize),
    NoImage,
}

impl<'d> ImageRequests<'d> {
    /// Asks for the image of a glTF texture; returns the index its texture will have.
    pub(super) fn request(&mut self, document: &'d Document, texture: usize, notes: &mut Warnings) -> usize {
        let image = document.textures[texture].source.value();
        let image = (image < document.images.len()).then_some(image);
        let source = match image {
            None => {
                notes.add(
                    document,
                    "texture",
                    format!("/textures/{texture}"),
                    instead("has no image that can be read"),
                );
                ImageSource::NoImage
            }
            Some(i) => source_of(document, i),
        };
        *self.slots.entry(source).or_insert_with(|| {
            self.wanted.push(image);
            self.wanted.len() - 1
        })
    }

    /// Reads and decodes all images that were asked for, on all cores. `bytes_read` is the size of the file and its buffers.
    pub(super) fn decode(
        self,
        document: &Document,
        buffers: &Buffers,
        bytes_read: u64,
        notes: &mut Warnings,
    ) -> Result<Vec<Texture>> {
        // 1. The encoded bytes. An embedded image outside of its buffer is an error; a file that is missing is not.
        let mut encoded = Vec::with_capacity(self.wanted.len());
        for image in &self.wanted {
            encoded.push(image.map(|image| read(document, buffers, image)).transpose()?);
        }

        // 2. Their sizes, against the budget: a few kB can claim to be an image of gigabytes.
        let external: usize = encoded.iter().flatten().flatten().map(|bytes| bytes.len()).sum();
        let mut budget = BASE_TEXEL_BYTES + MAX_TEXEL_EXPANSION.saturating_mul(bytes_read + external as u64);
        for bytes in encoded.iter_mut().flatten() {
            if let Err(cause) = bytes.as_deref().map_err(Clone::clone).and_then(|b| charge_texels(b, &mut budget)) {
                *bytes = Err(cause);
            }
        }

        // 3. The texels.
        let decoded: Vec<_> = encoded.into_par_iter().map(|bytes| bytes.map(|bytes| decode(&bytes?))).collect();
        let mut textures = Vec::with_capacity(decoded.len());
        for (image, decoded) in self.wanted.iter().zip(decoded) {
            textures.push(match decoded {
                None => checkerboard(),
                Some(Ok(texture)) => texture,
                Some(Err(cause)) => {
                    let object = format!("/images/{}", image.unwrap_or_default());
                    notes.add(document, "image", object, instead(&cause));
                    checkerboard()
                }
            });
        }
        Ok(textures)
    }
}

fn instead(cause: &str) -> String {
    format!("{cause}; a magenta checkerboard is shown instead")
}

fn source_of<'d>(document: &'d Document, image: usize) -> ImageSource<'d> {
    let object = &document.images[image];
    match (object.buffer_view, &object.uri) {
        (Some(view), _) => ImageSource::View(view.value()),
        (None, Some(uri)) => {
            uri::resolve(uri, document.path).map_or(ImageSource::UnresolvedUri(image), ImageSource::Location)
        }
        (None, None) => ImageSource::UnresolvedUri(image),
    }
}

/// An image's file; the inner error says why there is none.
fn read<'b>(document: &Document, buffers: &'b Buffers, image: usize) -> Result<Result<Cow<'b, [u8]>, String>> {
    let image = &document.images[image];
    Ok(match (image.buffer_view, &image.uri) {
        (Some(view), _) if !buffers.has_data(document, view.value()) => Err("its buffer has no data".into()),
        (Some(view), _) => Ok(Cow::Borrowed(buffers.view(document, view.value())?)),
        (None, Some(uri)) => {
            uri::resolve(uri, document.path).and_then(|location| location.read(MAX_FILE_BYTES)).map(Cow::Owned)
        }
        (None, None) => Err("has neither a bufferView nor a URI".into()),
    })
}

fn charge_texels(bytes: &[u8], budget: &mut u64) -> Result<(), String> {
    let (width, height) = reader(bytes, METADATA_BYTES)?.into_dimensions().map_err(|e| e.to_string())?;
    if width > MAX_SIDE || height > MAX_SIDE {
        return Err(format!("is {width} x {height} texels, more than {MAX_SIDE} on a side"));
    }
    let size = u64::from(width) * u64::from(height) * size_of::<[u8; 4]>() as u64;
    *budget = budget
        .checked_sub(size)
        .ok_or_else(|| format!("is {width} x {height} texels, with the others out of proportion to the file's size"))?;
    Ok(())
}

/// Takes up to three times what it returns: an image of 16 bits a channel is there next to the one of 8 bits.
fn decode(bytes: &[u8]) -> Result<Texture, String> {
    let (width, height) = reader(bytes, METADATA_BYTES)?.into_dimensions().map_err(|e| e.to_string())?;
    let largest = u64::from(width) * u64::from(height) * size_of::<[u16; 4]>() as u64;
    let image = reader(bytes, METADATA_BYTES + largest)?.decode().map_err(|e| e.to_string())?.into_rgba8();
    let (width, height) = image.dimensions();
    let (texels, _) = image.as_raw().as_chunks::<4>();
    Ok(Texture { width, height, texels: texels.into() })
}

/// The format is told by the first bytes, not by what the file says: exporters get that wrong. `max_alloc` is the most that the decoder
/// may take.
fn reader(bytes: &[u8], max_alloc: u64) -> Result<ImageReader<Cursor<&[u8]>>, String> {
    let Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) = ::image::guess_format(bytes) else {
        return Err("is neither PNG nor JPEG".into());
    };
    let mut limits = Limits::default();
    limits.max_alloc = Some(max_alloc);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits);
    Ok(reader)
}

/// Cannot be missed, and cannot be meant.
fn checkerboard() -> Texture {
    const SIDE: u32 = 16;
    const CHECKER_SIZE: u32 = 4;
    let texel = |i: u32| {
        let (x, y) = (i % SIDE, i / SIDE);
        if (x / CHECKER_SIZE + y / CHECKER_SIZE).is_multiple_of(2) { [255, 0, 255, 255] } else { [0, 0, 0, 255] }
    };
    Texture { width: SIDE, height: SIDE, texels: (0..SIDE * SIDE).map(texel).collect() }
}
