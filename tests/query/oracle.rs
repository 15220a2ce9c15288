//! Ray queries by brute force: every triangle by the test of T. Möller and B. Trumbore, with bounds of its rounding
//! error in f64.

use glam::DVec3;
use ropewalk::Ray;
use ropewalk::graph::AlphaMode;
use ropewalk::graph::NodePath;

use super::scenes::Drawn;

/// A triangle that a ray hits, or may hit within rounding.
#[derive(Clone, Debug)]
pub struct Candidate {
    pub path: NodePath,
    pub triangle: u32,
    pub t: f64,
    pub t_error: f64,
    /// Whether it is hit however its test is rounded.
    pub is_sure: bool,
}

/// All triangles that the ray hits or may hit, under the rules for camera rays.
pub fn candidates(drawn: &[Drawn], origin: DVec3, ray: &Ray) -> Vec<Candidate> {
    let mut found = Vec::new();
    for drawn in drawn {
        let material = &drawn.surface;
        let is_hole = matches!(material.alpha_mode, AlphaMode::Mask { cutoff } if material.base_color.w < cutoff);
        if is_hole {
            continue;
        }
        let from = drawn.local_from_world.transform_point3(ray.origin - origin);
        let direction = drawn.local_from_world.transform_vector3(ray.direction);
        for &(triangle, corners) in &drawn.triangles {
            let Some((t, t_error, is_inside)) = meet(from, direction, corners) else { continue };
            // Inverting the matrix enlarges rounding errors.
            let t_error = t_error + drawn.condition() * f64::EPSILON * t.abs();
            let [a, b, c] = corners;
            let is_back = direction.dot((b - a).cross(c - a)) > 0.0;
            if is_back && !material.double_sided {
                continue;
            }
            if t + t_error < ray.t_min || t - t_error > ray.t_max {
                continue;
            }
            let is_sure = is_inside && t - t_error >= ray.t_min && t + t_error <= ray.t_max;
            found.push(Candidate { path: drawn.path.clone(), triangle, t, t_error, is_sure });
        }
    }
    found
}

/// The distance along the line to the triangle, the bound of its error, and whether the hit is certain; `None` for a
/// certain miss.
fn meet(from: DVec3, direction: DVec3, [a, b, c]: [DVec3; 3]) -> Option<(f64, f64, bool)> {
    let (ab, ac, to) = (b - a, c - a, from - a);
    let p = direction.cross(ac);
    let q = to.cross(ab);
    let determinant = ab.dot(p);
    let (u, v, t) = (to.dot(p) / determinant, direction.dot(q) / determinant, ac.dot(q) / determinant);
    // Corners relative to the ray's origin are rounded, then multiplied by two lengths; and so are the matrices.
    let size = ab.length().max(ac.length()).max((c - b).length());
    let rounding = 256.0 * f64::EPSILON * (to.length() + size);
    let error = rounding * direction.length() * size / determinant.abs();
    let least = u.min(v).min(1.0 - u - v);
    if !(least.is_finite() && t.is_finite() && error.is_finite() && error < 0.1) {
        // A triangle seen edge on: all that is known of the distance is that it lies between those of the corners.
        let along = [a, b, c].map(|corner| (corner - from).dot(direction) / direction.length_squared());
        let (first, last) = (along[0].min(along[1]).min(along[2]), along[0].max(along[1]).max(along[2]));
        return Some(((first + last) / 2.0, last - first + rounding / direction.length(), false));
    }
    if least < -error {
        return None;
    }
    let t_error = rounding * size * size / determinant.abs() + 16.0 * f64::EPSILON * t.abs();
    Some((t, t_error, least > error))
}
