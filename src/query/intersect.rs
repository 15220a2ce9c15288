//! Ray/box and ray/triangle tests in f64. The inside test of the triangle is exact, so a ray crosses a closed surface
//! an even number of times (an odd number if it starts inside), even through edges and vertices.
//!
//! A shear takes the ray to the z axis, as in the kernel's test (Woop, Benthin, Wald 2013). Whether the origin of that
//! plane lies left of an edge is decided by the rounded projections of its ends where their error cannot change it,
//! else exactly: by the orientation of the ray's line and the edge in space (J. R. Shewchuk, *Adaptive Precision
//! Floating-Point Arithmetic and Fast Robust Geometric Predicates*, 1997). The line goes through two points of a grid
//! of 2^-50 of their coordinates, so that the way from one to the other is exact too.
//!
//! If the line meets the edge exactly, it is perturbed symbolically: moved by an infinitesimal amount in x and a yet
//! smaller one in y (H. Edelsbrunner, E. P. Mücke, *Simulation of Simplicity*, 1990). Of two triangles that share the
//! edge the ray then hits one if they lie on different sides of it, and both or none if they lie on the same side. That
//! holds for parts of an edge too, where a vertex of another triangle lies exactly on it (a T-junction).

use glam::{DVec2, DVec3};
use robust::{Coord3D, orient3d};

use crate::device::layout::{Node, Triangle};
use crate::math::power_of_two;

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
    line: Line,
}

/// The line of a ray, by points of a grid, so that their difference `along` is exact.
struct Line {
    from: DVec3,
    to: DVec3,
    along: DVec3,
    /// A bound of how far the grid has moved `from`, and `along`, on each axis.
    error: DVec3,
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
        let line = Line::new(origin, direction);
        Self { origin, reciprocal_direction: direction.recip(), axes, slope, direction_z, line }
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
        let z = self.axes[2];
        let corners = [triangle.v0, triangle.v1, triangle.v2].map(|corner| self.project(corner));
        let t = DVec3::from_array([0, 1, 2].map(|i| (corners[i].position[z] - self.origin[z]) / self.direction_z));
        // 2. Edge functions: the ray hits if the origin of the plane is on the same side of all edges.
        let [a, b, c] = &corners;
        let edges = [self.edge(b, c), self.edge(c, a), self.edge(a, b)];
        let is_left = edges[0].is_left;
        if edges[1].is_left != is_left || edges[2].is_left != is_left {
            return None;
        }
        // 3. Barycentric coordinates: by areas, or by the edge that the ray meets. Of two triangles that share it, one
        //    may be seen at so low an angle that its areas are rounding errors; yet both are hit at the same t.
        let met = (0..3).filter(|&i| edges[i].is_met).max_by(|&i, &j| edges[i].length.total_cmp(&edges[j].length));
        let barycentrics = match met {
            None => {
                let areas = DVec3::from_array(edges.map(|edge| edge.area.abs()));
                areas / areas.element_sum()
            }
            Some(i) => {
                let (from, to) = ((i + 1) % 3, (i + 2) % 3);
                let mut weights = DVec3::ZERO;
                (weights[from], weights[to]) = weights_along(corners[from].projected, corners[to].projected);
                weights
            }
        };
        if !barycentrics.is_finite() {
            return None;
        }
        // 4. t, interpolated from those of the vertices, and which face was hit.
        let t = barycentrics.dot(t).clamp(t.min_element(), t.max_element());
        Some(TriangleIntersection { t, barycentrics, back_face: is_left == (self.direction_z > 0.0) })
    }
}

/// A vertex and its projection along the ray.
struct Corner {
    position: DVec3,
    projected: DVec2,
    /// A bound of the rounding error of each coordinate of `projected`.
    error: f64,
}

/// An edge of the projected triangle relative to the 2D origin: the ray.
struct Edge {
    /// Twice the signed area of the triangle that it spans with the origin; positive if counter-clockwise.
    area: f64,
    /// Whether the origin, perturbed if it lies on the edge, is to its left.
    is_left: bool,
    /// Whether the origin lies on the edge to within rounding.
    is_met: bool,
    /// The sum of its extents in x and y.
    length: f64,
}

/// Bounds the rounding error of a projected coordinate relative to the difference of vertex and origin, and to the way
/// that the slope takes it: 1 epsilon for a difference, 2 for a slope, 1 each for a product and a sum; rounded up.
const PROJECTION_ERROR_BOUND: f64 = 8.0 * f64::EPSILON;

impl TraversalRay {
    fn project(&self, corner: [f32; 3]) -> Corner {
        let [x, y, z] = self.axes;
        let position = DVec3::from_array(corner.map(f64::from));
        let relative = position - self.origin;
        let projected = DVec2::new(relative[x], relative[y]) - self.slope * relative[z];
        let depth = relative[z].abs();
        let rounding = DVec2::new(relative[x], relative[y]).abs() + self.slope.abs() * depth;
        // The grid of the line moves its start, and turns it by the errors of its direction along x or y, and along z.
        let Line { error, along, .. } = &self.line;
        let moved = DVec2::new(error[x], error[y]) + self.slope.abs() * error[z];
        let moved = moved * (1.0 + depth / along[z].abs());
        let error = (rounding * PROJECTION_ERROR_BOUND + moved).max_element();
        Corner { position, projected, error }
    }

    fn edge(&self, from: &Corner, to: &Corner) -> Edge {
        let area = from.projected.perp_dot(to.projected);
        // The errors of the coordinates, and the roundings of two products and their difference.
        let [from_length, to_length] = [from, to].map(|corner| corner.projected.abs().element_sum());
        let bound =
            from.error * (to_length + to.error) + to.error * from_length + 4.0 * f64::EPSILON * from_length * to_length;
        let is_met = area.abs() <= bound;
        let is_left = if is_met { self.line.is_left_of(from, to, self.axes) } else { area > 0.0 };
        let length = (to.projected - from.projected).abs().element_sum();
        Edge { area, is_left, is_met, length }
    }
}

impl Line {
    fn new(origin: DVec3, direction: DVec3) -> Self {
        let greatest = origin.abs().max_element();
        let length = if greatest > 0.0 { power_of_two(greatest) } else { 1.0 };
        let along = direction / power_of_two(direction.abs().max_element()) * length;
        // Each axis has a grid of its own: 2^-50 of a power of two above both coordinates.
        let greater = origin.abs().max(along.abs());
        let extent = DVec3::from_array(greater.to_array().map(|x| if x > 0.0 { 2.0 * power_of_two(x) } else { 1.0 }));
        // Adding and subtracting 1.5 * 2^52 grid steps rounds to the grid.
        let to_grid = extent * 6.0;
        let snap = |v: DVec3| (v + to_grid) - to_grid;
        let (from, along) = (snap(origin), snap(along));
        Self { from, to: from + along, along, error: extent * (4.0 * f64::EPSILON) }
    }

    /// Whether the line passes left of an edge, as seen along the last axis. Exact; where they meet, the line is
    /// perturbed.
    #[cold]
    fn is_left_of(&self, from: &Corner, to: &Corner, [x, y, z]: [usize; 3]) -> bool {
        let point = |v: DVec3| Coord3D { x: v.x, y: v.y, z: v.z };
        let (a, b) = (from.position, to.position);
        let along_z = self.along[z];
        let volume = orient3d(point(a), point(b), point(self.to), point(self.from));
        if volume != 0.0 {
            return (volume > 0.0) == (along_z > 0.0);
        }
        // Move the line in x: the area grows with the projected y of the start less that of the end; then in y.
        let edge = a - b;
        let in_x = sign_of_difference([edge[y], along_z], [edge[z], self.along[y]]);
        let in_y = sign_of_difference([edge[z], self.along[x]], [edge[x], along_z]);
        let sign = if in_x != 0.0 { in_x } else { in_y };
        sign != 0.0 && (sign > 0.0) == (along_z > 0.0)
    }
}

/// The weights of the ends of an edge at its point nearest to the origin.
fn weights_along(from: DVec2, to: DVec2) -> (f64, f64) {
    let along = to - from;
    let weight = (-from.dot(along) / along.length_squared()).clamp(0.0, 1.0);
    (1.0 - weight, weight)
}

/// A number with the sign of a * b - c * d: if the rounded products are equal, that of the difference of their rounding
/// errors (rounding is monotonic).
fn sign_of_difference([a, b]: [f64; 2], [c, d]: [f64; 2]) -> f64 {
    let (p, q) = (a * b, c * d);
    if p == q { a.mul_add(b, -p) - c.mul_add(d, -q) } else { p - q }
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
    fn an_edge_is_passed_on_one_side() {
        let values = [-1.0, -0.0, 0.0, 1.0, 3.0, 1.0 + f32::EPSILON, 1e-30];
        let points: Vec<[f32; 3]> = values.iter().flat_map(|&x| values.map(|y| [x, y, 0.25 * y])).collect();
        for ray in [DVec3::Z, DVec3::new(0.5, -0.25, 1.0), DVec3::new(0.1, 0.7, -3.0)]
            .map(|direction| TraversalRay::new(direction * -2.0, direction))
        {
            let corners: Vec<Corner> = points.iter().map(|&point| ray.project(point)).collect();
            for (a, b) in corners.iter().flat_map(|a| corners.iter().map(move |b| (a, b))) {
                if a.position != b.position {
                    let sides = [ray.edge(a, b).is_left, ray.edge(b, a).is_left];
                    assert_ne!(sides[0], sides[1], "{} to {}", a.position, b.position);
                }
            }
        }
    }

    /// The sides of an edge and of its halves, whose common end lies exactly on it.
    #[test]
    fn an_edge_and_its_halves_are_passed_on_the_same_side() {
        let mut rng = fastrand::Rng::with_seed(4);
        let mut exact = 0;
        for _ in 0..20_000 {
            // Multiples of 2^-10, so that the middle is exact.
            let mut point = || [(); 3].map(|()| rng.i32(-1024..=1024) as f32 / 512.0);
            let (a, b) = (point(), point());
            let middle: [f32; 3] = std::array::from_fn(|i| (a[i] + b[i]) / 2.0);
            // A ray at a point of it, or close by.
            let at = DVec3::from_array(a.map(f64::from)).lerp(DVec3::from_array(b.map(f64::from)), 0.25);
            let from = DVec3::from_array(point().map(f64::from)) * 3.0 + DVec3::Z * 9.0;
            let beside = DVec3::X * [0.0, 1e-15, -1e-16][rng.usize(0..3)];
            let ray = TraversalRay::new(from, at + beside - from);
            let [a, b, middle] = [a, b, middle].map(|corner| ray.project(corner));
            if a.projected != b.projected {
                let whole = ray.edge(&a, &b).is_left;
                assert_eq!([ray.edge(&a, &middle).is_left, ray.edge(&middle, &b).is_left], [whole; 2]);
                exact += usize::from(ray.edge(&a, &b).area.abs() < 1e-14);
            }
        }
        assert!(exact > 10_000, "{exact}");
    }
}
