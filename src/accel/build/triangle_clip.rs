//! Clips a triangle at an axis-aligned plane and bounds both parts.

use glam::Vec4;

use crate::accel::padding::SIDE_MARGIN;
use crate::accel::tree::SimdAabb;
use crate::graph::Geometry;
use crate::math::Aabb;

/// A triangle to be clipped, with the margin of the boxes of its parts.
pub(super) struct TriangleClipper {
    corners: [Vec4; 3],
    /// By how much boxes are widened along each axis, see [`split_bounds`](Self::split_bounds).
    margin: Vec4,
}

/// The boxes of the two parts; an empty one has `min > max` on some axis.
pub(super) struct ClippedBounds {
    pub(super) left: SimdAabb,
    pub(super) right: SimdAabb,
}

/// Margin of a clipped box, relative to the triangle's largest coordinate: 2^-21.
const CLIP_MARGIN: f32 = 1.0 / (1 << 21) as f32;

impl TriangleClipper {
    #[inline]
    pub(super) fn new(geometry: &Geometry, primitive: u32) -> Self {
        let corners = geometry.indices[primitive as usize].map(|v| geometry.positions[v as usize].extend(0.0));
        let [a, b, c] = corners;
        let longest = (a.max(b).max(c) - a.min(b).min(c)).max_element();
        let farthest = a.abs().max(b.abs()).max(c.abs());
        Self { corners, margin: farthest * CLIP_MARGIN + (longest * SIDE_MARGIN + f32::MIN_POSITIVE) }
    }

    /// Boxes around the parts of the triangle on either side of the plane, each intersected with `bounds`, the box of
    /// the part that is divided.
    ///
    /// Both are widened by 2^-18 times the triangle's longest side ([`SIDE_MARGIN`]), as the whole box is beforehand
    /// ([`widen_references`](super::spatial_split::widen_references)), and 2^-21 times, per axis, its largest absolute
    /// coordinate. This covers the rounding of the intersection points here (at most half of it) and the rounding that
    /// the proof of the traversal assumes (`trace::kernel::intersect`, point 3): the kernel meets the triangle at a
    /// rounded weighted mean of its corners, which may be off by 2^-24 of the longest corner vector relative to the ray
    /// origin. A box around whole corners contains such a point because rounding is monotonic; the box of a part need
    /// not. The share of the error that grows with the distance to the ray origin is covered by the slack of the box
    /// test.
    #[inline]
    pub(super) fn split_bounds(&self, bounds: &SimdAabb, axis: usize, plane: f32) -> ClippedBounds {
        let [mut left, mut right] = [SimdAabb::EMPTY; 2];
        let [a, b, c] = self.corners;
        // Walk the triangle's edges.
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let (start, end) = (from[axis], to[axis]);
            // A corner belongs to the side that it is on, and to both sides if it is in the plane.
            if start <= plane {
                left = left.extended_to(from);
            }
            if start >= plane {
                right = right.extended_to(from);
            }
            // If the edge crosses the plane, the intersection belongs to both sides.
            if (start < plane && plane < end) || (end < plane && plane < start) {
                let mut point = from + (to - from) * ((plane - start) / (end - start));
                point[axis] = plane;
                left = left.extended_to(point);
                right = right.extended_to(point);
            }
        }
        // Widen by the margin, but stay inside the given box, which has been widened before.
        ClippedBounds { left: self.within(left, bounds), right: self.within(right, bounds) }
    }

    #[inline]
    fn within(&self, part: SimdAabb, bounds: &SimdAabb) -> SimdAabb {
        SimdAabb { min: (part.min - self.margin).max(bounds.min), max: (part.max + self.margin).min(bounds.max) }
    }
}

/// Whether triangles in this box can be clipped in f32 without overflow or underflow: all coordinates are below 1e18,
/// and the longest side is above 1e-18.
pub(super) fn can_clip(bounds: &Aabb) -> bool {
    const MAX_COORDINATE: f32 = 1e18;
    const MIN_LONGEST_SIDE: f32 = 1e-18;
    let is_near = bounds.min.min_element() > -MAX_COORDINATE && bounds.max.max_element() < MAX_COORDINATE;
    is_near && (bounds.max - bounds.min).max_element() > MIN_LONGEST_SIDE
}
