//! One pixel: T. Whitted's recursion (*An Improved Illumination Model for Shaded Display*, 1980) as a loop over a stack
//! of pending rays. Twin of `shaders/shared/whitted.wgsl`, in which `render_pixel` contains what [`RayTree`] leaves to
//! its caller here, so that callers can trace the rays of many pixels together.
//!
//! What is approximate:
//! - A ray too deep ([`FrameParams::max_depth`], at most [`MAX_DEPTH`]), behind too many blended layers
//!   ([`MAX_LAYERS`]), or with throughput below [`MIN_THROUGHPUT`] sees the sky instead of the scene; so do the rays
//!   after the first [`MAX_RAYS`] of a pixel. This keeps energy: under a uniform sky the image does not change.
//! - The sky's light is not shadowed: there is no ambient occlusion.
//! - Nearly smooth surfaces reflect the scene sharply, rough ones a blurred sky; in between the two are mixed. Rough
//!   glass transmits as sharply as smooth glass.
//! - A transmissive surface that encloses a volume bounds a solid and refracts light by its index of refraction; any
//!   other ([`THIN`](crate::device::layout::InstanceFlags::THIN), decided by the compiler) is a thin wall, and light
//!   passes straight. `KHR_materials_transmission` alone means thin walls everywhere, but then a glass sphere would not
//!   refract. Which side is inside follows from the winding; nested solids are each refracted against air. A solid is
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

/// Greatest number of reflections and refractions of a ray, whatever `max_depth` says:
/// [`View::MAX_DEPTH`](crate::View::MAX_DEPTH).
pub(crate) const MAX_DEPTH: u32 = 8;
/// Most blended surfaces that a ray passes between two reflections or refractions.
pub(super) const MAX_LAYERS: u32 = 32;
/// Most rays of a pixel, shadow rays not counted.
pub(super) const MAX_RAYS: u32 = 256;
/// Rays of less throughput see the sky instead of the scene. For radiance up to 1 that cannot change an 8-bit pixel, as
/// half the smallest sRGB step is 0.5 / 255 / 12.92 = 1.24 * 2^-13; brighter radiance can.
pub(super) const MIN_THROUGHPUT: f32 = 1.0 / (1 << 13) as f32;
/// Each level of depth leaves at most two pending rays: one behind a blended surface (`BLEND`), and the first pushed of
/// the refracted and the reflected ray (`REFRACTION`; with reflection alone that ray is traced next). One more is the
/// ray to be traced next.
///
/// In WGSL, where private memory is scarce, 1, 9 or 17 by the scene's needs; here always 17.
pub(super) const MAX_PENDING: usize = 1 + 2 * MAX_DEPTH as usize;

/// Upper bound on rays per pixel, shadow rays not counted, by which dispatches are sized.
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

/// Outputs of one pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pixel {
    /// Linear radiance, and 1: the sky is part of the image.
    pub color: Vec4,
    /// Unit shading normal, facing the camera, world space; zero where the primary ray missed.
    pub normal: Vec3,
    /// Distance from the camera, world units; `f32::MAX` where the primary ray missed.
    pub distance: f32,
    /// Node slot, node version, primitive, instance; [`NONE`] (version 1: the null key) where the primary ray missed.
    pub ids: [u32; 4],
}

impl Pixel {
    /// Outputs where the primary ray missed.
    pub(crate) const MISS: Self =
        Self { color: Vec4::ZERO, normal: Vec3::ZERO, distance: f32::MAX, ids: [NONE, 1, NONE, NONE] };
}

#[derive(Clone, Copy)]
struct PendingRay {
    origin: Vec3,
    bounces: u32,
    direction: Vec3,
    layers: u32,
    /// Factor by which its radiance contributes to the pixel.
    throughput: Vec3,
}

/// A pixel in progress: radiance so far and a stack of pending rays.
pub(crate) struct RayTree {
    pixel: Pixel,
    color: Vec3,
    /// Number of rays traced so far.
    traced_rays: u32,
    pending_count: usize,
    /// The stack; `pending[pending_count]` is the ray being traced.
    pending: [PendingRay; MAX_PENDING],
}

/// A ray and the surface it hit.
pub(crate) struct SurfaceHit {
    ray: PendingRay,
    surface: Surface,
}

impl SurfaceHit {
    /// The light's sample at this surface, or `None` if it contributes nothing.
    pub(crate) fn light_sample(&self, light: &LightRecord) -> Option<LightSample> {
        if self.surface.flags.contains(MaterialFlags::UNLIT) {
            return None;
        }
        sample_light(light, &self.surface, -self.ray.direction)
    }
}

/// Renders the pixel of which `primary` is the primary ray.
pub(crate) fn render_pixel<'a>(rays: &mut impl RayQueries<'a>, params: &FrameParams, primary: &RayRecord) -> Pixel {
    let mut tree = RayTree::default();
    // Push the primary ray.
    tree.reset(primary);
    let scene = rays.scene();
    while let Some(ray) = tree.next_ray() {
        // Trace the next ray; a miss adds the sky.
        let hit = rays.closest_hit(&ray, params.ray_mask);
        let Some(surface_hit) = tree.record_hit(scene, params, &hit) else { continue };
        // Sample the lights.
        let samples = active_lights(scene, params).iter().filter_map(|light| surface_hit.light_sample(light));
        let light = samples
            .fold(Vec3::ZERO, |sum, sample| sum + sample.radiance(rays.transmittance(&sample.ray, params.ray_mask)));
        // Shade, and push secondary rays.
        tree.shade(params, &surface_hit, light);
    }
    tree.finish(params)
}

/// The first `params.light_count` lights.
pub(crate) fn active_lights<'a>(scene: &KernelScene<'a>, params: &FrameParams) -> &'a [LightRecord] {
    &scene.lights[..scene.lights.len().min(params.light_count as usize)]
}

impl Default for RayTree {
    /// A finished pixel without pending rays.
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
    /// Resets to a primary ray.
    pub(crate) fn reset(&mut self, primary: &RayRecord) {
        let [origin, direction] = [primary.origin, primary.direction].map(Vec3::from_array);
        (self.pixel, self.color, self.traced_rays) = (Pixel::MISS, Vec3::ZERO, 0);
        self.pending[0] = PendingRay { origin, bounces: 0, direction, layers: 0, throughput: Vec3::ONE };
        self.pending_count = 1;
    }

    /// Pops the next ray to trace, or `None` when the pixel is finished. The caller traces it, passes the hit to
    /// [`record_hit`](Self::record_hit) and, if that returns a surface, the lights' radiance to [`shade`](Self::shade).
    pub(crate) fn next_ray(&mut self) -> Option<RayRecord> {
        // A pixel that has used up its rays is finished.
        if self.traced_rays == MAX_RAYS {
            return None;
        }
        self.pending_count = self.pending_count.checked_sub(1)?;
        let PendingRay { origin, direction, .. } = self.pending[self.pending_count];
        Some(RayRecord { origin: origin.to_array(), t_min: 0.0, direction: direction.to_array(), t_max: f32::MAX })
    }

    /// Records the hit of the current ray: a miss adds sky radiance and returns `None`; a hit returns the surface to
    /// shade.
    pub(crate) fn record_hit(
        &mut self,
        scene: &KernelScene<'_>,
        params: &FrameParams,
        hit: &HitRecord,
    ) -> Option<SurfaceHit> {
        let ray = self.pending[self.pending_count];
        self.traced_rays += 1;
        // Miss: add the sky.
        if hit.instance == NONE {
            self.color += ray.throughput * sky_radiance(params, ray.direction);
            return None;
        }
        // Hit: reconstruct the surface.
        let surface = surface_at(scene, hit, ray.direction);
        // The first ray is the primary ray: it gives the pixel's normal, distance and identifiers.
        if self.traced_rays == 1 {
            let [slot, version] = scene.instances[hit.instance as usize].node_key;
            self.pixel.normal = surface.normal;
            self.pixel.distance = hit.t;
            self.pixel.ids = [slot, version, hit.primitive, hit.instance];
        }
        Some(SurfaceHit { ray, surface })
    }

    /// Adds the surface's emitted and reflected radiance, `light` of it from lights, and pushes its secondary rays. The
    /// ray behind a blended surface is pushed first, so it is traced last, and no other ray of this surface is pending
    /// then (see [`MAX_PENDING`]).
    pub(crate) fn shade(&mut self, params: &FrameParams, SurfaceHit { ray, surface }: &SurfaceHit, light: Vec3) {
        // 1. Alpha blends the surface over the ray behind it.
        let mut throughput = ray.throughput;
        if surface.flags.contains(MaterialFlags::BLEND) {
            let alpha = surface.base_color.w;
            let origin = offset_ray_origin(surface, ray.direction);
            let behind = PendingRay { origin, layers: ray.layers + 1, throughput: throughput * (1.0 - alpha), ..*ray };
            self.push_ray(params, behind);
            throughput *= alpha;
        }
        // Unlit surfaces show their base colour, and nothing else.
        if surface.flags.contains(MaterialFlags::UNLIT) {
            self.color += throughput * surface.base_color.xyz();
            return;
        }

        // 2. Add emitted light and the light reflected from the lights and the sky.
        let to_viewer = -ray.direction;
        let cosine = dot3(surface.normal, to_viewer);
        let eta = relative_ior(surface);
        let lobes = lobe_weights(surface, cosine, eta);
        let reflected_direction = clamp_cosine(surface.normal * (2.0 * cosine) - to_viewer, surface.geometric_normal);
        let sharp = traced_reflection_share(surface.roughness);
        // The blurred share of the reflection sees the sky only; the sharp share is traced below.
        let mut radiance = surface.emissive + lobes.diffuse * sky_irradiance_over_pi(params, surface.normal);
        if sharp < 1.0 {
            radiance += lobes.specular_reflection
                * (sky_blurred(params, reflected_direction, surface.roughness) * (1.0 - sharp));
        }
        radiance += light;
        self.color += throughput * radiance;

        // 3. Push the refracted and the reflected ray.
        let depth = ray.bounces + 1;
        if surface.transmission > 0.0 {
            let direction = refracted_direction(surface, ray.direction, cosine, eta);
            let origin = offset_ray_origin(surface, direction);
            let throughput = throughput * lobes.specular_transmission;
            self.push_ray(params, PendingRay { origin, bounces: depth, direction, layers: 0, throughput });
        }
        if sharp > 0.0 {
            let origin = offset_ray_origin(surface, reflected_direction);
            let throughput = throughput * (lobes.specular_reflection * sharp);
            self.push_ray(
                params,
                PendingRay { origin, bounces: depth, direction: reflected_direction, layers: 0, throughput },
            );
        }
    }

    /// Pushes a ray; beyond the depth or layer limit, or below [`MIN_THROUGHPUT`], adds sky radiance instead.
    fn push_ray(&mut self, params: &FrameParams, ray: PendingRay) {
        let is_deep = ray.bounces > params.max_depth.min(MAX_DEPTH) || ray.layers > MAX_LAYERS;
        let count = self.pending_count;
        // Cut off: the sky stands in for what the ray would have met.
        if is_deep || max_component(ray.throughput) < MIN_THROUGHPUT || count == MAX_PENDING {
            self.color += ray.throughput * sky_radiance(params, ray.direction);
            return;
        }
        self.pending[count] = ray;
        self.pending_count = count + 1;
    }

    /// Returns the finished pixel. Rays still pending after [`MAX_RAYS`] contribute sky radiance.
    pub(crate) fn finish(&mut self, params: &FrameParams) -> Pixel {
        for ray in &self.pending[..self.pending_count] {
            self.color += ray.throughput * sky_radiance(params, ray.direction);
        }
        Pixel { color: self.color.extend(1.0), ..self.pixel }
    }
}

/// Relative index of refraction, n of the viewer's side over n of the other (air = 1); 0 if the latter is infinite.
fn relative_ior(surface: &Surface) -> f32 {
    if surface.is_inside || surface.ior <= 0.0 {
        return surface.ior;
    }
    1.0 / surface.ior
}

/// Direction of the transmitted ray: refracted by Snell's law, or unchanged by a thin wall.
fn refracted_direction(surface: &Surface, direction: Vec3, cosine: f32, eta: f32) -> Vec3 {
    if surface.thin {
        return direction;
    }
    // Refract by Snell's law, and keep the ray on the far side of the surface.
    let bent = direction * eta + surface.normal * (eta * cosine - refracted_cosine(cosine, eta));
    clamp_cosine(normalize_or(bent, direction), -surface.geometric_normal)
}
