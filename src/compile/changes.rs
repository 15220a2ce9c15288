//! What changed since the last compile, from the log.

use crate::graph::{Change, Core, GeometryKey, MaterialKey, NodeKey, Object, Scene};

/// What changed, sorted by what it takes to catch up.
#[derive(Debug, Default)]
pub(super) struct Dirty {
    /// The scene is new to the compiler.
    pub(super) everything: bool,
    /// Something did, other than names and the like.
    pub(super) any: bool,
    /// Nodes whose transform changed: where they are and all below them.
    pub(super) moved: Vec<NodeKey>,
    /// Nodes that became something else: what they are and all below them.
    pub(super) changed: Vec<NodeKey>,
    pub(super) geometries: Vec<GeometryKey>,
    pub(super) materials: Vec<MaterialKey>,
    /// Some texture has other texels.
    pub(super) textures: bool,
    /// Some light has another colour, say.
    pub(super) lights: bool,
}

impl Dirty {
    /// Sorts changes. O(changes + users of changed cores).
    pub(super) fn new(scene: &Scene, changes: Vec<(Object, Change)>) -> Self {
        let mut dirty = Self::default();
        for (object, change) in changes {
            // A name is no part of the image; what comes and goes is seen by those that use it, nodes by the hierarchy.
            dirty.any |= !Change::NAME.contains(change);
            if change.contains(Change::REMOVED)
                || (change.contains(Change::ADDED) && !matches!(object, Object::Node(_)))
            {
                continue;
            }
            match object {
                Object::Node(node) => dirty.node(scene, node, change),
                Object::Core(key) => {
                    let users = || scene.users(key).into_iter().flatten();
                    match scene.core_of(key) {
                        _ if change.contains(Change::KIND) => dirty.changed.extend(users()),
                        Ok(Core::Transform(_)) => dirty.moved.extend(users()),
                        Ok(Core::Light(_)) => dirty.lights = true,
                        Ok(Core::Group | Core::Camera(_)) | Err(_) => {}
                        Ok(_) => dirty.changed.extend(users()),
                    }
                }
                Object::Geometry(key) => dirty.geometries.push(key),
                Object::Material(key) => dirty.materials.push(key),
                Object::Texture(_) => dirty.textures = true,
            }
        }
        dirty
    }

    fn node(&mut self, scene: &Scene, node: NodeKey, change: Change) {
        let own = Change::ADDED | Change::PARENT | Change::CORE | Change::MASK | Change::VISIBILITY;
        // The children of these are counted: each may be another child than it was.
        let counts = || matches!(scene.core(node), Ok(Core::Switch(_) | Core::Lod(_)));
        if change.intersects(own) || (change.contains(Change::CHILDREN) && counts()) {
            self.changed.push(node);
        }
    }
}
