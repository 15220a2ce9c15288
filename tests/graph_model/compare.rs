//! The scene, through each of its getters, against the model.

use std::collections::{HashMap, HashSet};

use glam::{DAffine3, DVec3};
use ropewalk::{Bounds, Core, NodeKey, Scene};

use crate::model::Model;
use crate::random::Issued;

/// Everything that can be read without `&mut`.
pub(crate) fn state(scene: &Scene, model: &Model, issued: &Issued) {
    scene.validate().unwrap();
    structure(scene, model);
    objects(scene, model);
    stale_keys(scene, model, issued);
    for &node in model.nodes.keys() {
        world(scene.world(node).unwrap(), node, model);
    }
    for &node in model.nodes.keys().take(4).chain([&model.root]) {
        bounds(scene.world_bounds(node).unwrap(), node, model);
    }
}

fn structure(scene: &Scene, model: &Model) {
    assert_eq!(scene.node_count(), model.nodes.len());
    assert_eq!(scene.root(), model.root);
    let preorder = model.preorder(model.root);
    assert_eq!(scene.descendants(model.root).unwrap().collect::<Vec<_>>(), preorder);
    for (&key, node) in &model.nodes {
        assert!(scene.contains(key));
        assert_eq!(scene.parent(key).unwrap(), node.parent);
        assert_eq!(scene.children(key).unwrap().collect::<Vec<_>>(), node.children);
        assert_eq!(scene.ancestors(key).unwrap().collect::<Vec<_>>(), model.upwards(key)[1..]);
        assert_eq!(scene.core_key(key).unwrap(), node.core);
        assert_eq!(scene.core(key).unwrap(), model.core(key));
        assert_eq!(scene.name(key).unwrap(), node.name);
        assert_eq!(scene.mask(key).unwrap(), node.mask);
        assert_eq!(scene.is_visible(key).unwrap(), node.visible);
    }
    for name in ["left", "right", "nobody"] {
        assert_eq!(scene.find(name), preorder.iter().copied().find(|key| model.nodes[key].name == name));
    }
    let subtree = model.nodes.keys().next().copied().unwrap();
    assert_eq!(scene.descendants(subtree).unwrap().collect::<Vec<_>>(), model.preorder(subtree));
}

fn objects(scene: &Scene, model: &Model) {
    let cores: HashMap<_, _> = scene.cores().map(|(key, core)| (key, core.clone())).collect();
    assert_eq!(cores, model.cores);
    for &core in model.cores.keys() {
        let users: Vec<NodeKey> = scene.users(core).unwrap().collect();
        assert_eq!(users.len(), model.users(core).len());
        assert_eq!(HashSet::from_iter(users), model.users(core));
    }
    let geometries: HashMap<_, _> = scene.geometries().map(|(key, value)| (key, value.clone())).collect();
    let materials: HashMap<_, _> = scene.materials().map(|(key, value)| (key, value.clone())).collect();
    let textures: HashMap<_, _> = scene.textures().map(|(key, value)| (key, value.clone())).collect();
    assert_eq!(
        (geometries, materials, textures),
        (model.geometries.clone(), model.materials.clone(), model.textures.clone())
    );

    assert_eq!(scene.core_count(), model.cores.len());
    assert_eq!(scene.geometry_count(), model.geometries.len());
    assert_eq!(scene.material_count(), model.materials.len());
    assert_eq!(scene.texture_count(), model.textures.len());
    assert_eq!(scene.triangle_count(), model.geometries.values().map(|g| g.indices.len() as u64).sum::<u64>());
    let shown = model.nodes.keys().filter_map(|&node| match model.core(node) {
        Core::Geometry { geometry, .. } => Some(model.geometries[geometry].indices.len() as u64),
        _ => None,
    });
    assert_eq!(scene.instanced_triangle_count(), shown.sum::<u64>());
}

fn stale_keys(scene: &Scene, model: &Model, issued: &Issued) {
    let node = |key: &_| !model.nodes.contains_key(key) && scene.parent(*key).is_ok();
    assert_eq!(issued.nodes.iter().find(|key| node(key)), None);
    let core = |key: &_| !model.cores.contains_key(key) && scene.core_of(*key).is_ok();
    assert_eq!(issued.cores.iter().find(|key| core(key)), None);
    let geometry = |key: &_| !model.geometries.contains_key(key) && scene.geometry(*key).is_ok();
    assert_eq!(issued.geometries.iter().find(|key| geometry(key)), None);
    let material = |key: &_| !model.materials.contains_key(key) && scene.material(*key).is_ok();
    assert_eq!(issued.materials.iter().find(|key| material(key)), None);
    let texture = |key: &_| !model.textures.contains_key(key) && scene.texture(*key).is_ok();
    assert_eq!(issued.textures.iter().find(|key| texture(key)), None);
}

/// The matrix takes points where the transforms, applied one by one, take them.
fn world(world: DAffine3, node: NodeKey, model: &Model) {
    for point in [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z] {
        let (expected, magnitude) = model.to_world(node, point);
        let found = world.transform_point3(point);
        let error = (found - expected).abs().max_element();
        assert!(error <= 1e-9 * magnitude, "{point} of {node:?} is at {found}, not at {expected}");
    }
}

/// The box is the box around the corners of the boxes, and every corner of every triangle lies in it.
fn bounds(found: Bounds, node: NodeKey, model: &Model) {
    let mut expected = Bounds::EMPTY;
    let mut magnitude = 0.0;
    let mut add = |bounds: &mut Bounds, node: NodeKey, point: DVec3| {
        let (point, size) = model.to_world(node, point);
        magnitude = f64::max(magnitude, size);
        *bounds = bounds.union(Bounds { min: point, max: point });
    };
    let mut triangles = Bounds::EMPTY;
    for node in model.preorder(node) {
        let Core::Geometry { geometry, .. } = model.core(node) else { continue };
        let geometry = &model.geometries[geometry];
        let vertices = || geometry.indices.iter().flatten().map(|&i| geometry.positions[i as usize].as_dvec3());
        let (min, max) = (vertices().reduce(DVec3::min), vertices().reduce(DVec3::max));
        let (Some(min), Some(max)) = (min, max) else { continue };
        for corner in 0..8 {
            let side = |axis: usize| if corner >> axis & 1 == 0 { min[axis] } else { max[axis] };
            add(&mut expected, node, DVec3::new(side(0), side(1), side(2)));
        }
        vertices().for_each(|vertex| add(&mut triangles, node, vertex));
    }
    assert_eq!(found.is_empty(), expected.is_empty());
    if !expected.is_empty() {
        let slack = DVec3::splat(1e-9 * magnitude);
        assert!((found.min - expected.min).abs().cmple(slack).all(), "{found:?}, not {expected:?}");
        assert!((found.max - expected.max).abs().cmple(slack).all(), "{found:?}, not {expected:?}");
        assert!(found.min.cmple(triangles.min + slack).all() && found.max.cmpge(triangles.max - slack).all());
    }
}

/// The preorder arrays against the model, and against what the getters said while the arrays were out of date.
pub(crate) fn hierarchy(scene: &mut Scene, model: &Model) {
    let walked: Vec<_> = scene.descendants(model.root).unwrap().map(|node| scene.world(node).unwrap()).collect();
    let (scene, hierarchy) = scene.with_hierarchy();
    let preorder = model.preorder(model.root);
    assert_eq!(hierarchy.nodes(), preorder);
    for (index, &node) in preorder.iter().enumerate() {
        assert_eq!(hierarchy.index(node), Some(index));
        let parent = model.nodes[&node].parent.map(|parent| preorder.iter().position(|&n| n == parent).unwrap() as u32);
        assert_eq!(hierarchy.parents()[index], parent.unwrap_or(ropewalk::Hierarchy::NO_PARENT));
        assert_eq!(hierarchy.subtree(index), index..index + model.preorder(node).len());
        let upwards = model.upwards(node);
        let mask = upwards.iter().fold(u32::MAX, |mask, node| mask & model.nodes[node].mask);
        assert_eq!(hierarchy.masks()[index], mask);
        assert_eq!(hierarchy.visible()[index], upwards.iter().all(|node| model.nodes[node].visible));
        assert_eq!(hierarchy.worlds()[index], walked[index], "the same product in the same order");
        assert_eq!(hierarchy.worlds()[index], scene.world(node).unwrap());
    }
}
