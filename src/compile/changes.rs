//! The scene's changes since the last compile, sorted by the compile step that handles them.

use crate::graph::{Change, Core, GeometryKey, MaterialKey, NodeKey, ObjectKey, Scene};

/// The changes of a scene, sorted by the compile step that handles them.
#[derive(Debug, Default)]
pub(super) struct SceneChanges {
    /// Something changed that can affect the image (names cannot).
    pub(super) affects_image: bool,
    /// Nodes whose transform changed: the world matrices of their subtrees are stale.
    pub(super) moved_nodes: Vec<NodeKey>,
    /// Nodes whose core, parent, mask or visibility changed: their subtrees must be classified again.
    pub(super) reclassified_nodes: Vec<NodeKey>,
    /// Geometries that were replaced.
    pub(super) geometries: Vec<GeometryKey>,
    /// Materials that were replaced.
    pub(super) materials: Vec<MaterialKey>,
    /// Some texture was replaced.
    pub(super) textures: bool,
    /// Some light's parameters changed (colour, intensity, cone).
    pub(super) lights: bool,
}

impl SceneChanges {
    /// Sorts the changes of a scene's log. O(changes + users of changed cores).
    pub(super) fn new(scene: &Scene, changes: Vec<(ObjectKey, Change)>) -> Self {
        let mut sorted = Self::default();
        for (object, change) in changes {
            sorted.affects_image |= !Change::NAME.contains(change);
            // Added and removed assets and cores are noticed through the nodes that use them, removed nodes through the
            // hierarchy.
            if change.contains(Change::REMOVED)
                || (change.contains(Change::ADDED) && !matches!(object, ObjectKey::Node(_)))
            {
                continue;
            }
            // Sort by what the change makes stale.
            match object {
                ObjectKey::Node(node) => sorted.add_node_change(scene, node, change),
                ObjectKey::Core(key) => {
                    let users = || scene.users(key).into_iter().flatten();
                    match scene.core(key) {
                        _ if change.contains(Change::KIND) => sorted.reclassified_nodes.extend(users()),
                        Ok(Core::Transform(_)) => sorted.moved_nodes.extend(users()),
                        Ok(Core::Light(_)) => sorted.lights = true,
                        Ok(Core::Group | Core::Camera(_)) | Err(_) => {}
                        Ok(_) => sorted.reclassified_nodes.extend(users()),
                    }
                }
                ObjectKey::Geometry(key) => sorted.geometries.push(key),
                ObjectKey::Material(key) => sorted.materials.push(key),
                ObjectKey::Texture(_) => sorted.textures = true,
            }
        }
        sorted
    }

    fn add_node_change(&mut self, scene: &Scene, node: NodeKey, change: Change) {
        let own = Change::ADDED | Change::PARENT | Change::CORE | Change::MASK | Change::VISIBILITY;
        // Switch and LOD nodes address children by index: a change of the child list may change which child is meant.
        let counts = || matches!(scene.node_core(node), Ok(Core::Switch(_) | Core::Lod(_)));
        if change.intersects(own) || (change.contains(Change::CHILDREN) && counts()) {
            self.reclassified_nodes.push(node);
        }
    }
}
