//! The executors and the shaders.

mod cancel;
#[cfg(feature = "gpu")]
mod gpu;
mod kernel;
mod shader;
