//! What the two walks share: quantised planes and triangles brought into SIMD lanes, and the triangle test on them.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f32x8, f32x16};

use crate::device::layout::{Triangle, WideNode};
use crate::trace::kernel::{CORNER_TOLERANCE, EDGE_TOLERANCE};

/// Lane by lane a ray and a triangle: where they cross.
pub(super) struct Crossings<V> {
    pub(super) t: V,
    pub(super) u: V,
    pub(super) v: V,
    /// A bit for each lane whose ray came from the side where the triangle winds clockwise.
    pub(super) back: u64,
}

/// `[T; 3]::map`, but never a call: code in a function that is not inlined is not compiled for the processor's own lanes.
#[inline(always)]
pub(super) fn each<T: Copy, U>(v: [T; 3], f: impl Fn(T) -> U) -> [U; 3] {
    [f(v[0]), f(v[1]), f(v[2])]
}

/// Each number in all lanes.
#[inline(always)]
pub(super) fn splats<S: Simd, V: SimdFloat<S, Element = f32>>(simd: S, v: [f32; 3]) -> [V; 3] {
    [V::splat(simd, v[0]), V::splat(simd, v[1]), V::splat(simd, v[2])]
}

#[inline(always)]
fn others<S: Simd, V: SimdFloat<S>>(v: [V; 3]) -> [V; 3] {
    [v[1].max(v[2]), v[2].max(v[0]), v[0].max(v[1])]
}

#[inline(always)]
fn least<S: Simd, V: SimdFloat<S>>(v: [V; 3]) -> V {
    v[0].min(v[1]).min(v[2])
}

#[inline(always)]
fn greatest<S: Simd, V: SimdFloat<S>>(v: [V; 3]) -> V {
    v[0].max(v[1]).max(v[2])
}

/// Lane by lane a ray and a triangle as they are, along the axes of their space.
pub(super) struct Unsheared<V> {
    pub(super) origin: [V; 3],
    pub(super) direction: [V; 3],
    pub(super) corners: [[V; 3]; 3],
    /// The [`ShearRay`](crate::trace::kernel::ShearRay)'s.
    pub(super) scale: f32,
}

/// [`cross_triangle`](crate::trace::kernel) lane by lane, with the same roundings: `x`, `y` and `t` are the three corners'.
/// Returns the lanes that cross. `plane_distance`, given these lanes and the corners' t and weights, is the kernel's.
#[inline(always)]
pub(super) fn cross<S: Simd, V: SimdFloat<S, Element = f32>>(
    simd: S,
    x: [V; 3],
    y: [V; 3],
    t: [V; 3],
    depth_scale: V,
    plane_distance: impl FnOnce(u64, [V; 3], [V; 3]) -> V,
) -> Option<(u64, Crossings<V>)> {
    let zero = V::splat(simd, 0.0);
    let (t_least, t_greatest) = (least(t), greatest(t));
    let depth = (-t_least).max(t_greatest) * depth_scale;

    // 1. Beside the triangle by more than rounding can explain?
    let (x_least, x_greatest) = (least(x), greatest(x));
    let (y_least, y_greatest) = (least(y), greatest(y));
    let (x_extent, y_extent) = ((-x_least).max(x_greatest), (-y_least).max(y_greatest));
    let x_tolerance = (depth + x_extent) * CORNER_TOLERANCE;
    let y_tolerance = (depth + y_extent) * CORNER_TOLERANCE;
    let beside = x_least.simd_gt(x_tolerance)
        | x_greatest.simd_lt(-x_tolerance)
        | y_least.simd_gt(y_tolerance)
        | y_greatest.simd_lt(-y_tolerance);

    // 2. Outside of an edge by more than that?
    let w = [x[2] * y[1] - y[2] * x[1], x[0] * y[2] - y[0] * x[2], x[1] * y[0] - y[1] * x[0]];
    let back = ((w[0] + w[1]) + w[2]).simd_lt(zero);
    let w = each(
        w,
        #[inline(always)]
        |w| back.select(-w, w),
    );
    let w_least = least(w);
    let tolerance = (depth * (x_extent + y_extent) + x_extent * y_extent * 4.0) * EDGE_TOLERANCE;
    let outside = w_least.simd_lt(-tolerance);
    let mut crossed = !(beside | outside);
    if crossed.all_false() {
        return None;
    }
    if (crossed & w_least.simd_lt(zero)).any_true() {
        let (x, y, z) = (
            others(each(
                x,
                #[inline(always)]
                |x| x.abs(),
            )),
            others(each(
                y,
                #[inline(always)]
                |y| y.abs(),
            )),
            others(each(
                t,
                #[inline(always)]
                |t| t.abs(),
            )),
        );
        for i in 0..3 {
            let tolerance = (z[i] * depth_scale * (x[i] + y[i]) + x[i] * y[i] * 4.0) * EDGE_TOLERANCE;
            crossed &= !((w[i] + tolerance).simd_lt(zero));
        }
    }

    // 3. The point, inside the triangle whatever was rounded.
    let w = each(
        w,
        #[inline(always)]
        |w| w.max(zero),
    );
    let area = (w[0] + w[1]) + w[2];
    crossed &= !area.simd_lt(V::splat(simd, f32::MIN_POSITIVE));
    let scale = V::splat(simd, 1.0) / area;
    let w = each(
        w,
        #[inline(always)]
        |w| w * scale,
    );
    let crossed = crossed.to_bitmask();
    let t = plane_distance(crossed, t, w).max(t_least).min(t_greatest);
    Some((crossed, Crossings { t, u: w[1], v: w[2], back: back.to_bitmask() }))
}

/// [`plane_distance`](crate::trace::kernel) lane by lane.
#[inline(always)]
pub(super) fn plane_distances<S: Simd, V: SimdFloat<S, Element = f32>>(
    lanes: &Unsheared<V>,
    t: [V; 3],
    w: [V; 3],
) -> V {
    let [v0, v1, v2] = lanes.corners;
    let [_, edge_1, edge_2] = each(
        lanes.corners,
        #[inline(always)]
        |v| {
            each(
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
    let corner = each(
        [0, 1, 2],
        #[inline(always)]
        |axis: usize| is_first.select(v0[axis], is_second.select(v1[axis], v2[axis])) - lanes.origin[axis],
    );
    let height = dot(normal, corner);
    let slope = dot(normal, lanes.direction);
    let without_quotient = slope.abs().simd_le(height.abs() * f32::MIN_POSITIVE);
    without_quotient.select(is_first.select(t[0], is_second.select(t[1], t[2])), height / slope)
}

#[inline(always)]
fn dot<S: Simd, V: SimdFloat<S, Element = f32>>(a: [V; 3], b: [V; 3]) -> V {
    (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
}

/// The near planes of a node's children along an axis in the lower lanes, the far ones in the upper; in steps of its grid. `near` is 0
/// where the ray goes up the axis, else 1.
#[inline(always)]
pub(super) fn planes<S: Simd>(simd: S, node: &WideNode, axis: usize, near: usize) -> f32x16<S> {
    let planes = &node.planes[axis];
    let near_first = u64::from_le_bytes(planes[near & 1]);
    let far_last = u64::from_le_bytes(planes[near & 1 ^ 1]);
    floats(simd, u128::from(near_first) | u128::from(far_last) << 64)
}

/// Sixteen bytes as numbers.
#[inline(always)]
fn floats<S: Simd>(simd: S, bytes: u128) -> f32x16<S> {
    #[cfg(target_arch = "x86_64")]
    {
        if let Some(avx512) = simd.level().as_avx512() {
            return x86::floats_avx512(avx512, bytes).simd_into(simd);
        }
        if let Some(avx2) = simd.level().as_avx2() {
            return x86::floats_avx2(avx2, bytes).simd_into(simd);
        }
    }
    bytes.to_le_bytes().map(f32::from).simd_into(simd)
}

/// The lower and the upper half.
#[inline(always)]
pub(super) fn halves<S: Simd>(v: f32x16<S>) -> (f32x8<S>, f32x8<S>) {
    v.split()
}

/// How a ray sees corners of triangles: along which axis it goes most, and the slopes along the others.
#[derive(Clone, Copy, Default)]
pub(super) struct Axes {
    /// The axes that become x, y and t.
    pub(super) order: [usize; 3],
}

/// Coordinates of the corners of up to four triangles, first corner, second, third: of each along x, y and z of `axes`.
#[inline(always)]
pub(super) fn corners<S: Simd>(simd: S, triangles: &[Triangle; 4], axes: Axes) -> [[f32x4<S>; 3]; 3] {
    let words: &[[f32; 12]; 4] = bytemuck::cast_ref(triangles);
    each(
        [0, 4, 8],
        #[inline(always)]
        |corner: usize| {
            each(
                axes.order,
                #[inline(always)]
                |axis: usize| {
                    let word = (corner + axis) % 12;
                    [words[0][word], words[1][word], words[2][word], words[3][word]].simd_into(simd)
                },
            )
        },
    )
}

/// The length of a step of a node's grid.
#[inline(always)]
pub(super) fn step(node: &WideNode, axis: usize) -> f32 {
    f32::from_bits(u32::from(node.exponents[axis]) << 23)
}

#[inline(always)]
pub(super) fn load<S: Simd>(simd: S, numbers: [f32; 16]) -> f32x16<S> {
    numbers.simd_into(simd)
}

/// One number in the lower lanes, another in the upper ones.
#[inline(always)]
pub(super) fn pair<S: Simd>(simd: S, low: f32, high: f32) -> f32x16<S> {
    f32x8::splat(simd, low).combine(f32x8::splat(simd, high))
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    fearless_simd::kernel!(
        #[inline(always)]
        pub(super) fn floats_avx512(avx512: Avx512, bytes: u128) -> [f32; 16] {
            let bytes = _mm_set_epi64x((bytes >> 64) as i64, bytes as i64);
            let floats = _mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(bytes));
            fearless_simd::f32x16::simd_from(avx512, floats).into()
        }
    );

    fearless_simd::kernel!(
        #[inline(always)]
        pub(super) fn floats_avx2(avx2: Avx2, bytes: u128) -> [f32; 16] {
            let low = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_cvtsi64_si128(bytes as i64)));
            let high = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_cvtsi64_si128((bytes >> 64) as i64)));
            let low = fearless_simd::f32x8::simd_from(avx2, low);
            let high = fearless_simd::f32x8::simd_from(avx2, high);
            low.combine(high).into()
        }
    );
    use fearless_simd::prelude::*;
}
