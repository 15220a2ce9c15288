// Surface reconstruction at a hit: position, normals and material values. Twin of src/trace/kernel/surface.rs.

// Least cosine between a shading normal and the geometric one, and between a normal and the view direction; also the
// least slope at which a secondary ray leaves. 2^-10, about 3 arc minutes: light from lower directions is treated as
// below the horizon.
const MIN_COSINE: f32 = 9.765625e-4; // 2^-10

struct Surface {
    position: vec3<f32>,
    // Unit normal of the triangle, facing the viewer, world space.
    geometric_normal: vec3<f32>,
    // Unit shading normal, facing the viewer, in the hemisphere of the geometric normal, world space.
    normal: vec3<f32>,
    // World-space distance along the geometric normal at which secondary rays start.
    ray_offset: f32,
    base_color: vec4<f32>,
    emissive: vec3<f32>,
    metallic: f32,
    roughness: f32,
    transmission: f32,
    ior: f32,
    flags: u32,
    // Factor on light transmitted through one crossing.
    tint: vec3<f32>,
    // Thin wall: light passes without refraction.
    thin: bool,
    // The viewer is inside the solid.
    is_inside: bool,
}

fn surface_at(hit: HitRecord, direction: vec3<f32>) -> Surface {
    let instance = instances[hit.instance];
    let triangle = triangle_at(hit.triangle);
    let material = materials[instance.material];
    // 1. Position and geometric normal.
    let point = triangle_point(instance, triangle.primitive, hit.u, hit.v);
    let at = hit_point(instance, triangle, point.weights, -direction);

    // 2. Face the viewer.
    let back = dot3(direction, at.normal) > 0.0;
    let side = select(1.0, -1.0, back);
    let geometric_normal = at.normal * side;
    // 3. Shading normal.
    let front_normal = shading_normal(instance, triangle, material, point, at.normal);
    let normal = clamp_shading_normal(front_normal * side, geometric_normal, -direction);

    // 4. Material values.
    let base_color = base_color_at(material, point);
    let metallic_roughness = metallic_roughness_at(material, point);
    var surface: Surface;
    surface.position = at.position;
    surface.geometric_normal = geometric_normal;
    surface.normal = normal;
    surface.ray_offset = at.ray_offset;
    surface.base_color = base_color;
    surface.emissive = emissive_at(material, point);
    surface.metallic = metallic_roughness.x;
    surface.roughness = metallic_roughness.y;
    surface.transmission = 0.0;
    surface.ior = material.ior;
    surface.flags = material.flags;
    // 5. Transmission.
    if NEEDS_REFRACTION && material.transmission > 0.0 {
        surface.transmission = transmission_at(material, point);
        surface.tint = crossing_tint(instance, base_color.xyz);
        surface.thin = (instance.flags & INSTANCE_THIN) != 0u;
        surface.is_inside = back && !surface.thin;
    }
    return surface;
}

// The unit shading normal: interpolated vertex normal, then perturbed by the normal map; on the triangle's front side.
fn shading_normal(
    instance: InstanceRecord,
    triangle: Triangle,
    material: MaterialRecord,
    point: TrianglePoint,
    plane_normal: vec3<f32>,
) -> vec3<f32> {
    var normal = plane_normal;
    if point.streams.first_normal != NONE {
        let a = vertex_normal(point.streams.first_normal, point.vertices.x) * point.weights.x;
        let b = vertex_normal(point.streams.first_normal, point.vertices.y) * point.weights.y;
        let c = vertex_normal(point.streams.first_normal, point.vertices.z) * point.weights.z;
        normal = normalize_or(transform_normal(instance.local_from_world, (a + b) + c), plane_normal);
        // Flip interpolated normals that disagree with the winding, which defines the front.
        if dot3(normal, plane_normal) < 0.0 {
            normal = -normal;
        }
    }
    if NEEDS_NORMAL_TEXTURES && material.normal_texture != NONE {
        normal = normal_mapped(instance, triangle, material, point, normal);
    }
    return normal;
}

// Applies a tangent-space normal map. The tangent frame comes from the triangle's texture coordinates: x along
// increasing u, y along decreasing v (up in the image). Mirrored coordinates mirror the frame.
fn normal_mapped(
    instance: InstanceRecord,
    triangle: Triangle,
    material: MaterialRecord,
    point: TrianglePoint,
    normal: vec3<f32>,
) -> vec3<f32> {
    let info = texture_infos[material.normal_texture];
    let first = first_tex_coord(info, point.streams);
    if first == NONE {
        return normal;
    }
    // Edges in texture space, and their handedness.
    let origin = image_coordinates(info, tex_coords[first + point.vertices.x]);
    let uv_edge_1 = image_coordinates(info, tex_coords[first + point.vertices.y]) - origin;
    let uv_edge_2 = image_coordinates(info, tex_coords[first + point.vertices.z]) - origin;
    let handedness = select(1.0, -1.0, uv_edge_1.x * uv_edge_2.y - uv_edge_2.x * uv_edge_1.y < 0.0);
    // Tangent and bitangent in world space.
    let edge_1 = transform_vector(instance.world_from_local, triangle.v1 - triangle.v0);
    let edge_2 = transform_vector(instance.world_from_local, triangle.v2 - triangle.v0);
    let along_u = (edge_1 * uv_edge_2.y - edge_2 * uv_edge_1.y) * handedness;
    let along_v = (edge_2 * uv_edge_1.x - edge_1 * uv_edge_2.x) * handedness;

    let tangent = normalize_or(along_u - normal * dot3(normal, along_u), vec3<f32>(0.0));
    var bitangent = cross3(normal, tangent);
    if dot3(bitangent, along_v) > 0.0 {
        bitangent = -bitangent;
    }
    // Perturb the normal.
    let value = sample_texture(info, tex_coord_at(info, point)).xyz * 2.0 - vec3<f32>(1.0);
    let slope = (tangent * (value.x * material.normal_scale) + bitangent * (value.y * material.normal_scale));
    return normalize_or(slope + normal * value.z, normal);
}

// Clamps the shading normal so that its cosine with both the geometric normal and the view direction is at least
// MIN_COSINE.
fn clamp_shading_normal(normal: vec3<f32>, geometric_normal: vec3<f32>, to_viewer: vec3<f32>) -> vec3<f32> {
    return clamp_cosine(clamp_cosine(normal, geometric_normal), to_viewer);
}

// Moves a unit vector toward `pole` until their cosine is at least MIN_COSINE.
fn clamp_cosine(v: vec3<f32>, pole: vec3<f32>) -> vec3<f32> {
    let height = dot3(v, pole);
    if height >= MIN_COSINE {
        return v;
    }
    return normalize_or(v + pole * (MIN_COSINE - height), pole);
}

fn vertex_normal(first: u32, vertex: u32) -> vec3<f32> {
    let i = first + 3u * vertex;
    return vec3<f32>(normals[i], normals[i + 1u], normals[i + 2u]);
}

// `v` scaled to length 1, whatever its length; `fallback` for the zero vector.
fn normalize_or(v: vec3<f32>, fallback: vec3<f32>) -> vec3<f32> {
    let largest = max_component(abs(v));
    if !(largest > 0.0) {
        return fallback;
    }
    return normalize3(v * reciprocal_power_of_two(largest));
}
