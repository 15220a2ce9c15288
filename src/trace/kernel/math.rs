//! Vector arithmetic written out, so that every executor adds and multiplies in the same order. Twin of
//! `shaders/shared/math.wgsl`.

use glam::Vec3;

/// The smaller; `b` if either is NaN. One instruction, where `f32::min` is four.
pub(crate) fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The greater; `b` if either is NaN.
pub(crate) fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

pub(crate) fn dot3(a: Vec3, b: Vec3) -> f32 {
    (a.x * b.x + a.y * b.y) + a.z * b.z
}

pub(crate) fn cross3(a: Vec3, b: Vec3) -> Vec3 {
    Vec3::new(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)
}

pub(crate) fn length3(v: Vec3) -> f32 {
    dot3(v, v).sqrt()
}

pub(crate) fn normalize3(v: Vec3) -> Vec3 {
    v * (1.0 / length3(v))
}

pub(crate) fn mix3(a: Vec3, b: Vec3, weight: f32) -> Vec3 {
    a * (1.0 - weight) + b * weight
}

pub(crate) fn transform_point(rows: &[[f32; 4]; 3], p: Vec3) -> Vec3 {
    transform_vector(rows, p) + Vec3::new(rows[0][3], rows[1][3], rows[2][3])
}

pub(crate) fn transform_vector(rows: &[[f32; 4]; 3], v: Vec3) -> Vec3 {
    let [x, y, z] = rows.map(|[x, y, z, _]| dot3(Vec3::new(x, y, z), v));
    Vec3::new(x, y, z)
}

/// The matrix's transpose times `v`: with `local_from_world` it takes a normal from local space to world space.
pub(crate) fn transform_normal(rows: &[[f32; 4]; 3], v: Vec3) -> Vec3 {
    let [x, y, z] = rows.map(|[x, y, z, _]| Vec3::new(x, y, z));
    (x * v.x + y * v.y) + z * v.z
}
