//! One pixel: T. Whitted's recursion (*An Improved Illumination Model for Shaded Display*, 1980) as a loop over a stack
//! of pending rays. Twin of `shaders/shared/whitted.wgsl`, in which `render_pixel` contains what [`RayTree`] leaves to
//! its caller here, so that callers can trace the rays of many pixels together.
//!
//! What is approximate:
//! - A ray too deep ([`FrameParams::max_depth`]) or with throughput below [`FrameParams::min_throughput`] sees the sky
//!   instead of the scene. This keeps energy: under a uniform sky the image does not change.
//! - After the first [`FrameParams::max_rays`] of a pixel, or where more than [`MAX_PENDING`] are pending, each pending
//!   ray sees the nearest opaque surface, and what that reflects is the sky.
//! - The sky's light is not shadowed: there is no ambient occlusion.
//! - Nearly smooth surfaces reflect the scene sharply, rough ones a blurred sky; in between the two are mixed. Rough
//!   glass transmits as sharply as smooth glass.
//! - A transmissive surface bounds a solid and refracts light by its index of refraction, or it is a thin wall
//!   ([`THIN`](crate::device::layout::InstanceFlags::THIN), by its [`WallKind`](crate::graph::WallKind)), and light
//!   passes straight. `KHR_materials_transmission` alone means thin walls everywhere, but then a glass sphere would not
//!   refract. Which side is inside follows from the winding; nested solids are each refracted against air. A solid is
//!   tinted by its base colour once, by the square root at each crossing.
//!
//! Rays that go straight on, through blended surfaces and thin walls, stay the same ray: it goes on behind the hit, in
//! the order of hits ([`Continuation`]), so that no layer is skipped or counted twice, however close they are. A ray
//! that is refracted first goes straight on as well, past all that touches the surface, to within rounding, and turns
//! there ([`Turn`]): what touches a solid (a table below a glass) is met by the ray that met the solid.

use glam::{Vec3, Vec4, Vec4Swizzles as _};

use super::KernelScene;
use super::brdf::{lobe_weights, refracted_cosine, traced_reflection_share};
use super::intersect::max_component;
use super::light::{LightSample, sample_light};
use super::math::{dot3, max};
use super::offset::offset_ray_origin;
use super::query::{Continuation, TOUCH_STEP};
use super::sky::{sky_blurred, sky_irradiance_over_pi, sky_radiance};
use super::surface::{MIN_COSINE, Surface, clamp_cosine, normalize_or, surface_at};
use super::traverse::RayQueries;
#[cfg(feature = "gpu")]
use crate::device::Needs;
use crate::device::layout::{FrameParams, HitRecord, LightRecord, MaterialFlags, NONE, RayRecord};

/// The most pending rays of a pixel, however deep its paths are. Of the rays that leave a surface the one of least
/// throughput is traced first, by the sum of its components. Together they have no more than the ray that arrived, so
/// where it leaves n pending, the first has at most 1 / (n + 1) of that. From 3, the camera's, n of 1 at each surface
/// leads below 2^-13, the [least throughput](crate::View::DEFAULT_MIN_THROUGHPUT), after 14 of them, with 15 rays
/// pending, n of 2 (a blended surface of glass) after 9, with 19. A lower limit may need more; then the pixel counts as
/// one that needs too many rays.
///
/// In WGSL, where private memory is scarce, 1, 15 or 19 by how many rays may leave a surface; here always 19.
pub(super) const MAX_PENDING: usize = 19;
/// A camera is on a surface that is nearer to it than this many times the bound of rounding by which secondary rays are
/// offset: once for the surface as it is drawn, once for where the scene has it.
pub(super) const ON_SURFACE: f32 = 2.0;

/// Upper bound on rays per pixel, shadow rays not counted, by which dispatches are sized. A refracted ray counts twice,
/// before and after its turn; those pending after `max_rays` are traced as well.
#[cfg(feature = "gpu")]
pub(crate) fn max_rays_per_pixel(params: &FrameParams, needs: Needs) -> u32 {
    let limit = params.max_rays.saturating_add(2 * MAX_PENDING as u32);
    // Depths beyond this reach any limit.
    let depth = params.max_depth.min(limit);
    let branching = 2u32.checked_shl(depth).map_or(limit, |leaves| leaves.saturating_mul(2).saturating_sub(2));
    match [Needs::BLEND, Needs::REFLECTION, Needs::REFRACTION].map(|need| needs.contains(need)) {
        [true, ..] => limit,
        [false, true, true] => branching.min(limit),
        [false, false, false] => 1,
        [false, false, true] => (1 + 2 * depth).min(limit),
        [false, true, false] => (1 + depth).min(limit),
    }
}

/// Outputs of one pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pixel {
    /// Linear radiance, and 1 (the sky is part of the image) plus the [`unlit_share`].
    pub color: Vec4,
    /// Unit shading normal, facing the camera, world space; zero where the primary ray missed.
    pub normal: Vec3,
    /// Distance from the camera, world units; `f32::MAX` where the primary ray missed.
    pub distance: f32,
    /// Node slot, node version, primitive, instance; [`NONE`] (version 1: the null key) where the primary ray missed.
    pub ids: [u32; 4],
    /// Whether the pixel needed more rays than [`FrameParams::max_rays`].
    pub is_limited: bool,
}

impl Pixel {
    /// Outputs where the primary ray missed.
    pub(crate) const MISS: Self = Self {
        color: Vec4::ZERO,
        normal: Vec3::ZERO,
        distance: f32::MAX,
        ids: [NONE, 1, NONE, NONE],
        is_limited: false,
    };
}

/// A ray to be traced.
#[derive(Clone, Copy)]
struct PendingRay {
    origin: Vec3,
    direction: Vec3,
    bounces: u32,
    /// Factor by which its radiance contributes to the pixel.
    throughput: Vec3,
    /// Whether it goes on from another ray, by its [`Passage`].
    goes_on: bool,
}

/// How a ray goes on from another: which hits it has passed, and where it turns. Kept apart from the
/// [rays](PendingRay), since most have none.
#[derive(Clone, Copy)]
struct Passage {
    start: Continuation,
    turn: Turn,
}

/// Where a refracted ray turns: if it hits nothing up to `t`, it goes on from `origin` in `direction`. Up to there it
/// goes straight on, but what it hits is shaded as seen along `direction`.
#[derive(Clone, Copy)]
struct Turn {
    t: f32,
    origin: Vec3,
    direction: Vec3,
}

impl Turn {
    /// For a ray that does not turn.
    const NEVER: Self = Self { t: f32::MAX, origin: Vec3::ZERO, direction: Vec3::ZERO };
}

impl PendingRay {
    /// A ray from a point, with nothing passed yet.
    fn new(origin: Vec3, direction: Vec3, bounces: u32, throughput: Vec3) -> Self {
        Self { origin, direction, bounces, throughput, goes_on: false }
    }
}

impl Passage {
    const NONE: Self = Self { start: Continuation::START, turn: Turn::NEVER };
}

impl Turn {
    fn happens(&self) -> bool {
        self.t < f32::MAX
    }
}

/// A pixel in progress: radiance so far and a stack of pending rays. What most pixels need comes first.
#[repr(C)]
pub(crate) struct RayTree {
    pixel: Pixel,
    color: Vec3,
    /// The sum of the components of the radiance in `color` that came from unlit surfaces.
    unlit: f32,
    /// Number of rays traced so far.
    traced_rays: u32,
    /// The least distance of a hit of the primary ray: it grows while that leaves surfaces on which the camera is.
    near: f32,
    pending_count: usize,
    /// The stack; `pending[pending_count]` is the ray being traced.
    pending: [PendingRay; MAX_PENDING],
    /// For each pending ray that goes on.
    passages: [Passage; MAX_PENDING],
}

/// The surface that the ray being traced has hit.
pub(crate) struct SurfaceHit {
    surface: Surface,
    /// Distance along the ray.
    t: f32,
    /// Where the ray goes on behind the surface, if it does.
    behind: Continuation,
}

/// Renders the pixel of which `primary` is the primary ray.
pub(crate) fn render_pixel<'a>(rays: &mut impl RayQueries<'a>, params: &FrameParams, primary: &RayRecord) -> Pixel {
    let mut tree = RayTree::default();
    // Push the primary ray.
    tree.reset(primary);
    let scene = rays.scene();
    while let Some((ray, start)) = tree.next_ray(params) {
        // Trace the next ray; a miss adds the sky.
        let hit = rays.next_hit(&ray, start.unwrap_or(Continuation::START), params.ray_mask);
        let Some(surface_hit) = tree.record_hit(scene, params, &hit) else { continue };
        // Sample the lights.
        let samples = active_lights(scene, params).iter().filter_map(|light| tree.light_sample(&surface_hit, light));
        let light = samples
            .fold(Vec3::ZERO, |sum, sample| sum + sample.radiance(rays.transmittance(&sample.ray, params.ray_mask)));
        // Shade, and push secondary rays.
        tree.shade(params, &surface_hit, light);
    }
    tree.finish()
}

/// The hit that a pixel of this primary ray shows: the closest one on which the camera is not.
pub(crate) fn primary_hit<'a>(rays: &mut impl RayQueries<'a>, primary: &RayRecord, ray_mask: u32) -> HitRecord {
    let direction = Vec3::from_array(primary.direction);
    let mut ray = *primary;
    loop {
        let hit = rays.next_hit(&ray, Continuation::START, ray_mask);
        if hit.instance == NONE || !is_at_camera(hit.t, direction, &surface_at(rays.scene(), &hit, direction)) {
            return hit;
        }
        ray.t_min = just_behind(hit.t);
    }
}

/// The first `params.light_count` lights.
pub(crate) fn active_lights<'a>(scene: &KernelScene<'a>, params: &FrameParams) -> &'a [LightRecord] {
    &scene.lights[..scene.lights.len().min(params.light_count as usize)]
}

impl Default for RayTree {
    /// A finished pixel without pending rays.
    fn default() -> Self {
        let nowhere = PendingRay::new(Vec3::ZERO, Vec3::ZERO, 0, Vec3::ZERO);
        Self {
            pixel: Pixel::MISS,
            color: Vec3::ZERO,
            unlit: 0.0,
            traced_rays: 0,
            near: 0.0,
            pending_count: 0,
            pending: [nowhere; MAX_PENDING],
            passages: [Passage::NONE; MAX_PENDING],
        }
    }
}

impl RayTree {
    /// Resets to a primary ray.
    pub(crate) fn reset(&mut self, primary: &RayRecord) {
        let [origin, direction] = [primary.origin, primary.direction].map(Vec3::from_array);
        (self.pixel, self.color, self.unlit, self.traced_rays) = (Pixel::MISS, Vec3::ZERO, 0.0, 0);
        self.near = primary.t_min;
        self.pending[0] = PendingRay::new(origin, direction, 0, Vec3::ONE);
        self.pending_count = 1;
    }

    /// Pops the next ray to trace, and what it has passed if anything, or `None` when the pixel is finished. The caller
    /// traces it, passes the hit to [`record_hit`](Self::record_hit) and, if that returns a surface, the lights'
    /// radiance to [`shade`](Self::shade).
    pub(crate) fn next_ray(&mut self, params: &FrameParams) -> Option<(RayRecord, Option<Continuation>)> {
        self.pending_count = self.pending_count.checked_sub(1)?;
        // A pixel that has used up its rays sees what is opaque.
        let is_limited = self.traced_rays >= params.max_rays;
        self.pixel.is_limited |= is_limited;
        let PendingRay { origin, direction, .. } = self.pending[self.pending_count];
        let [origin, direction] = [origin, direction].map(|v| v.to_array());
        let t_min = if self.is_primary() { self.near } else { 0.0 };
        let ray = RayRecord { origin, t_min, direction, t_max: f32::MAX };
        let passage = self.passage();
        if passage.is_none() && !is_limited {
            return Some((ray, None));
        }
        let Passage { start, turn } = passage.copied().unwrap_or(Passage::NONE);
        let start = Continuation { only_opaque: is_limited, ..start };
        Some((RayRecord { t_min: max(start.t_min(), t_min), t_max: turn.t, ..ray }, Some(start)))
    }

    /// Whether the current ray is the primary ray, which has seen nothing yet.
    fn is_primary(&self) -> bool {
        self.pixel.distance == f32::MAX
    }

    /// That of the current ray, if it goes on from another.
    fn passage(&self) -> Option<&Passage> {
        self.pending[self.pending_count].goes_on.then(|| &self.passages[self.pending_count])
    }

    /// The turn of the current ray, if it has one.
    fn turn(&self) -> Option<&Turn> {
        self.passage().map(|passage| &passage.turn).filter(|turn| turn.happens())
    }

    /// The direction along which light arrives by the current ray, reversed.
    fn view_direction(&self) -> Vec3 {
        self.turn().map_or(self.pending[self.pending_count].direction, |turn| turn.direction)
    }

    /// Records the hit of the current ray. A hit returns the surface to shade; but a primary ray whose camera is on the
    /// surface goes on behind it, and `None` is returned. So it is for a miss, which adds sky radiance, or, of a ray
    /// that turns, pushes the ray from there on.
    pub(crate) fn record_hit(
        &mut self,
        scene: &KernelScene<'_>,
        params: &FrameParams,
        hit: &HitRecord,
    ) -> Option<SurfaceHit> {
        let ray = &self.pending[self.pending_count];
        self.traced_rays += 1;
        // Nothing up to the turn: go on from there.
        if let Some(&Turn { origin, direction, .. }) = self.turn().filter(|_| hit.instance == NONE) {
            self.pending[self.pending_count] = PendingRay::new(origin, direction, ray.bounces, ray.throughput);
            self.pending_count += 1;
            return None;
        }
        // Miss: add the sky.
        if hit.instance == NONE {
            self.color += ray.throughput * sky_radiance(params, ray.direction);
            return None;
        }
        // Hit: reconstruct the surface.
        let surface = surface_at(scene, hit, self.view_direction());
        if self.is_primary() {
            if is_at_camera(hit.t, ray.direction, &surface) {
                self.near = just_behind(hit.t);
                self.pending_count += 1;
                return None;
            }
            // The primary ray gives the pixel's normal, distance and identifiers.
            let [slot, version] = scene.instances[hit.instance as usize].node_key;
            self.pixel.normal = surface.normal;
            self.pixel.distance = hit.t;
            self.pixel.ids = [slot, version, hit.primitive, hit.instance];
        }
        // Only where something is seen behind the surface does the ray go on.
        let goes_on = surface.flags.contains(MaterialFlags::BLEND) || surface.transmission > 0.0;
        let behind = if goes_on { Continuation::behind(scene, hit, ray.direction) } else { Continuation::START };
        Some(SurfaceHit { surface, t: hit.t, behind })
    }

    /// The light's sample at the surface that the current ray has hit, or `None` if it contributes nothing.
    pub(crate) fn light_sample(&self, hit: &SurfaceHit, light: &LightRecord) -> Option<LightSample> {
        if hit.surface.flags.contains(MaterialFlags::UNLIT) {
            return None;
        }
        sample_light(light, &hit.surface, -self.view_direction())
    }

    /// Adds the radiance that the surface hit by the current ray emits and reflects, `light` of it from lights, and
    /// pushes its secondary rays.
    pub(crate) fn shade(&mut self, params: &FrameParams, hit: &SurfaceHit, light: Vec3) {
        let SurfaceHit { surface, .. } = hit;
        let ray = self.pending[self.pending_count];
        let direction = self.view_direction();
        // What goes straight on behind the surface has passed it, and turns where this ray does.
        let turn = self.turn().copied().unwrap_or(Turn::NEVER);
        let passage = Passage { start: hit.behind, turn };
        let first = self.pending_count;
        // 1. Alpha blends the surface over the ray behind it.
        let mut throughput = ray.throughput;
        if surface.flags.contains(MaterialFlags::BLEND) {
            let alpha = surface.base_color.w;
            let behind = PendingRay { throughput: throughput * (1.0 - alpha), goes_on: true, ..ray };
            self.push_ray(params, first, behind, passage);
            throughput *= alpha;
        }
        // Unlit surfaces show their base colour, and nothing else.
        if surface.flags.contains(MaterialFlags::UNLIT) {
            let radiance = throughput * surface.base_color.xyz();
            self.color += radiance;
            self.unlit += component_sum(radiance);
            return;
        }

        // 2. Add emitted light and the light reflected from the lights and the sky.
        let to_viewer = -direction;
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
        let bounces = ray.bounces + 1;
        if surface.transmission > 0.0 {
            let refracted = || hit.turn(ray.direction, refracted_direction(surface, direction, cosine, eta));
            let turn = if surface.thin { turn } else { refracted() };
            let throughput = throughput * lobes.specular_transmission;
            let behind = PendingRay { bounces, throughput, goes_on: true, ..ray };
            self.push_ray(params, first, behind, Passage { turn, ..passage });
        }
        if sharp > 0.0 {
            let origin = offset_ray_origin(surface, reflected_direction);
            let throughput = throughput * (lobes.specular_reflection * sharp);
            let reflected = PendingRay::new(origin, reflected_direction, bounces, throughput);
            self.push_ray(params, first, reflected, Passage::NONE);
        }
    }

    /// Pushes a ray, and how it goes on if it does, below the rays of less throughput that were pushed since there were
    /// `first` (see [`MAX_PENDING`]). Too deep, of too little throughput, or if the pixel has used up its rays or their
    /// room, adds sky radiance instead.
    fn push_ray(&mut self, params: &FrameParams, first: usize, ray: PendingRay, passage: Passage) {
        let is_cut_off = ray.bounces > params.max_depth || max_component(ray.throughput) <= params.min_throughput;
        self.pixel.is_limited |= !is_cut_off && self.pending_count == MAX_PENDING;
        // Cut off: the sky stands in for what the ray would have met.
        if is_cut_off || self.pixel.is_limited {
            let direction = if passage.turn.happens() { passage.turn.direction } else { ray.direction };
            self.color += ray.throughput * sky_radiance(params, direction);
            return;
        }
        let mut place = self.pending_count;
        let throughput = component_sum(ray.throughput);
        while place > first && component_sum(self.pending[place - 1].throughput) < throughput {
            self.pending[place] = self.pending[place - 1];
            self.passages[place] = self.passages[place - 1];
            place -= 1;
        }
        self.pending[place] = ray;
        if ray.goes_on {
            self.passages[place] = passage;
        }
        self.pending_count += 1;
    }

    /// Returns the finished pixel.
    pub(crate) fn finish(&self) -> Pixel {
        Pixel { color: self.color.extend(1.0 + unlit_share(self.color, self.unlit)), ..self.pixel }
    }
}

/// Whether the camera is on the surface that its ray hits at `t`: nearer than the rounding of positions, and the hit is
/// where the camera is, not where a plane that it nearly lies in is far away.
fn is_at_camera(t: f32, direction: Vec3, surface: &Surface) -> bool {
    let cosine = max(dot3(direction, surface.geometric_normal).abs(), MIN_COSINE);
    t * cosine <= surface.ray_offset * ON_SURFACE
}

/// The next greater number; for 0 the least normal one.
fn just_behind(t: f32) -> f32 {
    max(t.next_up(), f32::MIN_POSITIVE)
}

/// The share of a pixel's radiance that came from unlit surfaces, 0 to 1, by the sums of components: tone mapping
/// leaves it alone.
fn unlit_share(color: Vec3, unlit: f32) -> f32 {
    if unlit > 0.0 { (unlit / component_sum(color)).min(1.0) } else { 0.0 }
}

fn component_sum(color: Vec3) -> f32 {
    (color.x + color.y) + color.z
}

impl SurfaceHit {
    /// The turn of a ray along `incoming` that is refracted into `direction`. It comes after all that touches the
    /// surface: twice the offset of secondary rays, and four steps of the order of hits, measured along the normal.
    fn turn(&self, incoming: Vec3, direction: Vec3) -> Turn {
        let Self { surface, t, .. } = self;
        let cosine = max(dot3(incoming, surface.geometric_normal).abs(), MIN_COSINE);
        let t = t + (2.0 * surface.ray_offset + 4.0 * TOUCH_STEP * t) / cosine;
        Turn { t, origin: offset_ray_origin(surface, direction), direction }
    }
}

/// Relative index of refraction, n of the viewer's side over n of the other (air = 1); 0 if the latter is infinite.
fn relative_ior(surface: &Surface) -> f32 {
    if surface.is_inside || surface.ior <= 0.0 {
        return surface.ior;
    }
    1.0 / surface.ior
}

/// Direction of the ray that enters or leaves a solid, by Snell's law; kept on the far side of the surface.
fn refracted_direction(surface: &Surface, direction: Vec3, cosine: f32, eta: f32) -> Vec3 {
    let bent = direction * eta + surface.normal * (eta * cosine - refracted_cosine(cosine, eta));
    clamp_cosine(normalize_or(bent, direction), -surface.geometric_normal)
}
