// Ray against box and ray against triangle. Twin of src/trace/kernel/intersect.rs: the proofs are there.

const BOX_ENTRY_SCALE: f32 = 1.0 - 0x1p-18;
const MIN_RELATIVE_COMPONENT: f32 = 0x1p-64;
const MIN_COMPONENT: f32 = 0x1p-120;
const SQRT_MAX_QUOTIENT: f32 = 0x1p63;
const CORNER_TOLERANCE: f32 = 0x1p-22;
const EDGE_TOLERANCE: f32 = 0x1p-21;

// A ray as boxes see it.
struct SlabRay {
    origin: vec3<f32>,
    reciprocal_direction: vec3<f32>,
}

// A ray as triangles see it: the rows of a shear that takes it to the z axis, and of what takes points to t.
struct ShearRay {
    origin: vec3<f32>,
    direction: vec3<f32>,
    x_row: vec3<f32>,
    y_row: vec3<f32>,
    t_row: vec3<f32>,
    // A power of two that takes coordinates to about 1.
    scale: f32,
    // From t to the unit of the sheared x and y.
    t_to_sheared: f32,
}

// Where a ray meets a triangle's plane within its edges.
struct TriangleHit {
    t: f32,
    u: f32,
    v: f32,
    // The ray came from the side where the triangle winds clockwise.
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

// For each corner the greater of the other two corners' values: those of the edge across.
fn greater_of_others(v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(max(v.y, v.z), max(v.z, v.x), max(v.x, v.y));
}

// 1 over the greatest power of two that is not above `value`.
fn reciprocal_power_of_two(value: f32) -> f32 {
    let exponent = min(bitcast<u32>(value) >> 23u, 253u);
    return bitcast<f32>((254u - exponent) << 23u);
}

fn shear_ray(origin: vec3<f32>, direction: vec3<f32>, extent: f32) -> ShearRay {
    let scale = reciprocal_power_of_two(extent);
    let length = abs(direction);
    var x_row: vec3<f32>;
    var y_row: vec3<f32>;
    var t_row: vec3<f32>;
    var depth: f32;
    if length.x >= length.y && length.x >= length.z {
        depth = direction.x;
        x_row = vec3<f32>(-direction.y / depth, 1.0, 0.0);
        y_row = vec3<f32>(-direction.z / depth, 0.0, 1.0);
        t_row = vec3<f32>(1.0 / depth, 0.0, 0.0);
    } else if length.y >= length.z {
        depth = direction.y;
        x_row = vec3<f32>(0.0, -direction.z / depth, 1.0);
        y_row = vec3<f32>(1.0, -direction.x / depth, 0.0);
        t_row = vec3<f32>(0.0, 1.0 / depth, 0.0);
    } else {
        depth = direction.z;
        x_row = vec3<f32>(1.0, 0.0, -direction.x / depth);
        y_row = vec3<f32>(0.0, 1.0, -direction.y / depth);
        t_row = vec3<f32>(0.0, 0.0, 1.0 / depth);
    }
    // Looking down the axis swaps left and right: swap back, so that the winding stays.
    if depth < 0.0 {
        return ShearRay(origin, direction, y_row * scale, x_row * scale, t_row, scale, -depth * scale);
    }
    return ShearRay(origin, direction, x_row * scale, y_row * scale, t_row, scale, depth * scale);
}

fn intersect_triangle(ray: ShearRay, triangle: Triangle) -> TriangleHit {
    let a = triangle.v0 - ray.origin;
    let b = triangle.v1 - ray.origin;
    let c = triangle.v2 - ray.origin;
    let x = vec3<f32>(dot3(ray.x_row, a), dot3(ray.x_row, b), dot3(ray.x_row, c));
    let y = vec3<f32>(dot3(ray.y_row, a), dot3(ray.y_row, b), dot3(ray.y_row, c));
    let t = vec3<f32>(dot3(ray.t_row, a), dot3(ray.t_row, b), dot3(ray.t_row, c));

    let depth = max(-min_component(t), max_component(t)) * ray.t_to_sheared;

    // 1. Beside the triangle by more than rounding can explain?
    let x_least = min_component(x);
    let x_greatest = max_component(x);
    let y_least = min_component(y);
    let y_greatest = max_component(y);
    let x_extent = max(-x_least, x_greatest);
    let y_extent = max(-y_least, y_greatest);
    let x_tolerance = CORNER_TOLERANCE * (depth + x_extent);
    let y_tolerance = CORNER_TOLERANCE * (depth + y_extent);
    if x_least > x_tolerance || x_greatest < -x_tolerance || y_least > y_tolerance || y_greatest < -y_tolerance {
        return TriangleHit();
    }

    // 2. Outside of an edge by more than that? Edge functions are twice the areas that the ray cuts the triangle into.
    var weights = vec3<f32>(x.z * y.y - y.z * x.y, x.x * y.z - y.x * x.z, x.y * y.x - y.y * x.x);
    let back = (weights.x + weights.y) + weights.z < 0.0;
    weights = select(weights, -weights, back);
    let tolerance = EDGE_TOLERANCE * (depth * (x_extent + y_extent) + 4.0 * (x_extent * y_extent));
    if min_component(weights) < -tolerance {
        return TriangleHit();
    }
    // Rarely needed: an edge with both corners near the ray is known better than that.
    if min_component(weights) < 0.0 {
        let edge_x = greater_of_others(abs(x));
        let edge_y = greater_of_others(abs(y));
        let edge_z = greater_of_others(abs(t)) * ray.t_to_sheared;
        let tolerances = EDGE_TOLERANCE * (edge_z * (edge_x + edge_y) + 4.0 * (edge_x * edge_y));
        if min_component(weights + tolerances) < 0.0 {
            return TriangleHit();
        }
    }

    // 3. The point, inside the triangle whatever was rounded.
    weights = max(weights, vec3<f32>(0.0));
    let area = (weights.x + weights.y) + weights.z;
    if area < F32_MIN_NORMAL {
        return TriangleHit();
    }
    weights = weights * (1.0 / area);
    let t_plane = plane_t(ray, triangle, t, weights);
    let t_hit = min(max(t_plane, min_component(t)), max_component(t));
    return TriangleHit(t_hit, weights.y, weights.z, back, true);
}

// How far it is to the triangle's plane; to the corner with the greatest weight, if the ray lies in the plane. `t` is that of the
// corners.
fn plane_t(ray: ShearRay, triangle: Triangle, t: vec3<f32>, weights: vec3<f32>) -> f32 {
    let normal = cross3((triangle.v1 - triangle.v0) * ray.scale, (triangle.v2 - triangle.v0) * ray.scale);
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
    // The quotient would not be a number.
    if abs(slope) * SQRT_MAX_QUOTIENT <= abs(height) / SQRT_MAX_QUOTIENT {
        return corner_t;
    }
    return height / slope;
}
