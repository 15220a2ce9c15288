//! The sky: radiance that changes with the sine of the elevation, linearly from the horizon up to the zenith and down to
//! the ground. Twin of `shaders/shared/sky.wgsl`.

use glam::Vec3;

use super::math::{dot3, max, mix3};
use crate::device::layout::FrameParams;

pub(crate) fn sky_radiance(params: &FrameParams, direction: Vec3) -> Vec3 {
    let height = dot3(direction, Vec3::from_array(params.sky_up)).clamp(-1.0, 1.0);
    sky_mix(params, max(height, 0.0), max(-height, 0.0))
}

/// What a white, matt surface reflects under the whole sky: irradiance over pi.
pub(crate) fn sky_ambient(params: &FrameParams, normal: Vec3) -> Vec3 {
    let height = dot3(normal, Vec3::from_array(params.sky_up)).clamp(-1.0, 1.0);
    sky_mix(params, cosine_overlap(height), cosine_overlap(-height))
}

/// The sky as a rough surface mirrors it: between the radiance and the ambient light. Approximate: GGX is no cosine lobe.
pub(crate) fn sky_blurred(params: &FrameParams, direction: Vec3, roughness: f32) -> Vec3 {
    mix3(sky_radiance(params, direction), sky_ambient(params, direction), roughness * roughness)
}

fn sky_mix(params: &FrameParams, up: f32, down: f32) -> Vec3 {
    let [zenith, horizon, ground] = [params.sky_zenith, params.sky_horizon, params.sky_ground].map(Vec3::from_array);
    let towards_zenith = (zenith - horizon) * up;
    let towards_ground = (ground - horizon) * down;
    horizon + (towards_zenith + towards_ground)
}

/// The integral over all directions w of max(w.n, 0) max(w.up, 0) / pi with n.up = `height`. In closed form
/// 2 / (3 pi) (sqrt(1 - h^2) + h (pi - acos h)): h / 3 and an even function, here a Chebyshev fit to 4e-4.
fn cosine_overlap(height: f32) -> f32 {
    let square = height * height;
    let even = ((0.012_317_886 * square + 0.000_506_380_14) * square + 0.107_993_01) * square + 0.212_146_21;
    max(height * (1.0 / 3.0) + even, 0.0)
}
