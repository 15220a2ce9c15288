//! The scene compiler: reads what changed in the scene graph and updates the device arrays. Independent of wgpu.
//!
//! `compiler` runs the phases of a compile. The tables below it each keep one kind of element:
//!
//! | module | keeps |
//! |---|---|
//! | `changes` | the scene's changes since the last compile, sorted by what handles them |
//! | `view_dependent` | levels of detail and billboards for the viewpoint |
//! | `instance_table` | which hierarchy entry is which element of the `instances` array |
//! | `users` | which instances use each geometry, and each material |
//! | `geometry_table`, `vertex_streams` | bottom-level structures and vertex streams |
//! | `material_table` | materials, texture references and texels |
//! | `instance_bounds` | the world boxes of the instances and the TLAS over them |
//! | `coincident_instances` | groups of instances of which one stands for all in the TLAS |
//! | `light_table` | the visible lights |
//!
//! No table holds another but `instance_bounds`, which has the groups of `coincident_instances`. Some take others as an
//! argument: `instance_record` computes an instance's record from several of them. `pack` converts single values.

mod buffer_allocator;
mod changes;
mod coincident_instances;
mod compiler;
mod deformation;
mod geometry_table;
mod instance_bounds;
mod instance_record;
mod instance_table;
mod light_table;
mod material_table;
mod pack;
mod render_origin;
mod report;
mod users;
mod vertex_streams;
mod view_dependent;
mod viewpoint;

pub use compiler::{Compiler, InstanceSource};
pub use deformation::{BlasBuildReasons, RebuildLimits};
pub use report::CompileReport;
pub(crate) use report::seconds;
pub use viewpoint::{ViewHeight, Viewpoint};
