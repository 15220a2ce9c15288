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
    let cpus: [Box<dyn Tracer>; 2] = [Box::new(Emulated::default()), Box::new(Cpu::default())];
    #[cfg(feature = "gpu")]
    let gpu = gpu::tracer().map(|gpu| Box::new(gpu) as Box<dyn Tracer>);
    #[cfg(not(feature = "gpu"))]
    let gpu = None;
    cpus.into_iter().chain(gpu).collect()
}
