//! Cores: what a node is. Nodes that share a core share its edits.

use serde::{Deserialize, Serialize};

use super::{Camera, CoreKey, GeometryKey, Light, MaterialKey, NodeKey, Transform};

/// What a node is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Core {
    /// Nothing but the parent of its children.
    Group,
    /// Moves its children into the space of its parent.
    Transform(Transform),
    /// Triangles of one material.
    Geometry {
        /// The triangles.
        geometry: GeometryKey,
        /// What they are made of.
        material: MaterialKey,
    },
    /// Shines.
    Light(Light),
    /// Sees.
    Camera(Camera),
}

impl Core {
    /// The kind in one word, as error messages name it.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Group => "group",
            Self::Transform(_) => "transform",
            Self::Geometry { .. } => "geometry",
            Self::Light(_) => "light",
            Self::Camera(_) => "camera",
        }
    }
}

/// Where a node's core comes from: a new one, or one that other nodes may share.
///
/// Calls that take `impl Into<CoreSource>` accept a [`Core`], a [`Transform`], a [`Light`] or a [`Camera`] (each makes
/// a new core) or a [`CoreKey`] (shares it).
#[derive(Clone, Debug, PartialEq)]
pub enum CoreSource {
    /// A core of the node's own, until somebody shares it.
    New(Core),
    /// The core that this key names.
    Shared(CoreKey),
}

impl From<Core> for CoreSource {
    fn from(core: Core) -> Self {
        Self::New(core)
    }
}

impl From<CoreKey> for CoreSource {
    fn from(key: CoreKey) -> Self {
        Self::Shared(key)
    }
}

impl From<Transform> for CoreSource {
    fn from(transform: Transform) -> Self {
        Self::New(Core::Transform(transform))
    }
}

impl From<Light> for CoreSource {
    fn from(light: Light) -> Self {
        Self::New(Core::Light(light))
    }
}

impl From<Camera> for CoreSource {
    fn from(camera: Camera) -> Self {
        Self::New(Core::Camera(camera))
    }
}

/// A core as the scene stores it, with the list of its users threaded through their nodes.
#[derive(Debug)]
pub(super) struct CoreSlot {
    pub(super) core: Core,
    pub(super) first_user: Option<NodeKey>,
    pub(super) user_count: usize,
}

impl CoreSlot {
    pub(super) fn new(core: Core) -> Self {
        Self { core, first_user: None, user_count: 0 }
    }
}
