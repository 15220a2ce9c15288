// Vector arithmetic written out, so that every executor adds and multiplies in the same order. Twin of
// src/trace/kernel/math.rs.

fn dot3(a: vec3<f32>, b: vec3<f32>) -> f32 {
    return (a.x * b.x + a.y * b.y) + a.z * b.z;
}

fn cross3(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

fn length3(v: vec3<f32>) -> f32 {
    return sqrt(dot3(v, v));
}

fn normalize3(v: vec3<f32>) -> vec3<f32> {
    return v * (1.0 / length3(v));
}

fn mix3(a: vec3<f32>, b: vec3<f32>, weight: f32) -> vec3<f32> {
    return a * (1.0 - weight) + b * weight;
}

fn transform_point(rows: array<vec4<f32>, 3>, p: vec3<f32>) -> vec3<f32> {
    return transform_vector(rows, p) + vec3<f32>(rows[0].w, rows[1].w, rows[2].w);
}

fn transform_vector(rows: array<vec4<f32>, 3>, v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot3(rows[0].xyz, v), dot3(rows[1].xyz, v), dot3(rows[2].xyz, v));
}

// The matrix's transpose times v: with local_from_world it takes a normal from local space to world space.
fn transform_normal(rows: array<vec4<f32>, 3>, v: vec3<f32>) -> vec3<f32> {
    return (rows[0].xyz * v.x + rows[1].xyz * v.y) + rows[2].xyz * v.z;
}
