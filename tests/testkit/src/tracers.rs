//! The executors that tests compare.

use ropewalk::trace::{Cpu, Emulated, Recursive, Tracer, Traversal};

/// Every executor with every traversal that it has; those of the GPU only where there is one.
pub fn tracers() -> Vec<Box<dyn Tracer>> {
    let mut tracers: Vec<Box<dyn Tracer>> = vec![Box::new(Cpu::default()), Box::new(Recursive::default())];
    for traversal in [Traversal::Rope, Traversal::Wide] {
        tracers.push(Box::new(Emulated::default().with_traversal(traversal)));
        tracers.extend(on_gpu(traversal));
    }
    tracers
}

#[cfg(feature = "gpu")]
fn on_gpu(traversal: Traversal) -> Option<Box<dyn Tracer>> {
    Some(Box::new(crate::gpu::tracer()?.with_traversal(traversal)))
}

#[cfg(not(feature = "gpu"))]
fn on_gpu(_: Traversal) -> Option<Box<dyn Tracer>> {
    None
}
