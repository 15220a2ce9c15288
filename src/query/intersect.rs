//! Ray/box and ray/triangle tests in f64. The inside test of the triangle is exact, so a ray crosses a closed surface
//! an even number of times (an odd number if it starts inside), even through edges and vertices.
//!
//! A shear takes the ray to the z axis, as in the kernel's test (Woop, Benthin, Wald 2013). Each vertex projects to a
//! 2D point that depends only on the vertex and the ray, so adjacent triangles agree on shared vertices (watertight).
//! Whether the origin lies left of an edge is decided exactly for these points: the sign of a difference of two
//! products is that of the rounded products, or, if these are equal, that of their rounding errors (rounding is
//! monotonic).
//!
//! If the origin lies exactly on an edge, it is perturbed symbolically: moved by an infinitesimal amount in x and a yet
//! smaller one in y (H. Edelsbrunner, E. P. Mücke, *Simulation of Simplicity*, 1990). Of two triangles that share the
//! edge the ray then hits one if they lie on different sides of it, and both or none if they lie on the same side.
//!
//! All this is about edges that two triangles share as a whole. Where a vertex of one lies within an edge of the other
//! (a T-junction), its projection is rounded to one side of the edge, and a ray that meets the edge to within that
//! rounding, about 2^-52 of the distance, may hit both or none. Triangles without area, which fill such edges in some
//! files, are in no structure.

use glam::{DVec2, DVec3};

use crate::device::layout::{Node, Triangle};

/// A ray prepared for traversal, in world space for the TLAS or in local space for a BLAS.
pub(super) struct TraversalRay {
    origin: DVec3,
    reciprocal_direction: DVec3,
    /// The axes that become x, y and z; z is the longest of the direction.
    axes: [usize; 3],
    /// Shear: dx/dz and dy/dz.
    slope: DVec2,
    /// The direction's component of largest magnitude.
    direction_z: f64,
}

/// The intersection of a ray with a triangle.
#[derive(Clone, Copy)]
pub(super) struct TriangleIntersection {
    pub(super) t: f64,
    /// Barycentric coordinates of the three vertices; they sum to 1.
    pub(super) barycentrics: DVec3,
    /// Whether the back face was hit: clockwise winding seen from the ray's origin.
    pub(super) back_face: bool,
}

/// Relative error bound of a slab distance: three roundings on each side of the comparison, rounded up.
const BOX_ERROR_BOUND: f64 = 8.0 * f64::EPSILON;

impl TraversalRay {
    pub(super) fn new(origin: DVec3, direction: DVec3) -> Self {
        let z = direction.abs().max_position();
        let axes = [(z + 1) % 3, (z + 2) % 3, z];
        let direction_z = direction[z];
        let slope = DVec2::new(direction[axes[0]], direction[axes[1]]) / direction_z;
        Self { origin, reciprocal_direction: direction.recip(), axes, slope, direction_z }
    }

    /// Whether the ray intersects the box between `t_min` and `t_max`: the slab test.
    #[inline]
    pub(super) fn intersects_box(&self, node: &Node, t_min: f64, t_max: f64) -> bool {
        let [min, max] = [node.min, node.max].map(|corner| DVec3::from_array(corner.map(f64::from)));
        // 0 * inf gives NaN for a ray in a face plane. Such a ray may miss the box, which is safe because boxes are
        // padded.
        let (a, b) = ((min - self.origin) * self.reciprocal_direction, (max - self.origin) * self.reciprocal_direction);
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        let (near, far) = (near - near.abs() * BOX_ERROR_BOUND, far + far.abs() * BOX_ERROR_BOUND);
        near <= far && near <= t_max && far >= t_min
    }

    /// The intersection of the ray's line with the triangle. A triangle seen edge-on is missed.
    pub(super) fn intersect_triangle(&self, triangle: &Triangle) -> Option<TriangleIntersection> {
        // 1. Shear the vertices, so that the ray is the z axis.
        let [x, y, z] = self.axes;
        let mut t = DVec3::ZERO;
        let mut points = [DVec2::ZERO; 3];
        for (i, corner) in [triangle.v0, triangle.v1, triangle.v2].into_iter().enumerate() {
            let relative = DVec3::from_array(corner.map(f64::from)) - self.origin;
            points[i] = DVec2::new(relative[x], relative[y]) - self.slope * relative[z];
            t[i] = relative[z] / self.direction_z;
        }
        // 2. Edge functions: the ray hits if the origin of the plane is on the same side of all edges.
        let [a, b, c] = points;
        let edges = [Edge::new(b, c), Edge::new(c, a), Edge::new(a, b)];
        let is_left = edges[0].is_left;
        if edges[1].is_left != is_left || edges[2].is_left != is_left {
            return None;
        }
        // 3. Barycentric coordinates.
        let areas = DVec3::from_array(edges.map(|edge| edge.area));
        let barycentrics = areas / areas.element_sum();
        if !barycentrics.is_finite() {
            return None;
        }
        // 4. t, interpolated from those of the vertices, and which face was hit.
        let t = barycentrics.dot(t).clamp(t.min_element(), t.max_element());
        Some(TriangleIntersection { t, barycentrics, back_face: is_left == (self.direction_z > 0.0) })
    }
}

/// An edge of the projected triangle relative to the 2D origin: the ray.
struct Edge {
    /// Twice the signed area of the triangle that it spans with the origin; positive if counter-clockwise.
    area: f64,
    /// Whether the origin, perturbed if it lies on the edge, is to its left.
    is_left: bool,
}

impl Edge {
    fn new(from: DVec2, to: DVec2) -> Self {
        let (p, q) = (from.x * to.y, from.y * to.x);
        // If the rounded products are equal, the difference of their rounding errors decides.
        let mut area = p - q;
        if area == 0.0 {
            area = from.x.mul_add(to.y, -p) - from.y.mul_add(to.x, -q);
        }
        // An exact zero: perturb the origin, first in x, then in y.
        let is_left = if area == 0.0 { (from.y, to.x) > (to.y, from.x) } else { area > 0.0 };
        Self { area, is_left }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle([v0, v1, v2]: [[f32; 3]; 3]) -> Triangle {
        Triangle::new([v0, v1, v2], 0)
    }

    /// A fan of triangles around corners of a grid, and rays through exactly its corners, edges and faces.
    #[test]
    fn a_plane_is_crossed_once_wherever_it_is_crossed() {
        let corner = |x: i32, y: i32| [x as f32, y as f32, 0.25 * x as f32 + 3.0];
        let mut triangles = Vec::new();
        for (x, y) in (-3..3).flat_map(|x| (-3..3).map(move |y| (x, y))) {
            let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
            let halves = if (x + y) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] };
            triangles.extend(halves.map(triangle));
        }
        let mut rays = 0;
        for (x, y) in (-8..=8).flat_map(|x| (-8..=8).map(move |y| (x, y))) {
            let target = DVec3::new(f64::from(x) / 4.0, f64::from(y) / 4.0, 3.0 + f64::from(x) / 16.0);
            for from in [DVec3::ZERO, DVec3::new(1.0, -2.0, -4.0), DVec3::new(0.5, 1.0, 16.0)] {
                let ray = TraversalRay::new(from, target - from);
                let crossings: Vec<TriangleIntersection> =
                    triangles.iter().filter_map(|t| ray.intersect_triangle(t)).collect();
                assert_eq!(crossings.len(), 1, "from {from} to {target}");
                assert!((crossings[0].t - 1.0).abs() < 1e-14);
                // The grid winds counter-clockwise seen from +z.
                assert_eq!(crossings[0].back_face, from.z < 10.0);
                rays += 1;
            }
        }
        assert_eq!(rays, 17 * 17 * 3);
    }

    #[test]
    fn an_edge_has_the_origin_on_one_side() {
        let values = [-1.0, -0.0, 0.0, 1.0, 3.0, 1.0 + f64::EPSILON, 1e-30, 7e-200];
        let points: Vec<DVec2> = values.iter().flat_map(|&x| values.map(|y| DVec2::new(x, y))).collect();
        for &a in &points {
            for &b in points.iter().filter(|&&b| b != a) {
                assert_ne!(Edge::new(a, b).is_left, Edge::new(b, a).is_left, "{a} to {b}");
            }
        }
    }
}
