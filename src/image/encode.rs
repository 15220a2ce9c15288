//! PNG and EXR encoders.

use std::io::Cursor;
use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Layer, LayerAttributes, SmallVec, Vec2, WritableImage as _,
};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::error::{EncodingError, ImageFormatHint, ParameterError, ParameterErrorKind};
use image::{ImageEncoder as _, ImageError, ImageFormat, ImageResult};
use slotmap::Key as _;

use super::{Aovs, Image};
use crate::{Error, Result};

/// Encodes an image as the content of a file.
pub(super) type EncodeFn = fn(&Image) -> ImageResult<Vec<u8>>;

/// The encoder for the extension of a file name, in upper or lower case.
pub(super) fn encoder_for_path(path: &Path) -> Result<EncodeFn> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    match extension.to_ascii_lowercase().as_str() {
        "png" => Ok(png),
        "exr" => Ok(exr),
        _ => Err(Error::ImageFormat { path: path.to_owned() }),
    }
}

/// An 8-bit sRGB PNG with alpha.
fn png(image: &Image) -> ImageResult<Vec<u8>> {
    let mut bytes = Vec::new();
    let pixels = image.to_rgba8();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::Adaptive).write_image(
        pixels.as_flattened(),
        image.width,
        image.height,
        image::ExtendedColorType::Rgba8,
    )?;
    Ok(bytes)
}

/// An EXR with one layer: 32-bit float R, G, B and A, and the unlit shares and AOVs if there are any.
fn exr(image: &Image) -> ImageResult<Vec<u8>> {
    if image.color.is_empty() {
        return Err(ImageError::Parameter(ParameterError::from_kind(ParameterErrorKind::DimensionMismatch)));
    }
    // 1. Channels.
    let mut channels: SmallVec<[AnyChannel<FlatSamples>; 4]> = ["R", "G", "B", "A"]
        .iter()
        .enumerate()
        .map(|(i, name)| float_channel(name, image.color.iter().map(|pixel| pixel[i])))
        .collect();
    if !image.unlit.is_empty() {
        channels.push(float_channel("unlit", image.unlit.iter().copied()));
    }
    if let Some(aovs) = &image.aovs {
        channels.extend(aov_channels(aovs));
    }

    // 2. One layer, compressed without loss.
    let size = Vec2(image.width as usize, image.height as usize);
    let encoding = Encoding { compression: exr::prelude::Compression::ZIP16, ..Encoding::FAST_LOSSLESS };
    let layer = Layer::new(size, LayerAttributes::default(), encoding, AnyChannels::sort(channels));
    let mut bytes = Cursor::new(Vec::new());
    exr::prelude::Image::from_layer(layer)
        .write()
        .to_buffered(&mut bytes)
        .map_err(|error| EncodingError::new(ImageFormatHint::Exact(ImageFormat::OpenExr), error))
        .map_err(ImageError::Encoding)?;
    Ok(bytes.into_inner())
}

/// The channels of the AOVs, under the names that compositing programs look for (Z, N.X) where there is a usual one.
fn aov_channels(aovs: &Aovs) -> [AnyChannel<FlatSamples>; 7] {
    let normal = |axis: usize| aovs.normal.iter().map(move |n| n[axis]);
    // A node's key has 64 bits: it is split into two channels of 32.
    let ids = |shift: u32| aovs.node.iter().map(move |node| (node.data().as_ffi() >> shift) as u32);
    [
        float_channel("Z", aovs.depth.iter().copied()),
        float_channel("N.X", normal(0)),
        float_channel("N.Y", normal(1)),
        float_channel("N.Z", normal(2)),
        integer_channel("id.node", ids(0)),
        integer_channel("id.node_version", ids(32)),
        integer_channel("id.triangle", aovs.triangle.iter().copied()),
    ]
}

fn float_channel(name: &str, samples: impl Iterator<Item = f32>) -> AnyChannel<FlatSamples> {
    AnyChannel::new(name, FlatSamples::F32(samples.collect()))
}

fn integer_channel(name: &str, samples: impl Iterator<Item = u32>) -> AnyChannel<FlatSamples> {
    AnyChannel::new(name, FlatSamples::U32(samples.collect()))
}
