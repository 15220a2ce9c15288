// Ray against box and ray against triangle. Twin of src/trace/kernel/intersect.rs: the proofs are there.

const BOX_ENTRY_SCALE: f32 = 1.0 - 0x1p-18;
const MIN_RELATIVE_COMPONENT: f32 = 0x1p-64;
const MIN_COMPONENT: f32 = 0x1p-120;
const SQRT_MAX_QUOTIENT: f32 = 0x1p63;
const SIDE_MARGIN: f32 = 0x1p-18;
const SHEARED_EXTENT: f32 = 0x1p30;
const CORNER_TOLERANCE: f32 = 0x1p-22;
const EDGE_TOLERANCE: f32 = 0x1p-21;
const START_ZONE: f32 = 0x1p-6;

// Ray operands of the slab test.
struct SlabRay {
    origin: vec3<f32>,
    reciprocal_direction: vec3<f32>,
}

// Ray operands of the triangle test: rows that shear points (relative to the origin) into a space in which the ray is
// the z axis, and the row that gives t.
struct ShearRay {
    origin: vec3<f32>,
    direction: vec3<f32>,
    // That of the slab test.
    reciprocal_direction: vec3<f32>,
    x_row: vec3<f32>,
    y_row: vec3<f32>,
    t_row: vec3<f32>,
    // Factor from t to units of sheared x and y.
    t_to_sheared: f32,
    // The magnitudes of the slopes in `x_row` and `y_row`, before they are scaled: at most 1.
    slopes: vec2<f32>,
}

// Intersection of a ray and a triangle: t, barycentric weights u of v1 and v of v2, facing.
struct TriangleHit {
    t: f32,
    u: f32,
    v: f32,
    // Back-face hit: the triangle winds clockwise as seen from the ray's origin, in local space.
    back: bool,
    is_hit: bool,
}

fn min_component(v: vec3<f32>) -> f32 {
    return min(min(v.x, v.y), v.z);
}

fn max_component(v: vec3<f32>) -> f32 {
    return max(max(v.x, v.y), v.z);
}

fn slab_ray(origin: vec3<f32>, direction: vec3<f32>) -> SlabRay {
    let least = max(max_component(abs(direction)) * MIN_RELATIVE_COMPONENT, MIN_COMPONENT);
    let bounded = max(abs(direction), vec3<f32>(least));
    return SlabRay(origin, select(1.0 / bounded, -1.0 / bounded, direction < vec3<f32>(0.0)));
}

fn intersects_box(ray: SlabRay, t_min: f32, t_max: f32, box_min: vec3<f32>, box_max: vec3<f32>) -> bool {
    let a = (box_min - ray.origin) * ray.reciprocal_direction;
    let b = (box_max - ray.origin) * ray.reciprocal_direction;
    let near = min(a, b);
    let far = max(a, b);
    let t_near = max(max(near.x, near.y), max(near.z, t_min));
    let t_far = min(min(far.x, far.y), min(far.z, t_max));
    return t_near * BOX_ENTRY_SCALE <= t_far;
}

// For each vertex the greater value of the other two, the ends of the opposite edge.
fn greater_of_others(v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(max(v.y, v.z), max(v.z, v.x), max(v.x, v.y));
}

// 1 over the greatest power of two that is not above `value`.
fn reciprocal_power_of_two(value: f32) -> f32 {
    let exponent = min(bitcast<u32>(value) >> 23u, 253u);
    return bitcast<f32>((254u - exponent) << 23u);
}

fn shear_ray(slab: SlabRay, direction: vec3<f32>, extent: f32) -> ShearRay {
    let scale = reciprocal_power_of_two(extent * (1.0 / SHEARED_EXTENT));
    // Find the dominant axis of the direction, and the rows of the shear along it.
    let length = abs(direction);
    var x_row: vec3<f32>;
    var y_row: vec3<f32>;
    var t_row: vec3<f32>;
    var major_component: f32;
    var slopes: vec2<f32>;
    if length.x >= length.y && length.x >= length.z {
        major_component = direction.x;
        slopes = vec2<f32>(-direction.y / major_component, -direction.z / major_component);
        x_row = vec3<f32>(slopes.x, 1.0, 0.0);
        y_row = vec3<f32>(slopes.y, 0.0, 1.0);
        t_row = vec3<f32>(1.0 / major_component, 0.0, 0.0);
    } else if length.y >= length.z {
        major_component = direction.y;
        slopes = vec2<f32>(-direction.z / major_component, -direction.x / major_component);
        x_row = vec3<f32>(0.0, slopes.x, 1.0);
        y_row = vec3<f32>(1.0, slopes.y, 0.0);
        t_row = vec3<f32>(0.0, 1.0 / major_component, 0.0);
    } else {
        major_component = direction.z;
        slopes = vec2<f32>(-direction.x / major_component, -direction.y / major_component);
        x_row = vec3<f32>(1.0, 0.0, slopes.x);
        y_row = vec3<f32>(0.0, 1.0, slopes.y);
        t_row = vec3<f32>(0.0, 0.0, 1.0 / major_component);
    }
    // Swap x and y for negative directions to preserve the winding.
    if major_component < 0.0 {
        let swapped = x_row;
        x_row = y_row;
        y_row = swapped;
        slopes = slopes.yx;
    }
    // Apply it to x and y; t keeps the unit of the ray.
    let t_to_sheared = min(abs(major_component) * scale, F32_MAX);
    let recip = slab.reciprocal_direction;
    return ShearRay(
        slab.origin, direction, recip, x_row * scale, y_row * scale, t_row, t_to_sheared, abs(slopes));
}

fn intersect_triangle(ray: ShearRay, triangle: Triangle) -> TriangleHit {
    // Shear the vertices.
    let a = triangle.v0 - ray.origin;
    let b = triangle.v1 - ray.origin;
    let c = triangle.v2 - ray.origin;
    let x = vec3<f32>(dot3(ray.x_row, a), dot3(ray.x_row, b), dot3(ray.x_row, c));
    let y = vec3<f32>(dot3(ray.y_row, a), dot3(ray.y_row, b), dot3(ray.y_row, c));
    let t = vec3<f32>(dot3(ray.t_row, a), dot3(ray.t_row, b), dot3(ray.t_row, c));

    // Depths in units of sheared x and y: the tolerances grow with them.
    let x_abs = abs(x);
    let y_abs = abs(y);
    let z = abs(t) * ray.t_to_sheared;

    // 1. Reject the ray if it misses the projected triangle's bounds by more than the rounding error of each corner.
    let x_tolerance = (z * ray.slopes.x + x_abs) * CORNER_TOLERANCE;
    let y_tolerance = (z * ray.slopes.y + y_abs) * CORNER_TOLERANCE;
    if min_component(x - x_tolerance) > 0.0 || max_component(x + x_tolerance) < 0.0
        || min_component(y - y_tolerance) > 0.0 || max_component(y + y_tolerance) < 0.0 {
        return TriangleHit();
    }

    // 2. Compute the edge functions (twice the sub-triangles' areas) and reject if one is negative beyond its
    //    tolerance.
    var weights = vec3<f32>(x.z * y.y - y.z * x.y, x.x * y.z - y.x * x.z, x.y * y.x - y.y * x.x);
    let back = (weights.x + weights.y) + weights.z < 0.0;
    weights = select(weights, -weights, back);
    let x_extent = max_component(x_abs);
    let y_extent = max_component(y_abs);
    let depth_share = max_component(z) * (y_extent * ray.slopes.x + x_extent * ray.slopes.y);
    let tolerance = EDGE_TOLERANCE * (depth_share + 4.0 * (x_extent * y_extent));
    if min_component(weights) < -tolerance {
        return TriangleHit();
    }
    // Outside an edge, repeat the test with the tighter tolerance of each edge's own two vertices (point 2).
    let is_outside = min_component(weights) < 0.0;
    if is_outside {
        let edge_x = greater_of_others(x_abs);
        let edge_y = greater_of_others(y_abs);
        let edge_z = greater_of_others(z);
        let depth_shares = edge_z * (edge_y * ray.slopes.x + edge_x * ray.slopes.y);
        let tolerances = EDGE_TOLERANCE * (depth_shares + 4.0 * (edge_x * edge_y));
        if min_component(weights + tolerances) < 0.0 {
            return TriangleHit();
        }
    }

    // 3. Compute barycentric weights and t, clamped to the triangle.
    weights = max(weights, vec3<f32>(0.0));
    let area = (weights.x + weights.y) + weights.z;
    if area < F32_MIN_NORMAL {
        return TriangleHit();
    }
    weights = weights * (1.0 / area);
    // Outside an edge, t is that of the point on the edge: the plane may be crossed far from it. But a plane behind the
    // ray's start stays there.
    var t_hit = plane_t(ray, triangle, t, weights);
    if is_outside && t_hit >= 0.0 {
        t_hit = dot3(weights, t);
    }
    t_hit = clamp_to_box(ray, triangle, t_hit);
    t_hit = min(max(t_hit, min_component(t)), max_component(t));
    // Near the ray's start the tolerance admits nothing (point 2).
    let start_zone = START_ZONE * (max_component(z) + (x_extent + y_extent));
    if is_outside && abs(t_hit) * ray.t_to_sheared <= start_zone {
        return TriangleHit();
    }
    return TriangleHit(t_hit, weights.y, weights.z, back, true);
}

// Clamps t to the interval in which the ray is within the triangle's box (point 6), padded by the least that the box of
// a node around it is, as the slab test computes it.
fn clamp_to_box(ray: ShearRay, triangle: Triangle, t: f32) -> f32 {
    let least = min(min(triangle.v0, triangle.v1), triangle.v2);
    let greatest = max(max(triangle.v0, triangle.v1), triangle.v2);
    let margin = max_component(greatest - least) * SIDE_MARGIN;
    let a = ((least - margin) - ray.origin) * ray.reciprocal_direction;
    let b = ((greatest + margin) - ray.origin) * ray.reciprocal_direction;
    let near = min(a, b);
    let far = max(a, b);
    return max(min(t, min_component(far)), max_component(near));
}

// t at the triangle's plane (point 5). If the ray lies in the plane, t of the vertex with the greatest weight. `t`
// holds the vertices' t.
fn plane_t(ray: ShearRay, triangle: Triangle, t: vec3<f32>, weights: vec3<f32>) -> f32 {
    // Normal, from edges that are scaled to about 1 by a power of two.
    let edge_1 = triangle.v1 - triangle.v0;
    let edge_2 = triangle.v2 - triangle.v0;
    let scale = reciprocal_power_of_two(max_component(max(abs(edge_1), abs(edge_2))));
    let normal = cross3(edge_1 * scale, edge_2 * scale);
    // Vertex with the greatest weight.
    var corner = triangle.v2 - ray.origin;
    var corner_t = t.z;
    if weights.x >= weights.y && weights.x >= weights.z {
        corner = triangle.v0 - ray.origin;
        corner_t = t.x;
    } else if weights.y >= weights.z {
        corner = triangle.v1 - ray.origin;
        corner_t = t.y;
    }
    let height = dot3(normal, corner);
    let slope = dot3(normal, ray.direction);
    // Avoid a quotient that overflows or is 0/0. Neither product is subnormal, which is slow on some processors.
    if abs(slope) * SQRT_MAX_QUOTIENT <= abs(height) / SQRT_MAX_QUOTIENT {
        return corner_t;
    }
    return height / slope;
}
