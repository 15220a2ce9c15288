//! Visiting and finding nodes: compared with recursion on small trees, and without overflowing the stack on a deep one.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use std::collections::BTreeSet;
use std::ops::ControlFlow::{self, Break, Continue};

use glam::Vec3;
use proptest::prelude::*;
use ropewalk::graph::{Descend, Visitor};
use ropewalk::{Core, Error, Geometry, Material, NodeKey, Scene, Transform};

/// Records the calls of a visitor; skips the subtrees of nodes of one name, and breaks off after some calls.
struct Recorder<'a> {
    scene: &'a Scene,
    calls: Vec<(bool, NodeKey)>,
    last: usize,
}

impl Recorder<'_> {
    fn record(&mut self, enter: bool, node: NodeKey) -> ControlFlow<usize> {
        self.calls.push((enter, node));
        if self.calls.len() == self.last { Break(self.last) } else { Continue(()) }
    }
}

impl Visitor for &mut Recorder<'_> {
    type Break = usize;

    fn enter(&mut self, node: NodeKey) -> ControlFlow<usize, Descend> {
        self.record(true, node)?;
        Continue(if self.scene.name(node).unwrap() == "a" { Descend::Skip } else { Descend::Into })
    }

    fn leave(&mut self, node: NodeKey) -> ControlFlow<usize> {
        self.record(false, node)
    }
}

/// The calls that a recorder that never breaks off must record.
fn expected(scene: &Scene, node: NodeKey, calls: &mut Vec<(bool, NodeKey)>) {
    calls.push((true, node));
    if scene.name(node).unwrap() != "a" {
        scene.children(node).unwrap().for_each(|child| expected(scene, child, calls));
    }
    calls.push((false, node));
}

/// Every node below `node`, with the names that lead there.
fn paths(scene: &Scene, node: NodeKey, names: &[String], found: &mut Vec<(Vec<String>, NodeKey)>) {
    for child in scene.children(node).unwrap() {
        let names = [names, &[scene.name(child).unwrap().to_owned()]].concat();
        found.push((names.clone(), child));
        paths(scene, child, &names, found);
    }
}

/// A tree of nodes named "a" to "c": each node's parent, and its name.
fn tree() -> impl Strategy<Value = Vec<(prop::sample::Index, u8)>> {
    prop::collection::vec((any::<prop::sample::Index>(), 0..3u8), 0..30)
}

fn grow(tree: &[(prop::sample::Index, u8)]) -> (Scene, Vec<NodeKey>) {
    let mut scene = Scene::new();
    let mut nodes = vec![scene.root()];
    for (parent, name) in tree {
        let node = scene.add(*parent.get(&nodes), Transform::IDENTITY).unwrap();
        scene.set_name(node, ["a", "b", "c"][usize::from(*name)]).unwrap();
        nodes.push(node);
    }
    (scene, nodes)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn visitors_enter_skip_leave_and_break_off(tree in tree(), top: prop::sample::Index, last in 1..70usize) {
        let (scene, nodes) = grow(&tree);
        let top = *top.get(&nodes);
        let mut whole = Vec::new();
        expected(&scene, top, &mut whole);
        let mut recorder = Recorder { scene: &scene, calls: Vec::new(), last };
        let end = scene.visit(top, &mut recorder).unwrap();
        prop_assert_eq!(end, if last <= whole.len() { Break(last) } else { Continue(()) });
        prop_assert_eq!(&recorder.calls, &whole[..last.min(whole.len())]);
    }

    #[test]
    fn paths_lead_to_the_first_node_of_their_names(tree in tree(), top: prop::sample::Index) {
        let (scene, nodes) = grow(&tree);
        let top = *top.get(&nodes);
        let mut all = Vec::new();
        paths(&scene, top, &[], &mut all);
        for (names, node) in &all {
            // `all` is in preorder.
            let first = all.iter().find(|(other, _)| other == names).unwrap().1;
            prop_assert_eq!(scene.find_path(top, names).unwrap(), Some(first));
            if top == scene.root() {
                prop_assert_eq!(scene.path_of(*node).unwrap(), names.iter().map(String::as_str).collect::<Vec<_>>());
            }
        }
        let known: BTreeSet<_> = all.iter().map(|(names, _)| names.clone()).collect();
        for names in [["a", "b", "c"], ["b", "b", "b"], ["a", "a", "d"]] {
            let names = names.map(str::to_owned).to_vec();
            prop_assert_eq!(scene.find_path(top, &names).unwrap().is_some(), known.contains(&names));
        }
        prop_assert_eq!(scene.find_path(top, [""; 0]).unwrap(), Some(top));
        let named: Vec<_> = scene.subtree(scene.root()).unwrap().filter(|&n| scene.name(n).unwrap() == "b").collect();
        prop_assert_eq!(scene.find("b"), named.first().copied());
        prop_assert_eq!(scene.find_all("b").collect::<Vec<_>>(), named);
    }
}

#[test]
fn depth_is_no_limit() {
    const DEPTH: usize = 100_000;
    let mut scene = Scene::new();
    let mut node = scene.root();
    for _ in 0..DEPTH {
        node = scene.add(node, Transform::IDENTITY).unwrap();
        scene.set_name(node, "link").unwrap();
    }
    let mut recorder = Recorder { scene: &scene, calls: Vec::new(), last: usize::MAX };
    assert_eq!(scene.visit(scene.root(), &mut recorder).unwrap(), Continue(()));
    assert_eq!(recorder.calls.len(), 2 * (DEPTH + 1));
    let path = scene.path_of(node).unwrap();
    assert_eq!(path.len(), DEPTH);
    assert_eq!(scene.find_path(scene.root(), &path).unwrap(), Some(node));
}

#[test]
fn geometries_and_materials_know_their_nodes() {
    let mut scene = Scene::new();
    let root = scene.root();
    let [shown, other] =
        [0, 1].map(|_| scene.add_geometry(Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 2]])).unwrap());
    let [red, blue] = [Vec3::X, Vec3::Z].map(|color| scene.add_material(Material::diffuse(color)).unwrap());
    let first = scene.add(root, Core::Geometry { geometry: shown, material: red }).unwrap();
    let shared = scene.core_key(first).unwrap();
    let second = scene.add(root, shared).unwrap();
    let third = scene.add(root, Core::Geometry { geometry: shown, material: blue }).unwrap();
    let users: BTreeSet<_> = scene.geometry_users(shown).unwrap().collect();
    assert_eq!(users, BTreeSet::from([first, second, third]));
    assert_eq!(scene.geometry_users(other).unwrap().count(), 0);
    let users: BTreeSet<_> = scene.material_users(red).unwrap().collect();
    assert_eq!(users, BTreeSet::from([first, second]));
    assert_eq!(scene.material_users(blue).unwrap().collect::<Vec<_>>(), [third]);

    scene.remove_unused();
    assert!(matches!(scene.geometry_users(other).map(Iterator::count), Err(Error::StaleKey { .. })));
    scene.remove(third).unwrap();
    assert!(matches!(scene.path_of(third), Err(Error::StaleKey { .. })));
    assert!(matches!(scene.find_path(third, ["a"]), Err(Error::StaleKey { .. })));
    let visited: Result<ControlFlow<()>, _> = scene.visit(third, |_| Continue(Descend::Into));
    assert!(matches!(visited, Err(Error::StaleKey { .. })));
}
