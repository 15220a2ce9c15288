//! The closest hit by brute force in f64, with bounds of the errors that a kernel may make in f32; and which triangles
//! have an area.

use glam::{DMat3, DVec3, Vec3};
use robust::{Coord, orient2d};
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{HitRecord, InstanceFlags, InstanceRecord, NONE, RayRecord, Triangle};

/// The relative error of one operation in f32: WGSL allows rounding up or down.
const ROUNDING: f64 = 1.0 / (1 << 23) as f64;
/// The kernel's tolerances of corners and edge functions.
const CORNER_TOLERANCE: f64 = 1.0 / (1 << 22) as f64;
const EDGE_TOLERANCE: f64 = 1.0 / (1 << 21) as f64;

/// The intersection of a ray and a triangle in f64.
pub struct Candidate {
    pub instance: u32,
    pub primitive: u32,
    /// Whether the ray hits the triangle, if that is certain.
    pub verdict: Verdict,
    pub t: f64,
    /// The greatest error of `t` in f32.
    pub t_error: f64,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Verdict {
    Hit,
    Miss,
    /// So near an edge that rounding decides.
    Tie,
}

/// A contradiction between the kernel's answer and f64.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Fault {
    /// The kernel reported a miss, but a triangle is certainly hit.
    FalseMiss,
    /// The kernel reported a triangle that is certainly missed, or culled, or masked out.
    FalseHit,
    /// Another triangle is certainly hit, and certainly nearer.
    WrongTriangle,
    /// The kernel reported the right triangle at a wrong distance.
    WrongDistance,
}

/// The ray in an instance's space in f64, with bounds of its errors in f32.
struct LocalRay {
    origin: DVec3,
    direction: DVec3,
    /// Largest component of `direction`.
    axis: usize,
    origin_error: f64,
    /// Relative to the largest component.
    direction_error: f64,
}

/// All triangles that the ray hits or may hit from `t_min` to `t_max`, each with the bound of its error.
pub fn candidates(arrays: &DeviceArrays, ray: &RayRecord, ray_mask: u32) -> Vec<Candidate> {
    let mut found = Vec::new();
    for (index, instance) in (0..).zip(arrays.instances.iter()) {
        if instance.mask & ray_mask == 0 {
            continue;
        }
        let local = LocalRay::new(instance, ray);
        for triangle in triangles_of(arrays, instance) {
            let Some(candidate) = local.meet(index, triangle) else { continue };
            let is_culled = InstanceFlags::from_bits_retain(instance.flags).contains(InstanceFlags::CULL_BACK)
                && is_back_facing_in_world(instance, triangle, ray);
            if !is_culled {
                found.push(candidate);
            }
        }
    }
    found
}

/// Whether the ray hits the candidate within its interval however the computation is rounded.
pub fn is_sure(candidate: &Candidate, ray: &RayRecord) -> bool {
    candidate.verdict == Verdict::Hit
        && candidate.t - candidate.t_error >= f64::from(ray.t_min)
        && candidate.t + candidate.t_error <= f64::from(ray.t_max)
}

/// Compares the kernel's hit with the candidates of its ray.
pub fn fault(ray: &RayRecord, hit: &HitRecord, candidates: &[Candidate]) -> Option<Fault> {
    let nearest = candidates.iter().filter(|c| is_sure(c, ray)).map(|c| c.t + c.t_error).min_by(f64::total_cmp);
    if hit.instance == NONE {
        return nearest.map(|_| Fault::FalseMiss);
    }
    let is_it = |c: &&Candidate| (c.instance, c.primitive) == (hit.instance, hit.primitive);
    let Some(own) = candidates.iter().find(is_it) else { return Some(Fault::FalseHit) };
    if (f64::from(hit.t) - own.t).abs() > own.t_error || hit.t < ray.t_min || hit.t > ray.t_max {
        return Some(Fault::WrongDistance);
    }
    nearest.is_some_and(|t| t < own.t - own.t_error).then_some(Fault::WrongTriangle)
}

fn triangles_of<'a>(arrays: &'a DeviceArrays, instance: &InstanceRecord) -> &'a [Triangle] {
    let starts = arrays.instances.iter().map(|i| i.first_triangle).filter(|&t| t > instance.first_triangle);
    let end = starts.min().map_or(arrays.triangles.len(), |t| t as usize);
    &arrays.triangles[instance.first_triangle as usize..end]
}

impl LocalRay {
    fn new(instance: &InstanceRecord, ray: &RayRecord) -> Self {
        let rows = instance.local_from_world.map(|r| r.map(f64::from));
        let linear = DMat3::from_cols_array_2d(&rows.map(|[x, y, z, _]| [x, y, z])).transpose();
        let translation = DVec3::from_array(rows.map(|r| r[3]));
        let (origin, direction) = (vector(ray.origin), vector(ray.direction));
        let local_direction = linear * direction;
        let axis = local_direction.abs().max_position();
        // Each component is a sum of four (three) products, of which each is rounded at most four times.
        let magnitudes = DMat3::from_cols(linear.x_axis.abs(), linear.y_axis.abs(), linear.z_axis.abs());
        let origin_error = 4.0 * ROUNDING * (magnitudes * origin.abs() + translation.abs()).max_element();
        let direction_error = 3.0 * ROUNDING * (magnitudes * direction.abs()).max_element();
        Self {
            origin: linear * origin + translation,
            direction: local_direction,
            axis,
            origin_error,
            direction_error: direction_error / local_direction[axis].abs(),
        }
    }

    /// `None` for a sure miss.
    ///
    /// Let every sheared x and y be off by at most `error`, from the transformed origin and direction and from the
    /// kernel's own shear. An edge function, a difference of products of two of them, is then off by `edge_error`,
    /// and the kernel accepts it down to minus `tolerance`.
    fn meet(&self, instance: u32, triangle: &Triangle) -> Option<Candidate> {
        let (z, x, y) = (self.axis, (self.axis + 1) % 3, (self.axis + 2) % 3);
        let depth = self.direction[z];
        let points = [triangle.v0, triangle.v1, triangle.v2].map(|v| vector(v) - self.origin);
        let xs = points.map(|p| p[x] - self.direction[x] / depth * p[z]);
        let ys = points.map(|p| p[y] - self.direction[y] / depth * p[z]);
        let ts = points.map(|p| p[z] / depth);
        let largest = |v: [f64; 3]| v.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        let (x_extent, y_extent, z_extent) = (largest(xs), largest(ys), largest(points.map(|p| p[z])));

        let shear_error = 4.0 * ROUNDING * (z_extent + x_extent.max(y_extent));
        let error = 2.0 * self.origin_error + 2.0 * self.direction_error * z_extent + shear_error;
        let is_beside = |v: [f64; 3]| {
            let (least, greatest) = (v[0].min(v[1]).min(v[2]), v[0].max(v[1]).max(v[2]));
            let margin = error + CORNER_TOLERANCE * (z_extent + least.abs().max(greatest.abs()));
            least > margin || greatest < -margin
        };
        if is_beside(xs) || is_beside(ys) {
            return None;
        }
        let edge_error = 2.0 * error * (x_extent + y_extent + error) + 8.0 * ROUNDING * x_extent * y_extent;
        let tolerance = EDGE_TOLERANCE * (z_extent * (x_extent + y_extent) + 4.0 * x_extent * y_extent);

        let edge = |b: usize, c: usize| xs[c] * ys[b] - ys[c] * xs[b];
        let weights = [edge(1, 2), edge(2, 0), edge(0, 1)];
        let area: f64 = weights.iter().sum();
        let least = weights.map(|w| w * area.signum()).into_iter().fold(f64::MAX, f64::min);
        if least < -2.0 * (edge_error + tolerance) {
            return None;
        }
        let verdict = if least > edge_error { Verdict::Hit } else { Verdict::Tie };
        let [a, b, c] = ts;
        let (first, last) = (a.min(b).min(c), a.max(b).max(c));
        // A triangle seen edge on: t may be anywhere between those of its corners.
        let weighted = (weights[0] * a + weights[1] * b + weights[2] * c) / area;
        let t = if weighted.is_finite() { weighted.clamp(first, last) } else { first };
        let weight_error = (6.0 * (edge_error + tolerance) / area.abs()).min(1.0);
        let corner_error = (self.origin_error / depth.abs()) + (8.0 * ROUNDING + self.direction_error) * largest(ts);
        Some(Candidate {
            instance,
            primitive: triangle.primitive,
            verdict,
            t,
            t_error: 2.0 * corner_error + weight_error * (last - first),
        })
    }
}

/// glTF: counter-clockwise is the front, clockwise under a transform that mirrors.
fn is_back_facing_in_world(instance: &InstanceRecord, triangle: &Triangle, ray: &RayRecord) -> bool {
    let rows = instance.world_from_local.map(|r| r.map(f64::from));
    let linear = DMat3::from_cols_array_2d(&rows.map(|[x, y, z, _]| [x, y, z])).transpose();
    let [a, b, c] = [triangle.v0, triangle.v1, triangle.v2].map(|v| linear * vector(v));
    let faces_away = (b - a).cross(c - a).dot(vector(ray.direction)) > 0.0;
    faces_away != (linear.determinant() < 0.0)
}

/// Whether the corners do not lie on one line: a projection along an axis has an area. Exact.
pub fn has_area(corners: [Vec3; 3]) -> bool {
    (0..3).any(|axis| {
        let project = |v: Vec3| Coord { x: f64::from(v[(axis + 1) % 3]), y: f64::from(v[(axis + 2) % 3]) };
        let [a, b, c] = corners.map(project);
        orient2d(a, b, c) != 0.0
    })
}

fn vector(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}
