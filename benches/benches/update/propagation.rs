//! World transforms after some nodes moved: Ropewalk, `bevy_transform` and a tree in a slotmap, visited from the top.

use std::time::{Duration, Instant};

use bevy_app::{App, PostUpdate, TaskPoolOptions, TaskPoolPlugin, TaskPoolThreadAssignmentPolicy};
use bevy_ecs::prelude::{ChildOf, Entity, QueryState};
use bevy_transform::TransformPlugin;
use bevy_transform::components::{GlobalTransform, Transform as BevyTransform};
use glam::{DAffine3, DVec3};
use ropewalk::{Core, NodeKey, Scene, Transform};
use slotmap::{DefaultKey, SlotMap};

use crate::shape::Pose;

/// A contender: it keeps the world transforms of a tree.
pub trait Propagation {
    fn name(&self) -> &'static str;
    /// Sets the local transforms of these nodes.
    fn edit(&mut self, moves: &[(usize, Pose)]);
    /// Brings the world transforms up to date.
    fn propagate(&mut self);
    /// Where a node is, after [`propagate`](Self::propagate).
    fn world(&mut self, node: usize) -> DVec3;
}

/// Moves, and how long the edits and the propagation took.
pub fn run(contender: &mut dyn Propagation, moves: &[(usize, Pose)]) -> [Duration; 2] {
    let start = Instant::now();
    contender.edit(moves);
    let edited = start.elapsed();
    contender.propagate();
    [edited, start.elapsed() - edited]
}

/// One node for each pose.
pub struct Ropewalk {
    scene: Scene,
    nodes: Vec<NodeKey>,
}

impl Ropewalk {
    pub fn new(parents: &[Option<usize>], poses: &[Pose]) -> ropewalk::Result<Self> {
        let mut scene = Scene::new();
        let mut nodes: Vec<NodeKey> = Vec::with_capacity(parents.len());
        for (parent, pose) in parents.iter().zip(poses) {
            let parent = parent.map_or(scene.root(), |parent| nodes[parent]);
            nodes.push(scene.add(parent, Core::Transform(transform(pose)))?);
        }
        Ok(Self { scene, nodes })
    }

    pub fn scene(&mut self) -> &mut Scene {
        &mut self.scene
    }
}

/// The transform of a pose.
pub fn transform(pose: &Pose) -> Transform {
    Transform::Trs { translation: pose.translation, rotation: pose.rotation, scale: DVec3::ONE }
}

impl Propagation for Ropewalk {
    fn name(&self) -> &'static str {
        "ropewalk"
    }

    fn edit(&mut self, moves: &[(usize, Pose)]) {
        for (node, pose) in moves {
            self.scene.set_local(self.nodes[*node], transform(pose)).expect("the node is there");
        }
    }

    fn propagate(&mut self) {
        self.scene.hierarchy().expect("nothing is instanced");
    }

    fn world(&mut self, node: usize) -> DVec3 {
        self.scene.world_from_local(self.nodes[node]).expect("the node is there").translation
    }
}

/// An app with the task pools and the transform plugin of `DefaultPlugins`, of which one schedule runs.
pub struct Bevy {
    app: App,
    entities: Vec<Entity>,
    locals: QueryState<&'static mut BevyTransform>,
}

impl Bevy {
    pub fn new(parents: &[Option<usize>], poses: &[Pose]) -> Self {
        let mut app = App::new();
        // All cores compute, as they do for the others; by default half of four are kept for other work.
        let compute = TaskPoolThreadAssignmentPolicy {
            min_threads: std::thread::available_parallelism().map_or(1, usize::from),
            ..TaskPoolOptions::default().compute
        };
        let task_pool_options = TaskPoolOptions { compute, ..TaskPoolOptions::default() };
        app.add_plugins((TaskPoolPlugin { task_pool_options }, TransformPlugin));
        app.finish();
        app.cleanup();
        let world = app.world_mut();
        let mut entities: Vec<Entity> = Vec::with_capacity(parents.len());
        for (parent, pose) in parents.iter().zip(poses) {
            let mut entity = world.spawn(bevy_transform(pose));
            if let Some(parent) = parent {
                entity.insert(ChildOf(entities[*parent]));
            }
            entities.push(entity.id());
        }
        let locals = world.query();
        Self { app, entities, locals }
    }
}

fn bevy_transform(pose: &Pose) -> BevyTransform {
    BevyTransform {
        translation: pose.translation.as_vec3().to_array().into(),
        rotation: bevy_math::Quat::from_array(pose.rotation.as_quat().to_array()),
        ..BevyTransform::IDENTITY
    }
}

impl Propagation for Bevy {
    fn name(&self) -> &'static str {
        "bevy_transform"
    }

    fn edit(&mut self, moves: &[(usize, Pose)]) {
        let mut locals = self.locals.query_mut(self.app.world_mut());
        for (node, pose) in moves {
            *locals.get_mut(self.entities[*node]).expect("it has one") = bevy_transform(pose);
        }
    }

    fn propagate(&mut self) {
        self.app.world_mut().run_schedule(PostUpdate);
    }

    fn world(&mut self, node: usize) -> DVec3 {
        let world = self.app.world().get::<GlobalTransform>(self.entities[node]).expect("it has one");
        DVec3::from(world.translation().to_array().map(f64::from))
    }
}

/// Nodes in a slotmap; each has the keys of its children. All are visited, those that moved and all below are computed.
pub struct Plain {
    nodes: SlotMap<DefaultKey, PlainNode>,
    keys: Vec<DefaultKey>,
    tops: Vec<DefaultKey>,
}

struct PlainNode {
    children: Vec<DefaultKey>,
    local: DAffine3,
    world: DAffine3,
    is_dirty: bool,
}

impl Plain {
    pub fn new(parents: &[Option<usize>], poses: &[Pose]) -> Self {
        let (mut nodes, mut keys, mut tops) = (SlotMap::new(), Vec::with_capacity(parents.len()), Vec::new());
        for (parent, pose) in parents.iter().zip(poses) {
            let (local, world) = (affine(pose), DAffine3::IDENTITY);
            let key = nodes.insert(PlainNode { children: Vec::new(), local, world, is_dirty: true });
            match parent {
                Some(parent) => nodes[keys[*parent]].children.push(key),
                None => tops.push(key),
            }
            keys.push(key);
        }
        Self { nodes, keys, tops }
    }
}

fn affine(pose: &Pose) -> DAffine3 {
    DAffine3::from_rotation_translation(pose.rotation, pose.translation)
}

impl Propagation for Plain {
    fn name(&self) -> &'static str {
        "plain slotmap"
    }

    fn edit(&mut self, moves: &[(usize, Pose)]) {
        for (node, pose) in moves {
            let node = &mut self.nodes[self.keys[*node]];
            (node.local, node.is_dirty) = (affine(pose), true);
        }
    }

    fn propagate(&mut self) {
        // Recursion with an explicit stack: chains are deeper than a thread's stack allows.
        let mut stack: Vec<_> = self.tops.iter().map(|&top| (top, DAffine3::IDENTITY, false)).collect();
        while let Some((key, above, moved)) = stack.pop() {
            let node = &mut self.nodes[key];
            let moved = moved || std::mem::take(&mut node.is_dirty);
            if moved {
                node.world = above * node.local;
                node.is_dirty = false;
            }
            let world = node.world;
            stack.extend(node.children.iter().map(|&child| (child, world, moved)));
        }
    }

    fn world(&mut self, node: usize) -> DVec3 {
        self.nodes[self.keys[node]].world.translation
    }
}
