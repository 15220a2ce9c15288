//! Images: embedded, in data URIs, or in files; PNG or JPEG. An image that cannot be decoded is replaced by a
//! checkerboard.

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::Cursor;

use ::image::{ImageFormat, ImageReader, Limits};
use rayon::prelude::*;

use super::files::{ExternalFiles, UriTarget};
use super::uri::spelling_fault;
use super::warnings::Warnings;
use super::{Budget, Buffers, Document, GltfFault, UriFault, WarningKind};
use crate::Result;
use crate::graph::Texture;

/// The largest width and height that are decoded, in texels.
const MAX_SIDE: u32 = 1 << 14;
/// What an image takes besides its texels, in bytes: the request, its source, the texture, and the checkerboard if that
/// stands in for it.
const BYTES_PER_IMAGE: usize = 2048;
/// Memory that the decoder may take for metadata, in bytes: a colour profile has some kB, seldom a few MB.
const METADATA_BYTES: u64 = 16 << 20;
/// The largest image file that is read, in bytes.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// The images that the imported materials use, each once, in the order of their requests.
pub(super) struct ImageRequests<'d> {
    files: &'d ExternalFiles<'d>,
    /// The index in the file of each requested image; `None` for a texture without image. [`decode`](Self::decode)
    /// returns their textures in this order.
    requested: Vec<Option<usize>>,
    /// The index of each source in `requested`.
    requested_index: HashMap<ImageSource<'d>, usize>,
}

/// Source of an image; equal sources share one texture.
#[derive(PartialEq, Eq, Hash)]
enum ImageSource<'d> {
    /// A buffer view.
    View(usize),
    /// A data URI or a file.
    Uri(UriTarget<'d>),
    /// The image of this index in the file, which has no URI that can be resolved.
    Unresolved(usize),
    /// The texture has no image.
    NoImage,
}

/// Why an image is replaced by the checkerboard. The text continues a warning about the image.
#[derive(Clone, Debug, thiserror::Error)]
enum ImageFault {
    #[error("has no image that can be read")]
    NoImage,
    #[error("has neither a bufferView nor a URI")]
    NoSource,
    #[error("its buffer has no data")]
    NoData,
    #[error(transparent)]
    Uri(#[from] UriFault),
    #[error("is neither PNG nor JPEG")]
    UnknownFormat,
    /// With the decoder's message.
    #[error("{0}")]
    Decoder(String),
    #[error("is {width} x {height} texels, more than {MAX_SIDE} on a side")]
    TooLarge { width: u32, height: u32 },
    #[error("is {width} x {height} texels, with the others out of proportion to the file's size")]
    Budget { width: u32, height: u32 },
}

impl ImageFault {
    /// What is done instead, in words.
    fn fallback_text(&self) -> String {
        format!("{self}; a magenta checkerboard is shown instead")
    }
}

impl From<::image::ImageError> for ImageFault {
    fn from(error: ::image::ImageError) -> Self {
        Self::Decoder(error.to_string())
    }
}

impl<'d> ImageRequests<'d> {
    /// No requests. `files` are the external files of the document.
    pub(super) fn new(files: &'d ExternalFiles<'d>) -> Self {
        Self { files, requested: Vec::new(), requested_index: HashMap::new() }
    }

    /// Requests the image of a glTF texture; returns the index that its texture will have.
    pub(super) fn request(&mut self, document: &'d Document, texture: usize, warnings: &mut Warnings) -> usize {
        let image = document.textures[texture].source.value();
        // For a texture without an image the crate gives an index beyond all images.
        let image = (image < document.images.len()).then_some(image);
        let source = match image {
            None => {
                let pointer = format!("/textures/{texture}");
                warnings.add(document, WarningKind::Data, "texture", pointer, ImageFault::NoImage.fallback_text());
                ImageSource::NoImage
            }
            Some(i) => source_of(document, self.files, i),
        };
        // Reuse the request for an equal source.
        *self.requested_index.entry(source).or_insert_with(|| {
            self.requested.push(image);
            self.requested.len() - 1
        })
    }

    /// Reads all requested images, and decodes them on all cores.
    pub(super) fn decode(
        self,
        document: &Document,
        buffers: &Buffers,
        budget: &mut Budget,
        warnings: &mut Warnings,
    ) -> Result<Vec<Texture>> {
        let at = || "/images".to_owned();
        budget.charge(self.requested.len(), BYTES_PER_IMAGE, document, at)?;
        // 1. Read the encoded bytes. An embedded image outside of its buffer is an error; a missing file is not.
        let mut encoded = Vec::with_capacity(self.requested.len());
        for image in &self.requested {
            document.cancel.check()?;
            if let Some(image) = image {
                warn_of_spelling(document, *image, warnings)?;
            }
            encoded.push(image.map(|image| read(document, buffers, self.files, image)).transpose()?);
        }

        // 2. Charge the decoded sizes to the budget: an image of a few kB can claim to decode to gigabytes.
        let is_external = |bytes: &&Cow<[u8]>| matches!(bytes, Cow::Owned(_));
        let external: usize = encoded.iter().flatten().flatten().filter(is_external).map(|bytes| bytes.len()).sum();
        budget.add_data(external as u64);
        for bytes in encoded.iter_mut().flatten() {
            if let Err(fault) = bytes.as_deref().map_err(Clone::clone).and_then(|b| charge_texels(b, budget)) {
                *bytes = Err(fault);
            }
        }

        // 3. Decode.
        let decode = |bytes: Option<Result<Cow<'_, [u8]>, ImageFault>>| {
            document.cancel.check()?;
            Ok(bytes.map(|bytes| decode(&bytes?)))
        };
        let decoded: Vec<_> = encoded.into_par_iter().map(decode).collect::<Result<_>>()?;
        // Replace the images that cannot be shown.
        let mut textures = Vec::with_capacity(decoded.len());
        for (image, decoded) in self.requested.iter().zip(decoded) {
            textures.push(match decoded {
                None => checkerboard(),
                Some(Ok(texture)) => texture,
                Some(Err(fault)) => {
                    let pointer = format!("/images/{}", image.unwrap_or_default());
                    let error = document.error_at(pointer, GltfFault::Image(fault.to_string()));
                    warnings.forgive(&document.value, "image", fault.fallback_text(), error)?;
                    checkerboard()
                }
            });
        }
        Ok(textures)
    }
}

fn source_of<'d>(document: &'d Document, files: &ExternalFiles, image: usize) -> ImageSource<'d> {
    let object = &document.images[image];
    match (object.buffer_view, &object.uri) {
        (Some(view), _) => ImageSource::View(view.value()),
        (None, Some(uri)) => files.resolve(uri).map_or(ImageSource::Unresolved(image), ImageSource::Uri),
        (None, None) => ImageSource::Unresolved(image),
    }
}

/// Warns if the data URI of an image is spelled against the rules, although it can be read.
fn warn_of_spelling(document: &Document, image: usize, warnings: &mut Warnings) -> Result<()> {
    let object = &document.images[image];
    let uri = object.uri.as_ref().filter(|_| object.buffer_view.is_none());
    let Some(fault) = uri.and_then(|uri| spelling_fault(uri)) else { return Ok(()) };
    let fallback = format!("{fault}: read as if it had not");
    let error = document.error_at(format!("/images/{image}/uri"), GltfFault::Image(fault.to_string()));
    warnings.forgive(&document.value, "URI", fallback, error)
}

/// The encoded bytes of an image. The inner error is one that a checkerboard stands in for.
fn read<'b>(
    document: &Document,
    buffers: &'b Buffers,
    files: &ExternalFiles,
    image: usize,
) -> Result<Result<Cow<'b, [u8]>, ImageFault>> {
    let image = &document.images[image];
    Ok(match (image.buffer_view, &image.uri) {
        (Some(view), _) if !buffers.has_data(document, view.value()) => Err(ImageFault::NoData),
        (Some(view), _) => Ok(Cow::Borrowed(buffers.view(document, view.value())?)),
        (None, Some(uri)) => {
            let bytes = files.resolve(uri).and_then(|target| files.read(&target, MAX_FILE_BYTES));
            bytes.map(Cow::Owned).map_err(ImageFault::Uri)
        }
        (None, None) => Err(ImageFault::NoSource),
    })
}

/// Takes the texels of an image from the budget, in bytes, by the size in its header.
fn charge_texels(bytes: &[u8], budget: &mut Budget) -> Result<(), ImageFault> {
    let (width, height) = reader(bytes, METADATA_BYTES)?.into_dimensions()?;
    if width > MAX_SIDE || height > MAX_SIDE {
        return Err(ImageFault::TooLarge { width, height });
    }
    let size = u64::from(width) * u64::from(height) * size_of::<[u8; 4]>() as u64;
    if budget.try_take_texels(size) { Ok(()) } else { Err(ImageFault::Budget { width, height }) }
}

/// Decodes an image to RGBA8. Peak memory: up to three times the result, since an image of 16 bits a channel is held
/// beside its copy of 8 bits.
fn decode(bytes: &[u8]) -> Result<Texture, ImageFault> {
    // Limit the decoder's memory to what an image of this size can take, at 16 bits a channel.
    let (width, height) = reader(bytes, METADATA_BYTES)?.into_dimensions()?;
    let largest = u64::from(width) * u64::from(height) * size_of::<[u16; 4]>() as u64;
    let image = reader(bytes, METADATA_BYTES + largest)?.decode()?.into_rgba8();
    let (width, height) = image.dimensions();
    let (texels, _) = image.as_raw().as_chunks::<4>();
    Ok(Texture { width, height, texels: texels.into() })
}

/// A decoder that takes at most `max_alloc` bytes of memory. The format is detected from the data; `mimeType` is often
/// wrong.
fn reader(bytes: &[u8], max_alloc: u64) -> Result<ImageReader<Cursor<&[u8]>>, ImageFault> {
    let Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) = ::image::guess_format(bytes) else {
        return Err(ImageFault::UnknownFormat);
    };
    let mut limits = Limits::default();
    limits.max_alloc = Some(max_alloc);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits);
    Ok(reader)
}

/// The magenta checkerboard that is shown for a missing image.
fn checkerboard() -> Texture {
    const SIDE: u32 = 16;
    const CHECKER_SIZE: u32 = 4;
    let texel = |i: u32| {
        let (x, y) = (i % SIDE, i / SIDE);
        if (x / CHECKER_SIZE + y / CHECKER_SIZE).is_multiple_of(2) { [255, 0, 255, 255] } else { [0, 0, 0, 255] }
    };
    Texture { width: SIDE, height: SIDE, texels: (0..SIDE * SIDE).map(texel).collect() }
}
