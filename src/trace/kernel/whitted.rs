//! One pixel: T. Whitted's recursion (*An Improved Illumination Model for Shaded Display*, 1980) as a loop over rays that
//! wait. Twin of `shaders/shared/whitted.wgsl`.
//!
//! What is approximate:
//! - A ray too deep ([`FrameParams::max_depth`], at most [`MAX_DEPTH`]), behind too many blended layers ([`MAX_LAYERS`]), or
//!   carrying too little ([`MIN_THROUGHPUT`]) sees the sky instead of the scene; so do the rays after the first [`MAX_RAYS`] of
//!   a pixel. The energy stays right: under a uniform sky nothing changes.
//! - The sky's light is not shadowed: there is no ambient occlusion.
//! - Rough surfaces mirror the scene sharply where they are nearly polished, and a blurred sky where they are not; in between
//!   the two are mixed. Rough glass transmits as sharply as polished glass.
//! - A transmissive surface that encloses something is the skin of a solid and bends light by its index of refraction; any
//!   other ([`THIN`](crate::device::layout::InstanceFlags::THIN), which the compiler finds out) is a pane and lets it pass
//!   straight. `KHR_materials_transmission` alone means thin walls everywhere, but then a glass sphere would look like a soap
//!   bubble. Which side is inside follows from the winding; solids within solids are each refracted against air. A solid is
//!   tinted by its base colour once, by the square root at each crossing.

use glam::{Vec3, Vec4, Vec4Swizzles as _};

use super::brdf::{divide_light, refracted_cosine, sharpness};
use super::intersect::max_component;
use super::light::direct_light;
use super::math::dot3;
use super::offset::leave;
use super::sky::{sky_ambient, sky_blurred, sky_radiance};
use super::surface::{Surface, raise, surface_at, unit_or};
use super::traverse::Traverse;
#[cfg(feature = "gpu")]
use crate::compile::Needs;
use crate::device::layout::{FrameParams, Hit, MaterialFlags, NONE, Ray};

/// The most reflections and refractions of a path, whatever `max_depth` says: [`View::MAX_DEPTH`](crate::View::MAX_DEPTH).
pub(crate) const MAX_DEPTH: u32 = 8;
/// The most blended surfaces that a path goes through between two of those.
pub(super) const MAX_LAYERS: u32 = 32;
/// The most rays of a pixel, shadow rays not counted.
pub(super) const MAX_RAYS: u32 = 256;
/// A ray that carries less cannot change an 8-bit pixel by seeing radiance up to 1: half the smallest sRGB step is
/// 0.5 / 255 / 12.92 = 1.24 * 2^-13.
pub(super) const MIN_THROUGHPUT: f32 = 1.0 / (1 << 13) as f32;
/// A level of depth leaves at most two rays waiting, one for what lies behind alpha and one of the refracted and the
/// mirrored; one more is the ray to be traced next.
///
/// In WGSL, where memory is dear, 1, 9 or 17 by what the scene needs. Here always 17: what is not needed never waits.
pub(super) const MAX_PENDING: usize = 1 + 2 * MAX_DEPTH as usize;

/// The most rays that a pixel can need, shadow rays not counted: how much work a dispatch may be.
#[cfg(feature = "gpu")]
pub(crate) fn most_rays(max_depth: u32, needs: Needs) -> u32 {
    let depth = max_depth.min(MAX_DEPTH);
    match [Needs::BLEND, Needs::REFLECTION, Needs::REFRACTION].map(|need| needs.contains(need)) {
        [true, ..] => MAX_RAYS,
        [false, true, true] => ((2 << depth) - 1).min(MAX_RAYS),
        [false, false, false] => 1,
        [false, ..] => 1 + depth,
    }
}

/// What a primary ray brings back.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pixel {
    /// Linear radiance, and 1: the sky is part of the image.
    pub color: Vec4,
    /// Unit shading normal, towards the camera; zero where nothing was met.
    pub normal: Vec3,
    /// Distance from the camera, or `f32::MAX` where nothing was met.
    pub depth: f32,
    /// Node slot, node version, primitive, instance; [`NONE`] (version 1: the null key) where nothing was met.
    pub ids: [u32; 4],
}

impl Pixel {
    /// Nothing was met.
    pub(crate) const NOTHING: Self =
        Self { color: Vec4::ZERO, normal: Vec3::ZERO, depth: f32::MAX, ids: [NONE, 1, NONE, NONE] };
}

#[derive(Clone, Copy)]
struct PendingRay {
    origin: Vec3,
    depth: u32,
    direction: Vec3,
    layers: u32,
    /// The part of what it sees that reaches the camera.
    throughput: Vec3,
}

struct Paths {
    color: Vec3,
    pending_count: usize,
    pending: [PendingRay; MAX_PENDING],
}

/// `primary` goes through the pixel and hits `hit`: neighbours find that out together.
pub(crate) fn render_pixel<'a>(rays: &mut impl Traverse<'a>, params: &FrameParams, primary: &Ray, hit: Hit) -> Pixel {
    let mut pixel = Pixel::NOTHING;
    let [origin, direction] = [primary.origin, primary.direction].map(Vec3::from_array);
    let first = PendingRay { origin, depth: 0, direction, layers: 0, throughput: Vec3::ONE };
    let mut paths = Paths { color: Vec3::ZERO, pending_count: 1, pending: [first; MAX_PENDING] };
    let mut traced = 0;
    while traced < MAX_RAYS && paths.pending_count > 0 {
        paths.pending_count -= 1;
        let ray = paths.pending[paths.pending_count];
        let world_ray =
            Ray { origin: ray.origin.to_array(), t_min: 0.0, direction: ray.direction.to_array(), t_max: f32::MAX };
        let hit = if traced == 0 { hit } else { rays.closest_hit(&world_ray, params.ray_mask) };
        if hit.instance == NONE {
            paths.color += ray.throughput * sky_radiance(params, ray.direction);
        } else {
            let surface = surface_at(rays.scene(), &hit, ray.direction);
            if traced == 0 {
                let [slot, version] = rays.scene().instances[hit.instance as usize].node;
                pixel.normal = surface.normal;
                pixel.depth = hit.t;
                pixel.ids = [slot, version, hit.primitive, hit.instance];
            }
            shade(rays, params, &mut paths, &ray, &surface);
        }
        traced += 1;
    }
    // Rays beyond the limit see the sky.
    for ray in &paths.pending[..paths.pending_count] {
        paths.color += ray.throughput * sky_radiance(params, ray.direction);
    }
    pixel.color = paths.color.extend(1.0);
    pixel
}

/// Adds what the surface sends back along the ray, and the rays that must be traced to know the rest. What lies behind a
/// blended surface comes last, so that nothing of this surface waits while it is traced: see [`MAX_PENDING`].
fn shade<'a>(
    rays: &mut impl Traverse<'a>,
    params: &FrameParams,
    paths: &mut Paths,
    ray: &PendingRay,
    surface: &Surface,
) {
    // 1. Alpha divides the light between what lies behind and the surface.
    let mut throughput = ray.throughput;
    if surface.flags.contains(MaterialFlags::BLEND) {
        let alpha = surface.base_color.w;
        let origin = leave(surface, ray.direction);
        let behind = PendingRay { origin, layers: ray.layers + 1, throughput: throughput * (1.0 - alpha), ..*ray };
        follow(params, paths, behind);
        throughput *= alpha;
    }
    if surface.flags.contains(MaterialFlags::UNLIT) {
        paths.color += throughput * surface.base_color.xyz();
        return;
    }

    // 2. Light from the surface itself, from lights, and from the sky.
    let to_viewer = -ray.direction;
    let cosine = dot3(surface.normal, to_viewer);
    let eta = eta_at(surface);
    let shares = divide_light(surface, cosine, eta);
    let mirrored = raise(surface.normal * (2.0 * cosine) - to_viewer, surface.geometric_normal);
    let sharp = sharpness(surface.roughness);
    let mut radiance = surface.emissive + shares.matt * sky_ambient(params, surface.normal);
    radiance += shares.mirrored * (sky_blurred(params, mirrored, surface.roughness) * (1.0 - sharp));
    radiance += direct_light(rays, params, surface, to_viewer);
    paths.color += throughput * radiance;

    // 3. Light through the surface, and light mirrored by it.
    let depth = ray.depth + 1;
    if surface.transmission > 0.0 {
        let direction = refracted_direction(surface, ray.direction, cosine, eta);
        let origin = leave(surface, direction);
        let throughput = throughput * shares.refracted;
        follow(params, paths, PendingRay { origin, depth, direction, layers: 0, throughput });
    }
    if sharp > 0.0 {
        let origin = leave(surface, mirrored);
        let throughput = throughput * (shares.mirrored * sharp);
        follow(params, paths, PendingRay { origin, depth, direction: mirrored, layers: 0, throughput });
    }
}

/// Lets a ray wait to be traced; one that is too deep or carries too little sees the sky at once.
fn follow(params: &FrameParams, paths: &mut Paths, ray: PendingRay) {
    let is_deep = ray.depth > params.max_depth.min(MAX_DEPTH) || ray.layers > MAX_LAYERS;
    let count = paths.pending_count;
    if is_deep || max_component(ray.throughput) < MIN_THROUGHPUT || count == MAX_PENDING {
        paths.color += ray.throughput * sky_radiance(params, ray.direction);
        return;
    }
    paths.pending[count] = ray;
    paths.pending_count = count + 1;
}

/// Index of refraction of the viewer's side over that of the other, 0 where that is infinite.
fn eta_at(surface: &Surface) -> f32 {
    if surface.inside || surface.ior <= 0.0 {
        return surface.ior;
    }
    1.0 / surface.ior
}

/// Where a ray goes on behind the surface: bent by Snell's law, or straight through a thin one.
fn refracted_direction(surface: &Surface, direction: Vec3, cosine: f32, eta: f32) -> Vec3 {
    if surface.thin {
        return direction;
    }
    let bent = direction * eta + surface.normal * (eta * cosine - refracted_cosine(cosine, eta));
    raise(unit_or(bent, direction), -surface.geometric_normal)
}
