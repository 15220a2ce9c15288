//! The triangle test in lanes: one triangle and sixteen rays, or four triangles and one ray.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f32x16};

use super::ray_packet::SHEAR_AXES;
use super::simd::{abs, map_axes, max_component, min_component};
use crate::device::layout::Triangle;
use crate::trace::kernel::{CORNER_TOLERANCE, EDGE_TOLERANCE, SQRT_MAX_QUOTIENT};

/// Lane by lane a ray and a triangle: where they cross.
pub(super) struct TriangleHits<V> {
    pub(super) t: V,
    pub(super) u: V,
    pub(super) v: V,
    /// A bit for each lane whose ray came from the side where the triangle winds clockwise.
    pub(super) back: u64,
}

/// What takes corners, as they lie from a ray's origin, into the plane across the ray and to its t: a row of
/// [`ShearRay`](crate::trace::kernel::ShearRay) has one slope and one scale.
#[derive(Clone, Copy)]
pub(super) struct Shear<V> {
    /// Of x and y, negated: of corners counted from the corner to the origin.
    pub(super) minus_scale: V,
    /// Of t in x and in y.
    pub(super) slopes: [V; 2],
    pub(super) t_scale: V,
}

impl<V: Copy> Shear<V> {
    /// The corner seen along the ray, given origin - corner across it and corner - origin along its axis. A fused product rounds as
    /// the kernel's does: the scale is a power of two.
    #[inline(always)]
    pub(super) fn apply<S: Simd>(&self, [x, y]: [V; 2], t: V) -> [V; 3]
    where
        V: SimdFloat<S>,
    {
        let [slope_x, slope_y] = self.slopes;
        [x.mul_add(self.minus_scale, t * slope_x), y.mul_add(self.minus_scale, t * slope_y), t * self.t_scale]
    }
}

/// Each number in all lanes.
#[inline(always)]
pub(super) fn splat_axes<S: Simd, V: SimdFloat<S, Element = f32>>(simd: S, v: [f32; 3]) -> [V; 3] {
    [V::splat(simd, v[0]), V::splat(simd, v[1]), V::splat(simd, v[2])]
}

/// Lane by lane a ray and a triangle as they are, along the axes of their space.
pub(super) struct PlaneOperands<V> {
    pub(super) origin: [V; 3],
    pub(super) direction: [V; 3],
    pub(super) corners: [[V; 3]; 3],
    /// The [`ShearRay`](crate::trace::kernel::ShearRay)'s.
    pub(super) scale: V,
}

#[inline(always)]
fn greater_of_others<S: Simd, V: SimdFloat<S>>(v: [V; 3]) -> [V; 3] {
    [v[1].max(v[2]), v[2].max(v[0]), v[0].max(v[1])]
}

/// [`cross_triangle`](crate::trace::kernel::intersect_triangle) in the lanes of `lanes`, with the same roundings: `x`, `y` and `t` are
/// the three corners'. Returns the lanes that cross. `plane_distance`, given the corners' t and weights, is the kernel's.
///
/// The edges come first. Where the ray is inside all of them by more than the tolerance, it is not beside the triangle either, so that
/// this is asked only where it is close to an edge.
#[inline(always)]
pub(super) fn intersect_triangles<S: Simd, V: SimdFloat<S, Element = f32>>(
    simd: S,
    lanes: u64,
    [x, y, t]: [[V; 3]; 3],
    depth_scale: V,
    plane_distance: impl FnOnce([V; 3], [V; 3]) -> V,
) -> Option<(u64, TriangleHits<V>)> {
    let zero = V::splat(simd, 0.0);
    let w = [x[2] * y[1] - y[2] * x[1], x[0] * y[2] - y[0] * x[2], x[1] * y[0] - y[1] * x[0]];
    let back = ((w[0] + w[1]) + w[2]).simd_lt(zero);
    let w = map_axes(
        w,
        #[inline(always)]
        |w| back.select(-w, w),
    );
    let w_least = min_component(w);
    let (x_abs, y_abs, t_abs) = (abs(x), abs(y), abs(t));
    let (x_extent, y_extent) = (max_component(x_abs), max_component(y_abs));
    let depth = max_component(t_abs) * depth_scale;
    let tolerance = (depth * (x_extent + y_extent) + x_extent * y_extent * 4.0) * EDGE_TOLERANCE;
    let outside = w_least.simd_lt(-tolerance).to_bitmask();
    let mut crossed = lanes & !outside;
    if crossed == 0 {
        return None;
    }

    if crossed & !w_least.simd_gt(tolerance).to_bitmask() != 0 {
        let x_tolerance = (depth + x_extent) * CORNER_TOLERANCE;
        let y_tolerance = (depth + y_extent) * CORNER_TOLERANCE;
        let beside = min_component(x).simd_gt(x_tolerance)
            | max_component(x).simd_lt(-x_tolerance)
            | min_component(y).simd_gt(y_tolerance)
            | max_component(y).simd_lt(-y_tolerance);
        crossed &= !beside.to_bitmask();
        // An edge with both corners near the ray is known better than by the triangle's tolerance.
        let (x, y, z) = (greater_of_others(x_abs), greater_of_others(y_abs), greater_of_others(t_abs));
        for i in 0..3 {
            let tolerance = (z[i] * depth_scale * (x[i] + y[i]) + x[i] * y[i] * 4.0) * EDGE_TOLERANCE;
            crossed &= !(w[i] + tolerance).simd_lt(zero).to_bitmask();
        }
    }

    // The point, inside the triangle whatever was rounded.
    let w = map_axes(
        w,
        #[inline(always)]
        |w| w.max(zero),
    );
    let area = (w[0] + w[1]) + w[2];
    crossed &= !area.simd_lt(V::splat(simd, f32::MIN_POSITIVE)).to_bitmask();
    let scale = V::splat(simd, 1.0) / area;
    let w = map_axes(
        w,
        #[inline(always)]
        |w| w * scale,
    );
    let t_hit = plane_distance(t, w).max(min_component(t)).min(max_component(t));
    Some((crossed, TriangleHits { t: t_hit, u: w[1], v: w[2], back: back.to_bitmask() }))
}

/// [`plane_distance`](crate::trace::kernel) lane by lane.
#[inline(always)]
pub(super) fn plane_distances<S: Simd, V: SimdFloat<S, Element = f32>>(
    lanes: &PlaneOperands<V>,
    t: [V; 3],
    w: [V; 3],
) -> V {
    let [v0, v1, v2] = lanes.corners;
    let [_, edge_1, edge_2] = map_axes(
        lanes.corners,
        #[inline(always)]
        |v| {
            map_axes(
                [0, 1, 2],
                #[inline(always)]
                |axis: usize| (v[axis] - v0[axis]) * lanes.scale,
            )
        },
    );
    let normal = [
        edge_1[1] * edge_2[2] - edge_1[2] * edge_2[1],
        edge_1[2] * edge_2[0] - edge_1[0] * edge_2[2],
        edge_1[0] * edge_2[1] - edge_1[1] * edge_2[0],
    ];
    let is_first = w[0].simd_ge(w[1]) & w[0].simd_ge(w[2]);
    let is_second = w[1].simd_ge(w[2]);
    let corner = map_axes(
        [0, 1, 2],
        #[inline(always)]
        |axis: usize| is_first.select(v0[axis], is_second.select(v1[axis], v2[axis])) - lanes.origin[axis],
    );
    let height = dot(normal, corner);
    let slope = dot(normal, lanes.direction);
    let without_quotient = (slope.abs() * SQRT_MAX_QUOTIENT).simd_le(height.abs() * (1.0 / SQRT_MAX_QUOTIENT));
    without_quotient.select(is_first.select(t[0], is_second.select(t[1], t[2])), height / slope)
}

#[inline(always)]
fn dot<S: Simd, V: SimdFloat<S, Element = f32>>(a: [V; 3], b: [V; 3]) -> V {
    (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
}

/// The first four triangles; where there are fewer, the last over and over.
#[inline(always)]
pub(super) fn first_four<'a>(triangles: &'a [Triangle], few: &'a mut [Triangle; 4]) -> &'a [Triangle; 4] {
    match triangles.first_chunk() {
        Some(four) => four,
        None => {
            *few = std::array::from_fn(|i| triangles[i.min(triangles.len() - 1)]);
            few
        }
    }
}

/// A vector for each of three corners, as [`gather_corners`] has them.
#[inline(always)]
pub(super) fn split_corners<S: Simd>(v: f32x16<S>) -> [f32x4<S>; 3] {
    let (ab, c) = v.split();
    let (a, b) = ab.split();
    [a, b, c.split().0]
}

/// Coordinates of the corners of four triangles along those [`SHEAR_AXES`]: four first corners, four second, four third, four of no meaning.
#[inline(always)]
pub(super) fn gather_corners<S: Simd>(simd: S, triangles: &[Triangle; 4], axes: usize) -> [f32x16<S>; 3] {
    #[cfg(target_arch = "x86_64")]
    if let Some(avx512) = simd.level().as_avx512() {
        let [x, y, t] = x86::corners_avx512(avx512, bytemuck::cast_ref(triangles), axes);
        return [x.simd_into(simd), y.simd_into(simd), t.simd_into(simd)];
    }
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

    /// For each of [`SHEAR_AXES`] where lanes come from: of the first 32 of 48 words, then of those lanes and the last 16 words. The last two are
    /// never used: eight are indexed with less ado.
    static SOURCES: [[[[u32; 16]; 2]; 3]; 8] = {
        let mut sources = [[[[0; 16]; 2]; 3]; 8];
        let mut i = 0;
        while i < SHEAR_AXES.len() * 3 * 16 {
            let (axes, axis, lane) = (i / 48, i / 16 % 3, i % 16);
            let word = lane % 4 * 12 + lane / 4 % 3 * 4 + SHEAR_AXES[axes][axis];
            sources[axes][axis][0][lane] = word as u32 % 32;
            sources[axes][axis][1][lane] = if word < 32 { lane as u32 } else { word as u32 - 16 };
            i += 1;
        }
        sources
    };

    fearless_simd::kernel!(
        #[inline(always)]
        pub(super) fn corners_avx512(avx512: Avx512, words: &[[f32; 16]; 3], axes: usize) -> [[f32; 16]; 3] {
            let load = |i: usize| -> __m512 { f32x16::simd_from(avx512, words[i]).into() };
            let [a, b, c] = [load(0), load(1), load(2)];
            let along = |[first, second]: &[[u32; 16]; 2]| {
                let first = fearless_simd::u32x16::simd_from(avx512, *first).into();
                let second = fearless_simd::u32x16::simd_from(avx512, *second).into();
                let v = _mm512_permutex2var_ps(_mm512_permutex2var_ps(a, first, b), second, c);
                f32x16::simd_from(avx512, v).into()
            };
            let [x, y, t] = &SOURCES[axes % 8];
            [along(x), along(y), along(t)]
        }
    );
}
