//! Batches of rays of the application's, traced where frames are.

use glam::DVec3;
use rayon::prelude::*;

use super::Renderer;
use crate::Result;
use crate::device::layout::{self, NONE};
use crate::graph::Scene;
use crate::math::Bounds;
use crate::query::{Hit, Queries, Ray};

/// Rays by the batch: what a frame's rays would meet, traced by the renderer's device with all its threads.
impl Renderer {
    /// What each ray meets first of the nodes whose mask shares a bit with `mask`. Catches up with the scene, as
    /// [`prepare`](Renderer::prepare) does, then traces: tens of millions of rays a second on a GPU, where a batch is split as the
    /// device's limits demand.
    ///
    /// For a few rays, [`Queries::closest_hit`] is faster and exact. Rays of a batch are rounded to f32 relative to the
    /// [render origin](Renderer::render_origin), from where they come near the scene: what they hit may differ where one passes an edge
    /// within that rounding, and their [`t_min`](Ray::t_min) and [`t_max`](Ray::t_max) are known to it only.
    ///
    /// ```
    /// use ropewalk::glam::{DVec3, Vec3};
    /// use ropewalk::{Core, DeviceChoice, Geometry, Material, Ray, Renderer, RendererOptions, Scene, Transform};
    ///
    /// // A triangle at z = -5.
    /// let mut scene = Scene::new();
    /// let geometry = scene.add_geometry(Geometry::new([Vec3::NEG_X, Vec3::X, Vec3::Y], [[0, 1, 2]]))?;
    /// let material = scene.add_material(Material::default())?;
    /// let place = scene.add(scene.root(), Transform::from_translation(DVec3::new(0.0, 0.0, -5.0)))?;
    /// let triangle = scene.add(place, Core::Geometry { geometry, material })?;
    ///
    /// let mut renderer = Renderer::new(&RendererOptions { device: DeviceChoice::Cpu })?;
    /// let rays = [0.5, 2.0].map(|y| Ray::new(DVec3::new(0.0, y, 0.0), DVec3::NEG_Z));
    /// let hits = renderer.closest_hits(&mut scene, &rays, u32::MAX)?;
    /// assert_eq!((hits.distance(0), hits.distance(1)), (Some(5.0), None));
    /// let hit = hits.get(0).unwrap();
    /// assert_eq!((hit.path.node, hit.triangle, hit.position), (triangle, 0, DVec3::new(0.0, 0.5, -5.0)));
    /// assert_eq!(renderer.any_hits(&mut scene, &rays, u32::MAX)?, [true, false]);
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`Ray::validate`] and [`prepare`](Renderer::prepare).
    pub fn closest_hits<'a>(&'a mut self, scene: &'a mut Scene, rays: &[Ray], mask: u32) -> Result<ClosestHits<'a>> {
        let places = self.device_rays(scene, rays)?;
        let rays: Vec<layout::RayRecord> = places.iter().map(|place| place.ray).collect();
        let traced = self.device.tracer_mut().closest_hits(self.compiler.arrays(), &rays, mask);
        let hits = self.device.record_failure(traced)?;
        let distances = hits.iter().zip(&places).map(|(hit, place)| place.distance(hit.t)).collect();
        Ok(ClosestHits { queries: Queries::of_compiled_scene(&self.compiler, scene)?, hits, distances })
    }

    /// Whether each ray meets anything that lets no light through, of the nodes whose mask shares a bit with `mask`: what a shadow
    /// ray asks. Unlike [`closest_hits`](Renderer::closest_hits) it is stopped by both sides of every triangle, and passes surfaces
    /// that blend or transmit.
    ///
    /// # Errors
    /// As [`closest_hits`](Renderer::closest_hits).
    pub fn any_hits(&mut self, scene: &mut Scene, rays: &[Ray], mask: u32) -> Result<Vec<bool>> {
        let places = self.device_rays(scene, rays)?;
        let rays: Vec<layout::RayRecord> = places.iter().map(|place| place.ray).collect();
        let traced = self.device.tracer_mut().any_hits(self.compiler.arrays(), &rays, mask);
        self.device.record_failure(traced)
    }

    /// Catches up with the scene and gives the rays in the device's terms.
    fn device_rays(&mut self, scene: &mut Scene, rays: &[Ray]) -> Result<Vec<RelativeRay>> {
        rays.iter().try_for_each(Ray::validate)?;
        self.prepare(scene)?;
        let bounds = Queries::of_compiled_scene(&self.compiler, scene)?.bounds();
        let origin = self.render_origin();
        Ok(rays.par_iter().map(|ray| RelativeRay::new(ray, origin, &bounds)).collect())
    }
}

/// The closest hits of a batch of rays, in their order. The scene cannot be edited while they are looked at.
#[derive(Debug)]
pub struct ClosestHits<'a> {
    queries: Queries<'a>,
    hits: Vec<layout::HitRecord>,
    distances: Vec<f64>,
}

impl ClosestHits<'_> {
    /// How many rays there were.
    pub fn len(&self) -> usize {
        self.hits.len()
    }

    /// Whether there were none.
    pub fn is_empty(&self) -> bool {
        self.hits.is_empty()
    }

    /// Where ray `i` hits, in units of its direction's length; `None` where it hits nothing, or is none of the batch.
    pub fn distance(&self, i: usize) -> Option<f64> {
        self.hits.get(i).filter(|hit| hit.instance != NONE).map(|_| self.distances[i])
    }

    /// What ray `i` hits: looked up in main memory, some hundred nanoseconds.
    pub fn get(&self, i: usize) -> Option<Hit> {
        self.queries.hit_from_record(self.hits.get(i)?, self.distances[i])
    }

    /// What each ray hits.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Option<Hit>> + '_ {
        (0..self.len()).map(|i| self.get(i))
    }

    /// The hits as the device gave them: 32 bytes each, indices into the [device arrays](crate::device::DeviceArrays), and `t` in
    /// a unit of its own.
    pub fn records(&self) -> &[layout::HitRecord] {
        &self.hits
    }
}

/// A ray in f32, relative to the render origin, and what its t means.
struct RelativeRay {
    ray: layout::RayRecord,
    /// Where on the given ray it starts.
    start: f64,
    /// What 1 on the given ray is on this one: a power of two, so that nothing is rounded.
    scale: f64,
}

impl RelativeRay {
    /// Hits nothing.
    const MISS: Self = Self {
        ray: layout::RayRecord { origin: [0.0; 3], t_min: 1.0, direction: [1.0, 0.0, 0.0], t_max: 0.0 },
        start: 0.0,
        scale: 1.0,
    };

    fn new(ray: &Ray, origin: DVec3, bounds: &Bounds) -> Self {
        // 1. A direction whose longest component is between 1 and 2.
        let longest = ray.direction.abs().max_element();
        let scale = power_of_two(longest);
        let direction = ray.direction / scale;

        // 2. A start near the scene: a scene's size before its box, and not before the ray's own start, unless that looks back.
        let Some(entry) = box_entry(bounds, ray.origin, direction) else { return Self::MISS };
        let size = (bounds.min - origin).abs().max((bounds.max - origin).abs()).max_element();
        // In steps of a power of two, so that distances keep their bits.
        let step = power_of_two(size);
        let start = (((entry - 2.0 * size) / step).floor() * step / scale).max(ray.t_min.min(0.0));
        let from = (ray.origin - origin) + ray.direction * start;
        let most = f64::from(f32::MAX);
        let [t_min, t_max] = [ray.t_min, ray.t_max].map(|t| ((t - start) * scale).clamp(-most, most) as f32);
        let ray = layout::RayRecord {
            origin: from.as_vec3().to_array(),
            t_min: t_min.max(0.0),
            direction: direction.as_vec3().to_array(),
            t_max,
        };
        if from.as_vec3().is_finite() && t_max >= 0.0 { Self { ray, start, scale } } else { Self::MISS }
    }

    /// Where on the given ray t is.
    fn distance(&self, t: f32) -> f64 {
        self.start + f64::from(t) / self.scale
    }
}

/// The greatest power of two that is not above `value`, a positive number; at least the least normal one.
fn power_of_two(value: f64) -> f64 {
    f64::from_bits(value.to_bits() & f64::INFINITY.to_bits()).max(f64::MIN_POSITIVE)
}

/// Where a line meets a box first; `None` if it does not, or the box is empty.
fn box_entry(bounds: &Bounds, origin: DVec3, direction: DVec3) -> Option<f64> {
    if bounds.is_empty() {
        return None;
    }
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let (low, high) = (bounds.min[axis] - origin[axis], bounds.max[axis] - origin[axis]);
        if direction[axis] == 0.0 {
            if low > 0.0 || high < 0.0 {
                return None;
            }
            continue;
        }
        let (a, b) = (low / direction[axis], high / direction[axis]);
        (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
    }
    // Rounding may have put the line a little beside the box.
    let slack = 1e-6 * near.abs().max(far.abs());
    (near <= far + slack).then_some(near)
}
