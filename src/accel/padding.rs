//! The padding of node boxes: how far a box extends beyond its contents.

use glam::{Vec3, Vec4, Vec4Swizzles};

use super::tree::SimdAabb;

/// The share of its longest side by which a box is padded: 2^-18.
pub(crate) const SIDE_MARGIN: f32 = 1.0 / (1 << 18) as f32;

/// Pads a box on every side by 2 to 4 ulp of the coordinate, 2^-18 of the box's longest side ([`SIDE_MARGIN`]), and the
/// smallest normal float.
///
/// Without padding the slab test misses rays that lie in a face plane, and all rays through a flat box. Ulps alone do
/// not help a flat box at coordinate 0. The share of the longest side is what the tolerance of the triangle test
/// requires (`trace::kernel::intersect`, point 3); the smallest normal float serves a box
/// that is a point (a subnormal would be flushed to zero on some GPUs). Every operation is monotonic, so a box inside
/// another stays inside. The result is finite.
///
/// This is for a `side_margin` of [`SIDE_MARGIN`].
pub(super) fn pad_corners(min: Vec3, max: Vec3, side_margin: f32) -> (Vec3, Vec3) {
    let padded = pad_by(SimdAabb { min: min.extend(0.0), max: max.extend(0.0) }, side_margin);
    (padded.min.xyz(), padded.max.xyz())
}

/// [`pad_corners`] on 4-lane vectors, by [`SIDE_MARGIN`].
#[inline]
pub(super) fn pad_bounds(bounds: SimdAabb) -> SimdAabb {
    pad_by(bounds, SIDE_MARGIN)
}

#[inline(always)]
fn pad_by(SimdAabb { min, max }: SimdAabb, side_margin: f32) -> SimdAabb {
    const ULPS: f32 = 1.0 / (1 << 22) as f32;
    // The fourth lanes may hold indices, whose bits may be subnormal floats and would slow the arithmetic a
    // hundredfold: clear them.
    let (min, max) = (min.with_w(0.0), max.with_w(0.0));
    let half_side = (max * 0.5 - min * 0.5).max_element();
    let margin = Vec4::splat(half_side * (2.0 * side_margin) + f32::MIN_POSITIVE);
    let finite = Vec4::splat(f32::MAX);
    SimdAabb {
        min: (min - (min.abs() * ULPS + margin)).max(-finite),
        max: (max + (max.abs() * ULPS + margin)).min(finite),
    }
}
