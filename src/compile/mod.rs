//! From changes in the graph to changes in the device arrays. Never touches wgpu.

mod needs;

pub use needs::Needs;
