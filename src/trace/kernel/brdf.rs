//! How surfaces reflect: Fresnel's equations, and the microfacet model of glTF 2.0 (appendix B). Twin of
//! `shaders/shared/brdf.wgsl`.

use std::f32::consts::PI;

use glam::{Vec3, Vec4Swizzles as _};

use super::material::normal_reflectance;
use super::math::{dot3, max, mix3};
use super::surface::{GRAZING, Surface, unit_or};
use crate::compile::MAX_MIRROR_ROUGHNESS;

/// Roughness up to which a surface is a mirror. Above [`MAX_MIRROR_ROUGHNESS`] nothing is seen in it.
const MIRROR_ROUGHNESS: f32 = 0.1;
/// Punctual lights have no size, and a polished surface would show none: they are seen in it as in this roughness.
const HIGHLIGHT_ROUGHNESS: f32 = 0.1;

/// How much of a surface's reflection is traced, 1 for a mirror; the rest is blurred sky.
pub(crate) fn sharpness(roughness: f32) -> f32 {
    let x = ((MAX_MIRROR_ROUGHNESS - roughness) * (1.0 / (MAX_MIRROR_ROUGHNESS - MIRROR_ROUGHNESS))).clamp(0.0, 1.0);
    (x * x) * (3.0 - 2.0 * x)
}

/// What a dielectric reflects of unpolarised light: Fresnel's equations. `eta` is the index of the side that the light
/// comes from over that of the other side, 0 for an infinite one; `cosine` is of the angle of incidence. 1 where reflection
/// is total.
pub(crate) fn fresnel_dielectric(cosine: f32, eta: f32) -> f32 {
    let cosine_2 = refracted_cosine(cosine, eta);
    if cosine_2 <= 0.0 || eta <= 0.0 {
        return 1.0;
    }
    let perpendicular = (eta * cosine - cosine_2) / (eta * cosine + cosine_2);
    let parallel = (cosine - eta * cosine_2) / (cosine + eta * cosine_2);
    0.5 * (perpendicular * perpendicular + parallel * parallel)
}

/// The cosine of the angle of refraction (Snell's law), or 0 where reflection is total.
pub(crate) fn refracted_cosine(cosine: f32, eta: f32) -> f32 {
    max(1.0 - (eta * eta) * (1.0 - cosine * cosine), 0.0).sqrt()
}

/// (1 - cosine)^5: Schlick's approximation of how reflectance goes to 1.
fn schlick(cosine: f32) -> f32 {
    let x = (1.0 - cosine).clamp(0.0, 1.0);
    let square = x * x;
    (square * square) * x
}

/// How a surface divides the light that comes along the line of view; with what it absorbs, the sum is 1.
pub(crate) struct Shares {
    /// Like a mirror, sharp or blurred.
    pub mirrored: Vec3,
    /// Through the surface.
    pub refracted: Vec3,
    /// In all directions.
    pub matt: Vec3,
}

/// `eta` is as in [`fresnel_dielectric`]. Roughness flattens the rise of reflectance towards grazing angles.
pub(crate) fn divide_light(surface: &Surface, cosine: f32, eta: f32) -> Shares {
    let base_color = surface.base_color.xyz();
    let polish = 1.0 - surface.roughness;
    let metal = mix3(base_color, Vec3::ONE, schlick(cosine) * polish);
    let mut dielectric = fresnel_dielectric(cosine, eta);
    if dielectric < 1.0 {
        let normal_incidence = normal_reflectance(surface.ior);
        dielectric = normal_incidence + (dielectric - normal_incidence) * polish;
    }
    let entering = (1.0 - surface.metallic) * (1.0 - dielectric);
    Shares {
        mirrored: mix3(Vec3::splat(dielectric), metal, surface.metallic),
        refracted: surface.tint * (entering * surface.transmission),
        matt: base_color * (entering * (1.0 - surface.transmission)),
    }
}

/// The light that a surface reflects to the viewer of light from one direction, times that direction's cosine. All unit
/// vectors.
pub(crate) fn reflect_light(surface: &Surface, to_viewer: Vec3, to_light: Vec3) -> Vec3 {
    let n_l = dot3(surface.normal, to_light);
    if n_l <= 0.0 {
        return Vec3::ZERO;
    }
    let n_v = max(dot3(surface.normal, to_viewer), GRAZING);
    let half_way = unit_or(to_viewer + to_light, surface.normal);
    let n_h = dot3(surface.normal, half_way).clamp(0.0, 1.0);
    let edge = schlick(dot3(to_viewer, half_way));

    let dielectric = normal_reflectance(surface.ior) * (1.0 - edge) + edge;
    let metal = mix3(surface.base_color.xyz(), Vec3::ONE, edge);
    let fresnel = mix3(Vec3::splat(dielectric), metal, surface.metallic);
    let matt = (1.0 - surface.metallic) * (1.0 - dielectric) * (1.0 - surface.transmission);

    let roughness = max(surface.roughness, HIGHLIGHT_ROUGHNESS);
    let specular = fresnel * microfacets(n_l, n_v, n_h, roughness * roughness);
    (surface.base_color.xyz() * (matt / PI) + specular) * n_l
}

/// GGX's distribution times Smith's height-correlated visibility.
fn microfacets(n_l: f32, n_v: f32, n_h: f32, alpha: f32) -> f32 {
    let square = alpha * alpha;
    // n_h^2 (square - 1) + 1, without the cancellation at n_h = 1.
    let spread = (1.0 - n_h * n_h) + (n_h * n_h) * square;
    let distribution = square / (PI * spread * spread);
    let light_side = n_l * (n_v * n_v * (1.0 - square) + square).sqrt();
    let viewer_side = n_v * (n_l * n_l * (1.0 - square) + square).sqrt();
    distribution * (0.5 / (light_side + viewer_side))
}
