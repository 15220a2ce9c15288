//! Range checks of the values in transforms, lights, cameras, materials and textures.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::DAffine3;

use super::{
    AlphaMode, Billboard, Camera, Core, Light, LightKind, Lod, LodMetric, Material, Texture, TextureRef, Transform,
};
use crate::Result;
use crate::error::require;

/// Checks the numbers in a core, not the keys.
pub(super) fn check_core(core: &Core) -> Result<()> {
    match core {
        Core::Group
        | Core::Switch(_)
        | Core::Billboard(Billboard::Spherical)
        | Core::MaterialGroup(_)
        | Core::Instance(_)
        | Core::Geometry { .. } => Ok(()),
        Core::Transform(transform) => check_transform(transform).map(drop),
        Core::Lod(lod) => check_lod(lod),
        Core::Billboard(Billboard::Cylindrical(axis)) => {
            let length = axis.length();
            require(length > 0.0 && length.is_finite(), "billboard axis", axis, "finite and not 0")
        }
        Core::Light(light) => check_light(light),
        Core::Camera(camera) => check_camera(camera),
    }
}

/// Checks the numbers in a transform and in its matrix, whose products can overflow. Returns the matrix.
pub(super) fn check_transform(transform: &Transform) -> Result<DAffine3> {
    let affine = transform.to_affine();
    require(transform.is_finite() && affine.is_finite(), "transform", transform, "finite")?;
    Ok(affine)
}

fn check_lod(lod: &Lod) -> Result<()> {
    // Check the centre, the hysteresis and each threshold by itself.
    require(lod.center.is_finite(), "centre of the levels of detail", &lod.center, "finite")?;
    let hysteresis = lod.hysteresis;
    require((0.0..1.0).contains(&hysteresis), "hysteresis of levels of detail", &hysteresis, "at least 0 and below 1")?;
    let is_positive = |value: &f64| *value > 0.0 && value.is_finite();
    require(
        lod.thresholds.iter().all(is_positive),
        "limits of levels of detail",
        &lod.thresholds,
        "finite and above 0",
    )?;
    // Thresholds go from near to far: distances ascend, projected sizes descend.
    match lod.metric {
        LodMetric::Distance => {
            require(lod.thresholds.is_sorted(), "limits of levels of detail", &lod.thresholds, "ascending distances")
        }
        LodMetric::ProjectedSize { radius } => {
            require(is_positive(&radius), "radius of levels of detail", &radius, "finite and above 0")?;
            let descending = lod.thresholds.iter().rev().is_sorted();
            require(descending, "limits of levels of detail", &lod.thresholds, "descending sizes")
        }
    }
}

fn check_light(light: &Light) -> Result<()> {
    let color = light.color;
    require(color.is_finite() && color.min_element() >= 0.0, "light colour", &color, "finite and at least 0")?;
    require_at_least_zero("light intensity", light.intensity)?;
    if let Some(range) = light.range {
        require_positive("light range", range)?;
    }
    if let LightKind::Spot { inner_cone_angle: inner, outer_cone_angle: outer } = light.kind {
        require(
            outer > 0.0 && outer <= FRAC_PI_2,
            "spot light outer cone angle",
            &outer,
            "above 0 and at most pi / 2",
        )?;
        require(inner >= 0.0 && inner <= outer, "spot light inner cone angle", &inner, "between 0 and the outer one")?;
    }
    Ok(())
}

pub(super) fn check_camera(camera: &Camera) -> Result<()> {
    require(camera.shift().is_finite(), "camera lens shift", &camera.shift(), "finite")?;
    match *camera {
        Camera::Perspective { y_fov, aspect, .. } => {
            require(y_fov > 0.0 && y_fov < PI, "camera field of view", &y_fov, "above 0 and below pi")?;
            aspect.map_or(Ok(()), |aspect| require_positive("camera aspect", aspect))
        }
        Camera::Orthographic { x_mag, y_mag, .. } => {
            require_positive("camera half width", x_mag)?;
            require_positive("camera half height", y_mag)
        }
    }
}

/// Checks the numbers in a material, not the keys.
pub(super) fn check_material(material: &Material) -> Result<()> {
    for value in material.base_color.to_array() {
        require_unit("material base colour", value)?;
    }
    require_unit("material metallic", material.metallic)?;
    require_unit("material roughness", material.roughness)?;
    require_unit("material transmission", material.transmission)?;
    for value in material.emissive.to_array() {
        require_at_least_zero("material emission", value)?;
    }
    // 0 is glTF's notation for an infinite index.
    let ior = material.ior;
    require(
        ior == 0.0 || (ior >= 1.0 && ior.is_finite()),
        "material index of refraction",
        &ior,
        "0, or finite and at least 1",
    )?;
    if let AlphaMode::Mask { cutoff } = material.alpha_mode {
        require_at_least_zero("material alpha cutoff", cutoff)?;
    }
    require(material.normal_scale.is_finite(), "material normal scale", &material.normal_scale, "finite")?;
    material.textures().try_for_each(check_texture_ref)
}

fn check_texture_ref(texture: &TextureRef) -> Result<()> {
    require(texture.tex_coord < 2, "set of texture coordinates", &texture.tex_coord, "0 or 1")?;
    require(texture.transform.is_finite(), "texture transform", &texture.transform, "finite")
}

/// Checks that a texture has `width * height` texels, and at least one.
pub(super) fn check_texture(texture: &Texture) -> Result<()> {
    let (width, height, texels) = (texture.width, texture.height, texture.texels.len());
    // In u64, where the product of two u32 cannot overflow.
    let matches = u64::from(width) * u64::from(height) == texels as u64;
    let size = format_args!("{width} x {height} with {texels} texels");
    let expected = "at least 1 x 1, with width times height texels";
    require(width > 0 && height > 0 && matches, "texture size", &size, expected)
}

fn require_unit(what: &'static str, value: f32) -> Result<()> {
    require((0.0..=1.0).contains(&value), what, &value, "between 0 and 1")
}

fn require_at_least_zero(what: &'static str, value: f32) -> Result<()> {
    require(value >= 0.0 && value.is_finite(), what, &value, "finite and at least 0")
}

fn require_positive(what: &'static str, value: f32) -> Result<()> {
    require(value > 0.0 && value.is_finite(), what, &value, "finite and above 0")
}
