//! The kernel on a GPU, through wgpu: Vulkan, Metal, Direct3D 12 or OpenGL.

mod adapter;
mod array;
mod batch;
mod context;
mod frame;
mod pipelines;
mod probe;
mod scene;
mod timer;
mod tracer;

pub use adapter::{AdapterKinds, GpuOptions, optional_features, required_limits};
pub use batch::RayBuffers;
pub use tracer::GpuTracer;
