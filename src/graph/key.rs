//! Handles: generation-checked keys that outlive any edit.

use std::fmt;

use serde::{Deserialize, Serialize};
use slotmap::Key as _;

slotmap::new_key_type! {
    /// Names a node of a scene.
    pub struct NodeKey;
    /// Names a core: what a node is. Nodes that share a core share its edits.
    pub struct CoreKey;
    /// Names a [`Geometry`](super::Geometry).
    pub struct GeometryKey;
    /// Names a [`Material`](super::Material).
    pub struct MaterialKey;
    /// Names a [`Texture`](super::Texture).
    pub struct TextureKey;
}

/// Any object of a scene, by its key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[non_exhaustive]
pub enum ObjectKey {
    /// A node.
    Node(NodeKey),
    /// A core.
    Core(CoreKey),
    /// A geometry.
    Geometry(GeometryKey),
    /// A material.
    Material(MaterialKey),
    /// A texture.
    Texture(TextureKey),
}

impl fmt::Display for ObjectKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Node(key) => key.fmt(f),
            Self::Core(key) => key.fmt(f),
            Self::Geometry(key) => key.fmt(f),
            Self::Material(key) => key.fmt(f),
            Self::Texture(key) => key.fmt(f),
        }
    }
}

macro_rules! key_of {
    ($($key:ident => $variant:ident, $kind:literal;)*) => {
        $(impl fmt::Display for $key {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                // slotmap writes "3v1": slot 3, version 1.
                write!(f, concat!($kind, " {:?}"), self.data())
            }
        }

        impl From<$key> for ObjectKey {
            fn from(key: $key) -> Self {
                Self::$variant(key)
            }
        })*
    };
}

key_of! {
    NodeKey => Node, "node";
    CoreKey => Core, "core";
    GeometryKey => Geometry, "geometry";
    MaterialKey => Material, "material";
    TextureKey => Texture, "texture";
}
