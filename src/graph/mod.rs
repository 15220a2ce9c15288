//! The retained scene graph: nodes, cores, the change log.

mod camera;
mod geometry;
mod key;
mod light;
mod material;
mod transform;

pub use camera::Camera;
pub use geometry::Geometry;
pub use key::{CoreKey, GeometryKey, MaterialKey, NodeKey, Object, TextureKey};
pub use light::{Light, LightKind};
pub use material::{AlphaMode, Filter, Material, Sampler, Texture, TextureRef, Wrap};
pub use transform::Transform;
