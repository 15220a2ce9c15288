//! From changes in the graph to changes in the device arrays. Never touches wgpu.

mod buffer_allocator;
mod changes;
mod closed_surface;
mod compiler;
mod deformation;
mod geometry_table;
mod instance_table;
mod material_table;
mod pack;
mod report;
mod vertex_streams;
mod view_dependent;
mod viewpoint;

pub use compiler::Compiler;
pub use deformation::BlasBuildReasons;
pub use instance_table::InstanceSource;
pub use report::CompileReport;
pub(crate) use report::seconds;
pub use viewpoint::{ViewHeight, Viewpoint};
