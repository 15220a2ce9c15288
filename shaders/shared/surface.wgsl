// The surface at a hit: frame, and material values. Twin of src/trace/kernel/surface.rs.

// The least cosine between a shading normal and the geometric one, and between a normal and the direction of view; also the
// least slope at which a secondary ray leaves.
const MIN_COSINE: f32 = 9.765625e-4; // 2^-10

struct Surface {
    position: vec3<f32>,
    // Of the triangle's plane; unit, on the viewer's side.
    geometric_normal: vec3<f32>,
    // For shading; unit, on the viewer's side of the surface, and never below it.
    normal: vec3<f32>,
    // How far along the geometric normal secondary rays start.
    ray_offset: f32,
    base_color: vec4<f32>,
    emissive: vec3<f32>,
    metallic: f32,
    roughness: f32,
    transmission: f32,
    ior: f32,
    flags: u32,
    // What one crossing does to transmitted light.
    tint: vec3<f32>,
    // Light does not bend: the surface is a sheet, not the skin of a solid.
    thin: bool,
    // Seen from within the solid.
    is_inside: bool,
}

fn surface_at(hit: HitRecord, direction: vec3<f32>) -> Surface {
    let instance = instances[hit.instance];
    let triangle = triangle_at(hit.triangle);
    let material = materials[instance.material];
    let place = triangle_point(instance, triangle.primitive, hit.u, hit.v);
    let anchor = hit_point(instance, triangle, place.weights, -direction);

    let back = dot3(direction, anchor.normal) > 0.0;
    let side = select(1.0, -1.0, back);
    let geometric_normal = anchor.normal * side;
    let front_normal = shading_normal(instance, triangle, material, place, anchor.normal);
    let normal = clamp_shading_normal(front_normal * side, geometric_normal, -direction);

    let base_color = base_color_at(material, place);
    let metallic_roughness = metallic_roughness_at(material, place);
    var surface: Surface;
    surface.position = anchor.position;
    surface.geometric_normal = geometric_normal;
    surface.normal = normal;
    surface.ray_offset = anchor.ray_offset;
    surface.base_color = base_color;
    surface.emissive = emissive_at(material, place);
    surface.metallic = metallic_roughness.x;
    surface.roughness = metallic_roughness.y;
    surface.transmission = 0.0;
    surface.ior = material.ior;
    surface.flags = material.flags;
    if NEEDS_REFRACTION && material.transmission > 0.0 {
        surface.transmission = transmission_at(material, place);
        surface.tint = crossing_tint(instance, base_color.xyz);
        surface.thin = (instance.flags & INSTANCE_THIN) != 0u;
        surface.is_inside = back && !surface.thin;
    }
    return surface;
}

// The unit normal to shade with, on the side of the triangle's winding: the vertices', bent by the normal texture.
fn shading_normal(instance: InstanceRecord, triangle: Triangle, material: MaterialRecord, place: TrianglePoint, plane_normal: vec3<f32>) -> vec3<f32> {
    var normal = plane_normal;
    if place.streams.first_normal != NONE {
        let a = vertex_normal(place.streams.first_normal, place.vertices.x) * place.weights.x;
        let b = vertex_normal(place.streams.first_normal, place.vertices.y) * place.weights.y;
        let c = vertex_normal(place.streams.first_normal, place.vertices.z) * place.weights.z;
        normal = normalize_or(transform_normal(instance.local_from_world, (a + b) + c), plane_normal);
        // Vertex normals that contradict the winding: the winding says which side is out.
        if dot3(normal, plane_normal) < 0.0 {
            normal = -normal;
        }
    }
    if NEEDS_NORMAL_TEXTURES && material.normal_texture != NONE {
        normal = normal_mapped(instance, triangle, material, place, normal);
    }
    return normal;
}

// A normal from a texture, in the frame that the texture coordinates span: x along increasing u, y along decreasing v (up in
// the image). Mirrored coordinates mirror the frame.
fn normal_mapped(instance: InstanceRecord, triangle: Triangle, material: MaterialRecord, place: TrianglePoint, normal: vec3<f32>) -> vec3<f32> {
    let info = texture_infos[material.normal_texture];
    let first = first_tex_coord(info, place.streams);
    if first == NONE {
        return normal;
    }
    let origin = image_coordinates(info, tex_coords[first + place.vertices.x]);
    let along_1 = image_coordinates(info, tex_coords[first + place.vertices.y]) - origin;
    let along_2 = image_coordinates(info, tex_coords[first + place.vertices.z]) - origin;
    let handedness = select(1.0, -1.0, along_1.x * along_2.y - along_2.x * along_1.y < 0.0);
    let edge_1 = transform_vector(instance.world_from_local, triangle.v1 - triangle.v0);
    let edge_2 = transform_vector(instance.world_from_local, triangle.v2 - triangle.v0);
    let along_u = (edge_1 * along_2.y - edge_2 * along_1.y) * handedness;
    let along_v = (edge_2 * along_1.x - edge_1 * along_2.x) * handedness;

    let tangent = normalize_or(along_u - normal * dot3(normal, along_u), vec3<f32>(0.0));
    var bitangent = cross3(normal, tangent);
    if dot3(bitangent, along_v) > 0.0 {
        bitangent = -bitangent;
    }
    let value = sample_texture(info, tex_coord_at(info, place)).xyz * 2.0 - vec3<f32>(1.0);
    let slope = (tangent * (value.x * material.normal_scale) + bitangent * (value.y * material.normal_scale));
    return normalize_or(slope + normal * value.z, normal);
}

// The normal bent so that it lies above the surface and faces the viewer, both by at least GRAZING.
fn clamp_shading_normal(normal: vec3<f32>, geometric_normal: vec3<f32>, to_viewer: vec3<f32>) -> vec3<f32> {
    return clamp_cosine(clamp_cosine(normal, geometric_normal), to_viewer);
}

// A unit vector, bent towards a pole until its cosine with it is at least GRAZING.
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

// v scaled to length 1, whatever its length; `fallback` where it has no direction.
fn normalize_or(v: vec3<f32>, fallback: vec3<f32>) -> vec3<f32> {
    let largest = max_component(abs(v));
    if !(largest > 0.0) {
        return fallback;
    }
    return normalize3(v * reciprocal_power_of_two(largest));
}
