//! The sky: radiance that changes with the sine of the elevation, linearly from the horizon up to the zenith and down
//! to the ground. Twin of `shaders/shared/sky.wgsl`.

use glam::Vec3;

use super::math::{dot3, max, mix3};
use crate::device::layout::FrameParams;

/// Polynomial coefficients in the even powers of the sine of the elevation in [`cosine_product_integral`].
pub(super) const COSINE_INTEGRAL_6: f32 = 0.012_317_886;
pub(super) const COSINE_INTEGRAL_4: f32 = 0.000_506_380_14;
pub(super) const COSINE_INTEGRAL_2: f32 = 0.107_993_014;
pub(super) const COSINE_INTEGRAL_0: f32 = 0.212_146_21;

pub(crate) fn sky_radiance(params: &FrameParams, direction: Vec3) -> Vec3 {
    let sine_elevation = dot3(direction, Vec3::from_array(params.sky_up)).clamp(-1.0, 1.0);
    sky_gradient(params, max(sine_elevation, 0.0), max(-sine_elevation, 0.0))
}

/// Radiance of a white diffuse surface lit by the whole sky (irradiance / pi).
pub(crate) fn sky_irradiance_over_pi(params: &FrameParams, normal: Vec3) -> Vec3 {
    let sine_elevation = dot3(normal, Vec3::from_array(params.sky_up)).clamp(-1.0, 1.0);
    sky_gradient(params, cosine_product_integral(sine_elevation), cosine_product_integral(-sine_elevation))
}

/// The sky as reflected by a rough surface. Approximates the specular lobe by a blend of the mirror direction and a
/// cosine lobe.
pub(crate) fn sky_blurred(params: &FrameParams, direction: Vec3, roughness: f32) -> Vec3 {
    mix3(sky_radiance(params, direction), sky_irradiance_over_pi(params, direction), roughness * roughness)
}

fn sky_gradient(params: &FrameParams, up: f32, down: f32) -> Vec3 {
    let [zenith, horizon, ground] = [params.sky_zenith, params.sky_horizon, params.sky_ground].map(Vec3::from_array);
    let towards_zenith = (zenith - horizon) * up;
    let towards_ground = (ground - horizon) * down;
    horizon + (towards_zenith + towards_ground)
}

/// The integral over all directions w of max(w.n, 0) max(w.up, 0) / pi with n.up = `sine_elevation`. In closed form 2 /
/// (3 pi) (sqrt(1 - h^2) + h (pi - acos h)), h being that sine: h / 3 and an even function, here a Chebyshev fit to
/// 4e-4.
fn cosine_product_integral(sine_elevation: f32) -> f32 {
    let square = sine_elevation * sine_elevation;
    let even =
        ((COSINE_INTEGRAL_6 * square + COSINE_INTEGRAL_4) * square + COSINE_INTEGRAL_2) * square + COSINE_INTEGRAL_0;
    max(sine_elevation * (1.0 / 3.0) + even, 0.0)
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;

    use super::*;

    fn params() -> FrameParams {
        FrameParams {
            sky_zenith: [0.1, 0.5, 3.0],
            sky_horizon: [0.8, 0.7, 0.6],
            sky_ground: [0.3, 0.2, 0.0],
            sky_up: Vec3::new(1.0, 2.0, -0.5).normalize().to_array(),
            ..FrameParams::zeroed()
        }
    }

    /// Irradiance over pi by summing radiance over the sphere, midpoint rule.
    fn ambient_by_sum(params: &FrameParams, normal: Vec3) -> Vec3 {
        let (rows, columns) = (400, 400);
        let mut sum = glam::DVec3::ZERO;
        for i in 0..rows {
            let z = (f64::from(i) + 0.5) / f64::from(rows) * 2.0 - 1.0;
            for j in 0..columns {
                let azimuth = (f64::from(j) + 0.5) / f64::from(columns) * std::f64::consts::TAU;
                let radius = (1.0 - z * z).sqrt();
                let direction = Vec3::new((radius * azimuth.cos()) as f32, (radius * azimuth.sin()) as f32, z as f32);
                sum += (sky_radiance(params, direction) * direction.dot(normal).max(0.0)).as_dvec3();
            }
        }
        (sum * 4.0 / f64::from(rows * columns)).as_vec3()
    }

    #[test]
    fn ambient_light_is_the_integral_of_the_sky() {
        let params = params();
        for normal in [Vec3::X, Vec3::Y, -Vec3::Y, Vec3::new(2.0, -1.0, 1.0).normalize(), params.sky_up.into()] {
            let (found, expected) = (sky_irradiance_over_pi(&params, normal), ambient_by_sum(&params, normal));
            let error = (found - expected).abs().max_element();
            assert!(error < 2e-3, "{normal}: {found}, expected {expected}");
        }
    }

    #[test]
    fn a_uniform_sky_is_uniform_however_blurred() {
        let params = FrameParams { sky_zenith: [0.7; 3], sky_horizon: [0.7; 3], sky_ground: [0.7; 3], ..params() };
        for direction in [Vec3::X, Vec3::Y, Vec3::NEG_ONE.normalize()] {
            for roughness in [0.0, 0.3, 1.0] {
                assert_eq!(sky_radiance(&params, direction), Vec3::splat(0.7));
                assert!((sky_blurred(&params, direction, roughness) - Vec3::splat(0.7)).abs().max_element() < 1e-6);
            }
        }
    }
}
