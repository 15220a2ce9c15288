//! Scenes that are very deep, very wide or very large: nothing overflows the stack, and edits cost what they change.

use std::time::Instant;

use glam::DVec3;
use ropewalk::{Changes, Core, NodeKey, Scene, Transform};

const STEP: DVec3 = DVec3::new(1.0, 0.0, 0.0);

#[test]
#[ignore = "prints times: cargo test --release --test graph_scale -- --ignored --nocapture"]
fn times_of_a_million_nodes() {
    let mut scene = Scene::new();
    let time = |what: &str, work: &mut dyn FnMut()| {
        let start = Instant::now();
        work();
        println!("{what:<44} {:>10.1} us", start.elapsed().as_secs_f64() * 1e6);
    };
    let mut movers = Vec::new();
    time("add 1,000,000 transform nodes", &mut || movers = humanoids(&mut scene));
    let mut cursor = scene.subscribe();
    assert_eq!(scene.changes_since(&mut cursor), Changes::Everything);
    time("hierarchy from nothing", &mut || assert!(!scene.hierarchy().nodes().is_empty()));
    time("hierarchy, nothing changed", &mut || assert!(!scene.hierarchy().nodes().is_empty()));

    let mut offset = 0.0;
    for (what, stride) in [("1 leaf", movers.len()), ("1 %", 100), ("all", 1)] {
        for _ in 0..5 {
            offset += 1.0;
            let transform = Transform::from_translation(STEP * offset);
            time(&format!("set_local, {what}"), &mut || {
                for &node in movers.iter().rev().step_by(stride) {
                    scene.set_local(node, transform).unwrap();
                }
            });
            time(&format!("hierarchy after {what}"), &mut || assert!(!scene.hierarchy().nodes().is_empty()));
            time(&format!("read the log after {what}"), &mut || {
                assert_ne!(scene.changes_since(&mut cursor), Changes::Everything)
            });
        }
    }
    scene.add(scene.root(), Core::Group).unwrap();
    time("hierarchy after a structural edit", &mut || assert!(!scene.hierarchy().nodes().is_empty()));
    time("world_bounds of the root", &mut || assert!(scene.world_bounds(scene.root()).unwrap().is_empty()));
    time("remove everything", &mut || {
        for &node in movers.iter().step_by(100) {
            scene.remove(node).unwrap();
        }
    });
}

/// 10,000 trees of 100 transform nodes, in preorder.
fn humanoids(scene: &mut Scene) -> Vec<NodeKey> {
    let mut nodes: Vec<NodeKey> = Vec::with_capacity(1_000_000);
    for i in 0..1_000_000 {
        let parent = if i % 100 == 0 { scene.root() } else { nodes[i - 1 - (i % 100 - 1) % 7] };
        nodes.push(scene.add(parent, Transform::from_translation(STEP)).unwrap());
    }
    nodes
}
