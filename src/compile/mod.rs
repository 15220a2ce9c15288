//! From changes in the graph to changes in the device arrays. Never touches wgpu.

mod arena;
mod compiler;
mod deformation;
mod dirty;
mod enclosure;
mod geometry_cache;
mod instance_table;
mod material_table;
mod needs;
mod observer;
mod pack;
mod report;
mod vertex_streams;
mod view_dependent;

pub use compiler::Compiler;
pub use deformation::BlasBuilds;
pub use instance_table::InstanceSource;
pub use needs::{MAX_MIRROR_ROUGHNESS, Needs};
pub use observer::{ImageHeight, Observer};
pub use report::CompileReport;
pub(crate) use report::seconds;
