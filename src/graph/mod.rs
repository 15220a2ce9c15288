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
mod light;
mod links;
mod lod;
mod material;
mod node;
mod node_path;
mod query;
mod ranges;
mod scene;
mod structure;
mod switch;
mod transform;
mod validate;
mod visit;

pub use billboard::Billboard;
pub use camera::Camera;
pub use changes::{Change, Changes, Cursor};
pub use core::{Core, CoreSource};
pub use geometry::Geometry;
pub use hierarchy::{Hierarchy, Placed};
pub use key::{CoreKey, GeometryKey, MaterialKey, NodeKey, Object, TextureKey};
pub use light::{Light, LightKind};
pub use lod::{Lod, LodMeasure};
pub use material::{AlphaMode, Filter, Material, Sampler, Texture, TextureRef, Wrap};
pub use node::Keep;
pub use node_path::NodePath;
pub use query::{Ancestors, Children, Descendants, Users};
pub use scene::{Scene, SceneId};
pub use switch::Switch;
pub use transform::Transform;
pub use visit::{Descend, Visitor};
