//! Axis-aligned boxes, and matrices that flatten space.

mod aabb;
mod flat;
pub use aabb::{Aabb, Bounds};
pub(crate) use flat::{MappedSpace, with_least_thickness};
