//! Conversion of materials: factors are clamped to their ranges, texture references resolved.

use std::ops::RangeInclusive;

use ::gltf::json;
use glam::{Affine2, Mat2, Vec2, Vec3, Vec4};
use json::texture::{MagFilter, WrappingMode};
use json::validation::Checked::{Invalid, Valid};

use super::texture::ImageRequests;
use super::warnings::Warnings;
use super::{Document, GltfFault, WarningKind, schema};
use crate::Result;
use crate::graph::{AlphaMode, FilterMode, Material, Sampler, TextureKey, TextureRef, WallKind, WrapMode};

/// A material whose textures are not in the scene yet.
pub(super) struct PlannedMaterial {
    /// Everything but the textures.
    values: Material,
    base_color: Option<PlannedTexture>,
    metallic_roughness: Option<PlannedTexture>,
    emissive: Option<PlannedTexture>,
    transmission: Option<PlannedTexture>,
    normal: Option<PlannedTexture>,
}

/// A [`TextureRef`] by the index of its image among the requested ones.
#[derive(Clone, Copy)]
struct PlannedTexture {
    image: usize,
    sampler: Sampler,
    tex_coord: u32,
    transform: Affine2,
}

/// Converts the materials of one document, and records warnings.
pub(super) struct MaterialConverter<'a, 'd> {
    pub(super) document: &'d Document<'d>,
    pub(super) images: &'a mut ImageRequests<'d>,
    pub(super) warnings: &'a mut Warnings,
    /// What transmissive surfaces bound where the file does not say.
    pub(super) wall: WallKind,
}

impl PlannedMaterial {
    /// The material that glTF specifies for a primitive without one.
    pub(super) fn gltf_default() -> Self {
        let values = Material { metallic: 1.0, double_sided: false, ..Material::default() };
        Self { values, base_color: None, metallic_roughness: None, emissive: None, transmission: None, normal: None }
    }

    /// Which sets of texture coordinates its textures need.
    pub(super) fn tex_coords_needed(&self) -> [bool; 2] {
        [0, 1].map(|set| self.textures().any(|texture| texture.tex_coord == set))
    }

    /// Whether it has a normal texture.
    pub(super) fn has_normal_texture(&self) -> bool {
        self.normal.is_some()
    }

    /// Whether its surfaces transmit light, and the geometry decides what they bound.
    pub(super) fn is_judged_by_geometry(&self) -> bool {
        self.values.transmission > 0.0 && self.values.wall == WallKind::Auto
    }

    /// The material with the keys of its textures, which are in the scene by now: `keys` by the index of their image.
    pub(super) fn resolve_textures(self, keys: &[TextureKey]) -> Material {
        let resolve = |texture: Option<PlannedTexture>| {
            let PlannedTexture { image, sampler, tex_coord, transform } = texture?;
            Some(TextureRef { texture: keys[image], sampler, tex_coord, transform })
        };
        Material {
            base_color_texture: resolve(self.base_color),
            metallic_roughness_texture: resolve(self.metallic_roughness),
            emissive_texture: resolve(self.emissive),
            transmission_texture: resolve(self.transmission),
            normal_texture: resolve(self.normal),
            ..self.values
        }
    }

    fn textures(&self) -> impl Iterator<Item = &PlannedTexture> {
        [&self.base_color, &self.metallic_roughness, &self.emissive, &self.transmission, &self.normal]
            .into_iter()
            .flatten()
    }
}

impl<'d> MaterialConverter<'_, 'd> {
    /// Converts the material with this index in the file.
    pub(super) fn convert(&mut self, index: usize) -> Result<PlannedMaterial> {
        const UNIT: RangeInclusive<f32> = 0.0..=1.0;
        const POSITIVE: RangeInclusive<f32> = 0.0..=f32::MAX;
        let (document, unsaid_wall) = (self.document, self.wall);
        let material = &document.materials[index];
        let pbr = &material.pbr_metallic_roughness;
        let pointer = format!("/materials/{index}");
        // The extensions' factors, each with the default of the specification, which also replaces one that is not
        // finite.
        let extensions = material.extensions.as_ref();
        let strength = extensions.and_then(|e| e.emissive_strength.as_ref()).map_or(1.0, |s| s.emissive_strength.0);
        let strength = self.finite_or(&pointer, "emissiveStrength", strength, 1.0)?;
        let transmission = extensions.and_then(|e| e.transmission.as_ref());
        let factor = transmission.map_or(0.0, |t| t.transmission_factor.0);
        let factor = self.finite_or(&pointer, "transmissionFactor", factor, 0.0)?;
        let ior =
            self.finite_or(&pointer, "ior", extensions.and_then(|e| e.ior.as_ref()).map_or(1.5, |i| i.ior.0), 1.5)?;
        let mut number = |what: &'static str, value: f32, range| self.clamp_with_warning(&pointer, what, value, range);

        // 1. The core's factors.
        let mut base_color = Vec4::from(pbr.base_color_factor.0);
        for value in base_color.as_mut() {
            *value = number("baseColorFactor", *value, UNIT)?;
        }
        let mut emissive = Vec3::from(material.emissive_factor.0);
        for value in emissive.as_mut() {
            *value = number("emissiveFactor", *value, UNIT)?;
        }
        let strength = number("emissiveStrength", strength, POSITIVE)?;
        let ior = match ior {
            // 0 means infinite (KHR_materials_ior).
            0.0 => 0.0,
            ior => number("ior", ior, 1.0..=f32::MAX)?,
        };
        let thickness = match extensions.and_then(|e| e.volume.as_ref()) {
            Some(volume) => Some(number("thicknessFactor", volume.thickness_factor.0, POSITIVE)?),
            None => None,
        };
        let values = Material {
            base_color,
            metallic: number("metallicFactor", pbr.metallic_factor.0, UNIT)?,
            roughness: number("roughnessFactor", pbr.roughness_factor.0, UNIT)?,
            emissive,
            transmission: number("transmissionFactor", factor, UNIT)?,
            ior,
            wall: match thickness {
                None => unsaid_wall,
                Some(0.0) => WallKind::Thin,
                Some(_) => WallKind::Solid,
            },
            alpha_mode: match material.alpha_mode {
                Valid(json::material::AlphaMode::Opaque) => AlphaMode::Opaque,
                Valid(json::material::AlphaMode::Blend) => AlphaMode::Blend,
                Valid(json::material::AlphaMode::Mask) => {
                    let cutoff = material.alpha_cutoff.unwrap_or_default().0;
                    AlphaMode::Mask { cutoff: number("alphaCutoff", cutoff, POSITIVE)? }
                }
                Invalid => return Err(document.error_at(format!("{pointer}/alphaMode"), GltfFault::UnknownMode)),
            },
            double_sided: material.double_sided,
            unlit: extensions.is_some_and(|e| e.unlit.is_some()),
            normal_scale: match &material.normal_texture {
                Some(texture) => number("normal scale", texture.scale, f32::MIN..=f32::MAX)?,
                None => 1.0,
            },
            ..Material::default()
        };
        // The product of two large numbers may overflow.
        let values = Material { emissive: (emissive * strength).min(Vec3::MAX), ..values };

        if let Some(volume) = extensions.and_then(|e| e.volume.as_ref()) {
            self.warn_of_attenuation(&pointer, volume, &values);
        }
        if values.transmission > 0.0 && values.roughness > 0.0 && !values.unlit {
            let fallback = "not supported: light is refracted as by a smooth surface";
            self.warnings.add(document, WarningKind::Feature, "rough transmission", &*pointer, fallback);
        }

        // 2. The textures.
        let mut texture = |info: Option<&json::texture::Info>| {
            let Some(info) = info else { return Ok(None) };
            self.texture(&pointer, info.index.value(), info.tex_coord, transform_of(info.extensions.as_ref()).as_ref())
        };
        Ok(PlannedMaterial {
            base_color: texture(pbr.base_color_texture.as_ref())?,
            metallic_roughness: texture(pbr.metallic_roughness_texture.as_ref())?,
            emissive: texture(material.emissive_texture.as_ref())?,
            transmission: texture(transmission.and_then(|t| t.transmission_texture.as_ref()))?,
            normal: match &material.normal_texture {
                None => None,
                Some(info) => {
                    let transform = self.normal_transform_of(info, &pointer)?;
                    self.texture(&pointer, info.index.value(), info.tex_coord, transform.as_ref())?
                }
            },
            values,
        })
    }

    fn texture(
        &mut self,
        pointer: &str,
        texture: usize,
        tex_coord: u32,
        transform: Option<&json::extensions::texture::TextureTransform>,
    ) -> Result<Option<PlannedTexture>> {
        // The transform's set of texture coordinates takes precedence over the texture's own.
        let tex_coord = transform.and_then(|t| t.tex_coord).unwrap_or(tex_coord);
        if tex_coord >= 2 {
            let feature = format!("texture coordinate set {tex_coord}");
            let fallback = "not supported: the texture is left out";
            self.warnings.add(self.document, WarningKind::Feature, feature, pointer, fallback);
            return Ok(None);
        }
        // Convert the transform, and check that it did not overflow.
        let transform = transform.map_or(Affine2::IDENTITY, to_affine);
        let transform = if transform.is_finite() {
            transform
        } else {
            let error = self.document.error_at(pointer, GltfFault::NotFinite { what: "a texture transform" });
            self.warnings.leave_out(&self.document.value, "KHR_texture_transform", error)?;
            Affine2::IDENTITY
        };
        let sampler = self.document.textures[texture].sampler.map(|s| &self.document.samplers[s.value()]);
        // Request the image. Textures with equal images and other samplers share it.
        let image = self.images.request(self.document, texture, self.warnings);
        let sampler = sampler.map_or_else(Sampler::default, to_sampler);
        Ok(Some(PlannedTexture { image, sampler, tex_coord, transform }))
    }

    /// Warns if light would lose colour on its way through a solid.
    fn warn_of_attenuation(&mut self, pointer: &str, volume: &json::extensions::material::Volume, values: &Material) {
        let is_clear = volume.attenuation_distance.0 == f32::INFINITY || volume.attenuation_color.0 == [1.0; 3];
        if values.wall == WallKind::Solid && values.transmission > 0.0 && !is_clear {
            let fallback = "not supported: light passes through it without loss";
            self.warnings.add(self.document, WarningKind::Feature, "attenuation", pointer, fallback);
        }
    }

    /// The value, or the default of an extension whose value is not finite, with a warning.
    fn finite_or(&mut self, pointer: &str, what: &'static str, value: f32, default: f32) -> Result<f32> {
        if value.is_finite() {
            return Ok(value);
        }
        let error = self.document.error_at(pointer, GltfFault::NotFinite { what });
        self.warnings.forgive(&self.document.value, what, format!("is not finite: {default} is used"), error)?;
        Ok(default)
    }

    /// `KHR_texture_transform` of a normal texture, for which the crate has no type; a broken one is left out.
    fn normal_transform_of(
        &mut self,
        info: &json::material::NormalTexture,
        pointer: &str,
    ) -> Result<Option<json::extensions::texture::TextureTransform>> {
        const EXTENSION: &str = "KHR_texture_transform";
        let Some(value) = info.extensions.as_ref().and_then(|e| e.others.get(EXTENSION)) else { return Ok(None) };
        match schema::parse(value) {
            Ok(transform) => Ok(Some(transform)),
            Err(fault) => {
                let pointer = format!("{pointer}/normalTexture/extensions/{EXTENSION}");
                let error = fault.error_at(self.document.path, &pointer);
                self.warnings.leave_out(&self.document.value, EXTENSION, error)?;
                Ok(None)
            }
        }
    }

    /// Clamps a value to its range, and warns if that changes it.
    fn clamp_with_warning(
        &mut self,
        pointer: &str,
        what: &'static str,
        value: f32,
        range: RangeInclusive<f32>,
    ) -> Result<f32> {
        if !value.is_finite() {
            return Err(self.document.error_at(pointer, GltfFault::NotFinite { what }));
        }
        let clamped = value.clamp(*range.start(), *range.end());
        if clamped != value {
            let fallback = format!("is {value}, outside of its range: {clamped} is used");
            let expected = match (*range.start(), *range.end()) {
                (_, 1.0) => "0 to 1",
                (1.0, _) => "1 or more",
                _ => "0 or more",
            };
            let error = self.document.error_at(pointer, GltfFault::OutOfRange { what, value, expected });
            self.warnings.forgive(&self.document.value, what, fallback, error)?;
        }
        Ok(clamped)
    }
}

fn to_sampler(sampler: &json::texture::Sampler) -> Sampler {
    let wrap = |wrap: &json::validation::Checked<WrappingMode>| match wrap {
        Valid(WrappingMode::ClampToEdge) => WrapMode::Clamp,
        Valid(WrappingMode::MirroredRepeat) => WrapMode::Mirror,
        Valid(WrappingMode::Repeat) | Invalid => WrapMode::Repeat,
    };
    // There are no mipmaps, so the magnification filter is used at any distance.
    let filter = match sampler.mag_filter {
        Some(Valid(MagFilter::Nearest)) => FilterMode::Nearest,
        _ => FilterMode::Linear,
    };
    Sampler { wrap_u: wrap(&sampler.wrap_s), wrap_v: wrap(&sampler.wrap_t), filter }
}

fn transform_of(
    extensions: Option<&json::extensions::texture::Info>,
) -> Option<json::extensions::texture::TextureTransform> {
    extensions?.texture_transform.clone()
}

/// `KHR_texture_transform`: scale, then rotate, then translate. Positive rotations turn texture coordinates
/// counter-clockwise as seen on the image, whose v axis points down. (So the extension's own example shows the lower
/// left quadrant turned clockwise.)
fn to_affine(transform: &json::extensions::texture::TextureTransform) -> Affine2 {
    let (sin, cos) = transform.rotation.0.sin_cos();
    let rotation = Mat2::from_cols(Vec2::new(cos, -sin), Vec2::new(sin, cos));
    let scale = Mat2::from_diagonal(Vec2::from(transform.scale.0));
    Affine2::from_mat2_translation(rotation * scale, Vec2::from(transform.offset.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;
    use serde_json::json;

    #[test]
    fn the_extension_s_own_example_shows_the_lower_left_quadrant_turned_clockwise() {
        let example = json!({"offset": [0, 1], "rotation": std::f32::consts::FRAC_PI_2, "scale": [0.5, 0.5]});
        let transform = to_affine(&Deserialize::deserialize(example).unwrap());
        // Corners of the surface, clockwise from the upper left, and where they are in the image, v down.
        for (corner, expected) in [
            (Vec2::new(0.0, 0.0), Vec2::new(0.0, 1.0)),
            (Vec2::new(1.0, 0.0), Vec2::new(0.0, 0.5)),
            (Vec2::new(1.0, 1.0), Vec2::new(0.5, 0.5)),
            (Vec2::new(0.0, 1.0), Vec2::new(0.5, 1.0)),
        ] {
            let found = transform.transform_point2(corner);
            assert!((found - expected).length() < 1e-6, "{corner} is at {found}, expected {expected}");
        }
    }
}
