//! The `gpu` executor: the kernel as WGSL compute shaders, through wgpu (Vulkan, Metal, Direct3D 12 or OpenGL).
//!
//! [`GpuTracer`] opens an adapter of its own or shares the application's device. It renders frames, traces batches of
//! rays from memory ([`Tracer`](crate::trace::Tracer)) or between buffers on the GPU ([`RayBuffers`]), and gives an
//! application's own compute shaders access to the scene ([`GpuTracer::include`]).

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
