//! How surfaces reflect: Fresnel's equations, and the microfacet model of glTF 2.0 (appendix B). Twin of
//! `shaders/shared/brdf.wgsl`.

use std::f32::consts::PI;

use glam::{Vec3, Vec4Swizzles as _};

use super::material::f0_from_ior;
use super::math::{dot3, max, mix3};
use super::surface::{MIN_COSINE, Surface, normalize_or};
use crate::device::MAX_MIRROR_ROUGHNESS;

/// Up to this roughness reflections are traced in full; between it and [`MAX_MIRROR_ROUGHNESS`] they fade to the
/// blurred sky.
pub(super) const SHARP_REFLECTION_ROUGHNESS: f32 = 0.1;
/// Least roughness for highlights: a punctual light has no extent, so a smooth surface would show no highlight.
pub(super) const MIN_HIGHLIGHT_ROUGHNESS: f32 = 0.1;

/// Share of the specular reflection that is traced as a ray (1 when smooth); the rest is the blurred sky.
pub(crate) fn traced_reflection_share(roughness: f32) -> f32 {
    let x = ((MAX_MIRROR_ROUGHNESS - roughness) * (1.0 / (MAX_MIRROR_ROUGHNESS - SHARP_REFLECTION_ROUGHNESS)))
        .clamp(0.0, 1.0);
    // Smoothstep: 1 up to the lower roughness, 0 from the upper one on.
    (x * x) * (3.0 - 2.0 * x)
}

/// Fresnel reflectance of a dielectric for unpolarised light; 1 under total internal reflection. `eta` is the index of
/// refraction of the side that the light comes from over that of the other side, 0 for an infinite one; `cosine` is
/// that of the angle of incidence.
pub(crate) fn fresnel_dielectric(cosine: f32, eta: f32) -> f32 {
    let cosine_transmitted = refracted_cosine(cosine, eta);
    // Total internal reflection, and an infinite index on the other side, reflect everything.
    if cosine_transmitted <= 0.0 || eta <= 0.0 {
        return 1.0;
    }
    // Average the reflectances of the two polarisations.
    let perpendicular = (eta * cosine - cosine_transmitted) / (eta * cosine + cosine_transmitted);
    let parallel = (cosine - eta * cosine_transmitted) / (cosine + eta * cosine_transmitted);
    0.5 * (perpendicular * perpendicular + parallel * parallel)
}

/// The cosine of the angle of refraction (Snell's law), or 0 where reflection is total.
pub(crate) fn refracted_cosine(cosine: f32, eta: f32) -> f32 {
    // 1 - eta^2 sin^2, without the cancellation at eta = 1.
    max((1.0 - eta) * (1.0 + eta) + (eta * cosine) * (eta * cosine), 0.0).sqrt()
}

/// (1 - cosine)^5: Schlick's approximation of the rise of reflectance toward grazing angles.
fn schlick(cosine: f32) -> f32 {
    let x = (1.0 - cosine).clamp(0.0, 1.0);
    let square = x * x;
    (square * square) * x
}

/// Factor on Schlick's grazing term for rough surfaces; a fit to the directional albedo of GGX.
fn grazing_rise(roughness: f32) -> f32 {
    1.0 - roughness * (0.1 + 0.86 * roughness)
}

/// Weights of the three lobes for the view direction; with absorption they sum to 1.
pub(crate) struct LobeWeights {
    /// Specular reflection.
    pub specular_reflection: Vec3,
    /// Specular transmission.
    pub specular_transmission: Vec3,
    /// Diffuse reflection.
    pub diffuse: Vec3,
}

/// `eta` is as in [`fresnel_dielectric`].
pub(crate) fn lobe_weights(surface: &Surface, cosine: f32, eta: f32) -> LobeWeights {
    let base_color = surface.base_color.xyz();
    // Fresnel reflectance as a metal and as a dielectric.
    let rise = grazing_rise(surface.roughness);
    let metal = mix3(base_color, Vec3::ONE, schlick(cosine) * rise);
    let mut dielectric = fresnel_dielectric(cosine, eta);
    // Rough surfaces rise less toward grazing angles; total reflection stays total.
    if dielectric < 1.0 {
        let normal_incidence = f0_from_ior(surface.ior);
        dielectric = normal_incidence + (dielectric - normal_incidence) * rise;
    }
    // What is not reflected is transmitted or reflected diffusely.
    let entering = (1.0 - surface.metallic) * (1.0 - dielectric);
    LobeWeights {
        specular_reflection: mix3(Vec3::splat(dielectric), metal, surface.metallic),
        specular_transmission: surface.tint * (entering * surface.transmission),
        diffuse: base_color * (entering * (1.0 - surface.transmission)),
    }
}

/// BRDF times the light's cosine (glTF 2.0 appendix B). All unit vectors.
///
/// The model is glTF's but for one thing: the diffuse lobe is also reduced by the specular reflectance toward the
/// viewer. glTF's example weighs the diffuse lobe by the Fresnel term of the half-way vector alone, and so reflects up
/// to 1.29 of the light at grazing angles.
pub(crate) fn evaluate_brdf(surface: &Surface, to_viewer: Vec3, to_light: Vec3) -> Vec3 {
    // A light below the shading horizon contributes nothing.
    let n_l = dot3(surface.normal, to_light);
    if n_l <= 0.0 {
        return Vec3::ZERO;
    }
    // Find the half-way vector and the cosines that the lobes need.
    let n_v = max(dot3(surface.normal, to_viewer), MIN_COSINE);
    let half_way = normalize_or(to_viewer + to_light, surface.normal);
    let n_h = dot3(surface.normal, half_way).clamp(0.0, 1.0);
    let schlick_weight = schlick(dot3(to_viewer, half_way));

    // Fresnel reflectance of the microfacets.
    let f0 = f0_from_ior(surface.ior);
    let dielectric = f0 + (1.0 - f0) * schlick_weight;
    let metal = mix3(surface.base_color.xyz(), Vec3::ONE, schlick_weight);
    let fresnel = mix3(Vec3::splat(dielectric), metal, surface.metallic);
    // Diffuse energy left.
    let towards_viewer = f0 + (1.0 - f0) * (schlick(n_v) * grazing_rise(surface.roughness));
    let diffuse = (1.0 - surface.metallic) * (1.0 - max(dielectric, towards_viewer)) * (1.0 - surface.transmission);

    // GGX specular.
    let roughness = max(surface.roughness, MIN_HIGHLIGHT_ROUGHNESS);
    let specular = fresnel * ggx_specular(n_l, n_v, n_h, roughness * roughness);
    // Add the Lambertian lobe, and weigh both by the light's cosine.
    (surface.base_color.xyz() * (diffuse / PI) + specular) * n_l
}

/// GGX's distribution times Smith's height-correlated visibility.
fn ggx_specular(n_l: f32, n_v: f32, n_h: f32, alpha: f32) -> f32 {
    let alpha_squared = alpha * alpha;
    // n_h^2 (alpha_squared - 1) + 1, without the cancellation at n_h = 1.
    let spread = (1.0 - n_h * n_h) + (n_h * n_h) * alpha_squared;
    let distribution = alpha_squared / (PI * spread * spread);
    // Smith's visibility, the masking of both directions correlated.
    let light_side = n_l * (n_v * n_v * (1.0 - alpha_squared) + alpha_squared).sqrt();
    let viewer_side = n_v * (n_l * n_l * (1.0 - alpha_squared) + alpha_squared).sqrt();
    distribution * (0.5 / (light_side + viewer_side))
}

#[cfg(test)]
mod tests {
    use glam::Vec4;

    use super::*;
    use crate::device::layout::MaterialFlags;

    fn surface(base_color: f32, metallic: f32, roughness: f32) -> Surface {
        Surface {
            position: Vec3::ZERO,
            geometric_normal: Vec3::Z,
            normal: Vec3::Z,
            ray_offset: 0.0,
            base_color: Vec4::splat(base_color),
            emissive: Vec3::ZERO,
            metallic,
            roughness,
            transmission: 0.0,
            ior: 1.5,
            flags: MaterialFlags::empty(),
            tint: Vec3::ONE,
            thin: false,
            is_inside: false,
        }
    }

    /// Fresnel's sine and tangent laws, and their limit at normal incidence, in f64.
    fn fresnel_by_angles(angle: f64, eta: f64) -> f64 {
        let sine = angle.sin() * eta;
        // Total internal reflection has no angle of refraction.
        if sine >= 1.0 {
            return 1.0;
        }
        let refracted = sine.asin();
        // At normal incidence the two laws are 0/0: use their limit.
        if angle < 1e-6 {
            return ((1.0 - eta) / (1.0 + eta)).powi(2);
        }
        let (difference, sum) = (angle - refracted, angle + refracted);
        let perpendicular = difference.sin() / sum.sin();
        let parallel = difference.tan() / sum.tan();
        0.5 * (perpendicular * perpendicular + parallel * parallel)
    }

    #[test]
    fn fresnel_is_the_closed_form() {
        let mut total = 0;
        for eta in [1.0 / 1.5, 1.5, 1.0 / 1.33, 1.33, 1.0 / 2.4, 2.4, 1.0] {
            for step in 0..=1000 {
                let angle = f64::from(step) * 1e-3 * 1.57;
                let cosine = angle.cos() as f32;
                // The angle that the f32 cosine stands for, and one ulp of cosine around it: total reflection begins
                // steeply.
                let expected = |cosine: f32| fresnel_by_angles(f64::from(cosine).acos(), f64::from(eta as f32));
                let (a, b) = (expected(cosine * (1.0 - 4e-7)), expected((cosine * (1.0 + 4e-7)).min(1.0)));
                let found = f64::from(fresnel_dielectric(cosine, eta as f32));
                assert!(
                    found >= a.min(b) - 2e-6 && found <= a.max(b) + 2e-6,
                    "eta {eta}, angle {angle}: {found}, expected {a} to {b}"
                );
                total += u32::from(found == 1.0);
            }
        }
        assert!(total > 100, "{total} cases of total reflection");
        assert_eq!(fresnel_dielectric(0.5, 0.0), 1.0, "an infinite index reflects all");
    }

    #[test]
    fn refraction_obeys_snell() {
        for eta in [1.0 / 1.5, 1.5, 1.0 / 2.4, 2.4] {
            for step in 1..500 {
                let angle = f64::from(step) * 1e-3 * std::f64::consts::PI;
                let sine = angle.sin() * eta;
                if sine < 0.999 {
                    let found = f64::from(refracted_cosine(angle.cos().abs() as f32, eta as f32));
                    let expected = sine.asin().cos();
                    assert!((found - expected).abs() < 3e-6, "eta {eta}, angle {angle}: {found}, expected {expected}");
                }
            }
        }
    }

    /// The part of light from all around that a surface reflects to the viewer: by reciprocity also the part of a beam
    /// from there that it reflects at all. Midpoint rule over cosine and azimuth.
    fn reflected_part(surface: &Surface, to_viewer: Vec3) -> f64 {
        let (rows, columns) = (1000, 500);
        let mut sum = 0.0;
        for i in 0..rows {
            let z = (f64::from(i) + 0.5) / f64::from(rows);
            let radius = (1.0 - z * z).sqrt();
            for j in 0..columns {
                let azimuth = (f64::from(j) + 0.5) / f64::from(columns) * std::f64::consts::TAU;
                let to_light = Vec3::new((radius * azimuth.cos()) as f32, (radius * azimuth.sin()) as f32, z as f32);
                sum += f64::from(evaluate_brdf(surface, to_viewer, to_light).x);
            }
        }
        sum * std::f64::consts::TAU / f64::from(rows * columns)
    }

    #[test]
    fn no_surface_reflects_more_than_it_gets() {
        for metallic in [0.0, 0.5, 1.0] {
            for roughness in [0.2, 0.3, 0.5, 0.8, 1.0] {
                for cosine in [1.0f32, 0.7, 0.5, 0.3, 0.1, 0.03] {
                    let to_viewer = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
                    let part = reflected_part(&surface(1.0, metallic, roughness), to_viewer);
                    // Half a percent: the fit of `grazing_rise`.
                    assert!(part <= 1.005, "metallic {metallic}, roughness {roughness}, cosine {cosine}: {part}");
                    assert!(part > 0.3, "metallic {metallic}, roughness {roughness}, cosine {cosine}: {part}");
                }
            }
        }
        // A smooth metal loses nothing to multiple scattering, which the model leaves out.
        let part = reflected_part(&surface(1.0, 1.0, 0.3), Vec3::Z);
        assert!((part - 1.0).abs() < 0.02, "{part}");
    }

    #[test]
    fn shares_add_up() {
        for (metallic, roughness) in [(0.0, 0.0), (0.0, 0.7), (1.0, 0.0), (1.0, 1.0), (0.4, 0.3)] {
            for cosine in [1.0, 0.5, 0.1, 1e-3] {
                for (transmission, eta) in [(0.0, 1.0 / 1.5), (0.6, 1.0 / 1.5), (1.0, 1.5)] {
                    let white = Surface { transmission, ..surface(1.0, metallic, roughness) };
                    let LobeWeights { specular_reflection: mirrored, specular_transmission: refracted, diffuse } =
                        lobe_weights(&white, cosine, eta);
                    let sum = mirrored + refracted + diffuse;
                    assert!((sum - Vec3::ONE).abs().max_element() < 1e-6, "{metallic} {roughness} {cosine} {sum}");
                    assert!(mirrored.min(refracted).min(diffuse).min_element() >= 0.0);
                }
            }
        }
    }

    #[test]
    fn sharpness_falls_from_mirror_to_blurred() {
        assert_eq!(traced_reflection_share(0.0), 1.0);
        assert_eq!(traced_reflection_share(SHARP_REFLECTION_ROUGHNESS), 1.0);
        assert_eq!(traced_reflection_share(MAX_MIRROR_ROUGHNESS), 0.0);
        assert_eq!(traced_reflection_share(1.0), 0.0);
        let falls = (0..100)
            .all(|i| traced_reflection_share(i as f32 * 0.01) >= traced_reflection_share((i + 1) as f32 * 0.01));
        assert!(falls);
    }
}
