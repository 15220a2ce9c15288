//! Axis-aligned boxes.

mod aabb;
pub use aabb::{Aabb, Bounds};
