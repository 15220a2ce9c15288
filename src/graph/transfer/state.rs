//! Complete state of one object, independent of its scene.

use serde::{Deserialize, Serialize};

use crate::graph::key_map::slot;
use crate::graph::{Core, CoreKey, Geometry, Material, NodeKey, ObjectKey, Scene, Texture};

/// Complete state of one object. The arrays of geometries and textures are shared with the scene, so that a copy is
/// cheap.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum ObjectState {
    /// State of a node.
    Node(NodeState),
    /// State of a core.
    Core(Core),
    /// State of a geometry.
    Geometry(Geometry),
    /// State of a material.
    Material(Box<Material>),
    /// State of a texture.
    Texture(Texture),
}

/// Complete state of a node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeState {
    /// The parent; `None` for the root.
    pub parent: Option<NodeKey>,
    /// The child before it among its parent's; `None` for the first.
    pub previous_sibling: Option<NodeKey>,
    /// The key of its core.
    pub core: CoreKey,
    /// Its own ray mask.
    pub mask: u32,
    /// Its own visibility.
    pub visible: bool,
    /// Its name.
    pub name: Box<str>,
}

impl ObjectState {
    /// Whether the state is of the key's kind.
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

    /// The objects that the state references, once per counted use.
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
    /// The complete state of an object; `None` if it is not in the scene. O(1).
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

    /// Whether the key is that of an object of this scene.
    pub(super) fn contains_object(&self, object: ObjectKey) -> bool {
        match object {
            ObjectKey::Node(key) => self.nodes.contains_key(key),
            ObjectKey::Core(key) => self.cores.contains_key(key),
            ObjectKey::Geometry(key) => self.geometries.contains_key(key),
            ObjectKey::Material(key) => self.materials.contains_key(key),
            ObjectKey::Texture(key) => self.textures.contains_key(key),
        }
    }

    /// The slot of the object's key, the object that has that slot now, and the number of slots of its kind.
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

    /// All objects, in ascending order of keys within each kind. O(slots).
    pub(super) fn objects(&self) -> impl Iterator<Item = ObjectKey> {
        let nodes = self.nodes.keys().map(ObjectKey::from);
        let cores = self.cores.keys().map(ObjectKey::from);
        let geometries = self.geometries.keys().map(ObjectKey::from);
        let materials = self.materials.keys().map(ObjectKey::from);
        nodes.chain(cores).chain(geometries).chain(materials).chain(self.textures.keys().map(ObjectKey::from))
    }
}
