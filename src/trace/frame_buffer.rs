//! A frame as the kernel writes it, before it becomes an [`Image`].

use slotmap::KeyData;

use super::kernel::Pixel;
use crate::Result;
use crate::device::layout::NONE;
use crate::error::{Resource, require_within};
use crate::graph::NodeKey;
use crate::image::{Aovs, Image};

/// Per-pixel outputs of the kernel, row by row from the top.
#[derive(Clone, Debug, Default)]
pub(crate) struct FrameBuffer {
    pub width: u32,
    pub height: u32,
    /// Linear radiance, and 1 plus the share of it that came from unlit surfaces.
    pub color: Vec<[f32; 4]>,
    pub aovs: Option<AovBuffers>,
    /// Number of pixels pushed that needed more rays than they may have.
    pub limited_pixels: u64,
}

/// The auxiliary outputs: normal, depth and identifiers.
#[derive(Clone, Debug, Default)]
pub(crate) struct AovBuffers {
    /// Normal, then depth: `f32::MAX` where the primary ray missed.
    pub normal_depth: Vec<[f32; 4]>,
    /// Node slot, node version, primitive and instance.
    pub ids: Vec<[u32; 4]>,
}

/// The most pixels in one frame: 12 GiB with AOVs.
const MAX_PIXELS: u64 = 1 << 28;

impl FrameBuffer {
    /// An empty frame buffer with capacity for `width * height` pixels.
    pub(crate) fn new(width: u32, height: u32, aovs: bool) -> Result<Self> {
        let pixels = Self::check_size(width, height)?;
        let aovs =
            aovs.then(|| AovBuffers { normal_depth: Vec::with_capacity(pixels), ids: Vec::with_capacity(pixels) });
        Ok(Self { width, height, color: Vec::with_capacity(pixels), aovs, limited_pixels: 0 })
    }

    /// The number of pixels of a frame, or [`Error::Limit`] if there are too many.
    pub(crate) fn check_size(width: u32, height: u32) -> Result<usize> {
        let needed = u64::from(width) * u64::from(height);
        require_within(Resource::ImagePixels, needed, MAX_PIXELS)?;
        Ok(needed as usize)
    }

    /// Adds the next pixel.
    pub(crate) fn push(&mut self, pixel: &Pixel) {
        self.color.push(pixel.color.to_array());
        self.limited_pixels += u64::from(pixel.is_limited);
        if let Some(aovs) = &mut self.aovs {
            aovs.normal_depth.push(pixel.normal.extend(pixel.distance).to_array());
            aovs.ids.push(pixel.ids);
        }
    }

    /// Converts to an [`Image`]; a missed pixel's depth becomes infinity, the shares of unlit surfaces a plane of their
    /// own.
    pub(crate) fn into_image(mut self) -> Image {
        let mut unlit = Vec::new();
        if self.color.iter().any(|pixel| pixel[3] > 1.0) {
            unlit = self.color.iter_mut().map(|pixel| std::mem::replace(&mut pixel[3], 1.0) - 1.0).collect();
        }
        let aovs = self.aovs.map(|AovBuffers { normal_depth, ids }| Aovs {
            depth: normal_depth.iter().map(|&[_, _, _, t]| if t == f32::MAX { f32::INFINITY } else { t }).collect(),
            normal: normal_depth.iter().map(|&[x, y, z, _]| [x, y, z]).collect(),
            node: ids.iter().map(|&[slot, version, _, instance]| node_key(slot, version, instance)).collect(),
            triangle: ids.iter().map(|&[_, _, primitive, _]| primitive).collect(),
        });
        Image { unlit, aovs, ..Image::new(self.width, self.height, self.color) }
    }
}

fn node_key(slot: u32, version: u32, instance: u32) -> NodeKey {
    if instance == NONE {
        return NodeKey::default();
    }
    KeyData::from_ffi(u64::from(version) << 32 | u64::from(slot)).into()
}
