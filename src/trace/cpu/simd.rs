//! Vectors of sixteen and what is done with three of them at once.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f32x16, u8x16, u32x16};

use crate::device::layout::WideNode;
use crate::trace::kernel::BOX_ENTRY_SCALE;

/// Rays of a packet.
pub(super) const LANES: usize = 16;
/// A number a ray.
pub(super) type F32Lanes = [f32; LANES];

/// `[T; 3]::map`, but never a call: code in a function that is not inlined is not compiled for the processor's own lanes.
#[inline(always)]
pub(super) fn map_axes<T: Copy, U>(v: [T; 3], f: impl Fn(T) -> U) -> [U; 3] {
    [f(v[0]), f(v[1]), f(v[2])]
}

#[inline(always)]
pub(super) fn abs<S: Simd, V: SimdFloat<S>>(v: [V; 3]) -> [V; 3] {
    [v[0].abs(), v[1].abs(), v[2].abs()]
}

#[inline(always)]
pub(super) fn min_component<S: Simd, V: SimdFloat<S>>(v: [V; 3]) -> V {
    v[0].min(v[1]).min(v[2])
}

#[inline(always)]
pub(super) fn max_component<S: Simd, V: SimdFloat<S>>(v: [V; 3]) -> V {
    v[0].max(v[1]).max(v[2])
}

#[inline(always)]
pub(super) fn load<S: Simd>(simd: S, numbers: F32Lanes) -> f32x16<S> {
    numbers.simd_into(simd)
}

/// The least of all lanes, in eight lanes.
#[inline(always)]
pub(super) fn reduce_min<S: Simd>(v: f32x16<S>) -> f32x8<S> {
    let (a, b) = v.split();
    let v = a.min(b);
    let v = v.min(v.rotate_elements_left::<4>());
    let v = v.min(v.rotate_elements_left::<2>());
    v.min(v.rotate_elements_left::<1>())
}

/// The greatest of all lanes, in eight lanes.
#[inline(always)]
pub(super) fn reduce_max<S: Simd>(v: f32x16<S>) -> f32x8<S> {
    let (a, b) = v.split();
    let v = a.max(b);
    let v = v.max(v.rotate_elements_left::<4>());
    let v = v.max(v.rotate_elements_left::<2>());
    v.max(v.rotate_elements_left::<1>())
}

/// The lanes of a mask, lowest first.
#[inline(always)]
pub(super) fn lanes_of(mut mask: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(
        #[inline(always)]
        move || {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask.wrapping_sub(1);
            (lane < LANES).then_some(lane)
        },
    )
}

/// For each axis the order of bytes that brings the near planes of a node's children into the lower lanes, the far ones into the
/// upper, for rays of that octant.
#[inline(always)]
pub(super) fn near_far_shuffle<S: Simd>(simd: S, octant: usize) -> [u8x16<S>; 3] {
    static ORDERS: [[[u8; 16]; 3]; 8] = {
        let mut orders = [[[0; 16]; 3]; 8];
        let mut i = 0;
        while i < 8 * 3 * 16 {
            let (octant, axis, byte) = (i / 48, i / 16 % 3, i % 16);
            orders[octant][axis][byte] = if octant >> axis & 1 == 0 { byte as u8 } else { byte as u8 ^ 8 };
            i += 1;
        }
        orders
    };
    let [x, y, z] = ORDERS[octant & 7];
    [x.simd_into(simd), y.simd_into(simd), z.simd_into(simd)]
}

/// The planes of a node's children along an axis, in steps of its grid and in an order of [`near_far_shuffle`].
#[inline(always)]
pub(super) fn child_planes<S: Simd>(simd: S, node: &WideNode, axis: usize, order: u8x16<S>) -> f32x16<S> {
    let bytes: &[u8; 16] = bytemuck::cast_ref(&node.planes[axis]);
    u8_to_f32(simd, u8x16::simd_from(simd, *bytes).swizzle_dyn(order))
}

/// The lengths of a step of a node's grid.
#[inline(always)]
pub(super) fn grid_step<S: Simd>(simd: S, node: &WideNode) -> [f32x16<S>; 3] {
    let exponents = u32x16::splat(simd, u32::from_le_bytes(node.exponents));
    let step = |bits: u32x16<S>| (bits & 0xff << 23).bitcast::<f32x16<S>>();
    [step(exponents << 23), step(exponents << 15), step(exponents << 7)]
}

/// A bit for each child that a node has.
#[inline(always)]
pub(super) fn used_slots(node: &WideNode) -> u32 {
    u32::from(node.child_mask())
}

/// What boxes must reach of a ray: its start in the lower lanes, its end, negated, in the upper ones. The greatest of these and of
/// where the ray enters and, negated, leaves the slabs of a box says whether it is met.
#[inline(always)]
pub(super) fn ray_interval<S: Simd>(t_min: f32x8<S>, t_max: f32x8<S>) -> f32x16<S> {
    (t_min * BOX_ENTRY_SCALE).combine(-t_max)
}

/// The slots whose boxes are met, and where, by the greatest of all slabs and the [`ray_interval`].
#[inline(always)]
pub(super) fn hit_slots<S: Simd>(node: &WideNode, slabs: f32x16<S>) -> (u32, f32x8<S>) {
    let (enters, leaves) = slabs.split();
    ((enters + leaves).simd_le(0.0).to_bitmask() as u32 & used_slots(node), enters)
}

#[inline(always)]
fn u8_to_f32<S: Simd>(simd: S, bytes: u8x16<S>) -> f32x16<S> {
    #[cfg(target_arch = "x86_64")]
    {
        let array: [u8; 16] = bytes.into();
        if let Some(avx512) = simd.level().as_avx512() {
            return x86::floats_avx512(avx512, array).simd_into(simd);
        }
        if let Some(avx2) = simd.level().as_avx2() {
            return x86::floats_avx2(avx2, array).simd_into(simd);
        }
    }
    <[u8; 16]>::from(bytes).map(f32::from).simd_into(simd)
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use fearless_simd::prelude::*;
    use fearless_simd::{f32x8, f32x16, u8x16};

    fearless_simd::kernel!(
        #[inline(always)]
        pub(super) fn floats_avx512(avx512: Avx512, bytes: [u8; 16]) -> [f32; 16] {
            let bytes = u8x16::simd_from(avx512, bytes);
            f32x16::simd_from(avx512, _mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(bytes.into()))).into()
        }
    );

    fearless_simd::kernel!(
        #[inline(always)]
        pub(super) fn floats_avx2(avx2: Avx2, bytes: [u8; 16]) -> [f32; 16] {
            let bytes: __m128i = u8x16::simd_from(avx2, bytes).into();
            let low = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(bytes));
            let high = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_unpackhi_epi64(bytes, bytes)));
            f32x8::simd_from(avx2, low).combine(f32x8::simd_from(avx2, high)).into()
        }
    );
}
