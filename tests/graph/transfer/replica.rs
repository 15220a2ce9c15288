//! A scene is edited on its thread while replicas on other threads follow it without waiting for each other.

use std::sync::mpsc::{Receiver, channel, sync_channel};
use std::thread;

use glam::DVec3;
use ropewalk::graph::{ChangeCursor, Delta, KeepTransform};
use ropewalk::{DeviceChoice, NodeKey, Renderer, RendererOptions, Scene, Transform, View};

use super::{content, sample};

const FRAMES: usize = 300;

/// Types that applications send or share between threads are `Send` and `Sync`.
const _: () = {
    const fn is_send_and_sync<T: Send + Sync>() {}
    is_send_and_sync::<Scene>();
    is_send_and_sync::<Delta>();
    is_send_and_sync::<ChangeCursor>();
};

/// Edits that keep an invariant: at the end of each frame as many nodes are named "even" as "odd".
fn edit(scene: &mut Scene, nodes: &mut Vec<NodeKey>, frame: usize) {
    for name in ["even", "odd"] {
        let parent = nodes[frame * 31 % nodes.len()];
        add(scene, parent, name, nodes);
    }
    let (a, b) = (nodes[frame * 17 % nodes.len()], nodes[frame * 13 % nodes.len()]);
    // Some of these edits fail, since they would close a cycle.
    let _ = scene.reparent(a, b, KeepTransform::Local);
    if frame.is_multiple_of(7) {
        // Removed nodes are replaced.
        let gone = nodes.swap_remove(1 + frame % (nodes.len() - 1));
        scene.remove(gone).unwrap();
        nodes.retain(|&node| scene.contains(node));
        let missing = named(scene, "odd") as isize - named(scene, "even") as isize;
        let name = if missing > 0 { "even" } else { "odd" };
        (0..missing.abs()).for_each(|_| add(scene, scene.root(), name, nodes));
    }
}

fn add(scene: &mut Scene, parent: NodeKey, name: &str, nodes: &mut Vec<NodeKey>) {
    let place = DVec3::splat(nodes.len() as f64);
    let node = scene.add(parent, Transform::from_translation(place)).unwrap();
    scene.set_name(node, name).unwrap();
    nodes.push(node);
}

fn named(scene: &Scene, name: &str) -> usize {
    scene.subtree(scene.root()).unwrap().filter(|&node| scene.name(node).unwrap() == name).count()
}

/// Applies the deltas that arrive, checks the invariant after each, and returns the final content.
fn follow(deltas: &Receiver<Delta>) -> (Scene, usize) {
    let (mut replica, mut frames) = (Scene::new(), 0);
    while let Ok(delta) = deltas.recv() {
        replica.apply(&delta).unwrap();
        assert_eq!(named(&replica, "even"), named(&replica, "odd"), "half a frame was seen");
        replica.hierarchy().unwrap();
        frames += 1;
    }
    (replica, frames)
}

#[test]
fn replicas_on_threads_see_whole_frames() {
    // One replica that the editor waits for, one that may lag, and four that join late.
    let mut scene = Scene::new();
    let mut nodes = vec![scene.root()];
    let mut followers = Vec::new();
    let (in_step, in_step_received) = sync_channel(0);
    let (lagging, lagging_received) = channel();
    let mut cursors = [ChangeCursor::default(), ChangeCursor::default()];
    followers.push(thread::spawn(move || follow(&in_step_received)));
    followers.push(thread::spawn(move || follow(&lagging_received)));
    let mut late = Vec::new();
    for frame in 0..FRAMES {
        edit(&mut scene, &mut nodes, frame);
        in_step.send(scene.delta_since(&mut cursors[0])).unwrap();
        if frame % 3 == 0 {
            lagging.send(scene.delta_since(&mut cursors[1])).unwrap();
        }
        if frame % 70 == 50 {
            let (sender, received) = channel();
            followers.push(thread::spawn(move || follow(&received)));
            late.push((sender, ChangeCursor::default()));
        }
        for (sender, cursor) in &mut late {
            sender.send(scene.delta_since(cursor)).unwrap();
        }
    }
    lagging.send(scene.delta_since(&mut cursors[1])).unwrap();
    drop((in_step, lagging, late));
    assert_eq!(followers.len(), 6);
    for follower in followers {
        let (replica, frames) = follower.join().unwrap();
        replica.validate().unwrap();
        assert!(frames > 1);
        assert!(content(&replica) == content(&scene));
    }
}

/// A replica renders what the scene rendered earlier, while the scene has already changed.
#[test]
fn a_replica_is_drawn_while_the_scene_is_edited() {
    let options = RendererOptions::default().with_device(DeviceChoice::Cpu);
    let mut scene = sample();
    let view = View::framing(&mut scene, 32, 24).unwrap();
    let expected = Renderer::new(&options).unwrap().render(&mut scene, &view).unwrap().image().unwrap().color.clone();

    let (deltas, received) = channel::<Delta>();
    let (go, gone) = channel();
    let drawing = thread::spawn(move || {
        let mut replica = Scene::new();
        replica.apply(&received.recv().unwrap()).unwrap();
        gone.recv().unwrap();
        let mut renderer = Renderer::new(&options).unwrap();
        let frame = renderer.render(&mut replica, &view).unwrap();
        frame.image().unwrap().color.clone()
    });
    deltas.send(scene.snapshot()).unwrap();
    let children: Vec<_> = scene.children(scene.root()).unwrap().collect();
    children.into_iter().for_each(|child| scene.remove(child).unwrap());
    go.send(()).unwrap();
    assert!(drawing.join().unwrap() == expected);
}
