//! From changes in the graph to changes in the device arrays. Never touches wgpu.

mod arena;
mod compiler;
mod enclosure;
mod geometry_cache;
mod instance_table;
mod material_table;
mod needs;
mod pack;
mod report;

pub use compiler::Compiler;
pub use instance_table::InstanceSource;
pub use needs::{MAX_MIRROR_ROUGHNESS, Needs};
pub(crate) use report::seconds;
pub use report::{CompileReport, RebuildReason, TlasUpdate};
