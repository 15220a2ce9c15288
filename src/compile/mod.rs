//! From changes in the graph to changes in the device arrays. Never touches wgpu.

mod arena;
mod changes;
mod compiler;
mod deformation;
mod enclosure;
mod geometry_cache;
mod instance_table;
mod material_table;
mod pack;
mod report;
mod vertex_streams;
mod view_dependent;
mod viewpoint;

pub use compiler::Compiler;
pub use deformation::BlasBuilds;
pub use instance_table::InstanceSource;
pub use report::CompileReport;
pub(crate) use report::seconds;
pub use viewpoint::{ImageHeight, Observer};
