//! The rays that executors and peers are measured with: the same for all, on every machine.

use std::f32::consts::TAU;

use clap::ValueEnum;
use glam::Vec3;
use rayon::prelude::*;
use ropewalk::device::layout::{HitRecord, NONE, RayRecord};
use ropewalk::trace::{Emulated, Tracer as _};
use ropewalk::{Camera, View};

use crate::Result;
use crate::scenes::BenchScene;

/// The kinds of rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RayKind {
    /// From the eye through each pixel, in blocks of 4 by 4 pixels.
    Primary,
    /// From the hits of the primary rays to one light; any-hit queries.
    Shadow,
    /// The primary rays that hit something, reflected once.
    Mirror,
    /// One cosine-distributed ray from each point that a primary ray hit.
    Diffuse,
}

impl RayKind {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Primary, Self::Shadow, Self::Mirror, Self::Diffuse];

    /// The value of `--rays`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Primary => "primary",
            Self::Shadow => "shadow",
            Self::Mirror => "mirror",
            Self::Diffuse => "diffuse",
        }
    }

    /// Whether these are any-hit queries.
    pub fn is_any_hit(self) -> bool {
        self == Self::Shadow
    }

    /// Whether neighbouring rays have similar origins and directions.
    pub fn is_coherent(self) -> bool {
        matches!(self, Self::Primary | Self::Shadow)
    }
}

/// All rays of a scene, in the world space of its device arrays. Directions have length 1.
#[derive(Clone, Debug)]
pub struct RaySets([Vec<RayRecord>; 4]);

/// Rays that one task traces.
const CHUNK: usize = 1 << 12;
/// How far from a surface a ray starts, in units of the largest coordinate of the surface or the eye: more than any
/// tracer's error.
const OFFSET: f32 = 1.0 / (1 << 16) as f32;
/// How much of the way to the light a shadow ray goes.
const TO_LIGHT: f32 = 1.0 - 1.0 / (1 << 12) as f32;

impl RaySets {
    /// Traces the primary rays, to know where the others start.
    ///
    /// # Errors
    /// As [`Tracer::closest_hits`](ropewalk::trace::Tracer::closest_hits).
    pub fn new(scene: &BenchScene) -> Result<Self> {
        let primary = primary(scene);
        let hits = closest_hits(scene, &primary)?;
        let mut random = fastrand::Rng::with_seed(2);
        let [mut shadow, mut mirror, mut diffuse] = [const { Vec::new() }; 3];
        for (ray, hit) in primary.iter().zip(&hits).filter(|(_, hit)| hit.instance != NONE) {
            let surface = Surface::new(scene, ray, hit);
            let incoming = Vec3::from_array(ray.direction);
            let to_light = scene.light - surface.origin;
            shadow.push(RayRecord { t_max: to_light.length() * TO_LIGHT, ..surface.ray(to_light) });
            mirror.push(surface.ray(incoming - 2.0 * incoming.dot(surface.normal) * surface.normal));
            diffuse.push(surface.ray(surface.cosine_direction(&mut random)));
        }
        Ok(Self([primary, shadow, mirror, diffuse]))
    }

    /// The rays of one kind.
    pub fn of(&self, kind: RayKind) -> &[RayRecord] {
        &self.0[kind as usize]
    }
}

fn closest_hits(scene: &BenchScene, rays: &[RayRecord]) -> Result<Vec<HitRecord>> {
    let hits = rays.par_chunks(CHUNK).map(|rays| Emulated::default().closest_hits(scene.arrays(), rays, NONE));
    Ok(hits.collect::<ropewalk::Result<Vec<_>>>()?.concat())
}

fn any_hits(scene: &BenchScene, rays: &[RayRecord]) -> Result<Vec<bool>> {
    let hits = rays.par_chunks(CHUNK).map(|rays| Emulated::default().any_hits(scene.arrays(), rays, NONE));
    Ok(hits.collect::<ropewalk::Result<Vec<_>>>()?.concat())
}

/// What the executor `emulated` finds, as [`closest_answer`] and [`any_answer`] have it.
///
/// # Errors
/// As [`Tracer::closest_hits`](ropewalk::trace::Tracer::closest_hits).
pub fn true_answers(scene: &BenchScene, rays: &[RayRecord], kind: RayKind) -> Result<Vec<f32>> {
    if kind.is_any_hit() {
        return Ok(any_hits(scene, rays)?.into_iter().map(any_answer).collect());
    }
    Ok(closest_hits(scene, rays)?.iter().map(closest_answer).collect())
}

/// The distance of a hit; infinity for a miss.
pub fn closest_answer(hit: &HitRecord) -> f32 {
    if hit.instance == NONE { f32::INFINITY } else { hit.t }
}

/// The same for any-hit queries, which have no distance: 0 for a hit.
pub fn any_answer(is_hit: bool) -> f32 {
    if is_hit { 0.0 } else { f32::INFINITY }
}

/// The number of rays whose answers differ between two tracers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Differences {
    /// One ray hit, the other did not.
    pub verdicts: usize,
    /// Both hit, at distances that are more than 1e-4 apart, relatively.
    pub distances: usize,
}

impl Differences {
    /// Compares two lists of answers to the same rays. Each answer that one list lacks counts as another verdict.
    pub fn between(ours: &[f32], theirs: &[f32]) -> Self {
        const SAME: f32 = 1e-4;
        let mut differences = Self { verdicts: ours.len().abs_diff(theirs.len()), distances: 0 };
        for (&a, &b) in ours.iter().zip(theirs) {
            differences.verdicts += usize::from(a.is_finite() != b.is_finite());
            differences.distances += usize::from(a.is_finite() && b.is_finite() && (a - b).abs() > SAME * a.max(b));
        }
        differences
    }
}

/// The distance at which a ray hits a triangle, from either side, before `t_max`: the test of Möller and Trumbore, for
/// peers without a triangle test.
#[inline]
pub fn meet(ray: &RayRecord, [v0, v1, v2]: &[Vec3; 3], t_max: f32) -> Option<f32> {
    let [origin, direction] = [ray.origin, ray.direction].map(Vec3::from_array);
    let (edge_1, edge_2, to_origin) = (v1 - v0, v2 - v0, origin - v0);
    let (p, q) = (direction.cross(edge_2), to_origin.cross(edge_1));
    let scale = edge_1.dot(p).recip();
    let (u, v, t) = (to_origin.dot(p) * scale, direction.dot(q) * scale, edge_2.dot(q) * scale);
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= ray.t_min && t < t_max).then_some(t)
}

/// Through the middle of each pixel, block after block, row by row.
fn primary(scene: &BenchScene) -> Vec<RayRecord> {
    const BLOCK: u32 = 4;
    let pose = &scene.view.world_from_view;
    let [right, up, back] =
        [pose.matrix3.x_axis, pose.matrix3.y_axis, pose.matrix3.z_axis].map(|axis| axis.normalize().as_vec3());
    let half_height = match scene.view.camera {
        Camera::Perspective { y_fov, .. } => (0.5 * y_fov).tan(),
        Camera::Orthographic { y_mag, .. } => y_mag,
    };
    let View { width, height, .. } = scene.view;
    let (origin, pixel) = (pose.translation.as_vec3(), 2.0 * half_height / height as f32);
    let ray = |x: u32, y: u32| {
        let (x, y) = (x as f32 + 0.5 - 0.5 * width as f32, 0.5 * height as f32 - y as f32 - 0.5);
        ray(origin, right * (x * pixel) + up * (y * pixel) - back)
    };
    let blocks = (0..height / BLOCK).flat_map(|y| (0..width / BLOCK).map(move |x| [x * BLOCK, y * BLOCK]));
    blocks.flat_map(|[x, y]| (0..BLOCK * BLOCK).map(move |i| ray(x + i % BLOCK, y + i / BLOCK))).collect()
}

fn ray(origin: Vec3, direction: Vec3) -> RayRecord {
    RayRecord { origin: origin.to_array(), t_min: 0.0, direction: direction.normalize().to_array(), t_max: f32::MAX }
}

/// The surface at a hit.
struct Surface {
    /// A little off the surface, on the ray's side.
    origin: Vec3,
    /// The triangle's own, towards the ray.
    normal: Vec3,
}

impl Surface {
    fn new(scene: &BenchScene, ray: &RayRecord, hit: &HitRecord) -> Self {
        let [origin, direction] = [ray.origin, ray.direction].map(Vec3::from_array);
        let [v0, v1, v2] = scene.corners(hit);
        let normal = (v1 - v0).cross(v2 - v0).normalize_or(-direction);
        let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
        let position = v0 + (v1 - v0) * hit.u + (v2 - v0) * hit.v;
        let reach = position.abs().max(origin.abs()).max_element();
        Self { origin: position + normal * (OFFSET * reach), normal }
    }

    fn ray(&self, direction: Vec3) -> RayRecord {
        ray(self.origin, direction)
    }

    /// Malley's method: a point of the disc, lifted to the hemisphere.
    fn cosine_direction(&self, random: &mut fastrand::Rng) -> Vec3 {
        let (share, angle) = (random.f32(), TAU * random.f32());
        let (tangent, bitangent) = self.normal.any_orthonormal_pair();
        let radius = share.sqrt();
        tangent * (radius * angle.cos()) + bitangent * (radius * angle.sin()) + self.normal * (1.0 - share).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layouts::{Layout, LayoutScene};
    use crate::scenes::{ImageSize, SCENES};

    #[test]
    fn differences_are_seen() {
        let infinity = f32::INFINITY;
        let ours = [1.0, 2.0, infinity, 0.0, infinity];
        assert_eq!(Differences::between(&ours, &ours), Differences::default());
        let theirs = [1.0 + 9e-5, 2.001, 5.0, infinity, infinity];
        assert_eq!(Differences::between(&ours, &theirs), Differences { verdicts: 2, distances: 1 });
        assert_eq!(Differences::between(&ours, &ours[..3]).verdicts, 2);
    }

    #[test]
    fn layouts_find_what_the_kernel_finds() {
        let scene = SCENES.iter().find(|recipe| recipe.name == "sphere").unwrap().load(ImageSize::Paper).unwrap();
        let sets = RaySets::new(&scene).unwrap();
        for kind in RayKind::ALL {
            let rays: Vec<RayRecord> = sets.of(kind).iter().step_by(7).copied().collect();
            let truth = true_answers(&scene, &rays, kind).unwrap();
            // Rays that leave a sphere's surface do not hit it again.
            let hit_share = truth.iter().filter(|t| t.is_finite()).count() as f64 / rays.len() as f64;
            let expected = match kind {
                RayKind::Primary => 0.42..0.44,
                RayKind::Shadow => 0.35..0.37,
                RayKind::Mirror | RayKind::Diffuse => 0.0..1e-9,
            };
            assert!(expected.contains(&hit_share), "{kind:?}: {hit_share}");
            for laid_out in Layout::ALL.map(|layout| LayoutScene::new(scene.arrays(), layout)) {
                let (answers, totals) = laid_out.trace(&rays, kind.is_any_hit());
                let Differences { verdicts, distances } = Differences::between(&truth, &answers);
                // Möller and Trumbore's test loses a ray at an edge now and then.
                assert!(verdicts <= 1 && distances == 0, "{kind:?}: {verdicts} verdicts, {distances} distances");
                assert!(totals.counts.nodes > 0 && (0.1..=1.0).contains(&totals.lockstep_efficiency));
            }
        }
    }
}
