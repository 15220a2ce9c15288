//! The retained scene graph: nodes, cores, the change log.
//!
//! [`Scene`] owns everything. Its methods are grouped by file: `tree_edits` and `core_edits`, `assets` (geometries,
//! materials, textures), `tree_reads`, `find`, `visit`, and `transfer` (undo, transactions, deltas, files, edit
//! queues). `hierarchy` is the flattened form of the tree that the compiler reads; `changes` is the log of changes that
//! tells it which objects to read again. `linked_lists` and `instance_cycles` maintain the links between nodes, cores
//! and instance targets.

mod assets;
mod billboard;
mod bit_set;
mod blas_kind;
mod camera;
mod changes;
mod core;
mod core_edits;
mod enclosure;
mod find;
mod geometry;
mod hierarchy;
mod instance_cycles;
mod key;
mod key_map;
mod light;
mod linked_lists;
mod lod;
mod material;
mod node;
mod scene;
mod store;
mod switch;
mod transfer;
mod transform;
mod tree_edits;
mod tree_reads;
mod validate;
mod value_checks;
mod visible_bounds;
mod visit;

pub use billboard::Billboard;
pub use blas_kind::{BlasKind, Quality};
pub use camera::Camera;
pub use changes::{Change, ChangeCursor, Changes};
pub use core::{Core, CoreKind, CoreSource};
pub(crate) use enclosure::Enclosure;
pub use geometry::Geometry;
pub use hierarchy::{Hierarchy, NodePath, ResolvedEntry};
pub use key::{CoreKey, GeometryKey, MaterialKey, NodeKey, ObjectKey, TextureKey};
pub(crate) use key_map::KeyMap;
pub use light::{Light, LightKind};
pub use lod::{Lod, LodMetric};
pub use material::{AlphaMode, FilterMode, Material, Sampler, Texture, TextureRef, WallKind, WrapMode};
pub use node::KeepTransform;
pub use scene::{Scene, SceneId};
pub use switch::Switch;
pub use transfer::{
    Delta, EditQueue, EditSender, NodeState, ObjectState, PendingEdit, Recorder, Replay, SceneFileError,
};
pub use transform::Transform;
pub use tree_reads::{Ancestors, Children, Subtree, Users};
pub use visit::{Descend, Visitor};
