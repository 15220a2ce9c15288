// Material values at a point of a triangle: factor x texture x vertex attribute, and the transmittance of shadow rays.
// Twin of src/trace/kernel/material.rs.

// A point of a triangle: vertex indices and barycentric weights, with the arrays they index.
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

// Alpha test: whether a masked material is cut out at this point. Evaluated for each closest-hit candidate.
fn fails_alpha_test(instance: InstanceRecord, primitive: u32, u: f32, v: f32) -> bool {
    let material = materials[instance.material];
    let alpha = base_color_at(material, triangle_point(instance, primitive, u, v)).w;
    return ((material.flags & MATERIAL_MASK) != 0u && alpha < material.alpha_cutoff)
        || ((material.flags & MATERIAL_BLEND) != 0u && alpha <= 0.0);
}

// Transmittance of a surface to a shadow ray: 1 in a hole of the alpha test. Else the share that the material
// transmits; with blending, that share weighted by alpha, plus 1 - alpha. Shadow rays are not refracted; Fresnel
// reflectance is taken at normal incidence.
fn surface_transmittance(instance: InstanceRecord, primitive: u32, u: f32, v: f32) -> vec3<f32> {
    let material = materials[instance.material];
    let point = triangle_point(instance, primitive, u, v);
    let base_color = base_color_at(material, point);
    // Cut out: all light.
    if (material.flags & MATERIAL_MASK) != 0u && base_color.w < material.alpha_cutoff {
        return vec3<f32>(1.0);
    }
    // The refracted share.
    var transmitted = vec3<f32>(0.0);
    if NEEDS_REFRACTION && material.transmission > 0.0 {
        let entering = (1.0 - f0_from_ior(material.ior)) * (1.0 - metallic_roughness_at(material, point).x);
        transmitted = crossing_tint(instance, base_color.xyz) * (entering * transmission_at(material, point));
    }
    // Blended: the rest by alpha.
    if NEEDS_BLEND && (material.flags & MATERIAL_BLEND) != 0u {
        return mix3(vec3<f32>(1.0), transmitted, base_color.w);
    }
    return transmitted;
}

// Linear base colour and alpha.
fn base_color_at(material: MaterialRecord, point: TrianglePoint) -> vec4<f32> {
    var color = material.base_color;
    if NEEDS_COLORS && point.streams.first_color != NONE {
        let first = point.streams.first_color;
        let a = vertex_color(first + point.vertices.x) * point.weights.x;
        let b = vertex_color(first + point.vertices.y) * point.weights.y;
        let c = vertex_color(first + point.vertices.z) * point.weights.z;
        color *= (a + b) + c;
    }
    if NEEDS_TEXTURES && material.base_color_texture != NONE {
        color *= texture_at(material.base_color_texture, point);
    }
    return color;
}

// Metallic and perceptual roughness.
fn metallic_roughness_at(material: MaterialRecord, point: TrianglePoint) -> vec2<f32> {
    if NEEDS_TEXTURES && material.metallic_roughness_texture != NONE {
        let value = texture_at(material.metallic_roughness_texture, point);
        return vec2<f32>(material.metallic * value.z, material.roughness * value.y);
    }
    return vec2<f32>(material.metallic, material.roughness);
}

fn emissive_at(material: MaterialRecord, point: TrianglePoint) -> vec3<f32> {
    if NEEDS_TEXTURES && material.emissive_texture != NONE {
        return material.emissive * texture_at(material.emissive_texture, point).xyz;
    }
    return material.emissive;
}

fn transmission_at(material: MaterialRecord, point: TrianglePoint) -> f32 {
    if NEEDS_TEXTURES && material.transmission_texture != NONE {
        return material.transmission * texture_at(material.transmission_texture, point).x;
    }
    return material.transmission;
}

// Tint of light per surface crossing: the base colour for thin walls; its square root for solids, which are crossed
// twice.
fn crossing_tint(instance: InstanceRecord, base_color: vec3<f32>) -> vec3<f32> {
    if (instance.flags & INSTANCE_THIN) != 0u {
        return base_color;
    }
    return sqrt(base_color);
}

// Reflectance of a dielectric at normal incidence. 0 stands for an infinite index of refraction.
fn f0_from_ior(ior: f32) -> f32 {
    if ior <= 0.0 {
        return 1.0;
    }
    let ratio = (ior - 1.0) / (ior + 1.0);
    return ratio * ratio;
}

fn texture_at(info_index: u32, point: TrianglePoint) -> vec4<f32> {
    let info = texture_infos[info_index];
    return sample_texture(info, tex_coord_at(info, point));
}

// Texture coordinates of the set that a texture uses; (0, 0) if the geometry does not have it.
fn tex_coord_at(info: TextureInfo, point: TrianglePoint) -> vec2<f32> {
    let first = first_tex_coord(info, point.streams);
    if first == NONE {
        return vec2<f32>(0.0);
    }
    let a = tex_coords[first + point.vertices.x] * point.weights.x;
    let b = tex_coords[first + point.vertices.y] * point.weights.y;
    let c = tex_coords[first + point.vertices.z] * point.weights.z;
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
