//! Ropewalk: a retained scene graph that is ray traced.

pub mod accel;
pub mod compile;
pub mod device;
mod error;
pub mod gltf;
pub mod graph;
pub mod image;
pub mod math;
pub mod render;
pub mod trace;

pub use error::{Error, Result};
pub use graph::{
    AlphaMode, Camera, Change, Changes, Core, CoreKey, CoreSource, Cursor, Filter, Geometry, GeometryKey, Hierarchy,
    Keep, Light, LightKind, Material, MaterialKey, NodeKey, Object, Sampler, Scene, SceneId, Texture, TextureKey,
    TextureRef, Transform, Wrap,
};
pub use math::{Aabb, Bounds};
pub use render::{DeviceChoice, Frame, FrameReport, Renderer, RendererOptions, Sky, View};
