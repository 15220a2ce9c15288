//! The surface at a hit: frame, and material values. Twin of `shaders/shared/surface.wgsl`.

use glam::{Vec2, Vec3, Vec4, Vec4Swizzles as _};

use super::KernelScene;
use super::intersect::{max_component, reciprocal_power_of_two};
use super::material::{
    TrianglePoint, base_color_at, crossing_tint, emissive_at, first_tex_coord, metallic_roughness_at, tex_coord,
    tex_coord_at, transmission_at, triangle_point,
};
use super::math::{cross3, dot3, normalize3, transform_normal, transform_vector};
use super::offset::hit_point;
use super::texture::{image_coordinates, sample_texture};
use crate::device::layout::{HitRecord, InstanceFlags, InstanceRecord, MaterialFlags, MaterialRecord, NONE, Triangle};

/// The least cosine between a shading normal and the geometric one, and between a normal and the direction of view; also
/// the least slope at which a secondary ray leaves. 3 minutes of arc, a fifth of the sun's radius: light from below that is
/// as good as set.
pub(crate) const MIN_COSINE: f32 = 1.0 / (1 << 10) as f32;

#[derive(Clone, Copy)]
pub(crate) struct Surface {
    pub position: Vec3,
    /// Of the triangle's plane; unit, on the viewer's side.
    pub geometric_normal: Vec3,
    /// For shading; unit, on the viewer's side of the surface, and never below it.
    pub normal: Vec3,
    /// How far along the geometric normal secondary rays start.
    pub ray_offset: f32,
    pub base_color: Vec4,
    pub emissive: Vec3,
    pub metallic: f32,
    pub roughness: f32,
    pub transmission: f32,
    pub ior: f32,
    pub flags: MaterialFlags,
    /// What one crossing does to transmitted light.
    pub tint: Vec3,
    /// Light does not bend: the surface is a sheet, not the skin of a solid.
    pub thin: bool,
    /// Seen from within the solid.
    pub is_inside: bool,
}

pub(crate) fn surface_at(scene: &KernelScene<'_>, hit: &HitRecord, direction: Vec3) -> Surface {
    let instance = &scene.instances[hit.instance as usize];
    let triangle = &scene.triangles[hit.triangle as usize];
    let material = &scene.materials[instance.material as usize];
    let place = triangle_point(scene, instance, triangle.primitive, hit.u, hit.v);
    let anchor = hit_point(instance, triangle, place.weights, -direction);

    let back = dot3(direction, anchor.normal) > 0.0;
    let side = if back { -1.0 } else { 1.0 };
    let geometric_normal = anchor.normal * side;
    let front_normal = shading_normal(scene, instance, triangle, material, &place, anchor.normal);
    let normal = clamp_shading_normal(front_normal * side, geometric_normal, -direction);

    let base_color = base_color_at(scene, material, &place);
    let [metallic, roughness] = metallic_roughness_at(scene, material, &place);
    let mut surface = Surface {
        position: anchor.position,
        geometric_normal,
        normal,
        ray_offset: anchor.ray_offset,
        base_color,
        emissive: emissive_at(scene, material, &place),
        metallic,
        roughness,
        transmission: 0.0,
        ior: material.ior,
        flags: MaterialFlags::from_bits_retain(material.flags),
        tint: Vec3::ZERO,
        thin: false,
        is_inside: false,
    };
    if material.transmission > 0.0 {
        surface.transmission = transmission_at(scene, material, &place);
        surface.tint = crossing_tint(instance, base_color.xyz());
        surface.thin = InstanceFlags::from_bits_retain(instance.flags).contains(InstanceFlags::THIN);
        surface.is_inside = back && !surface.thin;
    }
    surface
}

/// The unit normal to shade with, on the side of the triangle's winding: the vertices', bent by the normal texture.
fn shading_normal(
    scene: &KernelScene<'_>,
    instance: &InstanceRecord,
    triangle: &Triangle,
    material: &MaterialRecord,
    place: &TrianglePoint,
    plane_normal: Vec3,
) -> Vec3 {
    let mut normal = plane_normal;
    if place.streams.first_normal != NONE {
        let [a, b, c] = place.vertices.map(|vertex| vertex_normal(scene, place.streams.first_normal, vertex));
        let local = (a * place.weights.x + b * place.weights.y) + c * place.weights.z;
        normal = normalize_or(transform_normal(&instance.local_from_world, local), plane_normal);
        // Vertex normals that contradict the winding: the winding says which side is out.
        if dot3(normal, plane_normal) < 0.0 {
            normal = -normal;
        }
    }
    if material.normal_texture != NONE {
        normal = normal_mapped(scene, instance, triangle, material, place, normal);
    }
    normal
}

/// A normal from a texture, in the frame that the texture coordinates span: x along increasing u, y along decreasing v (up
/// in the image). Mirrored coordinates mirror the frame.
fn normal_mapped(
    scene: &KernelScene<'_>,
    instance: &InstanceRecord,
    triangle: &Triangle,
    material: &MaterialRecord,
    place: &TrianglePoint,
    normal: Vec3,
) -> Vec3 {
    let info = &scene.texture_infos[material.normal_texture as usize];
    let first = first_tex_coord(info, &place.streams);
    if first == NONE {
        return normal;
    }
    let [a, b, c] = place.vertices.map(|vertex| image_coordinates(info, tex_coord(scene, first + vertex)));
    let (along_1, along_2): (Vec2, Vec2) = (b - a, c - a);
    let handedness = if along_1.x * along_2.y - along_2.x * along_1.y < 0.0 { -1.0 } else { 1.0 };
    let [v0, v1, v2] = [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from_array);
    let edge_1 = transform_vector(&instance.world_from_local, v1 - v0);
    let edge_2 = transform_vector(&instance.world_from_local, v2 - v0);
    let along_u = (edge_1 * along_2.y - edge_2 * along_1.y) * handedness;
    let along_v = (edge_2 * along_1.x - edge_1 * along_2.x) * handedness;

    let tangent = normalize_or(along_u - normal * dot3(normal, along_u), Vec3::ZERO);
    let mut bitangent = cross3(normal, tangent);
    if dot3(bitangent, along_v) > 0.0 {
        bitangent = -bitangent;
    }
    let value = sample_texture(scene, info, tex_coord_at(scene, info, place)).xyz() * 2.0 - Vec3::ONE;
    let slope = tangent * (value.x * material.normal_scale) + bitangent * (value.y * material.normal_scale);
    normalize_or(slope + normal * value.z, normal)
}

/// The normal bent so that it lies above the surface and faces the viewer, both by at least [`MIN_COSINE`].
fn clamp_shading_normal(normal: Vec3, geometric_normal: Vec3, to_viewer: Vec3) -> Vec3 {
    clamp_cosine(clamp_cosine(normal, geometric_normal), to_viewer)
}

/// A unit vector, bent towards a pole until its cosine with it is at least [`MIN_COSINE`].
pub(crate) fn clamp_cosine(v: Vec3, pole: Vec3) -> Vec3 {
    let height = dot3(v, pole);
    if height >= MIN_COSINE {
        return v;
    }
    normalize_or(v + pole * (MIN_COSINE - height), pole)
}

fn vertex_normal(scene: &KernelScene<'_>, first: u32, vertex: u32) -> Vec3 {
    let i = (first + 3 * vertex) as usize;
    Vec3::new(scene.normals[i], scene.normals[i + 1], scene.normals[i + 2])
}

/// `v` scaled to length 1, whatever its length; `fallback` where it has no direction.
pub(crate) fn normalize_or(v: Vec3, fallback: Vec3) -> Vec3 {
    let largest = max_component(v.abs());
    if largest > 0.0 { normalize3(v * reciprocal_power_of_two(largest)) } else { fallback }
}
