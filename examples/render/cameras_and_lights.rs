//! The cameras of a scene, and a default light for scenes without one.

use glam::{DVec3, Vec3};
use ropewalk::{Core, Light, NodeKey, Scene, Transform, View};

/// The nodes with a camera, in preorder.
pub(crate) fn cameras(scene: &Scene) -> Vec<NodeKey> {
    cores_of_kind(scene, |core| matches!(core, Core::Camera(_)))
}

/// The name of the camera node or, if it has none, of its parent.
pub(crate) fn camera_name(scene: &Scene, camera: NodeKey) -> &str {
    let name = scene.name(camera).unwrap_or_default();
    let parent = scene.parent(camera).ok().flatten();
    if name.is_empty() { parent.and_then(|parent| scene.name(parent).ok()).unwrap_or_default() } else { name }
}

/// Adds a directional key light from the upper left behind the camera, if the scene has no light.
pub(crate) fn add_light_if_none(scene: &mut Scene, view: &View) -> ropewalk::Result<()> {
    if !cores_of_kind(scene, |core| matches!(core, Core::Light(_))).is_empty() {
        return Ok(());
    }
    let from = view.world_from_view.transform_vector3(DVec3::new(-0.5, 0.9, 0.7));
    let pose = Transform::looking_at(from, DVec3::ZERO, DVec3::Y);
    let key_light = scene.add(scene.root(), pose)?;
    scene.set_name(key_light, "key light")?;
    scene.add(key_light, Light::directional(Vec3::ONE, 2.6))?;
    Ok(())
}

fn cores_of_kind(scene: &Scene, is_kind: impl Fn(&Core) -> bool) -> Vec<NodeKey> {
    let nodes = scene.subtree(scene.root()).into_iter().flatten();
    nodes.filter(|&node| scene.node_core(node).is_ok_and(&is_kind)).collect()
}
