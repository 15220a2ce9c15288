//! What the kernel's tests trace: meshes, random numbers, device arrays, and the truth about them.

#![allow(dead_code, unreachable_pub, unused_imports, reason = "each test uses a part of this")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod arrays;
mod mesh;
pub mod oracle;
mod random;

pub use arrays::{Builder, Placed, arrays, arrays_by};
pub use mesh::Mesh;
pub use random::Random;
