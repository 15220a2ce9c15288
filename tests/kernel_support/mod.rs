//! What the kernel's tests trace: meshes, random numbers, device arrays, and the truth about them.

#![allow(dead_code, unreachable_pub, unused_imports, reason = "each test uses a part of this")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod arrays;
#[cfg(feature = "gpu")]
#[path = "../support/gpu.rs"]
pub mod gpu;
mod mesh;
pub mod oracle;
mod random;

pub use arrays::{Builder, Placed, arrays, arrays_by};
pub use mesh::Mesh;
pub use random::Random;

use ropewalk::trace::{Cpu, Emulated, Tracer};

/// Every executor; the GPU where there is one.
pub fn tracers() -> Vec<Box<dyn Tracer>> {
    let on_cpu: [Box<dyn Tracer>; 2] = [Box::new(Emulated::default()), Box::new(Cpu::default())];
    on_cpu.into_iter().chain(on_gpu()).collect()
}

#[cfg(feature = "gpu")]
fn on_gpu() -> Option<Box<dyn Tracer>> {
    Some(Box::new(gpu::tracer()?))
}

#[cfg(not(feature = "gpu"))]
fn on_gpu() -> Option<Box<dyn Tracer>> {
    None
}
