//! What changed since the last compile, from the log.

use crate::graph::{Change, Core, GeometryKey, MaterialKey, NodeKey, ObjectKey, Scene};

/// What changed, sorted by what it takes to catch up.
#[derive(Debug, Default)]
pub(super) struct SceneChanges {
    /// The scene is new to the compiler.
    pub(super) is_new_scene: bool,
    /// Something did, other than names and the like.
    pub(super) affects_image: bool,
    /// Nodes whose transform changed: where they are and all below them.
    pub(super) moved_nodes: Vec<NodeKey>,
    /// Nodes that became something else: what they are and all below them.
    pub(super) reclassified_nodes: Vec<NodeKey>,
    pub(super) geometries: Vec<GeometryKey>,
    pub(super) materials: Vec<MaterialKey>,
    /// Some texture has other texels.
    pub(super) textures: bool,
    /// Some light has another colour, say.
    pub(super) lights: bool,
}

impl SceneChanges {
    /// Sorts changes. O(changes + users of changed cores).
    pub(super) fn new(scene: &Scene, changes: Vec<(ObjectKey, Change)>) -> Self {
        let mut dirty = Self::default();
        for (object, change) in changes {
            // A name is no part of the image; what comes and goes is seen by those that use it, nodes by the hierarchy.
            dirty.affects_image |= !Change::NAME.contains(change);
            if change.contains(Change::REMOVED)
                || (change.contains(Change::ADDED) && !matches!(object, ObjectKey::Node(_)))
            {
                continue;
            }
            match object {
                ObjectKey::Node(node) => dirty.add_node_change(scene, node, change),
                ObjectKey::Core(key) => {
                    let users = || scene.users(key).into_iter().flatten();
                    match scene.core(key) {
                        _ if change.contains(Change::KIND) => dirty.reclassified_nodes.extend(users()),
                        Ok(Core::Transform(_)) => dirty.moved_nodes.extend(users()),
                        Ok(Core::Light(_)) => dirty.lights = true,
                        Ok(Core::Group | Core::Camera(_)) | Err(_) => {}
                        Ok(_) => dirty.reclassified_nodes.extend(users()),
                    }
                }
                ObjectKey::Geometry(key) => dirty.geometries.push(key),
                ObjectKey::Material(key) => dirty.materials.push(key),
                ObjectKey::Texture(_) => dirty.textures = true,
            }
        }
        dirty
    }

    fn add_node_change(&mut self, scene: &Scene, node: NodeKey, change: Change) {
        let own = Change::ADDED | Change::PARENT | Change::CORE | Change::MASK | Change::VISIBILITY;
        // The children of these are counted: each may be another child than it was.
        let counts = || matches!(scene.node_core(node), Ok(Core::Switch(_) | Core::Lod(_)));
        if change.intersects(own) || (change.contains(Change::CHILDREN) && counts()) {
            self.reclassified_nodes.push(node);
        }
    }
}
