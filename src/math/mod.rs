//! Boxes, rays and the conversions between the graph's f64 and the device's f32.

mod aabb;
pub use aabb::{Aabb, Bounds};
