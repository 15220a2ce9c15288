//! Ropewalk: a retained scene graph that is ray traced.

pub mod accel;
pub mod compile;
pub mod device;
mod error;
pub mod graph;
pub mod image;
pub mod math;
pub mod trace;

pub use error::{Error, Result};
