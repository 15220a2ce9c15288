//! The device arrays: plain data that every executor reads, the same bytes for all.

pub mod arrays;
pub mod layout;
mod needs;

pub use arrays::{DeviceArrays, DeviceBuffer};
pub use needs::{MAX_MIRROR_ROUGHNESS, Needs};
