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

use ropewalk::trace::{Cpu, Emulated, Recursive, Tracer, Traversal};

/// Every executor by every layout; the GPU where there is one.
pub fn tracers() -> Vec<Box<dyn Tracer>> {
    let mut tracers: Vec<Box<dyn Tracer>> = vec![Box::new(Cpu::default()), Box::new(Recursive::default())];
    for layout in [Traversal::Rope, Traversal::Wide] {
        tracers.push(Box::new(Emulated::default().with_traversal(layout)));
        tracers.extend(on_gpu(layout));
    }
    tracers
}

#[cfg(feature = "gpu")]
fn on_gpu(layout: Traversal) -> Option<Box<dyn Tracer>> {
    Some(Box::new(gpu::tracer()?.with_traversal(layout)))
}

#[cfg(not(feature = "gpu"))]
fn on_gpu(_: Traversal) -> Option<Box<dyn Tracer>> {
    None
}
