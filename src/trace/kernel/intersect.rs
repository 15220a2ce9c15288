//! Ray against box and ray against triangle. Twin of `shaders/shared/intersect.wgsl`.
//!
//! The triangle test is that of S. Woop, C. Benthin, I. Wald, *Watertight Ray/Triangle Intersection* (JCGT 2013): a
//! shear takes the ray to the z axis, and the signs of three edge functions in the plane decide whether the triangle is
//! hit. Their watertightness proof needs two triangles to compute the edge that they share with the same roundings. A
//! GPU's compiler may contract products and sums to fused multiply-adds as it likes, so here the test has a tolerance
//! instead, and the proof is this.
//!
//! Let v = 2^-23, the relative error of an operation that rounds either way, as WGSL allows; division has 2.5 v.
//! Contraction only leaves roundings out.
//!
//! 1. **Corners.** With p the rounded difference of a corner and the ray's origin, and S the rounded slopes of the ray,
//!    call x* = p.x - S.x p.z and y* = p.y - S.y p.z the vertex projected along the ray, in exact arithmetic. Only the
//!    vertex and the ray enter, so triangles agree on the vertices they share. A closed mesh stays closed, and a ray
//!    from inside hits a triangle whose exact edge functions of x* and y* have one sign. It has to be shown that this
//!    triangle is accepted, and that its boxes are.
//! 2. **Triangle.** Let X, Y, Z be the largest |x|, |y|, |p.z| of its corners. The computed x is a product and a sum
//!    off x*: at most v (|S.x p.z| + |x|) of that corner. The corners reach both sides of the ray within twice that,
//!    [`CORNER_TOLERANCE`]. An edge function is a difference of two products: at most v (2 Z (|S.x| Y + |S.y| X) + 4 X
//!    Y) off for its corners and 4 v X Y for its own three operations. Twice the sum is the tolerance,
//!    [`EDGE_TOLERANCE`]; the factor two covers terms in v^2. X, Y and Z may be those of the edge's two corners alone:
//!    a tighter tolerance, so that a ray that leaves past a convex edge misses what lies behind it. It is that of both
//!    triangles at an edge, as is that of a corner: at a ridge a ray hits both or neither. A ray that starts on the
//!    surface beside a convex edge would still hit the far side of it: while it has not gone far, it is no higher above
//!    the edge than the tolerance. Off a plane of slope `MIN_COSINE` or more (2^-10) it is that high after at most 2^10
//!    times five [`EDGE_TOLERANCE`]s of the edge's length, 2^-8.6. So a hit that only the tolerance admits does not
//!    count within [`START_ZONE`] of the triangle's extent from the ray's start. What that costs: a ray that starts
//!    there, within a closed mesh, and goes through an edge within rounding, may leave it on a device that contracts.
//!    Without contraction two triangles compute their common edge alike, and one of them is hit without tolerance.
//! 3. **Box.** Whatever triangle is accepted, its boxes are, so that a hit depends on nothing but ray and triangle: not
//!    on the structure, nor on what else is traced. The ray passes the triangle at a mean P of the corners' p, and t =
//!    P.z / direction.z. A box around the triangle has min <= corner, and rounding is monotonic: the computed min -
//!    origin is at most P. By its reciprocal, its product, and S, the plane's computed t is at most 6 v beyond t; that
//!    of the far plane at most 6 v before it. Where the tolerance admits it, P may be beside the ray: between the two
//!    corners of the edge, which are on both sides of the ray, along x by up to 4 v (|S.x| Z + 2 X), along y alike. Z
//!    is at most |P.z| and the box's longest side a, X at most 2 a; so that is 4 v |S.x P.z|, which is again 4 v of t,
//!    and 20 v a. Boxes are padded by 32 v a (`accel/padding.rs`), those of parts of a triangle by 32 v of its longest
//!    side (`accel/build/triangle_clip.rs`). The comparison allows 32 v of t, [`BOX_ENTRY_SCALE`]. `t_max` may be the
//!    rounded t of an earlier hit: see point 5.
//! 4. **Zeros.** Where a direction is shorter along one axis than 2^-64 of the longest, it counts as that long, so
//!    nothing is ever infinite. The ray is then misplaced by less than 2^-64 of its way, which the padding of the boxes
//!    exceeds.
//! 5. **Distance.** The edge functions decide that the triangle is hit, but do not give t well: an interpolated t is
//!    off by the errors of the weights times the distance between the corners, however near the hit. So t = n.q / n.d
//!    is that of the plane: n is the cross product of two edges, q the vector to the corner next to the hit (the one
//!    with the greatest weight), d the direction. Let N be n with all products positive, |e1.y e2.z| + |e1.z e2.y| and
//!    so on. An edge has one rounding, so n is at most 4 v N off, n.q at most 8 v N.|q|, n.d at most 7 v N.|d|, and t
//!    at most v (8 N.|q| + 7 |t| N.|d|) / |n.d| + 3 v |t|, up to terms in v^2. Where a triangle lies along two axes, n
//!    has one component, whose error is in both products alike: t is at most 6 v |t| off, at whatever angle. In any
//!    case t is clamped to the range of the vertices' t. Where a ray passes outside an edge, within the tolerance, t is
//!    interpolated along the edge: its plane may be crossed far from the triangle, and at a ridge the plane of the face
//!    behind before that of the face in front. A plane behind the ray's start stays there, so that a ray that leaves a
//!    surface does not meet its coplanar neighbours.
//! 6. **Order.** The closest hit must not depend on which of two hits is found first: a hit at t must not lie in a box
//!    that is entered only behind another hit at a greater t. Rounding, as of a plane that the ray grazes or of a
//!    corner far away, may take t there. So t is clamped to the interval in which the ray is within the triangle's own
//!    box, padded by as little as that of a node around it, by the operations of the slab test: these are monotonic, so
//!    every box around the triangle is entered at or before t and left at or behind it. Without the padding a ray that
//!    the tolerance admits could be beside the box, and t anywhere. A box around a part of the triangle (spatial
//!    splits, kd-tree) is not around the rest: there a hit may still be missed where the error of t exceeds what
//!    `T_BEFORE_SCALE` allows (`query.rs`).

use glam::Vec3;

use super::math::{cross3, dot3, max, min};
use crate::accel::SIDE_MARGIN;
use crate::device::layout::{Node, Triangle};

/// Factor on a box's entry distance that covers the rounding of point 3.
pub(crate) const BOX_ENTRY_SCALE: f32 = 1.0 - 1.0 / (1 << 18) as f32;
/// Least magnitude of a direction's component relative to the longest (point 4): 2^-64; and absolutely: 2^-120, whose
/// reciprocal is finite.
pub(crate) const MIN_RELATIVE_COMPONENT: f32 = 1.0 / (1_u128 << 64) as f32;
pub(crate) const MIN_COMPONENT: f32 = 1.0 / (1_u128 << 120) as f32;
/// 2^63: a quotient of magnitude up to its square, 2^126, is taken to be finite.
pub(crate) const SQRT_MAX_QUOTIENT: f32 = (1_u64 << 63) as f32;
/// About the greatest coordinate of the triangle test: 2^30.
pub(crate) const SHEARED_EXTENT: f32 = (1 << 30) as f32;
/// See point 2.
pub(crate) const CORNER_TOLERANCE: f32 = 1.0 / (1 << 22) as f32;
/// See point 2.
pub(crate) const EDGE_TOLERANCE: f32 = 1.0 / (1 << 21) as f32;
/// See point 2.
pub(crate) const START_ZONE: f32 = 1.0 / (1 << 6) as f32;

/// Ray operands of the slab test.
#[derive(Clone, Copy)]
pub(crate) struct SlabRay {
    pub origin: Vec3,
    pub reciprocal_direction: Vec3,
}

/// Ray operands of the triangle test: rows that shear points (relative to the origin) into a space in which the ray is
/// the z axis, and the row that gives t.
#[derive(Clone, Copy, Default)]
pub(crate) struct ShearRay {
    pub origin: Vec3,
    pub direction: Vec3,
    /// That of the slab test.
    pub reciprocal_direction: Vec3,
    pub x_row: Vec3,
    pub y_row: Vec3,
    pub t_row: Vec3,
    /// Factor from t to units of sheared x and y.
    pub t_to_sheared: f32,
    /// The magnitudes of the slopes in `x_row` and `y_row`, before they are scaled: at most 1.
    pub slopes: [f32; 2],
}

/// Intersection of a ray and a triangle: t, barycentric weights u of v1 and v of v2, facing.
#[derive(Clone, Copy)]
pub(crate) struct TriangleHit {
    pub t: f32,
    pub u: f32,
    pub v: f32,
    /// Back-face hit: the triangle winds clockwise as seen from the ray's origin, in local space.
    pub back: bool,
}

fn min_component(v: Vec3) -> f32 {
    min(min(v.x, v.y), v.z)
}

pub(crate) fn max_component(v: Vec3) -> f32 {
    max(max(v.x, v.y), v.z)
}

pub(crate) fn slab_ray(origin: Vec3, direction: Vec3) -> SlabRay {
    // Bound each component away from 0, so that its reciprocal is finite.
    let least = max(max_component(direction.abs()) * MIN_RELATIVE_COMPONENT, MIN_COMPONENT);
    let reciprocal = |d: f32| {
        let bounded = max(d.abs(), least);
        if d < 0.0 { -1.0 / bounded } else { 1.0 / bounded }
    };
    SlabRay {
        origin,
        reciprocal_direction: Vec3::new(reciprocal(direction.x), reciprocal(direction.y), reciprocal(direction.z)),
    }
}

/// Slab test: whether the ray enters the box within [`t_min`, `t_max`]; `t_min` is not negative.
#[inline]
pub(crate) fn intersects_box(ray: &SlabRay, t_min: f32, t_max: f32, node: &Node) -> bool {
    // Find the distances to the two planes of each axis, and sort them.
    let a = (Vec3::from_array(node.min) - ray.origin) * ray.reciprocal_direction;
    let b = (Vec3::from_array(node.max) - ray.origin) * ray.reciprocal_direction;
    let near = Vec3::new(min(a.x, b.x), min(a.y, b.y), min(a.z, b.z));
    let far = Vec3::new(max(a.x, b.x), max(a.y, b.y), max(a.z, b.z));
    // The ray is in the box from the last entry to the first exit.
    let t_near = max(max(near.x, near.y), max(near.z, t_min));
    let t_far = min(min(far.x, far.y), min(far.z, t_max));
    t_near * BOX_ENTRY_SCALE <= t_far
}

/// For each vertex the greater value of the other two, the ends of the opposite edge.
fn greater_of_others(v: Vec3) -> Vec3 {
    Vec3::new(max(v.y, v.z), max(v.z, v.x), max(v.x, v.y))
}

/// 1 over the greatest power of two that is not above `value`.
pub(crate) fn reciprocal_power_of_two(value: f32) -> f32 {
    // Negate the exponent, bounded so that the result is a normal number.
    let exponent = (value.to_bits() >> 23).min(253);
    f32::from_bits((254 - exponent) << 23)
}

/// Prepares the triangle test of a ray whose slab test is prepared. `extent` is the greatest absolute coordinate of the
/// geometry and the origin. Sheared coordinates are scaled by a power of two, exactly, so that the greatest is about
/// [`SHEARED_EXTENT`]: products of two do not overflow, whatever the geometry's unit, and do not underflow for
/// triangles down to 2^-93 of the extent.
///
/// Besides the slope a row has a 1 (times that power of two) and a 0: a product with either is exact, so that a dot
/// product rounds as one product and one sum do.
pub(crate) fn shear_ray(slab: &SlabRay, direction: Vec3, extent: f32) -> ShearRay {
    let SlabRay { origin, reciprocal_direction } = *slab;
    // Find the power of two that brings the greatest coordinate to about SHEARED_EXTENT.
    let scale = reciprocal_power_of_two(extent * (1.0 / SHEARED_EXTENT));
    // Find the dominant axis of the direction, and the rows of the shear along it.
    let length = direction.abs();
    let (major_component, mut slopes, mut x_row, mut y_row, t_row);
    if length.x >= length.y && length.x >= length.z {
        major_component = direction.x;
        slopes = [-direction.y / major_component, -direction.z / major_component];
        x_row = Vec3::new(slopes[0], 1.0, 0.0);
        y_row = Vec3::new(slopes[1], 0.0, 1.0);
        t_row = Vec3::new(1.0 / major_component, 0.0, 0.0);
    } else if length.y >= length.z {
        major_component = direction.y;
        slopes = [-direction.z / major_component, -direction.x / major_component];
        x_row = Vec3::new(0.0, slopes[0], 1.0);
        y_row = Vec3::new(1.0, slopes[1], 0.0);
        t_row = Vec3::new(0.0, 1.0 / major_component, 0.0);
    } else {
        major_component = direction.z;
        slopes = [-direction.x / major_component, -direction.y / major_component];
        x_row = Vec3::new(1.0, 0.0, slopes[0]);
        y_row = Vec3::new(0.0, 1.0, slopes[1]);
        t_row = Vec3::new(0.0, 0.0, 1.0 / major_component);
    }
    // Swap x and y for negative directions to preserve the winding.
    if major_component < 0.0 {
        (x_row, y_row) = (y_row, x_row);
        slopes.reverse();
    }
    // Apply it to x and y; t keeps the unit of the ray.
    let t_to_sheared = min(major_component.abs() * scale, f32::MAX);
    let slopes = slopes.map(f32::abs);
    let (x_row, y_row) = (x_row * scale, y_row * scale);
    ShearRay { origin, direction, reciprocal_direction, x_row, y_row, t_row, t_to_sheared, slopes }
}

/// Intersects the ray's whole line with a triangle; the caller checks [`t_min`, `t_max`]. The point is on the triangle,
/// tolerance or not: the weights are not negative, and t lies between those of the vertices. A triangle whose
/// projection along the ray has no area is missed, and so is one beside the ray's start that the tolerance
/// alone admits (point 2).
#[inline]
pub(crate) fn intersect_triangle(ray: &ShearRay, triangle: &Triangle) -> Option<TriangleHit> {
    // Shear the vertices.
    let a = Vec3::from_array(triangle.v0) - ray.origin;
    let b = Vec3::from_array(triangle.v1) - ray.origin;
    let c = Vec3::from_array(triangle.v2) - ray.origin;
    let x = Vec3::new(dot3(ray.x_row, a), dot3(ray.x_row, b), dot3(ray.x_row, c));
    let y = Vec3::new(dot3(ray.y_row, a), dot3(ray.y_row, b), dot3(ray.y_row, c));
    let t = Vec3::new(dot3(ray.t_row, a), dot3(ray.t_row, b), dot3(ray.t_row, c));

    // Depths in units of sheared x and y: the tolerances grow with them.
    let (x_abs, y_abs, z) = (x.abs(), y.abs(), t.abs() * ray.t_to_sheared);
    let [x_slope, y_slope] = ray.slopes;

    // 1. Reject the ray if it misses the projected triangle's bounds by more than the rounding error of each corner.
    let x_tolerance = (z * x_slope + x_abs) * CORNER_TOLERANCE;
    let y_tolerance = (z * y_slope + y_abs) * CORNER_TOLERANCE;
    if min_component(x - x_tolerance) > 0.0
        || max_component(x + x_tolerance) < 0.0
        || min_component(y - y_tolerance) > 0.0
        || max_component(y + y_tolerance) < 0.0
    {
        return None;
    }

    // 2. Compute the edge functions (twice the sub-triangles' areas) and reject if one is negative beyond its
    //    tolerance.
    let mut weights = Vec3::new(x.z * y.y - y.z * x.y, x.x * y.z - y.x * x.z, x.y * y.x - y.y * x.x);
    let back = (weights.x + weights.y) + weights.z < 0.0;
    if back {
        weights = -weights;
    }
    let (x_extent, y_extent) = (max_component(x_abs), max_component(y_abs));
    let depth_share = max_component(z) * (y_extent * x_slope + x_extent * y_slope);
    let tolerance = EDGE_TOLERANCE * (depth_share + 4.0 * (x_extent * y_extent));
    if min_component(weights) < -tolerance {
        return None;
    }
    // Outside an edge, repeat the test with the tighter tolerance of each edge's own two vertices (point 2).
    let is_outside = min_component(weights) < 0.0;
    if is_outside {
        let (x, y, z) = (greater_of_others(x_abs), greater_of_others(y_abs), greater_of_others(z));
        let tolerances = EDGE_TOLERANCE * (z * (y * x_slope + x * y_slope) + 4.0 * (x * y));
        if min_component(weights + tolerances) < 0.0 {
            return None;
        }
    }

    // 3. Compute barycentric weights and t, clamped to the triangle.
    weights = Vec3::new(max(weights.x, 0.0), max(weights.y, 0.0), max(weights.z, 0.0));
    let area = (weights.x + weights.y) + weights.z;
    // A projection without area, of a degenerate triangle or one seen edge-on, is missed.
    if area < f32::MIN_POSITIVE {
        return None;
    }
    weights *= 1.0 / area;
    // Outside an edge, t is that of the point on the edge: the plane may be crossed far from it. But a plane behind the
    // ray's start stays there.
    let t_plane = plane_t(ray, triangle, t, weights);
    let t_hit = if is_outside && t_plane >= 0.0 { dot3(weights, t) } else { t_plane };
    let t_hit = clamp_to_box(ray, triangle, t_hit);
    let t_hit = min(max(t_hit, min_component(t)), max_component(t));
    // Near the ray's start the tolerance admits nothing (point 2).
    let start_zone = START_ZONE * (max_component(z) + (x_extent + y_extent));
    if is_outside && t_hit.abs() * ray.t_to_sheared <= start_zone {
        return None;
    }
    Some(TriangleHit { t: t_hit, u: weights.y, v: weights.z, back })
}

/// The least and the greatest corner of a triangle's box, padded by the least that the box of a node around it is.
#[inline]
pub(crate) fn padded_box(triangle: &Triangle) -> [Vec3; 2] {
    let [v0, v1, v2] = [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from_array);
    let least = Vec3::new(min(min(v0.x, v1.x), v2.x), min(min(v0.y, v1.y), v2.y), min(min(v0.z, v1.z), v2.z));
    let greatest = Vec3::new(max(max(v0.x, v1.x), v2.x), max(max(v0.y, v1.y), v2.y), max(max(v0.z, v1.z), v2.z));
    let margin = max_component(greatest - least) * SIDE_MARGIN;
    [least - margin, greatest + margin]
}

/// Clamps t to the interval in which the ray is within the triangle's padded box (point 6), as the slab test computes
/// it.
#[inline]
fn clamp_to_box(ray: &ShearRay, triangle: &Triangle, t: f32) -> f32 {
    let [least, greatest] = padded_box(triangle);
    let a = (least - ray.origin) * ray.reciprocal_direction;
    let b = (greatest - ray.origin) * ray.reciprocal_direction;
    let entry = max(max(min(a.x, b.x), min(a.y, b.y)), min(a.z, b.z));
    let exit = min(min(max(a.x, b.x), max(a.y, b.y)), max(a.z, b.z));
    max(min(t, exit), entry)
}

/// t at the triangle's plane (point 5). If the ray lies in the plane, t of the vertex with the greatest weight. `t`
/// holds the vertices' t.
#[inline]
pub(crate) fn plane_t(ray: &ShearRay, triangle: &Triangle, t: Vec3, weights: Vec3) -> f32 {
    let [v0, v1, v2] = [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from_array);
    let normal = scaled_normal(triangle);
    // Vertex with the greatest weight.
    let (corner, corner_t) = if weights.x >= weights.y && weights.x >= weights.z {
        (v0 - ray.origin, t.x)
    } else if weights.y >= weights.z {
        (v1 - ray.origin, t.y)
    } else {
        (v2 - ray.origin, t.z)
    };
    // Height of the plane as seen from the origin, and the ray's speed toward it: t is their quotient.
    let (height, slope) = (dot3(normal, corner), dot3(normal, ray.direction));
    // Avoid a quotient that overflows or is 0/0. Neither product is subnormal, which is slow on some processors.
    if slope.abs() * SQRT_MAX_QUOTIENT <= height.abs() / SQRT_MAX_QUOTIENT {
        return corner_t;
    }
    height / slope
}

/// The normal of a triangle, from edges that are scaled to about 1 by a power of two.
#[inline]
pub(crate) fn scaled_normal(triangle: &Triangle) -> Vec3 {
    let [edge_1, edge_2] = scaled_edges(triangle);
    cross3(edge_1, edge_2)
}

/// The edges from the first corner of a triangle, scaled to about 1 by a power of two.
#[inline(always)]
pub(crate) fn scaled_edges(triangle: &Triangle) -> [Vec3; 2] {
    let scale = edge_scale(triangle);
    edges(triangle).map(|edge| edge * scale)
}

/// The power of two that scales the edges from the first corner of a triangle to about 1.
#[inline(always)]
pub(crate) fn edge_scale(triangle: &Triangle) -> f32 {
    let [edge_1, edge_2] = edges(triangle);
    reciprocal_power_of_two(max_component(edge_1.abs().max(edge_2.abs())))
}

#[inline(always)]
fn edges(triangle: &Triangle) -> [Vec3; 2] {
    let [v0, v1, v2] = [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from_array);
    [v1 - v0, v2 - v0]
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3Swizzles as _};

    use super::super::math::length3;
    use super::*;

    fn triangle([v0, v1, v2]: [Vec3; 3]) -> Triangle {
        Triangle::new([v0, v1, v2].map(|v| v.to_array()), 0)
    }

    fn sheared(origin: Vec3, direction: Vec3, extent: f32) -> ShearRay {
        shear_ray(&slab_ray(origin, direction), direction, extent)
    }

    /// Directions to the neighbours of a cell, in each of which the winding must come out right.
    fn directions() -> impl Iterator<Item = Vec3> {
        let steps = [-1.0, 0.0, 1.0];
        let all = steps.into_iter().flat_map(move |x| steps.map(|y| steps.map(|z| Vec3::new(x, y, z))));
        all.flatten().filter(|&d| d != Vec3::ZERO)
    }

    #[test]
    fn the_back_is_where_the_triangle_winds_clockwise() {
        let corners = [Vec3::new(2.0, -0.5, -0.25), Vec3::new(-1.0, 2.5, 0.5), Vec3::new(-1.25, -1.5, 0.25)];
        let normal = cross3(corners[1] - corners[0], corners[2] - corners[0]);
        let center = (corners[0] + corners[1] + corners[2]) / 3.0;
        let mut backs = 0;
        for direction in directions().filter(|d| dot3(*d, normal).abs() > 0.1) {
            let ray = sheared(center - direction * 4.0, direction, 8.0);
            let crossing = intersect_triangle(&ray, &triangle(corners)).expect("it aims at the centre");
            assert!((crossing.t - 4.0).abs() < 1e-5 && (crossing.u - 1.0 / 3.0).abs() < 1e-5, "{direction}");
            assert_eq!(crossing.back, dot3(direction, normal) > 0.0, "{direction}");
            backs += usize::from(crossing.back);
        }
        assert!(backs > 5 && backs < 20, "{backs}");
    }

    /// The relative error of an operation that rounds to nearest.
    const HALF_ULP: f64 = 1.0 / (1 << 24) as f64;

    /// Random numbers from 0 to 1.
    struct Random(fastrand::Rng);

    impl Random {
        fn next(&mut self) -> f32 {
            self.0.f32()
        }

        fn in_cube(&mut self) -> Vec3 {
            Vec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0
        }
    }

    /// A triangle with edges of length 1 or thereabouts, `thickness` wide, and a ray that goes through its middle from
    /// `away`, at an angle of `slope` or less.
    fn aimed(random: &mut Random, is_flat: bool, [thickness, slope, away]: [f32; 3]) -> ([Vec3; 3], Vec3, Vec3) {
        let axis = (random.next() * 3.0) as usize;
        let flattened = |mut v: Vec3| {
            v[axis] *= if is_flat { 0.0 } else { 1.0 };
            v
        };
        // Choose a corner and two edges, the second of which strays from the first by the thickness.
        let [mut v0, along, across] = [0; 3].map(|_| random.in_cube());
        v0[axis] *= 2.0;
        let corners = [v0, v0 + flattened(along), v0 + flattened(along * random.next() + across * thickness)];
        // Aim at a random point of the triangle, nearly in its plane where the slope is small.
        let (u, v) = (random.next(), random.next());
        let target = corners[0] + ((corners[1] - corners[0]) * (1.0 - v) + (corners[2] - corners[0]) * v) * u.sqrt();
        let normal = cross3(flattened(along), flattened(across)).normalize_or(Vec3::X);
        let direction = random.in_cube().reject_from(normal) + normal * (slope * random.next());
        (corners, target - direction * away, direction)
    }

    /// Point 5 of the proof: t by the same formula in f64, and the error bound of f32 rounding to nearest. The factor
    /// two covers the terms of second order. `None` where the plane's orientation is lost to rounding.
    fn plane_t_and_bound(ray: &ShearRay, corners: [Vec3; 3], weights: [f32; 3]) -> Option<(f64, f64)> {
        let [v0, v1, v2] = corners.map(Vec3::as_dvec3);
        let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        // Compute the normal, and the sums of absolute products that bound its rounding error.
        let (a, b) = (v1 - v0, v2 - v0);
        let products = [[a.y * b.z, a.z * b.y], [a.z * b.x, a.x * b.z], [a.x * b.y, a.y * b.x]];
        let normal = DVec3::from_array(products.map(|[p, q]| p - q));
        let sums = DVec3::from_array(products.map(|[p, q]| p.abs() + q.abs()));
        // Compute t by way of the vertex with the greatest weight, as the kernel does.
        let greatest = (0..3).max_by(|&i, &j| weights[i].total_cmp(&weights[j]))?;
        let corner = [v0, v1, v2][greatest] - origin;
        let slope = normal.dot(direction);
        let t = normal.dot(corner) / slope;
        // Give up where the error of the slope is not small against the slope.
        let slope_error = 7.0 * HALF_ULP * sums.dot(direction.abs()) / slope.abs();
        if slope_error > 0.25 {
            return None;
        }
        let error = 8.0 * HALF_ULP * sums.dot(corner.abs()) / slope.abs() + (slope_error + 3.0 * HALF_ULP) * t.abs();
        // Along two axes only what is left when the normal cancels.
        let is_flat = normal.to_array().iter().filter(|&&n| n != 0.0).count() == 1;
        Some((t, if is_flat { 5.0 * HALF_ULP * t.abs() } else { 2.0 * error }))
    }

    /// Rays at points of edges and corners, many of them nearly along an axis: where the tolerance admits them, or the
    /// box of the triangle is touched only, t is still that of the point.
    #[test]
    fn distances_at_edges_are_those_of_the_edge() {
        let mut random = Random(fastrand::Rng::with_seed(9));
        let mut hits = 0;
        for i in 0..200_000 {
            let corners = [0; 3].map(|_| random.in_cube());
            let normal = cross3(corners[1] - corners[0], corners[2] - corners[0]);
            // A point of an edge, or a corner.
            let along = [0.0, 1.0, random.next()][i % 3];
            let target = corners[0] * (1.0 - along) + corners[1] * along;
            // A direction of which some components are small.
            let small = [1.0, 1e-3, 1e-6, 1e-9, 0.0];
            let scales = Vec3::new(1.0, small[i / 3 % 5], small[i / 15 % 5]);
            let direction = random.in_cube() * [scales, scales.yzx(), scales.zxy()][i / 75 % 3];
            if dot3(direction, normal).abs() < 0.05 * length3(direction) * length3(normal) {
                continue;
            }
            let origin = target - direction * (2.0 / length3(direction));
            let ray = sheared(origin, target - origin, 4.0);
            if let Some(hit) = intersect_triangle(&ray, &triangle(corners)) {
                assert!((hit.t - 1.0).abs() < 2e-4, "{corners:?} at {target} along {direction}: {}", hit.t);
                hits += 1;
            }
        }
        assert!(hits > 50_000, "{hits}");
    }

    #[test]
    fn distances_are_as_exact_as_the_plane_is_known() {
        let mut random = Random(fastrand::Rng::with_seed(1));
        let (mut tested, mut close) = (0, 0);
        for i in 0..600_000 {
            // Vary the size, the thickness, the angle and the distance.
            let scale = [1e-18, 1e-6, 1.0, 1e6, 1e18][i % 5];
            let thickness = [1.0, 1e-2, 1e-4][i / 5 % 3];
            let slope = [1.0, 1e-2, 1e-4][i / 15 % 3];
            let away = 10f32.powf(random.next() * 6.0 - 5.0);
            let (corners, origin, direction) = aimed(&mut random, i / 45 % 2 == 0, [thickness, slope, away]);
            let (corners, origin) = (corners.map(|v| v * scale), origin * scale);
            let extent = corners.iter().fold(max_component(origin.abs()), |m, v| max(m, max_component(v.abs())));
            let ray = sheared(origin, direction * scale, extent);
            let Some(hit) = intersect_triangle(&ray, &triangle(corners)) else { continue };
            // Check that the hit lies between the vertices.
            let depths = Vec3::from_array(corners.map(|v| dot3(ray.t_row, v - origin)));
            let (least, greatest) = (min_component(depths), max_component(depths));
            assert!(hit.t >= least && hit.t <= greatest, "{corners:?}: {} beside {depths}", hit.t);
            // Check its distance against the exact one, unless the ray passes outside an edge.
            let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
            if weights.iter().any(|&weight| weight <= 1e-6) {
                continue;
            }
            let Some((t, bound)) = plane_t_and_bound(&ray, corners, weights) else { continue };
            // It is clamped to the range of the vertices, but by no more than the bound.
            let clamped = t.clamp(f64::from(least), f64::from(greatest)).clamp(t - bound, t + bound);
            let error = (f64::from(hit.t) - clamped).abs();
            assert!(
                error <= 2.0 * bound,
                "{corners:?} from {origin} along {direction}: {} for {t}, bound {bound:e}",
                hit.t
            );
            tested += 1;
            close += usize::from(bound < 1e-6 * t.abs());
        }
        println!("{tested} hits, {close} of them with a bound of 1e-6");
        assert!(tested > 200_000 && close > 100_000, "{tested}, {close}");
    }

    #[test]
    fn rays_that_leave_beside_a_huge_triangle_do_not_meet_it() {
        let mut random = Random(fastrand::Rng::with_seed(4));
        let (mut beside, mut behind) = (0, 0);
        for i in 0..200_000 {
            // A triangle in the plane y = 0 or a tilted one, and a point of it, at a corner, an edge or inside.
            let side = [1.0, 1e3, 1e6][i % 3];
            let tilt = Vec3::new(random.next() - 0.5, 1.0, random.next() - 0.5) * (i / 3 % 2) as f32;
            let corners = [(); 3].map(|()| {
                let v = random.in_cube() * side;
                v.with_y(-(v.x * tilt.x + v.z * tilt.z))
            });
            let (edge_1, edge_2) = (corners[1] - corners[0], corners[2] - corners[0]);
            let normal = cross3(edge_1, edge_2);
            // Of a needle the rounding of its corners leaves no plane.
            if normal.length() < 0.1 * side * side {
                continue;
            }
            let normal = normal.normalize() * normal.y.signum();
            let (u, v) = ([0.0, 0.0, 1e-3][i / 6 % 3] * random.next(), [0.0, 0.5][i / 18 % 2] * random.next());
            let at = corners[0] + edge_1 * u + edge_2 * v;
            // A ray that starts above it by more than the rounding of its plane, and rises.
            let height = side * 10f32.powf(random.next() * 4.0 - 6.0);
            let along = random.in_cube().reject_from(normal).normalize_or(normal.any_orthonormal_vector());
            let origin = at + normal * height + random.in_cube().reject_from(normal) * height;
            let direction = along + normal * 10f32.powf(-3.0 * random.next());
            match intersect_triangle(&sheared(origin, direction, side), &triangle(corners)) {
                Some(hit) => {
                    assert!(hit.t < 0.0, "{corners:?} from {origin} along {direction}, {height} above: {}", hit.t);
                    behind += 1;
                }
                None => beside += 1,
            }
        }
        assert!(beside > 20_000 && behind > 20_000, "{beside}, {behind}");
    }

    #[test]
    fn rays_that_rise_over_a_triangle_do_not_meet_it() {
        let mut random = Random(fastrand::Rng::with_seed(6));
        let mut behind = 0;
        for i in 0..200_000 {
            // A triangle in the plane y = 0, and a ray that starts a little above it and passes over it, still rising.
            let size = [1e-6, 1.0, 1e6][i % 3];
            let corners = [(); 3].map(|()| random.in_cube().with_y(0.0) * size);
            let target = (corners[0] + corners[1] * random.next() + corners[2] * random.next()) / 2.0;
            let height = size * 10f32.powf(-4.0 - 6.0 * random.next());
            let origin = (random.in_cube() * 3.0 * size).with_y(height);
            let rise = size * 10f32.powf(-3.0 - 6.0 * random.next());
            let direction = (target - origin).with_y(rise);
            let hit = intersect_triangle(&sheared(origin, direction, 3.0 * size), &triangle(corners));
            let t = hit.map_or(f32::NEG_INFINITY, |hit| hit.t);
            assert!(t < 0.0, "{corners:?} from {origin} along {direction}: {t}");
            behind += usize::from(t.is_finite());
        }
        assert!(behind > 50, "{behind}");
    }

    #[test]
    fn triangles_without_area_are_not_met() {
        let [a, b] = [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 0.0)];
        for direction in directions() {
            let ray = sheared(-2.0 * direction, direction, 4.0);
            for corners in [[a, b, b], [a, a, a], [a, Vec3::ZERO, b], [Vec3::ZERO; 3]] {
                assert!(intersect_triangle(&ray, &triangle(corners)).is_none(), "{corners:?} along {direction}");
            }
        }
    }

    #[test]
    fn nothing_is_met_without_a_direction() {
        let corners = [Vec3::new(-1.0, -1.0, 1.0), Vec3::new(1.0, -1.0, 1.0), Vec3::new(0.0, 1.0, 1.0)];
        for direction in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY] {
            assert!(intersect_triangle(&sheared(Vec3::ZERO, direction, 1.0), &triangle(corners)).is_none());
        }
    }

    #[test]
    fn reciprocal_powers_of_two_bring_numbers_to_one() {
        for value in [1e-37, 0.3, 1.0, 1.5, 2.0, 1e30, 1.7e38] {
            let scaled = value * reciprocal_power_of_two(value);
            assert!((1.0..2.0).contains(&scaled), "{value} becomes {scaled}");
        }
        for value in [0.0, f32::MAX, f32::INFINITY] {
            assert!(reciprocal_power_of_two(value).is_normal());
        }
    }
}
