// What a material is at a point of a triangle: vertex streams times textures times factors. Twin of
// src/trace/kernel/material.rs.

// A point of a triangle, as the vertex streams see it.
struct TrianglePoint {
    streams: GeometryRecord,
    vertices: vec3<u32>,
    weights: vec3<f32>,
}

fn triangle_point(instance: InstanceRecord, primitive: u32, u: f32, v: f32) -> TrianglePoint {
    let streams = geometries[instance.geometry];
    // A geometry without streams has no indices either.
    var vertices = vec3<u32>(0u);
    if streams.first_index != NONE {
        let first = streams.first_index + 3u * primitive;
        vertices = vec3<u32>(indices[first], indices[first + 1u], indices[first + 2u]);
    }
    return TrianglePoint(streams, vertices, vec3<f32>((1.0 - u) - v, u, v));
}

// Whether an alpha-masked material has a hole here: closest_hit asks about each candidate.
fn fails_alpha_test(instance: InstanceRecord, primitive: u32, u: f32, v: f32) -> bool {
    let material = materials[instance.material];
    if (material.flags & MATERIAL_MASK) == 0u {
        return false;
    }
    return base_color_at(material, triangle_point(instance, primitive, u, v)).w < material.alpha_cutoff;
}

// The part of the light that goes on through a candidate of a shadow ray: all through a hole, what alpha leaves open, and
// of the rest what is refracted. Shadow rays do not bend, and Fresnel reflection is taken at normal incidence.
fn surface_transmittance(instance: InstanceRecord, primitive: u32, u: f32, v: f32) -> vec3<f32> {
    let material = materials[instance.material];
    let place = triangle_point(instance, primitive, u, v);
    let base_color = base_color_at(material, place);
    if (material.flags & MATERIAL_MASK) != 0u && base_color.w < material.alpha_cutoff {
        return vec3<f32>(1.0);
    }
    var transmitted = vec3<f32>(0.0);
    if NEEDS_REFRACTION && material.transmission > 0.0 {
        let entering = (1.0 - f0_from_ior(material.ior)) * (1.0 - metallic_roughness_at(material, place).x);
        transmitted = crossing_tint(instance, base_color.xyz) * (entering * transmission_at(material, place));
    }
    if NEEDS_BLEND && (material.flags & MATERIAL_BLEND) != 0u {
        return mix3(vec3<f32>(1.0), transmitted, base_color.w);
    }
    return transmitted;
}

// Linear base colour and alpha.
fn base_color_at(material: MaterialRecord, place: TrianglePoint) -> vec4<f32> {
    var color = material.base_color;
    if NEEDS_COLORS && place.streams.first_color != NONE {
        let first = place.streams.first_color;
        let a = vertex_color(first + place.vertices.x) * place.weights.x;
        let b = vertex_color(first + place.vertices.y) * place.weights.y;
        let c = vertex_color(first + place.vertices.z) * place.weights.z;
        color *= (a + b) + c;
    }
    if NEEDS_TEXTURES && material.base_color_texture != NONE {
        color *= texture_at(material.base_color_texture, place);
    }
    return color;
}

// Metallic and perceptual roughness.
fn metallic_roughness_at(material: MaterialRecord, place: TrianglePoint) -> vec2<f32> {
    if NEEDS_TEXTURES && material.metallic_roughness_texture != NONE {
        let value = texture_at(material.metallic_roughness_texture, place);
        return vec2<f32>(material.metallic * value.z, material.roughness * value.y);
    }
    return vec2<f32>(material.metallic, material.roughness);
}

fn emissive_at(material: MaterialRecord, place: TrianglePoint) -> vec3<f32> {
    if NEEDS_TEXTURES && material.emissive_texture != NONE {
        return material.emissive * texture_at(material.emissive_texture, place).xyz;
    }
    return material.emissive;
}

fn transmission_at(material: MaterialRecord, place: TrianglePoint) -> f32 {
    if NEEDS_TEXTURES && material.transmission_texture != NONE {
        return material.transmission * texture_at(material.transmission_texture, place).x;
    }
    return material.transmission;
}

// What one crossing of the surface does to transmitted light. A solid is entered and left: two crossings make its base colour.
fn crossing_tint(instance: InstanceRecord, base_color: vec3<f32>) -> vec3<f32> {
    if (instance.flags & INSTANCE_THIN) != 0u {
        return base_color;
    }
    return sqrt(base_color);
}

// What a dielectric of this index of refraction reflects at normal incidence. 0 stands for infinite.
fn f0_from_ior(ior: f32) -> f32 {
    if ior <= 0.0 {
        return 1.0;
    }
    let ratio = (ior - 1.0) / (ior + 1.0);
    return ratio * ratio;
}

fn texture_at(info_index: u32, place: TrianglePoint) -> vec4<f32> {
    let info = texture_infos[info_index];
    return sample_texture(info, tex_coord_at(info, place));
}

// Texture coordinates of the set that a texture uses; (0, 0) where the geometry does not have it.
fn tex_coord_at(info: TextureInfo, place: TrianglePoint) -> vec2<f32> {
    let first = first_tex_coord(info, place.streams);
    if first == NONE {
        return vec2<f32>(0.0);
    }
    let a = tex_coords[first + place.vertices.x] * place.weights.x;
    let b = tex_coords[first + place.vertices.y] * place.weights.y;
    let c = tex_coords[first + place.vertices.z] * place.weights.z;
    return (a + b) + c;
}

fn first_tex_coord(info: TextureInfo, streams: GeometryRecord) -> u32 {
    if (info.flags & TEXTURE_TEX_COORD_1) != 0u {
        return streams.first_tex_coord_1;
    }
    return streams.first_tex_coord_0;
}

fn vertex_color(i: u32) -> vec4<f32> {
    let words = colors[i];
    let rgba = vec4<f32>(f32(words.x & 65535u), f32(words.x >> 16u), f32(words.y & 65535u), f32(words.y >> 16u));
    return rgba * (1.0 / 65535.0);
}
