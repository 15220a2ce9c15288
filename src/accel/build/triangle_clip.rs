//! The box of a part of a triangle.

use glam::Vec4;

use crate::accel::tree::SimdAabb;
use crate::graph::Geometry;
use crate::math::Aabb;

/// A triangle to be cut.
pub(super) struct TriangleClipper {
    corners: [Vec4; 3],
    /// See [`cut`](Self::split_bounds).
    margin: Vec4,
}

/// Two boxes; one may be empty, with a least corner above the greatest one.
pub(super) struct ClippedBounds {
    pub(super) left: SimdAabb,
    pub(super) right: SimdAabb,
}

/// 2^-21.
const CLIP_MARGIN: f32 = 1.0 / (1 << 21) as f32;

impl TriangleClipper {
    pub(super) fn new(geometry: &Geometry, primitive: u32) -> Self {
        let corners = geometry.indices[primitive as usize].map(|v| geometry.positions[v as usize].extend(0.0));
        let [a, b, c] = corners;
        let longest = (a.max(b).max(c) - a.min(b).min(c)).max_element();
        let farthest = a.abs().max(b.abs()).max(c.abs());
        Self { corners, margin: (farthest + longest) * CLIP_MARGIN + f32::MIN_POSITIVE }
    }

    /// The boxes around what lies on either side of a plane, of that part of the triangle that is in `bounds`.
    ///
    /// Both have a margin of 2^-21 of the triangle's longest side and of its corners' distances along each axis. It covers the
    /// rounding here, half of that at most, and that of the kernel's proof (`trace::kernel::intersect`, point 3): there a ray
    /// meets the triangle at a mean of its corners relative to the origin, rounded, which is off what is exact by 2^-24 of the
    /// longest of these. Boxes around whole corners hold that by monotonic rounding, but those of parts do not; the part of it
    /// that goes with the distance to the origin is in the slack of the box test.
    pub(super) fn split_bounds(&self, bounds: &SimdAabb, axis: usize, plane: f32) -> ClippedBounds {
        let [mut left, mut right] = [SimdAabb::EMPTY; 2];
        let [a, b, c] = self.corners;
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let (start, end) = (from[axis], to[axis]);
            if start <= plane {
                left = left.extended_to(from);
            }
            if start >= plane {
                right = right.extended_to(from);
            }
            if (start < plane && plane < end) || (end < plane && plane < start) {
                let mut point = from + (to - from) * ((plane - start) / (end - start));
                point[axis] = plane;
                left = left.extended_to(point);
                right = right.extended_to(point);
            }
        }
        ClippedBounds { left: self.within(left, bounds), right: self.within(right, bounds) }
    }

    fn within(&self, part: SimdAabb, bounds: &SimdAabb) -> SimdAabb {
        SimdAabb { min: (part.min - self.margin).max(bounds.min), max: (part.max + self.margin).min(bounds.max) }
    }
}

/// Whether triangles in this box can be cut: nothing overflows or vanishes.
pub(super) fn can_clip(bounds: &Aabb) -> bool {
    const FARTHEST: f32 = 1e18;
    const SHORTEST: f32 = 1e-18;
    let is_near = bounds.min.min_element() > -FARTHEST && bounds.max.max_element() < FARTHEST;
    is_near && (bounds.max - bounds.min).max_element() > SHORTEST
}
