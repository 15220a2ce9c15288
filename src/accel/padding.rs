//! The padding of boxes: how far a node's box lies outside of what it holds.

use glam::{Vec3, Vec4, Vec4Swizzles};

use super::tree::SimdAabb;

/// The box moved outward on every side: by 2 to 4 ulp of the coordinate, 2^-22 of the box's longest side and the smallest
/// normal number.
///
/// A slab test misses rays that lie exactly in a face plane, and all rays through a flat box. Ulps alone do not help a
/// flat box at coordinate 0, hence the share of the longest side; nor would a subnormal number, which a GPU may take for
/// zero. A box inside another stays inside: every operation here is monotonic. The result is finite.
pub(super) fn pad_corners(min: Vec3, max: Vec3) -> (Vec3, Vec3) {
    let padded = pad_bounds(SimdAabb { min: min.extend(0.0), max: max.extend(0.0) });
    (padded.min.xyz(), padded.max.xyz())
}

/// The same, four lanes at a time.
#[inline]
pub(super) fn pad_bounds(SimdAabb { min, max }: SimdAabb) -> SimdAabb {
    const ULPS: f32 = 1.0 / (1 << 22) as f32;
    // What is in the fourth lanes may be a subnormal number, which would slow the other lanes a hundredfold.
    let (min, max) = (min.with_w(0.0), max.with_w(0.0));
    let half_side = (max * 0.5 - min * 0.5).max_element();
    let margin = Vec4::splat(half_side * (2.0 * ULPS) + f32::MIN_POSITIVE);
    let finite = Vec4::splat(f32::MAX);
    SimdAabb {
        min: (min - (min.abs() * ULPS + margin)).max(-finite),
        max: (max + (max.abs() * ULPS + margin)).min(finite),
    }
}
