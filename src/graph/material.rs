//! Materials: glTF's metallic-roughness model with transmission, and the textures they refer to.

use std::sync::Arc;

use glam::{Affine2, Vec3, Vec4};
use serde::{Deserialize, Serialize};

use super::TextureKey;

/// How a surface scatters, absorbs and emits light: glTF 2.0's metallic-roughness model with
/// `KHR_materials_transmission`, `KHR_materials_ior` and `KHR_materials_emissive_strength`. All colours are linear.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Linear RGBA, each in 0 to 1; `alpha_mode` determines the use of alpha.
    pub base_color: Vec4,
    /// 0 for a dielectric, 1 for a metal.
    pub metallic: f32,
    /// Perceptual roughness, 0 (mirror) to 1.
    pub roughness: f32,
    /// Emitted radiance, linear, strength included.
    pub emissive: Vec3,
    /// Fraction of the light not reflected at the surface that is transmitted, 0 to 1 (1: glass). A solid refracts it
    /// by `ior`, a thin wall lets it pass without bending: see `wall`.
    pub transmission: f32,
    /// Index of refraction, 1 or more (0 means "infinite", as in glTF: a perfect reflector).
    pub ior: f32,
    /// Whether a transmissive surface bounds a solid or is a thin wall. No effect without transmission.
    pub wall: WallKind,
    /// How alpha is used.
    pub alpha_mode: AlphaMode,
    /// Whether back faces are there: sight and light that come from behind pass a single-sided surface, so that it
    /// casts a shadow only where its front is lit. A transmissive surface is always two-sided.
    pub double_sided: bool,
    /// Output the base colour unshaded (`KHR_materials_unlit`).
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
            wall: WallKind::Auto,
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

    /// The texture references, in the order of the fields; a texture that is used twice occurs twice.
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

/// What a transmissive surface bounds (`KHR_materials_volume` in glTF, "thin-walled" elsewhere).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum WallKind {
    /// Judged by the geometry: a surface that encloses a volume bounds a solid, any other is a thin wall. A glass ball
    /// is solid, a window pane of one sheet thin.
    ///
    /// What belongs together by shared vertices (within 2^-18 of the geometry's size) is judged together. It encloses a
    /// volume if each of its holes is small beside it, as those in the base of a scanned figure are, and its triangles
    /// face outward; or inward, as a cavity in a solid. Turned inside out as a whole, or one in the other and facing
    /// the same way, surfaces are thin. Where only parts of a geometry enclose a volume, it is drawn as most of its
    /// area. The compiler judges each geometry with such a material once, and again when it deforms: O(n log n) in its
    /// triangles.
    #[default]
    Auto,
    /// A wall without thickness: light passes without bending, and is tinted by the base colour once.
    Thin,
    /// The boundary of a solid: light refracts by `ior`. Inside is where the triangles' backs are.
    Solid,
}

/// How the alpha of a material's base colour is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum AlphaMode {
    /// Alpha is ignored; the surface is opaque.
    #[default]
    Opaque,
    /// The surface exists where alpha is at least the cutoff; tested inside traversal.
    Mask {
        /// The smallest alpha at which the surface exists.
        cutoff: f32,
    },
    /// The surface is blended over what is behind it by alpha.
    Blend,
}

/// A texture reference: texture, sampler, coordinate set and UV transform.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TextureRef {
    /// The texture.
    pub texture: TextureKey,
    /// Wrap modes and filter.
    pub sampler: Sampler,
    /// The set of texture coordinates: 0 or 1.
    pub tex_coord: u32,
    /// Maps the geometry's texture coordinates to the image's (`KHR_texture_transform`).
    pub transform: Affine2,
}

impl TextureRef {
    /// A reference with bilinear filter and repeat, by texture coordinate set 0.
    pub fn new(texture: TextureKey) -> Self {
        Self { texture, sampler: Sampler::default(), tex_coord: 0, transform: Affine2::IDENTITY }
    }
}

/// Wrap modes and filter of a texture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Sampler {
    /// Horizontal wrap mode.
    pub wrap_u: WrapMode,
    /// Vertical wrap mode.
    pub wrap_v: WrapMode,
    /// Filter between texel centres.
    pub filter: FilterMode,
}

/// How texture coordinates outside 0 to 1 are mapped to texels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum WrapMode {
    /// Repeat.
    #[default]
    Repeat,
    /// Repeat, mirrored every other time.
    Mirror,
    /// Clamp to edge.
    Clamp,
}

/// Filter between texel centres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum FilterMode {
    /// Bilinear interpolation of the four nearest texels.
    #[default]
    Linear,
    /// The nearest texel.
    Nearest,
}

/// An image of RGBA texels, 8 bits per channel, row by row from the top. The material field that refers to it
/// determines whether it is sRGB or linear.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Texture {
    /// Width in texels; at least 1.
    pub width: u32,
    /// Height in texels; at least 1.
    pub height: u32,
    /// `width * height` texels.
    pub texels: Arc<[[u8; 4]]>,
}
