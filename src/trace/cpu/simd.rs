//! 16-lane vectors: one `f32` per ray of a packet, and helpers on three of them, one per axis.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f32x16, u8x16};

/// Rays per packet, and `f32` lanes per vector.
pub(super) const LANES: usize = 16;
/// One `f32` per ray of a packet, in memory.
pub(super) type F32Lanes = [f32; LANES];

/// `[T; 3]::map` that is always inlined: a function that is not inlined is compiled without the target features of the
/// dispatch.
#[inline(always)]
pub(super) fn map_axes<T: Copy, U>(v: [T; 3], f: impl Fn(T) -> U) -> [U; 3] {
    [f(v[0]), f(v[1]), f(v[2])]
}

/// Broadcasts each coordinate of a point to all lanes.
#[inline(always)]
pub(super) fn splat_axes<S: Simd, V: SimdFloat<S, Element = f32>>(simd: S, v: [f32; 3]) -> [V; 3] {
    [V::splat(simd, v[0]), V::splat(simd, v[1]), V::splat(simd, v[2])]
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

#[inline(always)]
pub(super) fn store<S: Simd>(v: [f32x16<S>; 3]) -> [F32Lanes; 3] {
    [v[0].into(), v[1].into(), v[2].into()]
}

/// Horizontal minimum of 16 lanes, broadcast to eight.
#[inline(always)]
pub(super) fn reduce_min<S: Simd>(v: f32x16<S>) -> f32x8<S> {
    let (a, b) = v.split();
    let v = a.min(b);
    let v = v.min(v.rotate_elements_left::<4>());
    let v = v.min(v.rotate_elements_left::<2>());
    v.min(v.rotate_elements_left::<1>())
}

/// Horizontal maximum of 16 lanes, broadcast to eight.
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

/// Converts 16 bytes to floats, by one instruction each where the processor has it.
#[inline(always)]
pub(super) fn u8_to_f32<S: Simd>(simd: S, bytes: u8x16<S>) -> f32x16<S> {
    #[cfg(target_arch = "x86_64")]
    {
        let array: [u8; 16] = bytes.into();
        if let Some(avx512) = simd.level().as_avx512() {
            return x86::u8_to_f32_avx512(avx512, array).simd_into(simd);
        }
        if let Some(avx2) = simd.level().as_avx2() {
            return x86::u8_to_f32_avx2(avx2, array).simd_into(simd);
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
        pub(super) fn u8_to_f32_avx512(avx512: Avx512, bytes: [u8; 16]) -> [f32; 16] {
            let bytes = u8x16::simd_from(avx512, bytes);
            f32x16::simd_from(avx512, _mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(bytes.into()))).into()
        }
    );

    fearless_simd::kernel!(
        #[inline(always)]
        pub(super) fn u8_to_f32_avx2(avx2: Avx2, bytes: [u8; 16]) -> [f32; 16] {
            let bytes: __m128i = u8x16::simd_from(avx2, bytes).into();
            let low = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(bytes));
            let high = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_unpackhi_epi64(bytes, bytes)));
            f32x8::simd_from(avx2, low).combine(f32x8::simd_from(avx2, high)).into()
        }
    );
}
