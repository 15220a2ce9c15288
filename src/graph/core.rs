//! Cores: the content of nodes (group, transform, geometry, light and so on), shared by any number of them.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::{Billboard, Camera, CoreKey, GeometryKey, Light, Lod, MaterialKey, NodeKey, Switch, Transform};

/// The content of a node. Nodes that share a core share its edits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Core {
    /// Groups its children; has no effect of its own.
    Group,
    /// Applies a local transform to everything below it.
    Transform(Transform),
    /// Selects which of its children are visible.
    Switch(Switch),
    /// Selects one child by distance or projected size (level of detail).
    Lod(Lod),
    /// Rotates its children to face the viewpoint.
    Billboard(Billboard),
    /// Overrides the material of all geometry below it. If several apply, the **outermost** wins (as in OpenSG), so
    /// that one node can highlight a whole subassembly.
    MaterialGroup(MaterialKey),
    /// Instances the subtree of another node, the target, without copying it; instances can be nested. The target's own
    /// transform applies, its ancestors' do not. The target stays visible in its own position; to show only its
    /// instances, put it below a hidden node. If the target is removed, this core becomes a [`Group`](Self::Group).
    Instance(NodeKey),
    /// Triangles of one material.
    Geometry {
        /// The triangles.
        geometry: GeometryKey,
        /// Their material.
        material: MaterialKey,
    },
    /// A light source.
    Light(Light),
    /// A camera.
    Camera(Camera),
}

impl Core {
    /// The kind, without the content.
    pub fn kind(&self) -> CoreKind {
        match self {
            Self::Group => CoreKind::Group,
            Self::Transform(_) => CoreKind::Transform,
            Self::Switch(_) => CoreKind::Switch,
            Self::Lod(_) => CoreKind::Lod,
            Self::Billboard(_) => CoreKind::Billboard,
            Self::MaterialGroup(_) => CoreKind::MaterialGroup,
            Self::Instance(_) => CoreKind::Instance,
            Self::Geometry { .. } => CoreKind::Geometry,
            Self::Light(_) => CoreKind::Light,
            Self::Camera(_) => CoreKind::Camera,
        }
    }

    /// The geometry of a geometry core.
    pub fn geometry(&self) -> Option<GeometryKey> {
        match *self {
            Self::Geometry { geometry, .. } => Some(geometry),
            _ => None,
        }
    }

    /// The target of an instance core.
    pub fn instance_target(&self) -> Option<NodeKey> {
        match *self {
            Self::Instance(target) => Some(target),
            _ => None,
        }
    }

    /// The material of a geometry core or of a material group: the core's own, before material groups above it are
    /// applied.
    pub fn material(&self) -> Option<MaterialKey> {
        match *self {
            Self::Geometry { material, .. } | Self::MaterialGroup(material) => Some(material),
            _ => None,
        }
    }
}

/// The kind of a [`Core`]. `Display` gives its name in words: "level of detail".
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[non_exhaustive]
pub enum CoreKind {
    /// [`Core::Group`].
    Group,
    /// [`Core::Transform`].
    Transform,
    /// [`Core::Switch`].
    Switch,
    /// [`Core::Lod`].
    Lod,
    /// [`Core::Billboard`].
    Billboard,
    /// [`Core::MaterialGroup`].
    MaterialGroup,
    /// [`Core::Instance`].
    Instance,
    /// [`Core::Geometry`].
    Geometry,
    /// [`Core::Light`].
    Light,
    /// [`Core::Camera`].
    Camera,
}

impl CoreKind {
    /// The name in words, as error messages and user interfaces show it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Group => "group",
            Self::Transform => "transform",
            Self::Switch => "switch",
            Self::Lod => "level of detail",
            Self::Billboard => "billboard",
            Self::MaterialGroup => "material group",
            Self::Instance => "instance",
            Self::Geometry => "geometry",
            Self::Light => "light",
            Self::Camera => "camera",
        }
    }
}

impl fmt::Display for CoreKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// The core of a node: a new core, or the key of an existing one to share.
///
/// Calls that take `impl Into<CoreSource>` accept a [`Core`] or a core's content such as [`Transform`] or [`Light`]
/// (each creates a new core), or a [`CoreKey`] (shares it).
#[derive(Clone, Debug, PartialEq)]
pub enum CoreSource {
    /// A new core, used by this node only until its key is shared.
    New(Core),
    /// The core with this key.
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

macro_rules! core_source_from {
    ($($part:ident),*) => {
        $(impl From<$part> for CoreSource {
            fn from(part: $part) -> Self {
                Self::New(Core::$part(part))
            }
        })*
    };
}

core_source_from!(Transform, Switch, Lod, Billboard, Light, Camera);

/// A core as the scene stores it, with the head of the intrusive list of the nodes that use it.
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
