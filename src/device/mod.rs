//! The device arrays: plain data that every executor reads, the same bytes for all.

pub mod arrays;
pub mod layout;

pub use arrays::{DeviceArrays, DeviceBuffer};
