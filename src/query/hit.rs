//! Query results: a point on a triangle of a node.

use std::cmp::Ordering;

use glam::DVec3;

use super::{PlacedInstance, Queries, to_dvec3};
use crate::device::layout::{NONE, Triangle};
use crate::graph::{GeometryKey, MaterialKey, NodePath};

/// A point on a triangle of a node, in world space.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Hit {
    /// The node with the geometry.
    pub path: NodePath,
    /// The node's geometry.
    pub geometry: GeometryKey,
    /// Its material: that of the node's core, or of a material group above it.
    pub material: MaterialKey,
    /// Index into the geometry's `indices`.
    pub triangle: u32,
    /// Barycentric coordinates of the point: the weights of the triangle's three vertices; they sum to 1.
    pub barycentrics: DVec3,
    /// For a ray query: t, in units of the direction's length. For [`Queries::nearest`]: the distance in world units.
    pub distance: f64,
    /// The position of the point.
    pub position: DVec3,
    /// Unit geometric normal, pointing to the front side: the one from which the vertices are in counter-clockwise
    /// order in local space. Zero for a triangle so narrow that its normal is lost to rounding in f64.
    pub geometric_normal: DVec3,
    /// Unit normal interpolated between those of the vertices, turned to the side of the geometric normal; equal to
    /// that if the geometry has no normals. Normal maps are not applied.
    pub shading_normal: DVec3,
    /// Whether the ray's origin or the query point is on the back side of the triangle, away from the normals.
    pub back_face: bool,
}

/// A candidate hit, as indices; resolved to a [`Hit`] only if it is returned.
#[derive(Clone, Copy)]
pub(crate) struct HitCandidate {
    /// Index into the `instances` array.
    pub(crate) instance_index: u32,
    /// Index into the `triangles` array.
    pub(crate) triangle: u32,
    /// The triangle's index in its geometry.
    pub(crate) primitive: u32,
    pub(crate) barycentrics: DVec3,
    pub(crate) distance: f64,
    pub(crate) back_face: bool,
}

/// By how much a back face counts as farther, relative to its distance: beyond the rounding of both. Where a closed
/// surface is hit at a ridge, the face that faces the ray then comes before the other.
const BACK_FACE_STEP: f64 = 64.0 * f64::EPSILON;

impl HitCandidate {
    /// The order of hits along a ray: by distance, where a back face counts as a [little](BACK_FACE_STEP) farther, then
    /// by instance index, then by triangle.
    pub(super) fn order(&self, other: &Self) -> Ordering {
        let ids = |hit: &Self| (hit.instance_index, hit.primitive);
        self.depth().total_cmp(&other.depth()).then_with(|| ids(self).cmp(&ids(other)))
    }

    /// Whether this point is nearer; of points at one distance the one of the lower instance, then the lower triangle.
    pub(super) fn is_nearer(&self, other: &Self) -> bool {
        (self.distance, self.instance_index, self.primitive) < (other.distance, other.instance_index, other.primitive)
    }

    fn depth(&self) -> f64 {
        if self.back_face { self.distance + self.distance.abs() * BACK_FACE_STEP } else { self.distance }
    }

    /// The greatest distance of a hit that may come before this one.
    pub(super) fn greatest_distance_before(&self) -> f64 {
        self.distance + self.distance.abs() * (2.0 * BACK_FACE_STEP)
    }
}

impl Queries<'_> {
    /// Resolves a candidate to keys, world positions and normals.
    pub(super) fn hit(&self, found: &HitCandidate) -> Option<Hit> {
        let arrays = self.compiler.arrays();
        let source = self.compiler.instance_source(found.instance_index, self.hierarchy)?;
        let placement = self.placed(found.instance_index, &arrays.instances[found.instance_index as usize])?;
        // 1. The point in local space.
        let triangle = &arrays.triangles[found.triangle as usize];
        let corners = [triangle.v0, triangle.v1, triangle.v2].map(to_dvec3);
        let local = interpolate(corners, found.barycentrics);

        // 2. Normals, transformed to world space by the transpose of the inverse matrix.
        let to_world = placement.local_from_world.matrix3.transpose();
        let local_normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let geometric_normal = (to_world * local_normal.normalize_or_zero()).normalize_or_zero();
        let vertex_normal = self.vertex_normal(&placement, triangle, found.barycentrics);
        let shading_normal = vertex_normal
            .and_then(|normal| (to_world * normal).try_normalize())
            .map_or(geometric_normal, |normal| if normal.dot(geometric_normal) < 0.0 { -normal } else { normal });
        Some(Hit {
            path: source.path,
            geometry: source.geometry,
            material: source.material,
            triangle: found.primitive,
            barycentrics: found.barycentrics,
            distance: found.distance,
            position: placement.world_from_local.transform_point3(local) + self.compiler.origin(),
            geometric_normal,
            shading_normal,
            back_face: found.back_face,
        })
    }

    /// The normal interpolated between those of the vertices, in local space; `None` if the geometry has none.
    fn vertex_normal(&self, placement: &PlacedInstance<'_>, triangle: &Triangle, weights: DVec3) -> Option<DVec3> {
        let arrays = self.compiler.arrays();
        let streams = &arrays.geometries[placement.instance.geometry as usize];
        if streams.first_normal == NONE {
            return None;
        }
        let normal_at = |corner: u32| {
            let vertex = arrays.indices[(streams.first_index + 3 * triangle.primitive + corner) as usize];
            let first = (streams.first_normal + 3 * vertex) as usize;
            to_dvec3([arrays.normals[first], arrays.normals[first + 1], arrays.normals[first + 2]])
        };
        Some(interpolate([0, 1, 2].map(normal_at), weights))
    }
}

/// The weighted sum of three vectors.
pub(super) fn interpolate([a, b, c]: [DVec3; 3], weights: DVec3) -> DVec3 {
    a * weights.x + b * weights.y + c * weights.z
}
