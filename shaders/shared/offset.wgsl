// Origins of secondary rays: offset along the geometric normal by a bound on the hit point's rounding error. Twin of
// src/trace/kernel/offset.rs: the bound is derived there.

const HALF_ULP: f32 = 0x1p-24;
const LEAST_OFFSET: f32 = 0x1p-48;
const OFFSET_MARGIN: f32 = 1.015625;
const LIKELY_WEIGHT: f32 = 0.25;

// A hit point in world space, the unit geometric normal on the front side, and the offset for secondary rays along it
// (a rounding bound, world units).
struct HitPoint {
    position: vec3<f32>,
    normal: vec3<f32>,
    ray_offset: f32,
}

// Reconstructs the hit point. A triangle that rounds to a line has no plane: its normal is `fallback`, a unit vector.
fn hit_point(instance: InstanceRecord, triangle: Triangle, weights: vec3<f32>, fallback: vec3<f32>) -> HitPoint {
    let edge_1 = triangle.v1 - triangle.v0;
    let edge_2 = triangle.v2 - triangle.v0;
    // 1. The position, by way of the vertex with the greatest weight.
    var corner = triangle.v2;
    var along_1 = weights.y;
    var along_2 = weights.z - 1.0;
    if weights.x >= weights.y && weights.x >= weights.z {
        corner = triangle.v0;
        along_2 = weights.z;
    } else if weights.y >= weights.z {
        corner = triangle.v1;
        along_1 = weights.y - 1.0;
        along_2 = weights.z;
    }
    let from_corner = edge_1 * along_1 + edge_2 * along_2;
    let local = corner + from_corner;
    let to_world = transform_with_error(
        instance.world_from_local,
        rounded_rows(instance.flags, INSTANCE_EXACT_WORLD_ROWS),
        local,
        1.0,
    );
    let position = to_world.point;

    // 2. The geometric normal, from edges that are scaled to about 1.
    let extent = max_component(max(abs(edge_1), abs(edge_2)));
    let to_unit_edges = reciprocal_power_of_two(extent);
    let unit_1 = edge_1 * to_unit_edges;
    let unit_2 = edge_2 * to_unit_edges;
    let local_normal = cross3(unit_1, unit_2);
    let world_normal = transform_normal(instance.local_from_world, local_normal);
    let largest = max_component(abs(world_normal));
    let has_plane = largest > 0.0;
    if !has_plane {
        return HitPoint(position, fallback, 0.0);
    }
    let scale = reciprocal_power_of_two(largest);
    let scaled_length = length3(world_normal * scale);
    let normal = world_normal * (scale / scaled_length);

    // 3. Bounds of the rounding errors along the normal: in local space steps 1, 4 and 5, in world space 2 and 3.
    let edges_error = sum_error(triangle.v0, triangle.v1, edge_1) * abs(along_1)
        + sum_error(triangle.v0, triangle.v2, edge_2) * abs(along_2);
    let reach = abs(edge_1) * abs(along_1) + abs(edge_2) * abs(along_2);
    let to_corners = to_likely_corners(edge_1, edge_2, weights);
    let rounded = reach * 2.0 + to_corners * vec3<f32>(3.0, 3.0, 4.0);
    let to_local = transform_with_error(
        instance.local_from_world,
        rounded_rows(instance.flags, INSTANCE_EXACT_LOCAL_ROWS),
        position,
        0.0,
    );
    let local_error = ((edges_error * 2.0 + rounded * HALF_ULP) + sum_error(corner, from_corner, local))
        + (to_local.error + vec3<f32>(LEAST_OFFSET * extent));
    let products = dot3(abs_cross3(abs(unit_1), abs(unit_2)), to_corners);
    let along_local = dot3(abs(local_normal), local_error) + products * HALF_ULP;
    let world_error = to_world.error + abs(position) * HALF_ULP;

    // 4. The distance along the world-space normal that covers them.
    let distance = (along_local * scale) / scaled_length + dot3(abs(normal), world_error);
    return HitPoint(position, normal, distance * OFFSET_MARGIN);
}

// Bounds the way from a point of a triangle to the vertex by which the next ray's test measures its distance, per
// coordinate: to any vertex with a weight that is not far from the greatest.
fn to_likely_corners(edge_1: vec3<f32>, edge_2: vec3<f32>, weights: vec3<f32>) -> vec3<f32> {
    let from_v0 = edge_1 * weights.y + edge_2 * weights.z;
    var largest = vec3<f32>(0.0);
    if weights.x >= LIKELY_WEIGHT {
        largest = abs(from_v0);
    }
    if weights.y >= LIKELY_WEIGHT {
        largest = max(largest, abs(from_v0 - edge_1));
    }
    if weights.z >= LIKELY_WEIGHT {
        largest = max(largest, abs(from_v0 - edge_2));
    }
    return largest;
}

// The cross product of two vectors with all products added: of vectors without negative components, the sums that
// bound the rounding of their cross product, whatever their signs were.
fn abs_cross3(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(a.y * b.z + a.z * b.y, a.z * b.x + a.x * b.z, a.x * b.y + a.y * b.x);
}

// A transformed point, and a bound of the error of each coordinate.
struct TransformedPoint {
    point: vec3<f32>,
    error: vec3<f32>,
}

// Transforms a point, as `transform_point` does, and bounds the error per coordinate. `is_rounded` is 0 for the rows
// that are exact, so that they multiply without rounding, and 1 for the others. `matrix_rounding` is 1 if the matrix is
// a rounded one, and 0 if it is exact by definition.
//
// What is exact adds nothing: the products of an exact row, a sum with 0. So the bound is 0 for an instance that is not
// moved, and a sum's rounding for one that is only moved.
fn transform_with_error(
    rows: array<vec4<f32>, 3>,
    is_rounded: vec3<f32>,
    point: vec3<f32>,
    matrix_rounding: f32,
) -> TransformedPoint {
    let x = vec3<f32>(rows[0].x, rows[1].x, rows[2].x) * point.x;
    let y = vec3<f32>(rows[0].y, rows[1].y, rows[2].y) * point.y;
    let z = vec3<f32>(rows[0].z, rows[1].z, rows[2].z) * point.z;
    let translation = vec3<f32>(rows[0].w, rows[1].w, rows[2].w);
    let sum_xy = x + y;
    let sum_xyz = sum_xy + z;
    let transformed = sum_xyz + translation;
    // A rounding of each product, and of each number of the matrix.
    let products = (abs(x) + abs(y)) + abs(z);
    let rounded = products * (1.0 + matrix_rounding) + abs(translation) * matrix_rounding;
    // The sums.
    let sums = (sum_error(x, y, sum_xy) + sum_error(sum_xy, z, sum_xyz)) + sum_error(sum_xyz, translation, transformed);
    return TransformedPoint(transformed, rounded * is_rounded * HALF_ULP + sums);
}

// Per row of a matrix: 0 if it is exact, else 1. `exact_rows` are the three flags of the instance that say it.
fn rounded_rows(flags: u32, exact_rows: u32) -> vec3<f32> {
    let exact = (vec3<u32>(flags >> firstTrailingBit(exact_rows)) >> vec3<u32>(0u, 1u, 2u)) & vec3<u32>(1u);
    return 1.0 - vec3<f32>(exact);
}

// Bounds the rounding error of a sum, per coordinate: half an ulp of it, and no more than the smaller operand, since
// the greater one is a number that it could be rounded to.
fn sum_error(a: vec3<f32>, b: vec3<f32>, sum: vec3<f32>) -> vec3<f32> {
    return min(min(abs(a), abs(b)), abs(sum) * HALF_ULP);
}

// The origin of a secondary ray with the given direction: the position offset along the geometric normal to the side
// that the direction points to.
fn offset_ray_origin(surface: Surface, direction: vec3<f32>) -> vec3<f32> {
    if dot3(direction, surface.geometric_normal) >= 0.0 {
        return surface.position + surface.geometric_normal * surface.ray_offset;
    }
    return surface.position - surface.geometric_normal * surface.ray_offset;
}
