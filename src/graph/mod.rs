//! The retained scene graph: nodes, cores, the change log.
//!
//! [`Scene`] owns everything. Its edits and getters stand in files of their own: `structure` (the tree), `cores`,
//! `assets`, `query`, `find`, `visit`.

mod assets;
mod billboard;
mod bit_set;
mod camera;
mod changes;
mod core;
mod cores;
mod find;
mod geometry;
mod hierarchy;
mod instances;
mod key;
mod key_map;
mod light;
mod links;
mod lod;
mod material;
mod node;
mod query;
mod ranges;
mod scene;
mod store;
mod structure;
mod structure_choice;
mod switch;
mod transfer;
mod transform;
mod validate;
mod visit;

pub use billboard::Billboard;
pub use camera::Camera;
pub use changes::{Change, Changes, Cursor};
pub use core::{Core, CoreSource};
pub use geometry::Geometry;
pub use hierarchy::{Hierarchy, NodePath, Placed};
pub use key::{CoreKey, GeometryKey, MaterialKey, NodeKey, Object, TextureKey};
pub(crate) use key_map::KeyMap;
pub use light::{Light, LightKind};
pub use lod::{Lod, LodMeasure};
pub use material::{AlphaMode, Filter, Material, Sampler, Texture, TextureRef, Wrap};
pub use node::Keep;
pub use query::{Ancestors, Children, Descendants, Users};
pub use scene::{Scene, SceneId};
pub use structure_choice::{Quality, Structure};
pub use switch::Switch;
pub use transfer::{Delta, EditQueue, EditSender, NodeState, Pending, Recorder, Replay, SceneFileFault, State};
pub use transform::Transform;
pub use visit::{Descend, Visitor};
