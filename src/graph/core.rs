//! Cores: what a node is. Nodes that share a core share its edits.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::{Billboard, Camera, CoreKey, GeometryKey, Light, Lod, MaterialKey, NodeKey, Switch, Transform};

/// The content of a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Core {
    /// Nothing but the parent of its children.
    Group,
    /// Moves its children into the space of its parent.
    Transform(Transform),
    /// Shows some of its children.
    Switch(Switch),
    /// Shows the child that suits the distance or size at which it is seen.
    Lod(Lod),
    /// Turns its children towards the eye.
    Billboard(Billboard),
    /// Gives all geometry below it this material. Of several on the way down, the **outermost** counts, as in OpenSG: what
    /// stands above overrules what stands below, so that a whole part can be highlighted by one node.
    MaterialGroup(MaterialKey),
    /// Shows another node with everything below it here too, without copying anything: instancing of whole subtrees,
    /// nested as deep as one likes. The other node's own transform applies, those above it do not. It still stands where it
    /// stands; to see only its instances, put it below a hidden node. When it is removed, this becomes a group.
    Instance(NodeKey),
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

    /// The geometry that it refers to.
    pub fn geometry(&self) -> Option<GeometryKey> {
        match *self {
            Self::Geometry { geometry, .. } => Some(geometry),
            _ => None,
        }
    }

    /// The node that it shows here too.
    pub fn instance_target(&self) -> Option<NodeKey> {
        match *self {
            Self::Instance(target) => Some(target),
            _ => None,
        }
    }

    /// The material that it refers to.
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

/// Where a node's core comes from: a new one, or one that other nodes may share.
///
/// Calls that take `impl Into<CoreSource>` accept a [`Core`] or what some cores consist of, as a [`Transform`] or a
/// [`Light`] (each makes a new core), or a [`CoreKey`] (shares it).
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
