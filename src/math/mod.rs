//! Axis-aligned boxes, matrices that flatten space, and powers of two.

mod aabb;
mod flat;
pub use aabb::{Aabb, Bounds};
pub(crate) use flat::{MappedSpace, with_least_thickness};

/// The greatest power of two that is not above `value`, a positive number; at least the least normal one.
pub(crate) fn power_of_two(value: f64) -> f64 {
    f64::from_bits(value.to_bits() & f64::INFINITY.to_bits()).max(f64::MIN_POSITIVE)
}
