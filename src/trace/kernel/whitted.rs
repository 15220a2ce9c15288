//! Stub: colours what the primary ray hits.

use glam::{Vec3, Vec4};

use super::{KernelScene, closest_hit, transmittance};
use crate::device::layout::{FrameParams, NONE, Ray};

/// What a primary ray brings back.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pixel {
    pub color: Vec4,
    pub normal: Vec3,
    /// `f32::MAX` where nothing was met.
    pub depth: f32,
    /// Node (slot, version), primitive, instance.
    pub ids: [u32; 4],
}

impl Pixel {
    /// Nothing was met.
    pub(crate) const NOTHING: Self =
        Self { color: Vec4::ZERO, normal: Vec3::ZERO, depth: f32::MAX, ids: [NONE, 1, NONE, NONE] };
}

pub(crate) fn render_pixel(scene: &KernelScene<'_>, params: &FrameParams, x: u32, y: u32) -> Pixel {
    let sx = (x as f32 + 0.5) / params.width as f32 * 2.0 - 1.0;
    let sy = 1.0 - (y as f32 + 0.5) / params.height as f32 * 2.0;
    let offset = Vec3::from_array(params.right) * sx + Vec3::from_array(params.up) * sy;
    let (eye, forward) = (Vec3::from_array(params.eye), Vec3::from_array(params.forward));
    let (origin, direction) = if params.orthographic != 0 { (eye + offset, forward) } else { (eye, forward + offset) };
    let ray = Ray { origin: origin.to_array(), t_min: 0.0, direction: direction.to_array(), t_max: f32::MAX };
    let hit = closest_hit(scene, &ray, params.ray_mask);
    if hit.instance == NONE {
        return Pixel::NOTHING;
    }
    let behind = transmittance(scene, &Ray { t_min: hit.t * 1.001, ..ray }, params.ray_mask);
    let color = Vec3::new(hit.u, hit.v, 1.0 - hit.u - hit.v) * (Vec3::splat(0.5) + 0.5 * behind);
    let [slot, version] = scene.instances[hit.instance as usize].node;
    let ids = [slot, version, hit.primitive, hit.instance];
    Pixel { color: color.extend(1.0), normal: Vec3::ZERO, depth: hit.t, ids }
}
