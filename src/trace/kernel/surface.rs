//! Surface reconstruction at a hit: position, normals and material values. Twin of `shaders/shared/surface.wgsl`.

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

/// Least cosine between a shading normal and the geometric one, and between a normal and the view direction; also the
/// least slope at which a secondary ray leaves. 2^-10, about 3 arc minutes: light from lower directions is treated as
/// below the horizon.
pub(crate) const MIN_COSINE: f32 = 1.0 / (1 << 10) as f32;

#[derive(Clone, Copy)]
pub(crate) struct Surface {
    pub position: Vec3,
    /// Unit normal of the triangle, facing the viewer, world space.
    pub geometric_normal: Vec3,
    /// Unit shading normal, facing the viewer, in the hemisphere of the geometric normal, world space.
    pub normal: Vec3,
    /// World-space distance along the geometric normal at which secondary rays start.
    pub ray_offset: f32,
    pub base_color: Vec4,
    pub emissive: Vec3,
    pub metallic: f32,
    pub roughness: f32,
    pub transmission: f32,
    pub ior: f32,
    pub flags: MaterialFlags,
    /// Factor on light transmitted through one crossing.
    pub tint: Vec3,
    /// Thin wall: light passes without refraction.
    pub thin: bool,
    /// The viewer is inside the solid.
    pub is_inside: bool,
}

pub(crate) fn surface_at(scene: &KernelScene<'_>, hit: &HitRecord, direction: Vec3) -> Surface {
    let instance = &scene.instances[hit.instance as usize];
    let triangle = &scene.triangles[hit.triangle as usize];
    let material = &scene.materials[instance.material as usize];
    // 1. Position and geometric normal.
    let point = triangle_point(scene, instance, triangle.primitive, hit.u, hit.v);
    let at = hit_point(instance, triangle, point.weights, -direction);

    // 2. Face the viewer.
    let back = dot3(direction, at.normal) > 0.0;
    let side = if back { -1.0 } else { 1.0 };
    let geometric_normal = at.normal * side;
    // 3. Shading normal.
    let front_normal = shading_normal(scene, instance, triangle, material, &point, at.normal);
    let normal = clamp_shading_normal(front_normal * side, geometric_normal, -direction);

    // 4. Material values.
    let base_color = base_color_at(scene, material, &point);
    let [metallic, roughness] = metallic_roughness_at(scene, material, &point);
    let mut surface = Surface {
        position: at.position,
        geometric_normal,
        normal,
        ray_offset: at.ray_offset,
        base_color,
        emissive: emissive_at(scene, material, &point),
        metallic,
        roughness,
        transmission: 0.0,
        ior: material.ior,
        flags: MaterialFlags::from_bits_retain(material.flags),
        tint: Vec3::ZERO,
        thin: false,
        is_inside: false,
    };
    // 5. Transmission.
    if material.transmission > 0.0 {
        surface.transmission = transmission_at(scene, material, &point);
        surface.tint = crossing_tint(instance, base_color.xyz());
        surface.thin = InstanceFlags::from_bits_retain(instance.flags).contains(InstanceFlags::THIN);
        surface.is_inside = back && !surface.thin;
    }
    surface
}

/// The unit shading normal: interpolated vertex normal, then perturbed by the normal map; on the triangle's front side.
fn shading_normal(
    scene: &KernelScene<'_>,
    instance: &InstanceRecord,
    triangle: &Triangle,
    material: &MaterialRecord,
    point: &TrianglePoint,
    plane_normal: Vec3,
) -> Vec3 {
    let mut normal = plane_normal;
    if point.streams.first_normal != NONE {
        // Interpolate the vertex normals, and transform the result to world space.
        let [a, b, c] = point.vertices.map(|vertex| vertex_normal(scene, point.streams.first_normal, vertex));
        let local = (a * point.weights.x + b * point.weights.y) + c * point.weights.z;
        normal = normalize_or(transform_normal(&instance.local_from_world, local), plane_normal);
        // Flip interpolated normals that disagree with the winding, which defines the front.
        if dot3(normal, plane_normal) < 0.0 {
            normal = -normal;
        }
    }
    // Perturb it by the normal map.
    if material.normal_texture != NONE {
        normal = normal_mapped(scene, instance, triangle, material, point, normal);
    }
    normal
}

/// Applies a tangent-space normal map. The tangent frame comes from the triangle's texture coordinates: x along
/// increasing u, y along decreasing v (up in the image). Mirrored coordinates mirror the frame.
fn normal_mapped(
    scene: &KernelScene<'_>,
    instance: &InstanceRecord,
    triangle: &Triangle,
    material: &MaterialRecord,
    point: &TrianglePoint,
    normal: Vec3,
) -> Vec3 {
    let info = &scene.texture_infos[material.normal_texture as usize];
    let first = first_tex_coord(info, &point.streams);
    if first == NONE {
        return normal;
    }
    // Edges in texture space, and their handedness.
    let [a, b, c] = point.vertices.map(|vertex| image_coordinates(info, tex_coord(scene, first + vertex)));
    let (uv_edge_1, uv_edge_2): (Vec2, Vec2) = (b - a, c - a);
    let handedness = if uv_edge_1.x * uv_edge_2.y - uv_edge_2.x * uv_edge_1.y < 0.0 { -1.0 } else { 1.0 };
    let [v0, v1, v2] = [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from_array);
    // Tangent and bitangent in world space.
    let edge_1 = transform_vector(&instance.world_from_local, v1 - v0);
    let edge_2 = transform_vector(&instance.world_from_local, v2 - v0);
    let along_u = (edge_1 * uv_edge_2.y - edge_2 * uv_edge_1.y) * handedness;
    let along_v = (edge_2 * uv_edge_1.x - edge_1 * uv_edge_2.x) * handedness;

    // Make the frame orthogonal to the shading normal, with the bitangent up in the image.
    let tangent = normalize_or(along_u - normal * dot3(normal, along_u), Vec3::ZERO);
    let mut bitangent = cross3(normal, tangent);
    if dot3(bitangent, along_v) > 0.0 {
        bitangent = -bitangent;
    }
    // Perturb the normal.
    let value = sample_texture(scene, info, tex_coord_at(scene, info, point)).xyz() * 2.0 - Vec3::ONE;
    let slope = tangent * (value.x * material.normal_scale) + bitangent * (value.y * material.normal_scale);
    normalize_or(slope + normal * value.z, normal)
}

/// Clamps the shading normal so that its cosine with both the geometric normal and the view direction is at least
/// [`MIN_COSINE`].
fn clamp_shading_normal(normal: Vec3, geometric_normal: Vec3, to_viewer: Vec3) -> Vec3 {
    clamp_cosine(clamp_cosine(normal, geometric_normal), to_viewer)
}

/// Moves a unit vector toward `pole` until their cosine is at least [`MIN_COSINE`].
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

/// `v` scaled to length 1, whatever its length; `fallback` for the zero vector.
pub(crate) fn normalize_or(v: Vec3, fallback: Vec3) -> Vec3 {
    let largest = max_component(v.abs());
    if largest > 0.0 { normalize3(v * reciprocal_power_of_two(largest)) } else { fallback }
}
