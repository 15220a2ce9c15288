//! The scene, through each of its getters, against the model.

use std::collections::{HashMap, HashSet};

use glam::{DAffine3, DVec3};
use ropewalk::math::Bounds;
use ropewalk::{Core, NodeKey, Scene};

use super::model::{Model, Step};
use super::random::Issued;

/// Compares everything that can be read without `&mut Scene`.
pub(crate) fn state(scene: &mut Scene, model: &Model, issued: &Issued) {
    scene.validate().unwrap();
    structure(scene, model);
    objects(scene, model);
    stale_keys(scene, model, issued);
    for &node in model.nodes.keys() {
        world(scene.world_from_local(node).unwrap(), node, model);
    }
}

/// Compares the world bounds of the scene and of a few nodes, which brings the hierarchy up to date.
pub(crate) fn boxes(scene: &mut Scene, model: &Model) {
    for &node in model.nodes.keys().take(4).chain([&model.root]) {
        bounds(scene.world_bounds(node).unwrap(), node, model);
    }
}

fn structure(scene: &Scene, model: &Model) {
    assert_eq!(scene.node_count(), model.nodes.len());
    assert_eq!(scene.root(), model.root);
    let preorder = model.preorder(model.root);
    assert_eq!(scene.subtree(model.root).unwrap().collect::<Vec<_>>(), preorder);
    for (&key, node) in &model.nodes {
        assert!(scene.contains(key));
        assert_eq!(scene.parent(key).unwrap(), node.parent);
        assert_eq!(scene.children(key).unwrap().collect::<Vec<_>>(), node.children);
        assert_eq!(scene.ancestors(key).unwrap().collect::<Vec<_>>(), model.upwards(key)[1..]);
        assert_eq!(scene.core_key(key).unwrap(), node.core);
        assert_eq!(scene.node_core(key).unwrap(), model.core(key));
        assert_eq!(scene.name(key).unwrap(), node.name);
        assert_eq!(scene.mask(key).unwrap(), node.mask);
        assert_eq!(scene.is_visible(key).unwrap(), node.visible);
    }
    for name in ["left", "right", "nobody"] {
        assert_eq!(scene.find(name), preorder.iter().copied().find(|key| model.nodes[key].name == name));
    }
    let subtree = model.nodes.keys().next().copied().unwrap();
    assert_eq!(scene.subtree(subtree).unwrap().collect::<Vec<_>>(), model.preorder(subtree));
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
    let core = |key: &_| !model.cores.contains_key(key) && scene.core(*key).is_ok();
    assert_eq!(issued.cores.iter().find(|key| core(key)), None);
    let geometry = |key: &_| !model.geometries.contains_key(key) && scene.geometry(*key).is_ok();
    assert_eq!(issued.geometries.iter().find(|key| geometry(key)), None);
    let material = |key: &_| !model.materials.contains_key(key) && scene.material(*key).is_ok();
    assert_eq!(issued.materials.iter().find(|key| material(key)), None);
    let texture = |key: &_| !model.textures.contains_key(key) && scene.texture(*key).is_ok();
    assert_eq!(issued.textures.iter().find(|key| texture(key)), None);
}

/// Checks that a node's world matrix maps points to where its transforms, applied one by one, map them.
fn world(world: DAffine3, node: NodeKey, model: &Model) {
    for point in [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z] {
        let (expected, magnitude) = model.to_world(node, point);
        let found = world.transform_point3(point);
        let error = (found - expected).abs().max_element();
        assert!(error <= 1e-9 * magnitude, "{point} of {node:?} is at {found}, not at {expected}");
    }
}

/// Checks that a node's bounds are the box around its geometries' boxes, and that every corner of every triangle is
/// within.
fn bounds(found: Bounds, node: NodeKey, model: &Model) {
    let mut expected = Bounds::EMPTY;
    let mut magnitude = 0.0;
    let mut add = |bounds: &mut Bounds, upwards: &[NodeKey], point: DVec3| {
        let (point, size) = model.to_world_up(upwards, point);
        magnitude = f64::max(magnitude, size);
        *bounds = bounds.union(Bounds { min: point, max: point });
    };
    let mut triangles = Bounds::EMPTY;
    for chain in model.chains(model.chain(node)) {
        let upwards: Vec<NodeKey> = chain.iter().rev().map(|step| step.node).collect();
        let Core::Geometry { geometry, .. } = model.core(upwards[0]) else { continue };
        let geometry = &model.geometries[geometry];
        let vertices = || geometry.indices.iter().flatten().map(|&i| geometry.positions[i as usize].as_dvec3());
        let (min, max) = (vertices().reduce(DVec3::min), vertices().reduce(DVec3::max));
        let (Some(min), Some(max)) = (min, max) else { continue };
        for corner in 0..8 {
            let side = |axis: usize| if corner >> axis & 1 == 0 { min[axis] } else { max[axis] };
            add(&mut expected, &upwards, DVec3::new(side(0), side(1), side(2)));
        }
        vertices().for_each(|vertex| add(&mut triangles, &upwards, vertex));
    }
    assert_eq!(found.is_empty(), expected.is_empty());
    if !expected.is_empty() {
        let slack = DVec3::splat(1e-9 * magnitude);
        assert!((found.min - expected.min).abs().cmple(slack).all(), "{found:?}, not {expected:?}");
        assert!((found.max - expected.max).abs().cmple(slack).all(), "{found:?}, not {expected:?}");
        assert!(found.min.cmple(triangles.min + slack).all() && found.max.cmpge(triangles.max - slack).all());
    }
}

/// Compares the flattened hierarchy with the model, and with what the getters returned while it was out of date.
pub(crate) fn hierarchy(scene: &mut Scene, model: &Model) {
    let walked: HashMap<_, _> = model.nodes.keys().map(|&node| (node, scene.world_from_local(node).unwrap())).collect();
    let (scene, hierarchy) = scene.with_hierarchy().unwrap();
    let mut chains: HashMap<_, _> =
        model.chains(model.chain(model.root)).into_iter().map(|chain| (Model::path(&chain), chain)).collect();
    for (entry, &node) in hierarchy.nodes().iter().enumerate().filter(|&(entry, _)| !hierarchy.is_removed(entry)) {
        let path = hierarchy.path(entry);
        let chain = chains.remove(&path).unwrap_or_else(|| panic!("the model does not have {path:?}, or once only"));
        assert!(hierarchy.entries(node).any(|e| e == entry));
        assert_eq!(hierarchy.is_instance_root(entry), chain.last().unwrap().instanced);
        let parent = hierarchy.parents()[entry];
        assert_eq!(chain.len() == 1, parent == ropewalk::graph::Hierarchy::NO_PARENT);
        if chain.len() > 1 {
            assert_eq!(hierarchy.path(parent as usize), Model::path(&chain[..chain.len() - 1]));
        }
        let below = hierarchy.subtree(entry).into_iter().flatten().filter(|&e| !hierarchy.is_removed(e));
        assert_eq!(below.count(), model.chains(chain.clone()).len());

        let placed = &hierarchy.resolved()[entry];
        assert_eq!(placed.mask, chain.iter().fold(u32::MAX, |mask, step| mask & model.nodes[&step.node].mask));
        let shown = |step: &Step| model.nodes[&step.node].visible && (step.instanced || model.is_chosen(step.node));
        assert_eq!(placed.visible, chain.iter().all(shown));
        let groups = chain.iter().filter_map(|step| match *model.core(step.node) {
            Core::MaterialGroup(material) => Some(material),
            _ => None,
        });
        assert_eq!(placed.material, { groups }.next());
        let locals = chain.iter().filter_map(|step| match model.core(step.node) {
            Core::Transform(transform) => Some(transform.to_affine()),
            _ => None,
        });
        assert_eq!(
            placed.world_from_local,
            locals.fold(DAffine3::IDENTITY, |world, local| world * local),
            "the same product in the same order"
        );
        if path.instances.is_empty() {
            assert_eq!(hierarchy.entry(node), Some(entry));
            assert_eq!(placed.world_from_local, walked[&node]);
            assert_eq!(placed.world_from_local, scene.world_from_local(node).unwrap());
        }
    }
    assert!(chains.is_empty(), "not in the hierarchy: {chains:?}");
}
