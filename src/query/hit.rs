//! What a query found: a point on a triangle of a node.

use glam::DVec3;

use super::{PlacedInstance, Queries, to_dvec3};
use crate::device::layout::{NONE, Triangle};
use crate::graph::{GeometryKey, MaterialKey, NodePath};

/// A point on a triangle, and whose it is. World space.
#[derive(Clone, Debug, PartialEq)]
pub struct Hit {
    /// The node with the geometry.
    pub path: NodePath,
    /// What it shows.
    pub geometry: GeometryKey,
    /// What it is made of.
    pub material: MaterialKey,
    /// Index into the geometry's `indices`.
    pub triangle: u32,
    /// The weights of the triangle's three corners at the point; their sum is 1.
    pub barycentrics: DVec3,
    /// Of a ray: where on it, in units of its direction's length. Of a nearest point: how far it is.
    pub distance: f64,
    /// The point, on the triangle.
    pub position: DVec3,
    /// Unit normal of the triangle, on the side where it winds counter-clockwise in local space: its front. Zero for a triangle
    /// without area, which can be nearest, but not hit.
    pub geometric_normal: DVec3,
    /// Unit normal between those of the vertices, on the same side; the geometric one where there are none. Normal textures are
    /// not asked.
    pub shading_normal: DVec3,
    /// Whether the ray came, or the point lies, on the other side than the normals: behind.
    pub back_face: bool,
}

/// What is known of a hit until it turns out to be wanted.
#[derive(Clone, Copy)]
pub(super) struct HitCandidate {
    /// Index into the `instances` array.
    pub(super) instance_index: u32,
    /// Index into the `triangles` array.
    pub(super) triangle: u32,
    /// The triangle's index in its geometry.
    pub(super) primitive: u32,
    pub(super) barycentrics: DVec3,
    pub(super) distance: f64,
    pub(super) back: bool,
}

impl HitCandidate {
    /// By distance, then by instance and triangle: a strict order.
    pub(super) fn precedes(&self, other: &Self) -> bool {
        (self.distance, self.instance_index, self.primitive) < (other.distance, other.instance_index, other.primitive)
    }
}

impl Queries<'_> {
    pub(super) fn hit(&self, found: &HitCandidate) -> Option<Hit> {
        let arrays = self.compiler.arrays();
        let source = self.compiler.instance_source(found.instance_index, self.hierarchy)?;
        let placement = PlacedInstance::new(found.instance_index, &arrays.instances[found.instance_index as usize]);
        let triangle = &arrays.triangles[found.triangle as usize];
        let corners = [triangle.v0, triangle.v1, triangle.v2].map(to_dvec3);
        let local = interpolate(corners, found.barycentrics);

        // Normals go to the world by the transposed inverse.
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
            back_face: found.back,
        })
    }

    /// The normal between those of the vertices, local space; `None` where the geometry has none.
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

/// The sum of three vectors by their weights.
pub(super) fn interpolate([a, b, c]: [DVec3; 3], weights: DVec3) -> DVec3 {
    a * weights.x + b * weights.y + c * weights.z
}
