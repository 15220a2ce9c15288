//! What the kernel's tests trace: meshes, random numbers, and device arrays made without the product's builders.

#![allow(dead_code, unreachable_pub, reason = "each test uses a part of this")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod arrays;
mod mesh;
pub mod oracle;
mod random;

pub use arrays::{Placed, arrays};
pub use mesh::Mesh;
pub use random::Random;
