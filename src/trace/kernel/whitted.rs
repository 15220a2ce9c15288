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

use super::KernelScene;
use super::brdf::{lobe_weights, refracted_cosine, traced_reflection_share};
use super::intersect::max_component;
use super::light::{LightSample, sample_light};
use super::math::dot3;
use super::offset::offset_ray_origin;
use super::sky::{sky_blurred, sky_irradiance_over_pi, sky_radiance};
use super::surface::{Surface, clamp_cosine, normalize_or, surface_at};
use super::traverse::RayQueries;
#[cfg(feature = "gpu")]
use crate::device::Needs;
use crate::device::layout::{FrameParams, HitRecord, LightRecord, MaterialFlags, NONE, RayRecord};

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
pub(crate) fn max_rays_per_pixel(max_depth: u32, needs: Needs) -> u32 {
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
    pub distance: f32,
    /// Node slot, node version, primitive, instance; [`NONE`] (version 1: the null key) where nothing was met.
    pub ids: [u32; 4],
}

impl Pixel {
    /// Nothing was met.
    pub(crate) const MISS: Self =
        Self { color: Vec4::ZERO, normal: Vec3::ZERO, distance: f32::MAX, ids: [NONE, 1, NONE, NONE] };
}

#[derive(Clone, Copy)]
struct PendingRay {
    origin: Vec3,
    bounces: u32,
    direction: Vec3,
    layers: u32,
    /// The part of what it sees that reaches the camera.
    throughput: Vec3,
}

/// A pixel that is being rendered: what it has seen so far, and the rays that wait.
pub(crate) struct RayTree {
    pixel: Pixel,
    color: Vec3,
    /// Rays that have been traced.
    traced_rays: u32,
    pending_count: usize,
    /// The ray that is being traced is kept behind those that wait.
    pending: [PendingRay; MAX_PENDING],
}

/// A surface that a ray of a path has met.
pub(crate) struct SurfaceHit {
    ray: PendingRay,
    surface: Surface,
}

impl SurfaceHit {
    /// `None` where nothing of that light goes back along the ray.
    pub(crate) fn light_sample(&self, light: &LightRecord) -> Option<LightSample> {
        if self.surface.flags.contains(MaterialFlags::UNLIT) {
            return None;
        }
        sample_light(light, &self.surface, -self.ray.direction)
    }
}

/// `primary` goes through the pixel.
pub(crate) fn render_pixel<'a>(rays: &mut impl RayQueries<'a>, params: &FrameParams, primary: &RayRecord) -> Pixel {
    let mut path = RayTree::default();
    path.reset(primary);
    let scene = rays.scene();
    while let Some(ray) = path.next_ray() {
        let hit = rays.closest_hit(&ray, params.ray_mask);
        let Some(met) = path.record_hit(scene, params, &hit) else { continue };
        let lit = active_lights(scene, params).iter().filter_map(|light| met.light_sample(light));
        let light = lit.fold(Vec3::ZERO, |sum, lit| sum + lit.radiance(rays.transmittance(&lit.ray, params.ray_mask)));
        path.shade(params, &met, light);
    }
    path.finish(params)
}

/// The lights that are on.
pub(crate) fn active_lights<'a>(scene: &KernelScene<'a>, params: &FrameParams) -> &'a [LightRecord] {
    &scene.lights[..scene.lights.len().min(params.light_count as usize)]
}

impl Default for RayTree {
    /// Nothing is to be traced.
    fn default() -> Self {
        let nowhere =
            PendingRay { origin: Vec3::ZERO, bounces: 0, direction: Vec3::ZERO, layers: 0, throughput: Vec3::ZERO };
        Self {
            pixel: Pixel::MISS,
            color: Vec3::ZERO,
            traced_rays: 0,
            pending_count: 0,
            pending: [nowhere; MAX_PENDING],
        }
    }
}

impl RayTree {
    /// Forgets all and begins with a ray through the pixel.
    pub(crate) fn reset(&mut self, primary: &RayRecord) {
        let [origin, direction] = [primary.origin, primary.direction].map(Vec3::from_array);
        (self.pixel, self.color, self.traced_rays) = (Pixel::MISS, Vec3::ZERO, 0);
        self.pending[0] = PendingRay { origin, bounces: 0, direction, layers: 0, throughput: Vec3::ONE };
        self.pending_count = 1;
    }

    /// The ray that is to be traced now; then [`record_hit`](Self::record_hit) is told what it hits, and where that is a surface,
    /// [`shade`](Self::shade) what light it gets. None where nothing is to be traced any more.
    pub(crate) fn next_ray(&mut self) -> Option<RayRecord> {
        if self.traced_rays == MAX_RAYS {
            return None;
        }
        self.pending_count = self.pending_count.checked_sub(1)?;
        let PendingRay { origin, direction, .. } = self.pending[self.pending_count];
        Some(RayRecord { origin: origin.to_array(), t_min: 0.0, direction: direction.to_array(), t_max: f32::MAX })
    }

    /// The ray has hit that: either the sky, which is seen at once, or a surface.
    pub(crate) fn record_hit(
        &mut self,
        scene: &KernelScene<'_>,
        params: &FrameParams,
        hit: &HitRecord,
    ) -> Option<SurfaceHit> {
        let ray = self.pending[self.pending_count];
        self.traced_rays += 1;
        if hit.instance == NONE {
            self.color += ray.throughput * sky_radiance(params, ray.direction);
            return None;
        }
        let surface = surface_at(scene, hit, ray.direction);
        if self.traced_rays == 1 {
            let [slot, version] = scene.instances[hit.instance as usize].node_key;
            self.pixel.normal = surface.normal;
            self.pixel.distance = hit.t;
            self.pixel.ids = [slot, version, hit.primitive, hit.instance];
        }
        Some(SurfaceHit { ray, surface })
    }

    /// Adds what the surface sends back along the ray, `light` of it from lights, and the rays that must be traced to know the
    /// rest. What lies behind a blended surface comes last, so that nothing of this surface waits while it is traced: see
    /// [`MAX_PENDING`].
    pub(crate) fn shade(&mut self, params: &FrameParams, SurfaceHit { ray, surface }: &SurfaceHit, light: Vec3) {
        // 1. Alpha divides the light between what lies behind and the surface.
        let mut throughput = ray.throughput;
        if surface.flags.contains(MaterialFlags::BLEND) {
            let alpha = surface.base_color.w;
            let origin = offset_ray_origin(surface, ray.direction);
            let behind = PendingRay { origin, layers: ray.layers + 1, throughput: throughput * (1.0 - alpha), ..*ray };
            self.push_ray(params, behind);
            throughput *= alpha;
        }
        if surface.flags.contains(MaterialFlags::UNLIT) {
            self.color += throughput * surface.base_color.xyz();
            return;
        }

        // 2. Light from the surface itself, from lights, and from the sky.
        let to_viewer = -ray.direction;
        let cosine = dot3(surface.normal, to_viewer);
        let eta = relative_ior(surface);
        let shares = lobe_weights(surface, cosine, eta);
        let mirrored = clamp_cosine(surface.normal * (2.0 * cosine) - to_viewer, surface.geometric_normal);
        let sharp = traced_reflection_share(surface.roughness);
        let mut radiance = surface.emissive + shares.diffuse * sky_irradiance_over_pi(params, surface.normal);
        if sharp < 1.0 {
            radiance += shares.specular_reflection * (sky_blurred(params, mirrored, surface.roughness) * (1.0 - sharp));
        }
        radiance += light;
        self.color += throughput * radiance;

        // 3. Light through the surface, and light mirrored by it.
        let depth = ray.bounces + 1;
        if surface.transmission > 0.0 {
            let direction = refracted_direction(surface, ray.direction, cosine, eta);
            let origin = offset_ray_origin(surface, direction);
            let throughput = throughput * shares.specular_transmission;
            self.push_ray(params, PendingRay { origin, bounces: depth, direction, layers: 0, throughput });
        }
        if sharp > 0.0 {
            let origin = offset_ray_origin(surface, mirrored);
            let throughput = throughput * (shares.specular_reflection * sharp);
            self.push_ray(params, PendingRay { origin, bounces: depth, direction: mirrored, layers: 0, throughput });
        }
    }

    /// Lets a ray wait to be traced; one that is too deep or carries too little sees the sky at once.
    fn push_ray(&mut self, params: &FrameParams, ray: PendingRay) {
        let is_deep = ray.bounces > params.max_depth.min(MAX_DEPTH) || ray.layers > MAX_LAYERS;
        let count = self.pending_count;
        if is_deep || max_component(ray.throughput) < MIN_THROUGHPUT || count == MAX_PENDING {
            self.color += ray.throughput * sky_radiance(params, ray.direction);
            return;
        }
        self.pending[count] = ray;
        self.pending_count = count + 1;
    }

    /// The pixel, once there is no next ray. Rays beyond the limit see the sky.
    pub(crate) fn finish(&mut self, params: &FrameParams) -> Pixel {
        for ray in &self.pending[..self.pending_count] {
            self.color += ray.throughput * sky_radiance(params, ray.direction);
        }
        Pixel { color: self.color.extend(1.0), ..self.pixel }
    }
}

/// Index of refraction of the viewer's side over that of the other, 0 where that is infinite.
fn relative_ior(surface: &Surface) -> f32 {
    if surface.is_inside || surface.ior <= 0.0 {
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
    clamp_cosine(normalize_or(bent, direction), -surface.geometric_normal)
}
