// Origins of secondary rays: offset along the geometric normal by a bound on the hit point's rounding error. Twin of
// src/trace/kernel/offset.rs: the bound is derived there.

const HALF_ULP: f32 = 5.960464477539063e-8; // 2^-24
const TRANSFORM_ERROR_FACTOR: f32 = 16.0 * HALF_ULP;
const EDGE_ERROR: f32 = 64.0 * HALF_ULP;

// A hit point in world space, the unit geometric normal on the front side, and the offset for secondary rays along it
// (a rounding bound, world units).
struct HitPoint {
    position: vec3<f32>,
    normal: vec3<f32>,
    ray_offset: f32,
}

// Reconstructs the hit point. A triangle that rounds to a line has no plane: its normal is `fallback`, a unit vector.
fn hit_point(instance: InstanceRecord, triangle: Triangle, weights: vec3<f32>, fallback: vec3<f32>) -> HitPoint {
    // World-space position.
    let local = (triangle.v0 * weights.x + triangle.v1 * weights.y) + triangle.v2 * weights.z;
    let position = transform_point(instance.world_from_local, local);
    // Geometric normal from edges that are scaled to about 1.
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

    // Bound of the rounding error per coordinate, local space.
    let max_abs = max(max(abs(triangle.v0), abs(triangle.v1)), abs(triangle.v2));
    let round_trip = transform_abs(instance.local_from_world, transform_abs(instance.world_from_local, max_abs));
    let error = TRANSFORM_ERROR_FACTOR * (max_abs + round_trip) + vec3<f32>(EDGE_ERROR * extent);

    // Distance along the world-space normal that covers it.
    let scale = reciprocal_power_of_two(largest);
    let scaled_length = length3(world_normal * scale);
    let distance = (dot3(abs(local_normal), error) * scale) / scaled_length;
    return HitPoint(position, world_normal * (scale / scaled_length), distance);
}

// |M| (max_abs, 1): bounds every coordinate, and every partial sum, of a transformed point whose coordinates do not
// exceed `max_abs`.
fn transform_abs(rows: array<vec4<f32>, 3>, max_abs: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        dot3(abs(rows[0].xyz), max_abs) + abs(rows[0].w),
        dot3(abs(rows[1].xyz), max_abs) + abs(rows[1].w),
        dot3(abs(rows[2].xyz), max_abs) + abs(rows[2].w),
    );
}

// The origin of a secondary ray with the given direction: the position offset along the geometric normal to the side
// that the direction points to.
fn offset_ray_origin(surface: Surface, direction: vec3<f32>) -> vec3<f32> {
    if dot3(direction, surface.geometric_normal) >= 0.0 {
        return surface.position + surface.geometric_normal * surface.ray_offset;
    }
    return surface.position - surface.geometric_normal * surface.ray_offset;
}
