//! The triangle test in SIMD lanes: one triangle against the 16 rays of a packet, or one ray against four triangles.
//!
//! It accepts what [`intersect_triangle`](crate::trace::kernel::intersect_triangle) of the kernel accepts, with the
//! same roundings; why its tolerances suffice is derived there.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f32x16};

use super::shear::SHEAR_AXES;
use super::simd::{abs, map_axes, max_component, min_component};
use crate::accel::SIDE_MARGIN;
use crate::device::layout::Triangle;
use crate::trace::kernel::{CORNER_TOLERANCE, EDGE_TOLERANCE, SQRT_MAX_QUOTIENT, START_ZONE};

/// Hits, one ray-triangle pair per lane: distances and barycentric weights of the second and third vertex.
pub(super) struct TriangleHits<V> {
    pub(super) t: V,
    pub(super) u: V,
    pub(super) v: V,
    /// Mask of lanes that hit the back face, from where the triangle winds clockwise.
    pub(super) back: u64,
}

/// Unsheared operands of the plane-distance formula, in local axes.
pub(super) struct PlaneOperands<V> {
    pub(super) origin: [V; 3],
    pub(super) direction: [V; 3],
    pub(super) reciprocals: [V; 3],
    pub(super) corners: [[V; 3]; 3],
    /// The padded boxes of the triangles.
    pub(super) least: [V; 3],
    pub(super) greatest: [V; 3],
    /// The normals of the triangles, from edges that are scaled to about 1 by a power of two.
    pub(super) normal: [V; 3],
}

/// For each vertex the greater value of the other two, the ends of the opposite edge.
#[inline(always)]
fn greater_of_others<S: Simd, V: SimdFloat<S>>(v: [V; 3]) -> [V; 3] {
    [v[1].max(v[2]), v[2].max(v[0]), v[0].max(v[1])]
}

/// Intersects the ray and the triangle of each of `lanes`: `x`, `y` and `t` are those of the three vertices, sheared.
/// Returns the lanes that hit, or `None` if the first edge test rejects all. `slopes` are those of
/// [`ShearRay`](crate::trace::kernel::ShearRay); `plane` gives what the distance along the triangle's plane is computed
/// from.
///
/// Edge tests come first. A ray inside all edges by more than the tolerance also passes the bounding test, so that test
/// runs only for rays near an edge.
#[inline(always)]
pub(super) fn intersect_triangles<S: Simd, V: SimdFloat<S, Element = f32>>(
    simd: S,
    lanes: u64,
    [x, y, t]: [[V; 3]; 3],
    t_to_sheared: V,
    [x_slope, y_slope]: [V; 2],
    plane: impl FnOnce() -> PlaneOperands<V>,
) -> Option<(u64, TriangleHits<V>)> {
    // 1. Compute the edge functions, twice the areas of the sub-triangles, and from their sum the facing.
    let zero = V::splat(simd, 0.0);
    let w = [x[2] * y[1] - y[2] * x[1], x[0] * y[2] - y[0] * x[2], x[1] * y[0] - y[1] * x[0]];
    let back = ((w[0] + w[1]) + w[2]).simd_lt(zero);
    let w = map_axes(
        w,
        #[inline(always)]
        |w| back.select(-w, w),
    );
    let least_w = min_component(w);

    // Reject lanes that are outside an edge by more than the tolerance of the whole triangle.
    let (x_abs, y_abs) = (abs(x), abs(y));
    let z = map_axes(
        abs(t),
        #[inline(always)]
        |t| t * t_to_sheared,
    );
    let (x_extent, y_extent) = (max_component(x_abs), max_component(y_abs));
    let depth_share = max_component(z) * (y_extent * x_slope + x_extent * y_slope);
    let tolerance = (depth_share + x_extent * y_extent * 4.0) * EDGE_TOLERANCE;
    let outside = least_w.simd_lt(-tolerance).to_bitmask();
    let mut hit_lanes = lanes & !outside;
    if hit_lanes == 0 {
        return None;
    }

    // 2. Where a ray is near an edge, reject it if it misses the triangle's bounds by more than rounding explains.
    if hit_lanes & !least_w.simd_gt(tolerance).to_bitmask() != 0 {
        let tolerance = |at: V, z: V, slope: V| (z * slope + at) * CORNER_TOLERANCE;
        let [x_tolerance, y_tolerance] = [(x_abs, x_slope), (y_abs, y_slope)].map(
            #[inline(always)]
            |(at, slope)| [tolerance(at[0], z[0], slope), tolerance(at[1], z[1], slope), tolerance(at[2], z[2], slope)],
        );
        let is_beside = |at: [V; 3], tolerance: [V; 3]| {
            let least = [at[0] - tolerance[0], at[1] - tolerance[1], at[2] - tolerance[2]];
            let greatest = [at[0] + tolerance[0], at[1] + tolerance[1], at[2] + tolerance[2]];
            min_component(least).simd_gt(zero) | max_component(greatest).simd_lt(zero)
        };
        hit_lanes &= !(is_beside(x, x_tolerance) | is_beside(y, y_tolerance)).to_bitmask();
        // Repeat the edge test with the tighter tolerance of each edge's own two vertices.
        let (x, y, z) = (greater_of_others(x_abs), greater_of_others(y_abs), greater_of_others(z));
        for i in 0..3 {
            let tolerance = (z[i] * (y[i] * x_slope + x[i] * y_slope) + x[i] * y[i] * 4.0) * EDGE_TOLERANCE;
            hit_lanes &= !(w[i] + tolerance).simd_lt(zero).to_bitmask();
        }
    }

    let is_outside = least_w.simd_lt(zero);

    // 3. Compute the barycentric weights, clamped to the triangle.
    let w = map_axes(
        w,
        #[inline(always)]
        |w| w.max(zero),
    );
    let area = (w[0] + w[1]) + w[2];
    hit_lanes &= !area.simd_lt(V::splat(simd, f32::MIN_POSITIVE)).to_bitmask();
    let scale = V::splat(simd, 1.0) / area;
    let w = map_axes(
        w,
        #[inline(always)]
        |w| w * scale,
    );

    // 4. Compute the distance along the plane or, outside an edge, along the edge; clamp it to the vertices' t.
    let plane = plane();
    let mut t_hit = plane_distances(&plane, t, w);
    if is_outside.to_bitmask() & hit_lanes != 0 {
        let is_ahead = is_outside & t_hit.simd_ge(zero);
        t_hit = is_ahead.select((w[0] * t[0] + w[1] * t[1]) + w[2] * t[2], t_hit);
    }
    let [entry, exit] = box_interval(&plane);
    let t_hit = t_hit.min(exit).max(entry).max(min_component(t)).min(max_component(t));
    // Near the ray's start the tolerance admits nothing.
    let start_zone = (max_component(z) + (x_extent + y_extent)) * START_ZONE;
    let at_start = is_outside & (t_hit.abs() * t_to_sheared).simd_le(start_zone);
    hit_lanes &= !at_start.to_bitmask();
    Some((hit_lanes, TriangleHits { t: t_hit, u: w[1], v: w[2], back: back.to_bitmask() }))
}

/// Distances to the triangles' planes: the lane-wise form of the kernel's `plane_distance`. A ray that lies in the
/// plane gets the t of the vertex with the greatest weight.
#[inline(always)]
fn plane_distances<S: Simd, V: SimdFloat<S, Element = f32>>(
    operands: &PlaneOperands<V>,
    t: [V; 3],
    weights: [V; 3],
) -> V {
    let [v0, v1, v2] = operands.corners;
    // The vertex with the greatest weight, relative to the origin.
    let is_first = weights[0].simd_ge(weights[1]) & weights[0].simd_ge(weights[2]);
    let is_second = weights[1].simd_ge(weights[2]);
    let vertex = map_axes(
        [0, 1, 2],
        #[inline(always)]
        |axis: usize| is_first.select(v0[axis], is_second.select(v1[axis], v2[axis])) - operands.origin[axis],
    );
    // Distance to the plane, unless the quotient would overflow or be 0/0.
    let height = dot(operands.normal, vertex);
    let slope = dot(operands.normal, operands.direction);
    let is_in_plane = (slope.abs() * SQRT_MAX_QUOTIENT).simd_le(height.abs() * (1.0 / SQRT_MAX_QUOTIENT));
    is_in_plane.select(is_first.select(t[0], is_second.select(t[1], t[2])), height / slope)
}

/// The intervals of t in which the rays are within the triangles' padded boxes: what the kernel's `clamp_to_box` clamps
/// to.
#[inline(always)]
fn box_interval<S: Simd, V: SimdFloat<S, Element = f32>>(operands: &PlaneOperands<V>) -> [V; 2] {
    let planes = map_axes(
        [0, 1, 2],
        #[inline(always)]
        |axis: usize| {
            let (origin, reciprocal) = (operands.origin[axis], operands.reciprocals[axis]);
            let a = (operands.least[axis] - origin) * reciprocal;
            let b = (operands.greatest[axis] - origin) * reciprocal;
            [a.min(b), a.max(b)]
        },
    );
    let [x, y, z] = planes;
    [max_component([x[0], y[0], z[0]]), min_component([x[1], y[1], z[1]])]
}

/// The kernel's `padded_box` of triangles in lanes.
#[inline(always)]
pub(super) fn padded_boxes<S: Simd, V: SimdFloat<S, Element = f32>>([v0, v1, v2]: [[V; 3]; 3]) -> [[V; 3]; 2] {
    let axes = [0, 1, 2];
    let least = map_axes(
        axes,
        #[inline(always)]
        |axis: usize| v0[axis].min(v1[axis]).min(v2[axis]),
    );
    let greatest = map_axes(
        axes,
        #[inline(always)]
        |axis: usize| v0[axis].max(v1[axis]).max(v2[axis]),
    );
    let sides = [greatest[0] - least[0], greatest[1] - least[1], greatest[2] - least[2]];
    let margin = max_component(sides) * SIDE_MARGIN;
    [
        [least[0] - margin, least[1] - margin, least[2] - margin],
        [greatest[0] + margin, greatest[1] + margin, greatest[2] + margin],
    ]
}

/// The kernel's `scaled_normal` of triangles in lanes, whose edges are scaled by `edge_scale`.
#[inline(always)]
pub(super) fn scaled_normals<S: Simd, V: SimdFloat<S, Element = f32>>(
    [v0, v1, v2]: [[V; 3]; 3],
    edge_scale: V,
) -> [V; 3] {
    let edge = |v: [V; 3]| {
        map_axes(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| (v[axis] - v0[axis]) * edge_scale,
        )
    };
    let (a, b) = (edge(v1), edge(v2));
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
fn dot<S: Simd, V: SimdFloat<S, Element = f32>>(a: [V; 3], b: [V; 3]) -> V {
    (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
}

/// The first four triangles, in `padded` with the last repeated if there are fewer.
#[inline(always)]
pub(super) fn first_four<'a>(triangles: &'a [Triangle], padded: &'a mut [Triangle; 4]) -> &'a [Triangle; 4] {
    match triangles.first_chunk() {
        Some(four) => four,
        None => {
            // Fewer than four to the end of the array: repeat the last one.
            *padded = std::array::from_fn(|i| triangles[i.min(triangles.len() - 1)]);
            padded
        }
    }
}

/// Splits a vector of [`gather_corners`] into the four triangles' first, second and third vertices.
#[inline(always)]
pub(super) fn split_corners<S: Simd>(v: f32x16<S>) -> [f32x4<S>; 3] {
    let (ab, c) = v.split();
    let (a, b) = ab.split();
    [a, b, c.split().0]
}

/// The vertices of four triangles, one vector per shear axis of the row `axes` of [`SHEAR_AXES`]: lanes 0..4 hold the
/// first vertices, 4..8 the second, 8..12 the third, 12..16 are unspecified.
#[inline(always)]
pub(super) fn gather_corners<S: Simd>(simd: S, triangles: &[Triangle; 4], axes: usize) -> [f32x16<S>; 3] {
    #[cfg(target_arch = "x86_64")]
    if let Some(avx512) = simd.level().as_avx512() {
        let [x, y, t] = x86::gather_corners_avx512(avx512, bytemuck::cast_ref(triangles), axes);
        return [x.simd_into(simd), y.simd_into(simd), t.simd_into(simd)];
    }
    // Without AVX-512: gather the first vertices of all four, the second, the third; four lanes stay unused.
    let words: &[[f32; 12]; 4] = bytemuck::cast_ref(triangles);
    map_axes(
        SHEAR_AXES[axes % SHEAR_AXES.len()],
        #[inline(always)]
        |axis: usize| {
            let [a, b, c] = [axis, 4 + axis, 8 + axis];
            let [p, q, r, s] = words;
            [p[a], q[a], r[a], s[a], p[b], q[b], r[b], s[b], p[c], q[c], r[c], s[c], 0.0, 0.0, 0.0, 0.0].simd_into(simd)
        },
    )
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use fearless_simd::f32x16;
    use fearless_simd::prelude::*;

    use super::SHEAR_AXES;

    /// Permutation indices per row of [`SHEAR_AXES`]: first from words 0..32, then from those lanes and words 32..48.
    /// Padded to eight rows so that `axes % 8` needs no bounds check.
    static GATHER_INDICES: [[[[u32; 16]; 2]; 3]; 8] = {
        let mut indices = [[[[0; 16]; 2]; 3]; 8];
        let mut i = 0;
        while i < SHEAR_AXES.len() * 3 * 16 {
            let (axes, axis, lane) = (i / 48, i / 16 % 3, i % 16);
            let word = lane % 4 * 12 + lane / 4 % 3 * 4 + SHEAR_AXES[axes][axis];
            indices[axes][axis][0][lane] = word as u32 % 32;
            indices[axes][axis][1][lane] = if word < 32 { lane as u32 } else { word as u32 - 16 };
            i += 1;
        }
        indices
    };

    fearless_simd::kernel!(
        #[inline(always)]
        pub(super) fn gather_corners_avx512(avx512: Avx512, words: &[[f32; 16]; 3], axes: usize) -> [[f32; 16]; 3] {
            let load = |i: usize| -> __m512 { f32x16::simd_from(avx512, words[i]).into() };
            let [a, b, c] = [load(0), load(1), load(2)];
            // Select 16 of 48 words by two permutations: from a and b, then from the result and c.
            let along = |[first, second]: &[[u32; 16]; 2]| {
                let first = fearless_simd::u32x16::simd_from(avx512, *first).into();
                let second = fearless_simd::u32x16::simd_from(avx512, *second).into();
                let v = _mm512_permutex2var_ps(_mm512_permutex2var_ps(a, first, b), second, c);
                f32x16::simd_from(avx512, v).into()
            };
            let [x, y, t] = &GATHER_INDICES[axes % 8];
            [along(x), along(y), along(t)]
        }
    );
}
