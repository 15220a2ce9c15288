//! What most programs name, for `use ropewalk::prelude::*`.
//!
//! It has no `Result` and no `Error`, which a program may have of its own.

pub use glam::{DQuat, DVec3, Vec3, Vec4};

pub use crate::graph::{AlphaMode, Billboard, KeepTransform, LightKind, Lod, NodePath, ObjectKey, Switch, TextureRef};
pub use crate::math::Bounds;
pub use crate::{
    Camera, Core, CoreKey, DeviceChoice, Geometry, GeometryKey, Hit, Image, Light, Material, MaterialKey, NodeKey, Ray,
    Renderer, RendererOptions, Scene, Sky, Texture, TextureKey, Transform, View,
};
