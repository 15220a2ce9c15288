//! Keys of scene objects. A key carries a slot and a generation, so that a key of a removed object is detected as
//! stale.

use std::fmt;

use serde::{Deserialize, Serialize};
use slotmap::Key as _;

slotmap::new_key_type! {
    /// Key of a node.
    pub struct NodeKey;
    /// Key of a core, the content of one or more nodes. Editing a core affects every node that uses it.
    pub struct CoreKey;
    /// Key of a [`Geometry`](super::Geometry).
    pub struct GeometryKey;
    /// Key of a [`Material`](super::Material).
    pub struct MaterialKey;
    /// Key of a [`Texture`](super::Texture).
    pub struct TextureKey;
}

/// The key of any scene object.
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
