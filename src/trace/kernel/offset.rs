//! Where secondary rays start: outside the error of the hit point, and no farther. Twin of `shaders/shared/offset.wgsl`.
//!
//! A hit point is found in three roundings: interpolated in local space, taken to the world, and taken back to local space
//! when the next ray enters the same instance. With u = 2^-24, V the largest absolute coordinates of the triangle's
//! vertices, W = `world_from_local` and L = `local_from_world`, the point that the next ray starts from in local space
//! differs from one of the triangle's plane by at most, per coordinate:
//!
//! - interpolation: 8 u V (three products, two sums, and the weights' own rounding);
//! - to the world: 4 u |W| (V, 1), the rounding of W's numbers included, and u |W| (V, 1) for adding the offset; |L| takes
//!   both back to local space;
//! - to local space: 4 u (|L| (|W| (V, 1)) + |l|), l being L's translation, the rounding of L's numbers included;
//! - the next ray's direction turns by 4 u in local space, which over the size of the object is as much again.
//!
//! Together less than 16 u (V + |L| (|W| (V, 1)) + |l|) ([`TRANSFORM_ERROR`]). The intersection test has a tolerance of its
//! own, 8 u times sums of six extents of the triangle, less than 64 u of its longest edge ([`EDGE_ERROR`]). The bound `e` is the sum; for
//! the unnormalised local normal n it is |n|.e in the direction of n. A step d along the world normal L^T n / |L^T n| moves
//! the point in local space by d L L^T n / |L^T n|, which along n is d |L^T n|. Hence d = |n|.e / |L^T n|.
//!
//! An object of size 1 at the origin has offsets below 1e-5; one that is 1000 times its size away, some 1e-3 of its size.

use glam::Vec3;

use super::intersect::{max_component, reciprocal_power_of_two};
use super::math::{cross3, dot3, length3, transform_normal, transform_point};
use super::surface::Surface;
use crate::device::layout::{Instance, Triangle};

const HALF_ULP: f32 = 1.0 / 16_777_216.0;
const TRANSFORM_ERROR: f32 = 16.0 * HALF_ULP;
const EDGE_ERROR: f32 = 64.0 * HALF_ULP;

/// A point of a triangle in the world, with the plane's unit normal on the winding's side, and how far along it a ray must
/// start so that its own rounding cannot put it on the wrong side.
pub(crate) struct Anchor {
    pub position: Vec3,
    pub normal: Vec3,
    pub distance: f32,
}

/// A triangle that rounds to a line has no plane: it faces `fallback`, a unit vector.
pub(crate) fn anchor_on(instance: &Instance, triangle: &Triangle, weights: Vec3, fallback: Vec3) -> Anchor {
    let [v0, v1, v2] = [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from_array);
    let local = (v0 * weights.x + v1 * weights.y) + v2 * weights.z;
    let position = transform_point(&instance.world_from_local, local);
    let edge_1 = v1 - v0;
    let edge_2 = v2 - v0;
    let extent = max_component(edge_1.abs().max(edge_2.abs()));
    let to_unit_edges = reciprocal_power_of_two(extent);
    let local_normal = cross3(edge_1 * to_unit_edges, edge_2 * to_unit_edges);
    let world_normal = transform_normal(&instance.local_from_world, local_normal);
    let largest = max_component(world_normal.abs());
    if largest <= 0.0 {
        return Anchor { position, normal: fallback, distance: 0.0 };
    }

    let reach = v0.abs().max(v1.abs()).max(v2.abs());
    let round_trip = transform_extent(&instance.local_from_world, transform_extent(&instance.world_from_local, reach));
    let error = TRANSFORM_ERROR * (reach + round_trip) + Vec3::splat(EDGE_ERROR * extent);

    let scale = reciprocal_power_of_two(largest);
    let scaled_length = length3(world_normal * scale);
    let distance = (dot3(local_normal.abs(), error) * scale) / scaled_length;
    Anchor { position, normal: world_normal * (scale / scaled_length), distance }
}

/// The largest absolute coordinates, and sums on the way to them, of the transformed points with coordinates up to `reach`.
fn transform_extent(rows: &[[f32; 4]; 3], reach: Vec3) -> Vec3 {
    let [x, y, z] = rows.map(|[x, y, z, w]| dot3(Vec3::new(x, y, z).abs(), reach) + w.abs());
    Vec3::new(x, y, z)
}

/// Where a ray that leaves the surface in a direction starts.
pub(crate) fn leave(surface: &Surface, direction: Vec3) -> Vec3 {
    if dot3(direction, surface.geometric_normal) >= 0.0 {
        return surface.position + surface.geometric_normal * surface.offset;
    }
    surface.position - surface.geometric_normal * surface.offset
}
