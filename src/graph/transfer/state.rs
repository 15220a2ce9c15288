//! All that one object is, apart from the scene it is in.

use serde::{Deserialize, Serialize};

use crate::graph::key_map::slot;
use crate::graph::{Core, CoreKey, Geometry, Material, NodeKey, ObjectKey, Scene, Texture};

/// All that one object is. The arrays of geometries and textures are shared with the scene, so that a copy is cheap.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum ObjectState {
    /// Of a node.
    Node(NodeState),
    /// Of a core.
    Core(Core),
    /// Of a geometry.
    Geometry(Geometry),
    /// Of a material.
    Material(Box<Material>),
    /// Of a texture.
    Texture(Texture),
}

/// All that a node is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeState {
    /// Its parent; `None` for the root.
    pub parent: Option<NodeKey>,
    /// The child of its parent that comes before it; `None` for the first.
    pub previous_sibling: Option<NodeKey>,
    /// What it is.
    pub core: CoreKey,
    /// Its own traversal mask.
    pub mask: u32,
    /// Whether it is itself shown.
    pub visible: bool,
    /// Its name.
    pub name: Box<str>,
}

impl ObjectState {
    /// Whether an object can be in this state at all: a node in that of a node.
    pub(super) fn matches_kind(&self, object: ObjectKey) -> bool {
        matches!(
            (self, object),
            (Self::Node(_), ObjectKey::Node(_))
                | (Self::Core(_), ObjectKey::Core(_))
                | (Self::Geometry(_), ObjectKey::Geometry(_))
                | (Self::Material(_), ObjectKey::Material(_))
                | (Self::Texture(_), ObjectKey::Texture(_))
        )
    }

    /// The objects that one in this state refers to and counts as used, some of them twice.
    pub(super) fn references(&self) -> Vec<ObjectKey> {
        match self {
            Self::Node(node) => vec![node.core.into()],
            Self::Core(core) => {
                let geometry = core.geometry().map(ObjectKey::from);
                let target = core.instance_target().map(ObjectKey::from);
                geometry.into_iter().chain(core.material().map(ObjectKey::from)).chain(target).collect()
            }
            Self::Material(material) => material.textures().map(|texture| texture.texture.into()).collect(),
            Self::Geometry(_) | Self::Texture(_) => vec![],
        }
    }
}

impl Scene {
    /// All that an object is; `None` if it is not in the scene. O(1).
    pub fn state(&self, object: ObjectKey) -> Option<ObjectState> {
        Some(match object {
            ObjectKey::Node(key) => {
                let node = self.nodes.get(key)?;
                ObjectState::Node(NodeState {
                    parent: node.parent,
                    previous_sibling: node.previous_sibling,
                    core: node.core,
                    mask: node.mask,
                    visible: node.visible,
                    name: node.name.clone(),
                })
            }
            ObjectKey::Core(key) => ObjectState::Core(self.cores.get(key)?.core.clone()),
            ObjectKey::Geometry(key) => ObjectState::Geometry(self.geometries.get(key)?.value.geometry.clone()),
            ObjectKey::Material(key) => ObjectState::Material(Box::new(self.materials.get(key)?.value.clone())),
            ObjectKey::Texture(key) => ObjectState::Texture(self.textures.get(key)?.value.clone()),
        })
    }

    /// Whether the scene has this object.
    pub(super) fn contains_object(&self, object: ObjectKey) -> bool {
        match object {
            ObjectKey::Node(key) => self.nodes.contains_key(key),
            ObjectKey::Core(key) => self.cores.contains_key(key),
            ObjectKey::Geometry(key) => self.geometries.contains_key(key),
            ObjectKey::Material(key) => self.materials.contains_key(key),
            ObjectKey::Texture(key) => self.textures.contains_key(key),
        }
    }

    /// The slot of the object's key, the object that is there now, and how many such slots there are.
    pub(super) fn slot_occupancy(&self, object: ObjectKey) -> (usize, Option<ObjectKey>, usize) {
        match object {
            ObjectKey::Node(key) => {
                (slot(key), self.nodes.key_at(slot(key)).map(Into::into), self.nodes.generations().len())
            }
            ObjectKey::Core(key) => {
                (slot(key), self.cores.key_at(slot(key)).map(Into::into), self.cores.generations().len())
            }
            ObjectKey::Geometry(key) => {
                (slot(key), self.geometries.key_at(slot(key)).map(Into::into), self.geometries.generations().len())
            }
            ObjectKey::Material(key) => {
                (slot(key), self.materials.key_at(slot(key)).map(Into::into), self.materials.generations().len())
            }
            ObjectKey::Texture(key) => {
                (slot(key), self.textures.key_at(slot(key)).map(Into::into), self.textures.generations().len())
            }
        }
    }

    /// All objects, by rising keys of each kind. O(slots).
    pub(super) fn objects(&self) -> impl Iterator<Item = ObjectKey> {
        let nodes = self.nodes.keys().map(ObjectKey::from);
        let cores = self.cores.keys().map(ObjectKey::from);
        let geometries = self.geometries.keys().map(ObjectKey::from);
        let materials = self.materials.keys().map(ObjectKey::from);
        nodes.chain(cores).chain(geometries).chain(materials).chain(self.textures.keys().map(ObjectKey::from))
    }
}
