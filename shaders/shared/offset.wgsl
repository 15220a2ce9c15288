// Where secondary rays start: outside the error of the hit point, and no farther. Twin of src/trace/kernel/offset.rs: the
// bound is derived there.

const HALF_ULP: f32 = 5.960464477539063e-8; // 2^-24
const TRANSFORM_ERROR_FACTOR: f32 = 16.0 * HALF_ULP;
const EDGE_ERROR: f32 = 64.0 * HALF_ULP;

// A point of a triangle in the world, with the plane's unit normal on the winding's side, and how far along it a ray must
// start so that its own rounding cannot put it on the wrong side.
struct HitPoint {
    position: vec3<f32>,
    normal: vec3<f32>,
    ray_offset: f32,
}

// A triangle that rounds to a line has no plane: it faces `fallback`, a unit vector.
fn hit_point(instance: InstanceRecord, triangle: Triangle, weights: vec3<f32>, fallback: vec3<f32>) -> HitPoint {
    let local = (triangle.v0 * weights.x + triangle.v1 * weights.y) + triangle.v2 * weights.z;
    let position = transform_point(instance.world_from_local, local);
    let edge_1 = triangle.v1 - triangle.v0;
    let edge_2 = triangle.v2 - triangle.v0;
    let extent = max_component(max(abs(edge_1), abs(edge_2)));
    let to_unit_edges = reciprocal_power_of_two(extent);
    let local_normal = cross3(edge_1 * to_unit_edges, edge_2 * to_unit_edges);
    let world_normal = transform_normal(instance.local_from_world, local_normal);
    let largest = max_component(abs(world_normal));
    let has_plane = largest > 0.0;
    if !has_plane {
        return HitPoint(position, fallback, 0.0);
    }

    let reach = max(max(abs(triangle.v0), abs(triangle.v1)), abs(triangle.v2));
    let round_trip = transform_abs(instance.local_from_world, transform_abs(instance.world_from_local, reach));
    let error = TRANSFORM_ERROR_FACTOR * (reach + round_trip) + vec3<f32>(EDGE_ERROR * extent);

    let scale = reciprocal_power_of_two(largest);
    let scaled_length = length3(world_normal * scale);
    let distance = (dot3(abs(local_normal), error) * scale) / scaled_length;
    return HitPoint(position, world_normal * (scale / scaled_length), distance);
}

// The largest absolute coordinates, and sums on the way to them, of the transformed points with coordinates up to `reach`.
fn transform_abs(rows: array<vec4<f32>, 3>, reach: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        dot3(abs(rows[0].xyz), reach) + abs(rows[0].w),
        dot3(abs(rows[1].xyz), reach) + abs(rows[1].w),
        dot3(abs(rows[2].xyz), reach) + abs(rows[2].w),
    );
}

// Where a ray that leaves the surface in a direction starts.
fn offset_ray_origin(surface: Surface, direction: vec3<f32>) -> vec3<f32> {
    if dot3(direction, surface.geometric_normal) >= 0.0 {
        return surface.position + surface.geometric_normal * surface.ray_offset;
    }
    return surface.position - surface.geometric_normal * surface.ray_offset;
}
