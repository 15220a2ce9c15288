//! Rendered images: linear RGBA with optional AOVs, tone mapping, PNG and EXR output.

mod encode;
mod save;
mod tonemap;

pub use tonemap::{ToneMapping, khronos_pbr_neutral, srgb_from_linear};

use crate::Result;
use crate::error::require;
use crate::graph::NodeKey;

/// A rendered image: linear RGBA, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Image {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Linear radiance (RGB) and coverage (alpha) of each pixel; not clamped.
    pub color: Vec<[f32; 4]>,
    /// The share of each pixel's radiance that came from unlit surfaces (`KHR_materials_unlit`), 0 to 1, by the sum of
    /// its components; also what is seen of them in mirrors and through glass. Empty if there is none. The colours of
    /// unlit surfaces are meant for the display, so tone mapping leaves this share as it is.
    pub unlit: Vec<f32>,
    /// How [`to_rgba8`](Self::to_rgba8) and PNG files show radiance.
    pub tone_mapping: ToneMapping,
    /// Data of the primary hits, if the view asked for it.
    pub aovs: Option<Aovs>,
}

/// AOVs (arbitrary output variables): data of the primary hit of each pixel, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Aovs {
    /// Distance from the camera along the ray, in the scene's unit of length; infinite where nothing was hit.
    pub depth: Vec<f32>,
    /// Unit shading normal in world space, on the side of the camera; zero where nothing was hit.
    pub normal: Vec<[f32; 3]>,
    /// The node whose geometry was hit; the null key where nothing was.
    pub node: Vec<NodeKey>,
    /// The triangle's index in its geometry; `u32::MAX` where nothing was hit.
    pub triangle: Vec<u32>,
}

impl Aovs {
    /// AOVs from one array for each of them. All must have as many elements as the image has pixels, row by row from
    /// the top.
    pub fn new(depth: Vec<f32>, normal: Vec<[f32; 3]>, node: Vec<NodeKey>, triangle: Vec<u32>) -> Self {
        Self { depth, normal, node, triangle }
    }
}

impl Image {
    /// An image without AOVs. `color` is linear RGBA, row by row from the top, and must have `width * height` elements:
    /// [`save`](Self::save) and [`downscaled`](Self::downscaled) fail if it has not.
    pub fn new(width: u32, height: u32, color: Vec<[f32; 4]>) -> Self {
        Self { width, height, color, unlit: Vec::new(), tone_mapping: ToneMapping::default(), aovs: None }
    }

    /// The same image with these shares of [`unlit`](Self::unlit) surfaces: none, or one for each pixel.
    #[must_use]
    pub fn with_unlit(self, unlit: Vec<f32>) -> Self {
        Self { unlit, ..self }
    }

    /// The same image, shown by this tone mapping.
    #[must_use]
    pub fn with_tone_mapping(self, tone_mapping: ToneMapping) -> Self {
        Self { tone_mapping, ..self }
    }

    /// The same image with these AOVs.
    #[must_use]
    pub fn with_aovs(self, aovs: Aovs) -> Self {
        Self { aovs: Some(aovs), ..self }
    }

    /// The node seen in a pixel, counted from the upper left; `None` where nothing was hit, outside the image, and
    /// without [`aovs`](Self::aovs).
    pub fn node_at(&self, x: u32, y: u32) -> Option<NodeKey> {
        if x >= self.width || y >= self.height {
            return None;
        }
        let node = self.aovs.as_ref()?.node[y as usize * self.width as usize + x as usize];
        (!slotmap::Key::is_null(&node)).then_some(node)
    }

    /// The image for a display: each pixel tone mapped as [`tone_mapping`](Self::tone_mapping) says, but for its share
    /// of [`unlit`](Self::unlit) radiance, and sRGB encoded, 8 bits per channel, rounded to nearest. The 8-bit colours
    /// of an unlit texture come out as they are. Alpha is linear. NaN and negative values become 0, infinity becomes
    /// white. O(pixels).
    pub fn to_rgba8(&self) -> Vec<[u8; 4]> {
        let unlit = self.unlit.iter().copied().chain(std::iter::repeat(0.0));
        self.color.iter().zip(unlit).map(|(&pixel, unlit)| tonemap::rgba8(self.tone_mapping, pixel, unlit)).collect()
    }

    /// An image `1 / factor` as wide and high, whose pixels are the means of blocks of `factor * factor` pixels of this
    /// one: supersampling, if the image was rendered larger for it. A mean of depths or ids has no meaning, so the AOVs
    /// are those of the first pixel of each block. Rows and columns left over at the right and bottom are dropped.
    /// O(pixels).
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) if `factor` is 0 or larger than the image, or an array does not
    /// have `width * height` elements.
    pub fn downscaled(&self, factor: u32) -> Result<Self> {
        self.validate()?;
        let is_allowed = factor > 0 && factor <= self.width.min(self.height);
        let expected = "between 1 and the image's width and height";
        require(is_allowed, "the factor to downscale by", &factor, expected)?;

        // 1. The pixels of the result, and the index of the first pixel of each one's block.
        let (width, height) = (self.width / factor, self.height / factor);
        let pixels = || (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let first = |(x, y): (u32, u32)| (y * factor) as usize * self.width as usize + (x * factor) as usize;
        // 2. Colours: the mean of a block, row by row.
        let mean = |pixel| {
            let rows = (0..factor as usize).map(|row| first(pixel) + row * self.width as usize);
            let mut sum = glam::Vec4::ZERO;
            for start in rows {
                sum +=
                    self.color[start..start + factor as usize].iter().map(|&c| glam::Vec4::from(c)).sum::<glam::Vec4>();
            }
            (sum / (factor * factor) as f32).to_array()
        };
        // 3. The unlit share of that mean: the mean of the shares, each weighted by its pixel's radiance.
        let unlit_mean = |pixel| {
            let rows = (0..factor as usize).map(|row| first(pixel) + row * self.width as usize);
            let (mut unlit, mut all) = (0.0, 0.0);
            for i in rows.flat_map(|start| start..start + factor as usize) {
                let radiance: f32 = self.color[i][..3].iter().sum();
                unlit += self.unlit[i] * radiance;
                all += radiance;
            }
            if unlit > 0.0 { (unlit / all).min(1.0) } else { 0.0 }
        };
        let unlit = if self.unlit.is_empty() { Vec::new() } else { pixels().map(unlit_mean).collect() };
        // 4. AOVs: the first pixel of a block.
        let aovs = self.aovs.as_ref().map(|aovs| Aovs {
            depth: pixels().map(|p| aovs.depth[first(p)]).collect(),
            normal: pixels().map(|p| aovs.normal[first(p)]).collect(),
            node: pixels().map(|p| aovs.node[first(p)]).collect(),
            triangle: pixels().map(|p| aovs.triangle[first(p)]).collect(),
        });
        let color = pixels().map(mean).collect();
        Ok(Self { width, height, color, unlit, tone_mapping: self.tone_mapping, aovs })
    }

    /// Checks that every array has `width * height` elements.
    fn validate(&self) -> Result<()> {
        let expected = u64::from(self.width) * u64::from(self.height);
        let check =
            |what, len: usize| require(len as u64 == expected, what, &len, "the image's width times its height");
        check("the number of colours of an image", self.color.len())?;
        if !self.unlit.is_empty() {
            check("the number of unlit shares of an image", self.unlit.len())?;
        }
        if let Some(aovs) = &self.aovs {
            check("the number of depths of an image", aovs.depth.len())?;
            check("the number of normals of an image", aovs.normal.len())?;
            check("the number of nodes of an image", aovs.node.len())?;
            check("the number of triangles of an image", aovs.triangle.len())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: u32, height: u32, color: Vec<[f32; 4]>) -> Image {
        Image::new(width, height, color)
    }

    #[test]
    fn downscaling_takes_the_mean_of_each_block() {
        let color = (0..15).map(|i| [i as f32, 2.0 * i as f32, -(i as f32), 1.0]).collect();
        let half = image(5, 3, color).downscaled(2).unwrap();
        assert_eq!((half.width, half.height), (2, 1));
        // Blocks {0, 1, 5, 6} and {2, 3, 7, 8}; column 4 and row 2 are left over.
        assert_eq!(half.color, [[3.0, 6.0, -3.0, 1.0], [5.0, 10.0, -5.0, 1.0]]);
    }

    #[test]
    fn downscaling_weights_unlit_shares_by_radiance() {
        let full = image(2, 1, vec![[3.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0]]).with_unlit(vec![1.0, 0.0]);
        assert!(image(2, 1, full.color.clone()).downscaled(1).unwrap().unlit.is_empty());
        let full =
            Image { height: 2, color: [full.color.clone(), full.color].concat(), unlit: full.unlit.repeat(2), ..full };
        assert_eq!(full.downscaled(2).unwrap().unlit, [0.75]);
        assert!(full.clone().with_unlit(vec![0.5; 3]).downscaled(1).is_err());
        assert_eq!(full.with_tone_mapping(ToneMapping::None).downscaled(1).unwrap().tone_mapping, ToneMapping::None);
    }

    #[test]
    fn downscaling_keeps_the_first_pixels_aovs() {
        let mut full = image(4, 2, vec![[0.0; 4]; 8]);
        full.aovs = Some(Aovs {
            depth: (0..8).map(|i| i as f32).collect(),
            normal: vec![[0.0, 1.0, 0.0]; 8],
            node: vec![NodeKey::default(); 8],
            triangle: (0..8).collect(),
        });
        let half = full.downscaled(2).unwrap().aovs.unwrap();
        assert_eq!(half.triangle, [0, 2]);
        assert_eq!(half.depth, [0.0, 2.0]);
    }

    #[test]
    fn impossible_factors_and_images_are_errors() {
        let good = image(2, 2, vec![[0.0; 4]; 4]);
        assert!(good.downscaled(0).is_err());
        assert!(good.downscaled(3).is_err());
        assert!(image(2, 2, vec![[0.0; 4]; 3]).downscaled(1).is_err());
        assert!(image(u32::MAX, u32::MAX, Vec::new()).downscaled(1).is_err());
    }
}
