//! Material values at a point of a triangle: factor x texture x vertex attribute, and the transmittance of shadow rays.
//! Twin of `shaders/shared/material.wgsl`.

use glam::{Vec2, Vec3, Vec4, Vec4Swizzles as _};

use super::KernelScene;
use super::math::mix3;
use super::texture::sample_texture;
use crate::device::layout::{
    GeometryRecord, InstanceFlags, InstanceRecord, MaterialFlags, MaterialRecord, NONE, TextureFlags, TextureInfo,
};

/// A point of a triangle: vertex indices and barycentric weights, with the arrays they index.
pub(crate) struct TrianglePoint {
    pub streams: GeometryRecord,
    pub vertices: [u32; 3],
    pub weights: Vec3,
}

pub(crate) fn triangle_point(
    scene: &KernelScene<'_>,
    instance: &InstanceRecord,
    primitive: u32,
    u: f32,
    v: f32,
) -> TrianglePoint {
    let streams = scene.geometries[instance.geometry as usize];
    // A geometry without streams has no indices either.
    let mut vertices = [0; 3];
    if streams.first_index != NONE {
        let first = (streams.first_index + 3 * primitive) as usize;
        vertices = [scene.indices[first], scene.indices[first + 1], scene.indices[first + 2]];
    }
    TrianglePoint { streams, vertices, weights: Vec3::new((1.0 - u) - v, u, v) }
}

/// Alpha test: whether a masked material is cut out at this point, or a blended one fully transparent. Evaluated for
/// each closest-hit candidate.
pub(crate) fn fails_alpha_test(
    scene: &KernelScene<'_>,
    instance: &InstanceRecord,
    primitive: u32,
    u: f32,
    v: f32,
) -> bool {
    let material = &scene.materials[instance.material as usize];
    let alpha = base_color_at(scene, material, &triangle_point(scene, instance, primitive, u, v)).w;
    (has_flags(material, MaterialFlags::MASK) && alpha < material.alpha_cutoff)
        || (has_flags(material, MaterialFlags::BLEND) && alpha <= 0.0)
}

/// Transmittance of a surface to a shadow ray: 1 where the alpha test fails; else the transmitted share, of blended
/// materials (1 - alpha) plus alpha times it. Shadow rays are not refracted; Fresnel reflectance is taken at normal
/// incidence.
pub(crate) fn surface_transmittance(
    scene: &KernelScene<'_>,
    instance: &InstanceRecord,
    primitive: u32,
    u: f32,
    v: f32,
) -> Vec3 {
    // Evaluate the base colour where the ray crosses the surface.
    let material = &scene.materials[instance.material as usize];
    let point = triangle_point(scene, instance, primitive, u, v);
    let base_color = base_color_at(scene, material, &point);
    // Cut out: all light.
    if has_flags(material, MaterialFlags::MASK) && base_color.w < material.alpha_cutoff {
        return Vec3::ONE;
    }
    // The refracted share.
    let mut transmitted = Vec3::ZERO;
    if material.transmission > 0.0 {
        let [metallic, _] = metallic_roughness_at(scene, material, &point);
        let entering = (1.0 - f0_from_ior(material.ior)) * (1.0 - metallic);
        transmitted = crossing_tint(instance, base_color.xyz()) * (entering * transmission_at(scene, material, &point));
    }
    // Blended: the rest by alpha.
    if has_flags(material, MaterialFlags::BLEND) {
        return mix3(Vec3::ONE, transmitted, base_color.w);
    }
    transmitted
}

/// Linear base colour and alpha.
pub(crate) fn base_color_at(scene: &KernelScene<'_>, material: &MaterialRecord, point: &TrianglePoint) -> Vec4 {
    let mut color = Vec4::from_array(material.base_color);
    // Multiply by the interpolated vertex colour.
    if point.streams.first_color != NONE {
        let first = point.streams.first_color;
        let [a, b, c] = point.vertices.map(|vertex| vertex_color(scene, first + vertex));
        color *= (a * point.weights.x + b * point.weights.y) + c * point.weights.z;
    }
    // Multiply by the texture.
    if material.base_color_texture != NONE {
        color *= texture_at(scene, material.base_color_texture, point);
    }
    color
}

/// Metallic and perceptual roughness.
pub(crate) fn metallic_roughness_at(
    scene: &KernelScene<'_>,
    material: &MaterialRecord,
    point: &TrianglePoint,
) -> [f32; 2] {
    if material.metallic_roughness_texture != NONE {
        let value = texture_at(scene, material.metallic_roughness_texture, point);
        // glTF keeps roughness in the green channel and metallic in the blue one.
        return [material.metallic * value.z, material.roughness * value.y];
    }
    [material.metallic, material.roughness]
}

pub(crate) fn emissive_at(scene: &KernelScene<'_>, material: &MaterialRecord, point: &TrianglePoint) -> Vec3 {
    let emissive = Vec3::from_array(material.emissive);
    if material.emissive_texture != NONE {
        return emissive * texture_at(scene, material.emissive_texture, point).xyz();
    }
    emissive
}

pub(crate) fn transmission_at(scene: &KernelScene<'_>, material: &MaterialRecord, point: &TrianglePoint) -> f32 {
    if material.transmission_texture != NONE {
        return material.transmission * texture_at(scene, material.transmission_texture, point).x;
    }
    material.transmission
}

/// Tint of light per surface crossing: the base colour for thin walls; its square root for solids, which are crossed
/// twice.
pub(crate) fn crossing_tint(instance: &InstanceRecord, base_color: Vec3) -> Vec3 {
    if InstanceFlags::from_bits_retain(instance.flags).contains(InstanceFlags::THIN) {
        return base_color;
    }
    Vec3::new(base_color.x.sqrt(), base_color.y.sqrt(), base_color.z.sqrt())
}

/// Reflectance of a dielectric at normal incidence. 0 stands for an infinite index of refraction.
pub(crate) fn f0_from_ior(ior: f32) -> f32 {
    if ior <= 0.0 {
        return 1.0;
    }
    let ratio = (ior - 1.0) / (ior + 1.0);
    ratio * ratio
}

fn texture_at(scene: &KernelScene<'_>, info_index: u32, point: &TrianglePoint) -> Vec4 {
    let info = &scene.texture_infos[info_index as usize];
    sample_texture(scene, info, tex_coord_at(scene, info, point))
}

/// Texture coordinates of the set that a texture uses; (0, 0) if the geometry does not have it.
pub(crate) fn tex_coord_at(scene: &KernelScene<'_>, info: &TextureInfo, point: &TrianglePoint) -> Vec2 {
    let first = first_tex_coord(info, &point.streams);
    if first == NONE {
        return Vec2::ZERO;
    }
    let [a, b, c] = point.vertices.map(|vertex| tex_coord(scene, first + vertex));
    (a * point.weights.x + b * point.weights.y) + c * point.weights.z
}

pub(crate) fn tex_coord(scene: &KernelScene<'_>, i: u32) -> Vec2 {
    Vec2::from_array(scene.tex_coords[i as usize])
}

pub(crate) fn first_tex_coord(info: &TextureInfo, streams: &GeometryRecord) -> u32 {
    if TextureFlags::from_bits_retain(info.flags).contains(TextureFlags::TEX_COORD_1) {
        return streams.first_tex_coord_1;
    }
    streams.first_tex_coord_0
}

fn vertex_color(scene: &KernelScene<'_>, i: u32) -> Vec4 {
    // Unpack four 16-bit channels.
    let [low, high] = scene.colors[i as usize];
    let rgba = [low & 65535, low >> 16, high & 65535, high >> 16];
    Vec4::from_array(rgba.map(|unorm| unorm as f32)) * (1.0 / 65535.0)
}

fn has_flags(material: &MaterialRecord, flags: MaterialFlags) -> bool {
    MaterialFlags::from_bits_retain(material.flags).contains(flags)
}
