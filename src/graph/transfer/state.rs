//! All that one object is, apart from the scene it is in.

use serde::{Deserialize, Serialize};

use crate::graph::key_map::slot;
use crate::graph::{Core, CoreKey, Geometry, Material, NodeKey, Object, Scene, Texture};

/// All that one object is. The arrays of geometries and textures are shared with the scene, so that a copy is cheap.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum State {
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

impl State {
    /// Whether an object can be in this state at all: a node in that of a node.
    pub(super) fn fits(&self, object: Object) -> bool {
        matches!(
            (self, object),
            (Self::Node(_), Object::Node(_))
                | (Self::Core(_), Object::Core(_))
                | (Self::Geometry(_), Object::Geometry(_))
                | (Self::Material(_), Object::Material(_))
                | (Self::Texture(_), Object::Texture(_))
        )
    }

    /// The objects that one in this state refers to and counts as used, some of them twice.
    pub(super) fn references(&self) -> Vec<Object> {
        match self {
            Self::Node(node) => vec![node.core.into()],
            Self::Core(core) => {
                let geometry = core.geometry().map(Object::from);
                let target = core.target().map(Object::from);
                geometry.into_iter().chain(core.material().map(Object::from)).chain(target).collect()
            }
            Self::Material(material) => material.textures().map(|texture| texture.texture.into()).collect(),
            Self::Geometry(_) | Self::Texture(_) => vec![],
        }
    }
}

impl Scene {
    /// All that an object is; `None` if it is not in the scene. O(1).
    pub fn state(&self, object: Object) -> Option<State> {
        Some(match object {
            Object::Node(key) => {
                let node = self.nodes.get(key)?;
                State::Node(NodeState {
                    parent: node.parent,
                    previous_sibling: node.previous_sibling,
                    core: node.core,
                    mask: node.mask,
                    visible: node.visible,
                    name: node.name.clone(),
                })
            }
            Object::Core(key) => State::Core(self.cores.get(key)?.core.clone()),
            Object::Geometry(key) => State::Geometry(self.geometries.get(key)?.value.geometry.clone()),
            Object::Material(key) => State::Material(Box::new(self.materials.get(key)?.value.clone())),
            Object::Texture(key) => State::Texture(self.textures.get(key)?.value.clone()),
        })
    }

    /// Whether the scene has this object.
    pub(super) fn has(&self, object: Object) -> bool {
        match object {
            Object::Node(key) => self.nodes.contains_key(key),
            Object::Core(key) => self.cores.contains_key(key),
            Object::Geometry(key) => self.geometries.contains_key(key),
            Object::Material(key) => self.materials.contains_key(key),
            Object::Texture(key) => self.textures.contains_key(key),
        }
    }

    /// The slot of the object's key, the object that is there now, and how many such slots there are.
    pub(super) fn place(&self, object: Object) -> (usize, Option<Object>, usize) {
        match object {
            Object::Node(key) => {
                (slot(key), self.nodes.key_at(slot(key)).map(Into::into), self.nodes.generations().len())
            }
            Object::Core(key) => {
                (slot(key), self.cores.key_at(slot(key)).map(Into::into), self.cores.generations().len())
            }
            Object::Geometry(key) => {
                (slot(key), self.geometries.key_at(slot(key)).map(Into::into), self.geometries.generations().len())
            }
            Object::Material(key) => {
                (slot(key), self.materials.key_at(slot(key)).map(Into::into), self.materials.generations().len())
            }
            Object::Texture(key) => {
                (slot(key), self.textures.key_at(slot(key)).map(Into::into), self.textures.generations().len())
            }
        }
    }

    /// All objects, by rising keys of each kind. O(slots).
    pub(super) fn objects(&self) -> impl Iterator<Item = Object> {
        let nodes = self.nodes.keys().map(Object::from);
        let cores = self.cores.keys().map(Object::from);
        let geometries = self.geometries.keys().map(Object::from);
        let materials = self.materials.keys().map(Object::from);
        nodes.chain(cores).chain(geometries).chain(materials).chain(self.textures.keys().map(Object::from))
    }
}
