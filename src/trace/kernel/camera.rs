//! Camera rays, through pixel centres. Twin of `shaders/shared/camera.wgsl`.

use glam::Vec3;

use super::math::normalize3;
use crate::device::layout::{FrameParams, RayRecord};

/// The primary ray of a pixel; (0, 0) is the upper left one. Its direction is a unit vector.
pub(crate) fn camera_ray(params: &FrameParams, x: u32, y: u32) -> RayRecord {
    let [eye, right, up, forward] = [params.eye, params.right, params.up, params.forward].map(Vec3::from_array);
    // Find the pixel's centre in normalised device coordinates, y up.
    let ndc_x = (x as f32 + 0.5) / params.width as f32 * 2.0 - 1.0;
    let ndc_y = 1.0 - (y as f32 + 0.5) / params.height as f32 * 2.0;
    let in_plane = right * ndc_x + up * ndc_y;
    // Orthographic rays are parallel, perspective ones start at the eye.
    let (origin, direction) =
        if params.orthographic != 0 { (eye + in_plane, forward) } else { (eye, normalize3(forward + in_plane)) };
    RayRecord { origin: origin.to_array(), t_min: params.near, direction: direction.to_array(), t_max: f32::MAX }
}
