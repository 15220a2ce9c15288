//! Instances that coincide: one stands for all in the TLAS, and queries still find each.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use std::collections::{BTreeMap, BTreeSet};

use glam::{DVec3, Vec3};
use ropewalk::accel::TlasUpdate;
use ropewalk::compile::Compiler;
use ropewalk::graph::NodePath;
use ropewalk::math::Bounds;
use ropewalk::query::{Overlap, Queries, Ray, Region};
use ropewalk::{Core, Geometry, GeometryKey, Material, MaterialKey, NodeKey, Scene, Transform};
use ropewalk_testkit::Random;

/// Triangles at few places on a line: each node is shown at its place, with its material and mask, or not at all.
struct Line {
    scene: Scene,
    geometry: GeometryKey,
    materials: [MaterialKey; 2],
    shown: BTreeMap<NodeKey, Content>,
}

/// What a node shows; nodes of equal content coincide.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Content {
    place: u32,
    material: usize,
    mask: u32,
    visible: bool,
}

impl Line {
    fn new() -> Self {
        let mut scene = Scene::new();
        let triangle = Geometry::new([Vec3::NEG_ONE, Vec3::new(1.0, -1.0, -1.0), Vec3::Y], [[0, 1, 2]]);
        let geometry = scene.add_geometry(triangle).unwrap();
        let materials = [(); 2].map(|()| scene.add_material(Material::default()).unwrap());
        // Hidden nodes keep the materials while nothing is shown with them.
        for material in materials {
            let keeper = scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
            scene.set_visible(keeper, false).unwrap();
        }
        Self { scene, geometry, materials, shown: BTreeMap::new() }
    }

    fn core(&self, material: usize) -> Core {
        Core::Geometry { geometry: self.geometry, material: self.materials[material] }
    }

    /// Adds a node, or changes one, so that it shows this.
    fn show(&mut self, node: Option<NodeKey>, content: Content) {
        let node = node.unwrap_or_else(|| {
            let place = self.scene.add(self.scene.root(), Transform::default()).unwrap();
            self.scene.add(place, self.core(0)).unwrap()
        });
        let place = self.scene.parent(node).unwrap().unwrap();
        let transform = Transform::from_translation(DVec3::X * (4.0 * f64::from(content.place)));
        self.scene.set_local(place, transform).unwrap();
        self.scene.assign_core(node, self.core(content.material)).unwrap();
        self.scene.set_mask(node, content.mask).unwrap();
        self.scene.set_visible(node, content.visible).unwrap();
        self.shown.insert(node, content);
    }

    fn remove(&mut self, node: NodeKey) {
        self.scene.remove(self.scene.parent(node).unwrap().unwrap()).unwrap();
        self.shown.remove(&node);
    }

    /// The nodes that are shown at a place to rays of a mask.
    fn at(&self, place: u32, ray_mask: u32) -> BTreeSet<NodeKey> {
        let is_shown = |content: &Content| content.visible && content.mask & ray_mask != 0;
        let here = self.shown.iter().filter(|(_, content)| is_shown(content) && content.place == place);
        here.map(|(&node, _)| node).collect()
    }

    /// How many contents are shown, and by how many nodes.
    fn counts(&self) -> (usize, usize) {
        let visible: Vec<Content> = self.shown.values().filter(|content| content.visible).copied().collect();
        (visible.iter().collect::<BTreeSet<_>>().len(), visible.len())
    }
}

fn nodes(paths: Vec<NodePath>) -> BTreeSet<NodeKey> {
    paths.into_iter().map(|path| path.node).collect()
}

/// Compares all queries by rays of a mask, at each place, with what is shown there.
fn check(line: &mut Line, compiler: &mut Compiler, ray_mask: u32) {
    let expected: Vec<BTreeSet<NodeKey>> = (0..4).map(|place| line.at(place, ray_mask)).collect();
    let queries = Queries::new(compiler, &mut line.scene).unwrap().with_ray_mask(ray_mask);
    for (place, expected) in (0..).zip(&expected) {
        let center = DVec3::X * (4.0 * f64::from(place));
        // 1. Rays: all are hit, and first the one that is nearest in the order of hits.
        let ray = Ray::new(center + DVec3::new(0.1, -0.3, 5.0), DVec3::NEG_Z);
        let all = queries.all_hits(&ray).unwrap();
        let hit: BTreeSet<NodeKey> = all.iter().map(|hit| hit.path.node).collect();
        assert_eq!((&hit, all.len()), (expected, expected.len()), "place {place}");
        assert_eq!(queries.closest_hit(&ray).unwrap(), all.first().cloned());
        // 2. Regions and points.
        let around = Bounds { min: center - 1.5, max: center + 1.5 };
        let region = Region::new_box(&around).unwrap();
        assert_eq!(nodes(queries.overlapping(&region, Overlap::Inside)), *expected, "place {place}");
        let in_box = queries.boxes_containing(center + DVec3::new(0.0, 0.0, -0.5)).unwrap();
        assert_eq!(nodes(in_box), *expected, "place {place}");
    }
}

#[test]
fn random_edits_show_every_instance_that_coincides() {
    let mut random = Random::new(11);
    let (mut merged, mut promoted) = (0, 0);
    for _ in 0..40 {
        let (mut line, mut compiler) = (Line::new(), Compiler::new());
        for step in 0..60 {
            let mut pick = |count: usize| (random.unsigned() * count as f32) as usize % count;
            let content = Content {
                place: pick(4) as u32,
                material: pick(8) / 7,
                mask: if pick(8) == 0 { 1 } else { u32::MAX },
                visible: pick(6) > 0,
            };
            let known: Vec<NodeKey> = line.shown.keys().copied().collect();
            match pick(4) {
                0 | 1 if known.len() < 40 => line.show(None, content),
                2 if known.len() > 2 => line.remove(known[pick(known.len())]),
                _ if !known.is_empty() => line.show(Some(known[pick(known.len())]), content),
                _ => line.show(None, content),
            }
            if step % 3 == 0 {
                let report = compiler.compile(&mut line.scene, DVec3::ZERO).unwrap();
                assert_eq!(report.instances, line.counts().1);
                merged += report.coincident_instances;
                promoted += usize::from(matches!(report.tlas, TlasUpdate::Patched { .. }));
                check(&mut line, &mut compiler, u32::MAX);
                check(&mut line, &mut compiler, 2);
                // Compiled from nothing, each content is there once.
                let report = Compiler::new().compile(&mut line.scene, DVec3::ZERO).unwrap();
                assert_eq!((report.instances - report.coincident_instances, report.instances), line.counts());
            }
        }
    }
    assert!(merged > 1000 && promoted > 100, "{merged} left out, {promoted} patches");
}

#[test]
fn a_ray_through_many_instances_that_coincide_tests_one() {
    let (mut line, mut compiler) = (Line::new(), Compiler::new());
    let content = Content { place: 0, material: 0, mask: 1, visible: true };
    (0..20_000).for_each(|_| line.show(None, content));
    let visited = |line: &mut Line, compiler: &mut Compiler| {
        let queries = Queries::new(compiler, &mut line.scene).unwrap();
        queries.closest_hit(&Ray::new(DVec3::new(0.1, -0.3, 5.0), DVec3::NEG_Z)).unwrap().unwrap();
        queries.visited_nodes()
    };
    assert!(visited(&mut line, &mut compiler) < 10);
    // All of them move.
    let known: Vec<NodeKey> = line.shown.keys().copied().collect();
    for node in known {
        let place = line.scene.parent(node).unwrap().unwrap();
        line.scene.set_local(place, Transform::from_translation(DVec3::Y * 0.25)).unwrap();
    }
    assert!(visited(&mut line, &mut compiler) < 10);
    assert_eq!(compiler.compile(&mut line.scene, DVec3::ZERO).unwrap().coincident_instances, 19_999);
}
