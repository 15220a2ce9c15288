//! The bounds of a range of triangles, from which leaves are refitted.

use glam::Vec4;

use crate::accel::tree::SimdAabb;
use crate::device::layout::Triangle;

/// The box around triangles, not padded. Its fourth lanes hold no coordinates.
pub(super) fn triangle_bounds(triangles: &[Triangle]) -> SimdAabb {
    let corners = triangles.iter().flat_map(|triangle| bytemuck::cast::<_, [Vec4; 3]>(*triangle));
    corners.fold(SimdAabb::EMPTY, SimdAabb::extended_to)
}
