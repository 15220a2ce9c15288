//! Decoding of wide nodes: child planes and grid steps as SIMD vectors, and the slab test of eight boxes at once.
//!
//! Entry and exit distances of eight children are kept in one 16-lane vector: lanes 0..8 hold entry distances, lanes
//! 8..16 exit distances, negated. So one lane-wise maximum intersects slabs and intervals, for both at once.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f32x16, u8x16, u32x16};

use super::simd::u8_to_f32;
use crate::device::layout::WideNode;
use crate::trace::kernel::BOX_ENTRY_SCALE;

/// Byte shuffles, one per axis, that put the near planes of a node's eight children into bytes 0..8 and the far planes
/// into bytes 8..16 for a direction octant.
#[inline(always)]
pub(super) fn near_far_shuffles<S: Simd>(simd: S, octant: usize) -> [u8x16<S>; 3] {
    static SHUFFLES: [[[u8; 16]; 3]; 8] = {
        let mut shuffles = [[[0; 16]; 3]; 8];
        let mut i = 0;
        while i < 8 * 3 * 16 {
            let (octant, axis, byte) = (i / 48, i / 16 % 3, i % 16);
            // Along a negative axis the greatest plane is the near one: swap the halves.
            shuffles[octant][axis][byte] = if octant >> axis & 1 == 0 { byte as u8 } else { byte as u8 ^ 8 };
            i += 1;
        }
        shuffles
    };
    let [x, y, z] = SHUFFLES[octant & 7];
    [x.simd_into(simd), y.simd_into(simd), z.simd_into(simd)]
}

/// The quantised child planes along an axis, shuffled by one of [`near_far_shuffles`], as f32 in units of the node's
/// grid step.
#[inline(always)]
pub(super) fn child_planes<S: Simd>(simd: S, node: &WideNode, axis: usize, shuffle: u8x16<S>) -> f32x16<S> {
    let bytes: &[u8; 16] = bytemuck::cast_ref(&node.planes[axis]);
    u8_to_f32(simd, u8x16::simd_from(simd, *bytes).swizzle_dyn(shuffle))
}

/// The grid step along each axis: a power of two, in local units.
#[inline(always)]
pub(super) fn grid_step<S: Simd>(simd: S, node: &WideNode) -> [f32x16<S>; 3] {
    let exponents = u32x16::splat(simd, u32::from_le_bytes(node.exponents));
    // Move the axis's byte to the exponent field of an f32.
    let step = |bits: u32x16<S>| (bits & 0xff << 23).bitcast::<f32x16<S>>();
    [step(exponents << 23), step(exponents << 15), step(exponents << 7)]
}

/// Mask of the slots in use.
#[inline(always)]
pub(super) fn used_slots(node: &WideNode) -> u32 {
    u32::from(node.child_mask())
}

/// The ray's interval in the form of the slab test: `t_min` in lanes 0..8, `-t_max` in lanes 8..16. The lane-wise
/// maximum of it and of the three axes' (entry, -exit) gives each child's (entry, -exit); the box is hit where entry <=
/// exit.
#[inline(always)]
pub(super) fn ray_interval<S: Simd>(t_min: f32x8<S>, t_max: f32x8<S>) -> f32x16<S> {
    (t_min * BOX_ENTRY_SCALE).combine(-t_max)
}

/// Mask of the slots hit, and their entry distances, from the maximum described at [`ray_interval`].
#[inline(always)]
pub(super) fn hit_slots<S: Simd>(node: &WideNode, slabs: f32x16<S>) -> (u32, f32x8<S>) {
    let (t_entry, minus_t_exit) = slabs.split();
    ((t_entry + minus_t_exit).simd_le(0.0).to_bitmask() as u32 & used_slots(node), t_entry)
}
