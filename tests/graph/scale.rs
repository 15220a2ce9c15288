//! Scenes that are very deep, very wide or very large: nothing overflows the stack, and edits cost what they change.

use glam::DVec3;
use ropewalk::graph::KeepTransform;
use ropewalk::{Error, NodeKey, Scene, Transform};

const STEP: DVec3 = DVec3::new(1.0, 0.0, 0.0);

#[test]
fn a_chain_of_100_000_transforms() {
    const DEPTH: usize = 100_000;
    let mut scene = Scene::new();
    let mut chain = vec![scene.root()];
    for depth in 0..DEPTH {
        chain.push(scene.add(chain[depth], Transform::from_translation(STEP)).unwrap());
    }
    let (top, middle, leaf) = (chain[1], chain[DEPTH / 2], chain[DEPTH]);
    assert_eq!(scene.world_from_local(leaf).unwrap().translation, STEP * DEPTH as f64);
    assert_eq!(scene.subtree(scene.root()).unwrap().last(), Some(leaf));
    assert_eq!(scene.ancestors(leaf).unwrap().count(), DEPTH);
    assert!(scene.world_bounds(top).unwrap().is_empty());
    assert_eq!(scene.hierarchy().unwrap().resolved()[DEPTH].world_from_local.translation, STEP * DEPTH as f64);
    scene.validate().unwrap();

    scene.set_local(top, Transform::from_translation(STEP * 2.0)).unwrap();
    assert_eq!(scene.hierarchy().unwrap().resolved()[DEPTH].world_from_local.translation, STEP * (DEPTH + 1) as f64);
    assert!(matches!(scene.reparent(top, leaf, KeepTransform::Local), Err(Error::Cycle { .. })));

    // The lower half is reparented to the root, then the upper half is removed.
    scene.reparent(middle, scene.root(), KeepTransform::World).unwrap();
    assert_eq!(scene.world_from_local(leaf).unwrap().translation, STEP * (DEPTH + 1) as f64);
    scene.remove(top).unwrap();
    assert_eq!(scene.node_count(), 1 + DEPTH - DEPTH / 2 + 1);
    scene.validate().unwrap();
    scene.remove(middle).unwrap();
    assert_eq!((scene.node_count(), scene.core_count()), (1, 1));
}

#[test]
fn a_parent_of_1_000_000_children() {
    const WIDTH: usize = 1_000_000;
    let mut scene = Scene::new();
    let first = scene.add(scene.root(), Transform::from_translation(STEP)).unwrap();
    let core = scene.core_key(first).unwrap();
    let children: Vec<NodeKey> =
        std::iter::once(first).chain((1..WIDTH).map(|_| scene.add(scene.root(), core).unwrap())).collect();
    assert!(scene.children(scene.root()).unwrap().eq(children.iter().copied()));
    assert_eq!(scene.hierarchy().unwrap().resolved().len(), WIDTH + 1);

    // All share one core, so all move.
    scene.set_local(children[WIDTH / 2], Transform::from_translation(STEP * 3.0)).unwrap();
    assert!(
        scene.hierarchy().unwrap().resolved()[1..]
            .iter()
            .all(|placed| placed.world_from_local.translation == STEP * 3.0)
    );
    scene.validate().unwrap();

    // A node in the middle of both lists, that of siblings and that of the core's users.
    for &child in children.iter().skip(1).step_by(2) {
        scene.remove(child).unwrap();
    }
    for &child in children.iter().step_by(4) {
        scene.reparent(child, children[2], KeepTransform::Local).unwrap();
    }
    scene.validate().unwrap();
    assert_eq!(scene.users(core).unwrap().count(), WIDTH / 2);
    assert_eq!(scene.children(children[2]).unwrap().count(), WIDTH / 4);
    for &child in children.iter().skip(2).step_by(4) {
        scene.remove(child).unwrap();
    }
    assert_eq!((scene.node_count(), scene.core_count()), (1, 1));
}

/// Hierarchies large enough for several threads: scattered moves, moves of whole branches, nodes added below newly
/// added nodes.
#[test]
fn scattered_edits_of_30_000_nodes() {
    let mut state = 1u32;
    let mut random = |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    let mut scene = Scene::new();
    let mut nodes = vec![scene.root()];
    let add = |scene: &mut Scene, nodes: &mut Vec<NodeKey>, parent: usize| {
        nodes.push(scene.add(nodes[parent], Transform::from_translation(STEP)).unwrap());
    };
    for count in 1..30_000 {
        // Many small subtrees below a few branches.
        let parent = if random(3) == 0 { random(count) } else { count - 1 - random(count.min(20)) };
        add(&mut scene, &mut nodes, parent);
    }
    scene.hierarchy().unwrap();
    let generation = scene.hierarchy().unwrap().generation();
    for round in 1..=12 {
        let moved = [1, 100, 3000, nodes.len()][round % 4];
        for i in 0..moved {
            let node = if moved == nodes.len() { i } else { random(nodes.len()) };
            let translation = DVec3::new(random(1000) as f64, random(1000) as f64, round as f64);
            if node > 0 {
                scene.set_local(nodes[node], Transform::from_translation(translation)).unwrap();
            }
        }
        // New nodes below old nodes and below new ones, some of them in a later update than their parent.
        for _ in 0..100 {
            let parent = if random(2) == 0 { nodes.len() - 1 } else { random(nodes.len()) };
            add(&mut scene, &mut nodes, parent);
            if random(2) == 0 {
                scene.hierarchy().unwrap();
            }
        }
        scene.set_local(nodes[nodes.len() - 100 * round.min(3)], Transform::from_translation(STEP)).unwrap();
        scene.hierarchy().unwrap();
        scene.validate().unwrap();
    }
    assert_eq!(scene.hierarchy().unwrap().generation(), generation, "appended ranges were to be tested");
}
