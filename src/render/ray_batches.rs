//! Batches of the application's rays, traced by the renderer's tracer.

use glam::DVec3;
use rayon::prelude::*;

use super::Renderer;
use crate::Result;
use crate::compile::Compiler;
use crate::device::layout::{self, NONE};
use crate::graph::Scene;
use crate::math::{Bounds, power_of_two};
use crate::query::{Hit, Queries, Ray};

/// Which nodes rays of a batch can hit: those whose mask, combined (and) with the masks of all nodes above, has a bit
/// in common with it (see [`Scene::set_mask`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RayMask(pub u32);

impl RayMask {
    /// All nodes but those whose mask, combined (and) with those of all nodes above, is 0.
    pub const ALL: Self = Self(u32::MAX);
}

/// How exact the closest hits of a batch are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Precision {
    /// As the executor finds them, in f32: the distance of a surface seen at right angles is off by a few times 2^-24
    /// of it, and of two surfaces that are nearer to each other than that the farther one may be hit.
    #[default]
    Fast,
    /// Each hit is found again in f64, among all surfaces within the rounding of the first: triangle, distance and
    /// barycentrics are those of [`Queries::closest_hit`]. A ray that misses in f32 stays a miss: it may pass a
    /// silhouette within rounding. Costs a short query on the CPU for each hit, with all threads.
    Refined,
}

/// What a batch may hit, and how exactly: a [`RayMask`] converts to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct BatchOptions {
    /// Which nodes rays can hit; all by default.
    pub mask: RayMask,
    /// How exact the hits are.
    pub precision: Precision,
}

impl Default for BatchOptions {
    fn default() -> Self {
        RayMask::ALL.into()
    }
}

impl From<RayMask> for BatchOptions {
    fn from(mask: RayMask) -> Self {
        Self { mask, precision: Precision::default() }
    }
}

impl BatchOptions {
    /// The same with another mask.
    #[must_use]
    pub fn with_mask(self, mask: RayMask) -> Self {
        Self { mask, ..self }
    }

    /// The same with another precision.
    #[must_use]
    pub fn with_precision(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }
}

/// Queries by the batch, traced by the renderer's tracer with all its threads. Hits follow the rules of a frame's rays.
impl Renderer {
    /// The closest hit of each ray, among the nodes that the options show. Compiles and uploads the scene as
    /// [`prepare`](Renderer::prepare) does, then traces; on a GPU, a batch is split to fit the device's buffer limits.
    ///
    /// For a few rays, [`Queries::closest_hit`] is faster and exact. Rays of a batch are moved to just before the
    /// bounds of the scene and rounded to f32 relative to the [render origin](Renderer::render_origin). A ray that
    /// passes an edge within this rounding may hit or miss, and [`t_min`](Ray::t_min) and [`t_max`](Ray::t_max) are
    /// exact only up to it.
    ///
    /// That rounding is 2^-24 of the distance to the render origin, which moves to where the rays start if they are
    /// farther from it than a camera may be, or too far for what is near them: if the rounding is more than 2^-16 of
    /// the size of something there, or of its distance. This writes all instances anew, O(instances). Rays that start
    /// in several places, so far apart that no origin suits all of them (more than 2^-8), are traced place by place, up
    /// to 64.
    ///
    /// ```
    /// use ropewalk::glam::{DVec3, Vec3};
    /// use ropewalk::render::{BatchOptions, Precision, RayMask};
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
    ///
    /// let refined = BatchOptions::default().with_precision(Precision::Refined);
    /// let slanted = Ray::new(DVec3::new(0.0, 0.5, 0.0), DVec3::new(0.01, 0.0, -1.0));
    /// let hits = renderer.closest_hits(&mut scene, &[slanted], refined)?;
    /// assert!((hits.get(0).unwrap().position.x - 0.05).abs() < 1e-15);
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`Ray::validate`] and [`prepare`](Renderer::prepare).
    pub fn closest_hits<'a>(
        &'a mut self,
        scene: &'a mut Scene,
        rays: &[Ray],
        options: impl Into<BatchOptions>,
    ) -> Result<ClosestHits<'a>> {
        let BatchOptions { mask, precision } = options.into();
        let mut found = vec![FoundHit::MISS; rays.len()];
        self.trace_by_place(scene, rays, |renderer, scene, group| {
            let traced =
                renderer.device.tracer_mut().closest_hits(renderer.compiler.arrays(), &group.records(), mask.0);
            let hits = renderer.device.record_failure(traced)?;
            let queries = Queries::of_compiled_scene(&renderer.compiler, scene)?.with_ray_mask(mask.0);
            let resolve = |(&record, &(index, relative)): (&layout::HitRecord, &(usize, RelativeRay))| {
                let hit = FoundHit::new(record, &relative);
                if precision == Precision::Refined { hit.refined(&queries, &rays[index], &relative) } else { hit }
            };
            let resolved: Vec<FoundHit> = hits.par_iter().zip(&group.rays).map(resolve).collect();
            group.rays.iter().zip(resolved).for_each(|(&(index, _), hit)| found[index] = hit);
            Ok(())
        })?;
        Ok(ClosestHits { queries: Queries::of_compiled_scene(&self.compiler, scene)?, hits: found })
    }

    /// Occlusion of each ray, as of a shadow ray: whether it hits an opaque surface of a node that `mask` shows. Unlike
    /// in [`closest_hits`](Renderer::closest_hits), back faces are hit too, and surfaces that blend or transmit never
    /// are.
    ///
    /// # Errors
    /// As [`closest_hits`](Renderer::closest_hits).
    pub fn any_hits(&mut self, scene: &mut Scene, rays: &[Ray], mask: RayMask) -> Result<Vec<bool>> {
        let mut found = vec![false; rays.len()];
        self.trace_by_place(scene, rays, |renderer, _, group| {
            let traced = renderer.device.tracer_mut().any_hits(renderer.compiler.arrays(), &group.records(), mask.0);
            let hits = renderer.device.record_failure(traced)?;
            group.rays.iter().zip(hits).for_each(|(&(index, _), hit)| found[index] = hit);
            Ok(())
        })?;
        Ok(found)
    }

    /// Compiles and uploads the scene, and calls `trace` with all rays that may hit something: those of one place, for
    /// which the render origin is near enough, after the other.
    fn trace_by_place(
        &mut self,
        scene: &mut Scene,
        rays: &[Ray],
        mut trace: impl FnMut(&mut Self, &mut Scene, &RayGroup) -> Result<()>,
    ) -> Result<()> {
        rays.iter().try_for_each(Ray::validate)?;
        self.prepare(scene)?;
        let bounds = Queries::of_compiled_scene(&self.compiler, scene)?.bounds();
        let starts: Vec<Option<DVec3>> = rays.par_iter().map(|ray| start_within(ray, &bounds)).collect();
        let all = starts.iter().enumerate().filter_map(|(index, start)| start.map(|start| (index, start))).collect();
        let mut places = vec![Place { starts: all, splits: MOST_SPLITS }];
        while let Some(place) = places.pop() {
            if place.starts.is_empty() {
                continue;
            }
            // The render origin moves if it must. What is too far apart even then is split.
            let around = place.bounds();
            let can_be_one = |compiler: &Compiler| !compiler.has_detail_below(&around, around.radius() / COARSEST);
            if can_be_one(&self.compiler) || place.splits == 0 {
                self.prepare_by(scene, |compiler, scene| compiler.compile_around(scene, &around))?;
                if can_be_one(&self.compiler) || place.splits == 0 {
                    let origin = self.render_origin();
                    let bounds = Queries::of_compiled_scene(&self.compiler, scene)?.bounds();
                    let relative = |&(index, _): &(usize, DVec3)| {
                        RelativeRay::new(&rays[index], origin, &bounds).map(|ray| (index, ray))
                    };
                    let rays = place.starts.par_iter().filter_map(relative).collect();
                    trace(self, scene, &RayGroup { rays })?;
                    continue;
                }
            }
            places.extend(place.split(&around));
        }
        Ok(())
    }
}

/// How many times the rays of a batch are split at most, one half after the other: into 64 places.
const MOST_SPLITS: u32 = 6;
/// Rays whose starts are this many times as far apart as the [nearest extent](Compiler::has_detail_below), 2^16, are
/// split: positions are off by up to 2^-8 of the extent.
const COARSEST: f64 = 65536.0;

/// Rays that start near each other: the index of each, and where it begins to matter.
struct Place {
    starts: Vec<(usize, DVec3)>,
    /// How often it may still be split.
    splits: u32,
}

impl Place {
    fn bounds(&self) -> Bounds {
        let point = |&(_, start): &(usize, DVec3)| Bounds { min: start, max: start };
        self.starts.iter().map(point).fold(Bounds::EMPTY, Bounds::union)
    }

    /// The two halves of the longest side.
    fn split(self, bounds: &Bounds) -> [Self; 2] {
        let axis = (bounds.max - bounds.min).max_position();
        let middle = bounds.center()[axis];
        let (low, high) = self.starts.into_iter().partition(|(_, start)| start[axis] < middle);
        [low, high].map(|starts| Self { starts, splits: self.splits - 1 })
    }
}

/// Rays that are traced together, with the index of each in the batch.
struct RayGroup {
    rays: Vec<(usize, RelativeRay)>,
}

impl RayGroup {
    fn records(&self) -> Vec<layout::RayRecord> {
        self.rays.iter().map(|(_, ray)| ray.record).collect()
    }
}

/// The hit of a ray of a batch.
#[derive(Clone, Copy, Debug)]
struct FoundHit {
    record: layout::HitRecord,
    /// In units of the given ray's direction.
    distance: f64,
    /// Of the second and third vertex.
    weights: [f64; 2],
}

impl FoundHit {
    const MISS: Self = Self { record: layout::HitRecord::MISS, distance: f64::INFINITY, weights: [0.0; 2] };

    fn new(record: layout::HitRecord, ray: &RelativeRay) -> Self {
        Self { record, distance: ray.distance(record.t), weights: [record.u, record.v].map(f64::from) }
    }

    /// The hit found again in f64.
    fn refined(self, queries: &Queries<'_>, ray: &Ray, relative: &RelativeRay) -> Self {
        if self.record.instance == NONE {
            return self;
        }
        // The rounding of positions in units of the given ray's t.
        let rounding = relative.position_rounding / ray.direction.length();
        let Some(exact) = queries.closest_hit_near(ray, &self.record, self.distance, rounding) else {
            return Self::MISS;
        };
        let t = relative.record_t(exact.distance);
        let [_, u, v] = exact.barycentrics.to_array();
        let record = layout::HitRecord {
            t,
            u: u as f32,
            v: v as f32,
            instance: exact.instance_index,
            primitive: exact.primitive,
            triangle: exact.triangle,
            back_face: exact.back_face.into(),
            depth: t,
        };
        Self { record, distance: exact.distance, weights: [u, v] }
    }
}

/// The closest hits of a batch of rays, in their order. They borrow the scene, which cannot be edited meanwhile.
#[derive(Debug)]
pub struct ClosestHits<'a> {
    queries: Queries<'a>,
    hits: Vec<FoundHit>,
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
        self.hits.get(i).filter(|hit| hit.record.instance != NONE).map(|hit| hit.distance)
    }

    /// The hit of ray `i`, with its node and material looked up on the CPU; `None` if it misses.
    pub fn get(&self, i: usize) -> Option<Hit> {
        let FoundHit { record, distance, weights } = self.hits.get(i)?;
        self.queries.hit_from_record(record, *weights, *distance)
    }

    /// The hit of each ray.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Option<Hit>> + '_ {
        (0..self.len()).map(|i| self.get(i))
    }

    /// The hit records, with indices into the [device arrays](crate::device::DeviceArrays). Their `t` is that of the
    /// moved and scaled ray: [`distance`](Self::distance) has the unit of the ray that was given.
    pub fn records(&self) -> impl ExactSizeIterator<Item = &layout::HitRecord> {
        self.hits.iter().map(|hit| &hit.record)
    }
}

/// A ray record relative to the render origin, and the map from its t to that of the given ray:
/// `t_offset + t / t_scale`.
#[derive(Clone, Copy, Debug)]
struct RelativeRay {
    record: layout::RayRecord,
    /// The given ray's t where the record's ray starts.
    t_offset: f64,
    /// The record's t for each unit of the given ray's: a power of two, so that the conversion does not round.
    t_scale: f64,
    /// A bound on the rounding of positions: 2^-20 of the greatest distance from the render origin.
    position_rounding: f64,
}

impl RelativeRay {
    /// `None` for a ray that hits nothing: it passes the bounds, ends before them, or starts beyond f32.
    fn new(ray: &Ray, origin: DVec3, bounds: &Bounds) -> Option<Self> {
        // 1. Scale the direction by a power of two, so that its longest component is between 1 and 2.
        let t_scale = power_of_two(ray.direction.abs().max_element());
        let direction = ray.direction / t_scale;

        // 2. Move the start to two sizes of the scene before its bounds, but not before the ray's own start, unless its
        //    interval begins behind that.
        let entry = box_entry(bounds, ray.origin, direction)?;
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
        let position_rounding = size.max(from.abs().max_element()) / f64::from(1 << 20);
        let can_hit = from.as_vec3().is_finite() && t_max >= 0.0;
        can_hit.then_some(Self { record, t_offset, t_scale, position_rounding })
    }

    /// The given ray's t for one of the record's ray.
    fn distance(&self, t: f32) -> f64 {
        self.t_offset + f64::from(t) / self.t_scale
    }

    /// The record's t for one of the given ray.
    fn record_t(&self, distance: f64) -> f32 {
        ((distance - self.t_offset) * self.t_scale) as f32
    }
}

/// Where a ray begins to matter: its start, or where it enters the bounds of the scene; `None` if it passes them.
fn start_within(ray: &Ray, bounds: &Bounds) -> Option<DVec3> {
    let t_scale = power_of_two(ray.direction.abs().max_element());
    let direction = ray.direction / t_scale;
    let entry = box_entry(bounds, ray.origin, direction)?;
    let t = entry.max((ray.t_min * t_scale).clamp(f64::MIN, 0.0));
    Some((ray.origin + direction * t).clamp(bounds.min, bounds.max))
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
