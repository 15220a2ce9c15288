//! Ray against box and ray against triangle. Twin of `shaders/shared/intersect.wgsl`.

use glam::Vec3;

use super::math::{dot3, max, min};
use crate::device::layout::{Node, Triangle};

const BOX_SLACK: f32 = 1.0 - 1.0 / (1 << 18) as f32;
const CORNER_TOLERANCE: f32 = 1.0 / (1 << 22) as f32;
const EDGE_TOLERANCE: f32 = 1.0 / (1 << 21) as f32;

/// A ray as boxes see it.
#[derive(Clone, Copy)]
pub(super) struct SlabRay {
    pub origin: Vec3,
    pub reciprocal: Vec3,
}

/// A ray as triangles see it: a shear that takes the ray to the z axis.
#[derive(Clone, Copy)]
pub(super) struct ShearRay {
    pub origin: Vec3,
    pub x_row: Vec3,
    pub y_row: Vec3,
    pub t_row: Vec3,
    pub depth_scale: f32,
}

/// Where a ray meets a triangle within its edges.
#[derive(Clone, Copy)]
pub(super) struct Crossing {
    pub t: f32,
    pub u: f32,
    pub v: f32,
    /// The ray came from the side where the triangle winds clockwise.
    pub back: bool,
}

fn min_component(v: Vec3) -> f32 {
    min(min(v.x, v.y), v.z)
}

pub(super) fn max_component(v: Vec3) -> f32 {
    max(max(v.x, v.y), v.z)
}

pub(super) fn slab_ray(origin: Vec3, direction: Vec3) -> SlabRay {
    let least = max(max_component(direction.abs()) * 5.421_011e-20, 7.523_164e-37); // 2^-64, 2^-120
    let reciprocal = |d: f32| {
        let bounded = max(d.abs(), least);
        if d < 0.0 { -1.0 / bounded } else { 1.0 / bounded }
    };
    SlabRay { origin, reciprocal: Vec3::new(reciprocal(direction.x), reciprocal(direction.y), reciprocal(direction.z)) }
}

#[inline]
pub(super) fn meets_box(ray: &SlabRay, t_min: f32, t_max: f32, node: &Node) -> bool {
    let a = (Vec3::from_array(node.min) - ray.origin) * ray.reciprocal;
    let b = (Vec3::from_array(node.max) - ray.origin) * ray.reciprocal;
    let near = Vec3::new(min(a.x, b.x), min(a.y, b.y), min(a.z, b.z));
    let far = Vec3::new(max(a.x, b.x), max(a.y, b.y), max(a.z, b.z));
    let t_near = max(max(near.x, near.y), max(near.z, t_min));
    let t_far = min(min(far.x, far.y), min(far.z, t_max));
    t_near * BOX_SLACK <= t_far
}

/// 1 over the greatest power of two that is not above `value`.
pub(super) fn reciprocal_power_of_two(value: f32) -> f32 {
    let exponent = (value.to_bits() >> 23).min(253);
    f32::from_bits((254 - exponent) << 23)
}

pub(super) fn shear_ray(origin: Vec3, direction: Vec3, extent: f32) -> ShearRay {
    let scale = reciprocal_power_of_two(extent);
    let length = direction.abs();
    let (depth, x_row, y_row, t_row);
    if length.x >= length.y && length.x >= length.z {
        depth = direction.x;
        x_row = Vec3::new(-direction.y / depth, 1.0, 0.0);
        y_row = Vec3::new(-direction.z / depth, 0.0, 1.0);
        t_row = Vec3::new(1.0 / depth, 0.0, 0.0);
    } else if length.y >= length.z {
        depth = direction.y;
        x_row = Vec3::new(0.0, -direction.z / depth, 1.0);
        y_row = Vec3::new(1.0, -direction.x / depth, 0.0);
        t_row = Vec3::new(0.0, 1.0 / depth, 0.0);
    } else {
        depth = direction.z;
        x_row = Vec3::new(1.0, 0.0, -direction.x / depth);
        y_row = Vec3::new(0.0, 1.0, -direction.y / depth);
        t_row = Vec3::new(0.0, 0.0, 1.0 / depth);
    }
    // Looking down the axis swaps left and right: swap back, so that the winding stays.
    let (x_row, y_row) = if depth < 0.0 { (y_row, x_row) } else { (x_row, y_row) };
    ShearRay { origin, x_row: x_row * scale, y_row: y_row * scale, t_row, depth_scale: depth.abs() * scale }
}

#[inline]
pub(super) fn cross_triangle(ray: &ShearRay, triangle: &Triangle) -> Option<Crossing> {
    let a = Vec3::from_array(triangle.v0) - ray.origin;
    let b = Vec3::from_array(triangle.v1) - ray.origin;
    let c = Vec3::from_array(triangle.v2) - ray.origin;
    let x = Vec3::new(dot3(ray.x_row, a), dot3(ray.x_row, b), dot3(ray.x_row, c));
    let y = Vec3::new(dot3(ray.y_row, a), dot3(ray.y_row, b), dot3(ray.y_row, c));
    let t = Vec3::new(dot3(ray.t_row, a), dot3(ray.t_row, b), dot3(ray.t_row, c));

    let depth = max(-min_component(t), max_component(t)) * ray.depth_scale;

    // 1. Beside the triangle by more than rounding can explain?
    let (x_least, x_greatest) = (min_component(x), max_component(x));
    let (y_least, y_greatest) = (min_component(y), max_component(y));
    let (x_extent, y_extent) = (max(-x_least, x_greatest), max(-y_least, y_greatest));
    let x_tolerance = CORNER_TOLERANCE * (depth + x_extent);
    let y_tolerance = CORNER_TOLERANCE * (depth + y_extent);
    if x_least > x_tolerance || x_greatest < -x_tolerance || y_least > y_tolerance || y_greatest < -y_tolerance {
        return None;
    }

    // 2. Outside of an edge by more than that? Edge functions are twice the areas that the ray cuts the triangle into.
    let mut weights = Vec3::new(x.z * y.y - y.z * x.y, x.x * y.z - y.x * x.z, x.y * y.x - y.y * x.x);
    let back = (weights.x + weights.y) + weights.z < 0.0;
    if back {
        weights = -weights;
    }
    let tolerance = EDGE_TOLERANCE * (depth * (x_extent + y_extent) + 4.0 * (x_extent * y_extent));
    if min_component(weights) < -tolerance {
        return None;
    }

    // 3. The point, inside the triangle whatever was rounded.
    weights = Vec3::new(max(weights.x, 0.0), max(weights.y, 0.0), max(weights.z, 0.0));
    let area = (weights.x + weights.y) + weights.z;
    if area < f32::MIN_POSITIVE {
        return None;
    }
    weights *= 1.0 / area;
    let t_hit = min(max(dot3(weights, t), min_component(t)), max_component(t));
    Some(Crossing { t: t_hit, u: weights.y, v: weights.z, back })
}
