//! Materials: glTF's metallic-roughness model with transmission, and the textures they refer to.

use std::sync::Arc;

use glam::{Affine2, Vec3, Vec4};
use serde::{Deserialize, Serialize};

use super::TextureKey;

/// How a surface scatters, absorbs and emits light: glTF 2.0's metallic-roughness model with `KHR_materials_transmission`,
/// `KHR_materials_ior` and `KHR_materials_emissive_strength`. All colours are linear.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Linear RGBA; alpha is used as `alpha_mode` says. Each in 0 to 1.
    pub base_color: Vec4,
    /// 0 for a dielectric, 1 for a metal.
    pub metallic: f32,
    /// Perceptual roughness, 0 (mirror) to 1.
    pub roughness: f32,
    /// Emitted radiance, linear, strength included.
    pub emissive: Vec3,
    /// The part of non-reflected light that passes through, 0 to 1: 1 is glass. A geometry that encloses a solid bends it by
    /// `ior`; an open one is a thin pane that does not.
    pub transmission: f32,
    /// Index of refraction, 1 or more (0 means "infinite", as in glTF: a perfect reflector).
    pub ior: f32,
    /// What alpha means.
    pub alpha_mode: AlphaMode,
    /// Whether back faces are drawn. A transmissive surface is always two-sided to light inside it.
    pub double_sided: bool,
    /// Show the base colour as it is, without light.
    pub unlit: bool,
    /// Multiplied with `base_color`; sRGB.
    pub base_color_texture: Option<TextureRef>,
    /// Green times `roughness`, blue times `metallic`; linear.
    pub metallic_roughness_texture: Option<TextureRef>,
    /// Multiplied with `emissive`; sRGB.
    pub emissive_texture: Option<TextureRef>,
    /// Red times `transmission`; linear.
    pub transmission_texture: Option<TextureRef>,
    /// Tangent-space normals; linear.
    pub normal_texture: Option<TextureRef>,
    /// Scales the x and y of `normal_texture`.
    pub normal_scale: f32,
}

impl Default for Material {
    /// A white, fully rough, two-sided dielectric.
    fn default() -> Self {
        Self {
            base_color: Vec4::ONE,
            metallic: 0.0,
            roughness: 1.0,
            emissive: Vec3::ZERO,
            transmission: 0.0,
            ior: 1.5,
            alpha_mode: AlphaMode::Opaque,
            double_sided: true,
            unlit: false,
            base_color_texture: None,
            metallic_roughness_texture: None,
            emissive_texture: None,
            transmission_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
        }
    }
}

impl Material {
    /// A matt surface of this linear colour.
    pub fn diffuse(color: Vec3) -> Self {
        Self { base_color: color.extend(1.0), ..Self::default() }
    }

    /// A polished metal that reflects this linear colour.
    pub fn mirror(color: Vec3) -> Self {
        Self { base_color: color.extend(1.0), metallic: 1.0, roughness: 0.0, ..Self::default() }
    }

    /// Clear glass of this index of refraction (window glass: 1.5).
    pub fn glass(ior: f32) -> Self {
        Self { roughness: 0.0, transmission: 1.0, ior, ..Self::default() }
    }

    /// The textures it refers to, in the order of its fields; one that is used twice comes twice.
    pub fn textures(&self) -> impl Iterator<Item = &TextureRef> {
        let all = [
            &self.base_color_texture,
            &self.metallic_roughness_texture,
            &self.emissive_texture,
            &self.transmission_texture,
            &self.normal_texture,
        ];
        all.into_iter().flatten()
    }
}

/// What the alpha of a material's base colour means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum AlphaMode {
    /// Nothing.
    #[default]
    Opaque,
    /// There is a surface where alpha is at least the cutoff, and a hole elsewhere; tested inside traversal.
    Mask {
        /// The smallest alpha that is solid.
        cutoff: f32,
    },
    /// The surface covers what is behind it by alpha.
    Blend,
}

/// A texture as a material uses it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TextureRef {
    /// The image.
    pub texture: TextureKey,
    /// How it is read.
    pub sampler: Sampler,
    /// The set of texture coordinates: 0 or 1.
    pub tex_coord: u32,
    /// Maps the geometry's texture coordinates to the image's (`KHR_texture_transform`).
    pub transform: Affine2,
}

impl TextureRef {
    /// The image with bilinear filter, repeated, by texture coordinate set 0.
    pub fn new(texture: TextureKey) -> Self {
        Self { texture, sampler: Sampler::default(), tex_coord: 0, transform: Affine2::IDENTITY }
    }
}

/// How a texture is read between and beyond its texels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Sampler {
    /// What lies left and right of the image.
    pub wrap_u: WrapMode,
    /// What lies above and below the image.
    pub wrap_v: WrapMode,
    /// What lies between texel centres.
    pub filter: FilterMode,
}

/// What lies beyond the edge of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum WrapMode {
    /// The image again.
    #[default]
    Repeat,
    /// The image mirrored.
    Mirror,
    /// Its edge.
    Clamp,
}

/// What lies between texel centres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum FilterMode {
    /// The bilinear mix of the four nearest texels.
    #[default]
    Linear,
    /// The nearest texel.
    Nearest,
}

/// An image of RGBA texels, 8 bits a channel, row by row from the top. Whether they are sRGB or linear is the material's to say.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Texture {
    /// Texels a row; at least 1.
    pub width: u32,
    /// Rows; at least 1.
    pub height: u32,
    /// `width * height` texels.
    pub texels: Arc<[[u8; 4]]>,
}
