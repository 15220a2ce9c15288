//! The executors and the shaders.

#[cfg(feature = "gpu")]
mod gpu;
mod kernel;
mod shader;
