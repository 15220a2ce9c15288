//! Batches of the application's rays, traced by the renderer's tracer.

use glam::DVec3;
use rayon::prelude::*;

use super::Renderer;
use crate::Result;
use crate::device::layout::{self, NONE};
use crate::graph::Scene;
use crate::math::Bounds;
use crate::query::{Hit, Queries, Ray};

/// Which nodes rays of a batch can hit: those whose mask, combined (and) with the masks of all nodes above, has a bit
/// in common with it (see [`Scene::set_mask`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RayMask(pub u32);

impl RayMask {
    /// All nodes but those whose mask, combined (and) with those of all nodes above, is 0.
    pub const ALL: Self = Self(u32::MAX);
}

/// Queries by the batch, traced by the renderer's tracer with all its threads. Hits follow the rules of a frame's rays.
impl Renderer {
    /// The closest hit of each ray, among the nodes that `mask` shows. Compiles and uploads the scene as
    /// [`prepare`](Renderer::prepare) does, then traces; on a GPU, a batch is split to fit the device's buffer limits.
    ///
    /// For a few rays, [`Queries::closest_hit`] is faster and exact. Rays of a batch are moved to just before the
    /// bounds of the scene and rounded to f32 relative to the [render origin](Renderer::render_origin). A ray that
    /// passes an edge within this rounding may hit or miss, and [`t_min`](Ray::t_min) and [`t_max`](Ray::t_max) are
    /// exact only up to it.
    ///
    /// ```
    /// use ropewalk::glam::{DVec3, Vec3};
    /// use ropewalk::render::RayMask;
    /// use ropewalk::{Core, DeviceChoice, Geometry, Material, Ray, Renderer, RendererOptions, Scene, Transform};
    ///
    /// // A triangle at z = -5.
    /// let mut scene = Scene::new();
    /// let geometry = scene.add_geometry(Geometry::new([Vec3::NEG_X, Vec3::X, Vec3::Y], [[0, 1, 2]]))?;
    /// let material = scene.add_material(Material::default())?;
    /// let place = scene.add(scene.root(), Transform::from_translation(DVec3::new(0.0, 0.0, -5.0)))?;
    /// let triangle = scene.add(place, Core::Geometry { geometry, material })?;
    ///
    /// let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu))?;
    /// let rays = [0.5, 2.0].map(|y| Ray::new(DVec3::new(0.0, y, 0.0), DVec3::NEG_Z));
    /// let hits = renderer.closest_hits(&mut scene, &rays, RayMask::ALL)?;
    /// assert_eq!((hits.distance(0), hits.distance(1)), (Some(5.0), None));
    /// let hit = hits.get(0).unwrap();
    /// assert_eq!((hit.path.node, hit.triangle, hit.position), (triangle, 0, DVec3::new(0.0, 0.5, -5.0)));
    /// assert_eq!(renderer.any_hits(&mut scene, &rays, RayMask::ALL)?, [true, false]);
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`Ray::validate`] and [`prepare`](Renderer::prepare).
    pub fn closest_hits<'a>(
        &'a mut self,
        scene: &'a mut Scene,
        rays: &[Ray],
        mask: RayMask,
    ) -> Result<ClosestHits<'a>> {
        let batch = self.relative_rays(scene, rays)?;
        let records: Vec<layout::RayRecord> = batch.iter().map(|ray| ray.record).collect();
        let traced = self.device.tracer_mut().closest_hits(self.compiler.arrays(), &records, mask.0);
        let hits = self.device.record_failure(traced)?;
        let distances = hits.iter().zip(&batch).map(|(hit, ray)| ray.distance(hit.t)).collect();
        Ok(ClosestHits { queries: Queries::of_compiled_scene(&self.compiler, scene)?, hits, distances })
    }

    /// Occlusion of each ray, as of a shadow ray: whether it hits an opaque surface of a node that `mask` shows. Unlike
    /// in [`closest_hits`](Renderer::closest_hits), back faces are hit too, and surfaces that blend or transmit never
    /// are.
    ///
    /// # Errors
    /// As [`closest_hits`](Renderer::closest_hits).
    pub fn any_hits(&mut self, scene: &mut Scene, rays: &[Ray], mask: RayMask) -> Result<Vec<bool>> {
        let records: Vec<_> = self.relative_rays(scene, rays)?.iter().map(|ray| ray.record).collect();
        let traced = self.device.tracer_mut().any_hits(self.compiler.arrays(), &records, mask.0);
        self.device.record_failure(traced)
    }

    /// Compiles and uploads the scene, and converts the rays to records relative to the render origin.
    fn relative_rays(&mut self, scene: &mut Scene, rays: &[Ray]) -> Result<Vec<RelativeRay>> {
        rays.iter().try_for_each(Ray::validate)?;
        self.prepare(scene)?;
        let bounds = Queries::of_compiled_scene(&self.compiler, scene)?.bounds();
        let origin = self.render_origin();
        Ok(rays.par_iter().map(|ray| RelativeRay::new(ray, origin, &bounds)).collect())
    }
}

/// The closest hits of a batch of rays, in their order. They borrow the scene, which cannot be edited meanwhile.
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

    /// Distance to the hit of ray `i`, in units of its direction's length; `None` if it misses, or if there is no ray
    /// `i`.
    pub fn distance(&self, i: usize) -> Option<f64> {
        self.hits.get(i).filter(|hit| hit.instance != NONE).map(|_| self.distances[i])
    }

    /// The hit of ray `i`, with its node and material looked up on the CPU; `None` if it misses.
    pub fn get(&self, i: usize) -> Option<Hit> {
        self.queries.hit_from_record(self.hits.get(i)?, self.distances[i])
    }

    /// The hit of each ray.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Option<Hit>> + '_ {
        (0..self.len()).map(|i| self.get(i))
    }

    /// The hit records as traced: 32 bytes each, with indices into the [device arrays](crate::device::DeviceArrays).
    /// Their `t` is that of the moved and scaled ray: [`distance`](Self::distance) has the unit of the ray that was
    /// given.
    pub fn records(&self) -> &[layout::HitRecord] {
        &self.hits
    }
}

/// A ray record relative to the render origin, and the map from its t to that of the given ray:
/// `t_offset + t / t_scale`.
struct RelativeRay {
    record: layout::RayRecord,
    /// The given ray's t where the record's ray starts.
    t_offset: f64,
    /// The record's t for each unit of the given ray's: a power of two, so that the conversion does not round.
    t_scale: f64,
}

impl RelativeRay {
    /// A ray whose interval of t is empty, so that it misses everything.
    const MISS: Self = Self {
        record: layout::RayRecord { origin: [0.0; 3], t_min: 1.0, direction: [1.0, 0.0, 0.0], t_max: 0.0 },
        t_offset: 0.0,
        t_scale: 1.0,
    };

    fn new(ray: &Ray, origin: DVec3, bounds: &Bounds) -> Self {
        // 1. Scale the direction by a power of two, so that its longest component is between 1 and 2.
        let t_scale = power_of_two(ray.direction.abs().max_element());
        let direction = ray.direction / t_scale;

        // 2. Move the start to two sizes of the scene before its bounds, but not before the ray's own start, unless its
        //    interval begins behind that.
        let Some(entry) = box_entry(bounds, ray.origin, direction) else { return Self::MISS };
        let size = (bounds.min - origin).abs().max((bounds.max - origin).abs()).max_element();
        // The offset is a multiple of a power of two, so that adding it to a distance does not round.
        let step = power_of_two(size);
        let t_offset = (((entry - 2.0 * size) / step).floor() * step / t_scale).max(ray.t_min.min(0.0));
        let from = (ray.origin - origin) + ray.direction * t_offset;

        // 3. Round to f32, where the numbers are within its range.
        let most = f64::from(f32::MAX);
        let [t_min, t_max] = [ray.t_min, ray.t_max].map(|t| ((t - t_offset) * t_scale).clamp(-most, most) as f32);
        let record = layout::RayRecord {
            origin: from.as_vec3().to_array(),
            t_min: t_min.max(0.0),
            direction: direction.as_vec3().to_array(),
            t_max,
        };
        // A ray whose start is beyond f32, or that ends before it, hits nothing.
        if from.as_vec3().is_finite() && t_max >= 0.0 { Self { record, t_offset, t_scale } } else { Self::MISS }
    }

    /// The given ray's t for one of the record's ray.
    fn distance(&self, t: f32) -> f64 {
        self.t_offset + f64::from(t) / self.t_scale
    }
}

/// The greatest power of two that is not above `value`, a positive number; at least the least normal one.
fn power_of_two(value: f64) -> f64 {
    f64::from_bits(value.to_bits() & f64::INFINITY.to_bits()).max(f64::MIN_POSITIVE)
}

/// The t at which a line enters a box; `None` if it passes the box, or the box is empty.
fn box_entry(bounds: &Bounds, origin: DVec3, direction: DVec3) -> Option<f64> {
    if bounds.is_empty() {
        return None;
    }
    // Intersect the intervals of t in which the line is between the two planes of each axis.
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let (low, high) = (bounds.min[axis] - origin[axis], bounds.max[axis] - origin[axis]);
        if direction[axis] == 0.0 {
            // A line parallel to the planes is between them everywhere or nowhere.
            if low > 0.0 || high < 0.0 {
                return None;
            }
            continue;
        }
        let (a, b) = (low / direction[axis], high / direction[axis]);
        (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
    }
    // Rounding may have moved the line to just beside the box.
    let slack = 1e-6 * near.abs().max(far.abs());
    (near <= far + slack).then_some(near)
}
