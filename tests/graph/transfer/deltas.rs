//! Deltas that do not fit are refused whole, whatever is wrong with them.

use std::cell::Cell;

use glam::{DVec3, Vec3};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::TestRunner;
use ropewalk::error::{DeltaFault, RootEdit};
use ropewalk::graph::CoreKind;
use ropewalk::graph::{Change, ChangeCursor, Changes, Delta, KeepTransform, NodeState, ObjectKey, ObjectState, Switch};
use ropewalk::{Camera, Core, CoreKey, Error, Geometry, Material, NodeKey, Scene, Transform};

use super::{content, sample};

/// A delta made from its serialized form, so that it can hold anything.
fn forge(objects: &[(ObjectKey, Option<ObjectState>)]) -> Delta {
    // The serialized form of a delta: its objects, without generations.
    let bytes = postcard::to_stdvec(&(objects, None::<()>)).unwrap();
    postcard::from_bytes(&bytes).unwrap()
}

/// The named states of a small scene: root, an arm with a hand, a geometry.
struct Small {
    scene: Scene,
    arm: ObjectKey,
    hand: ObjectKey,
}

impl Small {
    fn new() -> Self {
        let mut scene = Scene::new();
        let arm = scene.add(scene.root(), Transform::IDENTITY).unwrap();
        let geometry = scene.add_geometry(Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 2]])).unwrap();
        let material = scene.add_material(Material::default()).unwrap();
        let hand = scene.add(arm, Core::Geometry { geometry, material }).unwrap();
        Self { scene, arm: arm.into(), hand: hand.into() }
    }

    fn with(&self, object: ObjectKey, edit: impl FnOnce(&mut ObjectState)) -> (ObjectKey, Option<ObjectState>) {
        let mut state = self.scene.state(object).unwrap();
        edit(&mut state);
        (object, Some(state))
    }

    fn refuses(&mut self, objects: &[(ObjectKey, Option<ObjectState>)]) -> Error {
        let before = format!("{:?}", self.scene);
        let error = self.scene.apply(&forge(objects)).expect_err("it does not fit");
        assert_eq!(format!("{:?}", self.scene), before, "{error}");
        error
    }
}

fn node(state: &mut ObjectState) -> &mut NodeState {
    match state {
        ObjectState::Node(node) => node,
        other => panic!("{other:?} is not a node's"),
    }
}

fn key(object: ObjectKey) -> NodeKey {
    match object {
        ObjectKey::Node(key) => key,
        other => panic!("{other} is no node"),
    }
}

#[test]
fn each_misfit_is_named() {
    let mut small = Small::new();
    let (arm, hand, root) = (small.arm, small.hand, small.scene.root());
    let core = ObjectKey::from(small.scene.core_key(key(hand)).unwrap());
    let root_core = ObjectKey::from(small.scene.core_key(root).unwrap());

    let says = |error: Error, object: ObjectKey, cause: DeltaFault| assert_eq!(error, Error::Delta { object, cause });
    says(small.refuses(&[(arm, None)]), hand, DeltaFault::ChildStays);
    says(small.refuses(&[(core, None)]), core, DeltaFault::StillUsed);
    says(small.refuses(&[(arm, Some(ObjectState::Core(Core::Group)))]), arm, DeltaFault::KindMismatch);
    let twice = small.with(arm, |_| {});
    says(small.refuses(&[twice.clone(), twice]), arm, DeltaFault::DuplicateObject);
    let rootless = small.with(hand, |state| node(state).parent = None);
    says(small.refuses(&[rootless]), hand, DeltaFault::NoParent);
    let elsewhere = small.with(hand, |state| node(state).previous_sibling = Some(root));
    says(small.refuses(&[elsewhere]), hand, DeltaFault::SiblingElsewhere);
    let itself = small.with(hand, |state| node(state).previous_sibling = Some(key(hand)));
    says(small.refuses(&[itself]), hand, DeltaFault::SiblingCycle);

    let missing = small.with(hand, |state| node(state).core = CoreKey::default());
    assert!(matches!(small.refuses(&[missing]), Error::StaleKey { .. }));
    let cycle = small.with(arm, |state| node(state).parent = Some(key(hand)));
    assert_eq!(small.refuses(&[cycle]), Error::Cycle { node: key(arm), parent: key(hand) });
    // An instance of the root is always below the root: a cycle.
    for target in [root, key(arm), key(hand)] {
        let itself = small.with(core, |state| *state = ObjectState::Core(Core::Instance(target)));
        assert_eq!(small.refuses(&[itself]), Error::Cycle { node: target, parent: key(hand) });
    }
    assert!(matches!(small.refuses(&[(root.into(), None)]), Error::Root { attempt: RootEdit::Remove }));
    let light = small.with(root_core, |state| *state = ObjectState::Core(Core::Camera(Camera::default())));
    assert_eq!(small.refuses(&[light]), Error::Root { attempt: RootEdit::SetCore(CoreKind::Camera) });
    let moved = small.with(root.into(), |state| node(state).parent = Some(key(arm)));
    assert_eq!(small.refuses(&[moved]), Error::Root { attempt: RootEdit::Move });
    let bad = small.with(core, |state| *state = ObjectState::Core(Core::Transform(Transform::from_scale(DVec3::NAN))));
    assert!(matches!(small.refuses(&[bad]), Error::OutOfRange { .. }));

    // Two first children.
    let other = small.scene.add(root, Core::Group).unwrap();
    let first = small.with(other.into(), |state| node(state).previous_sibling = None);
    let same = small.with(arm, |_| {});
    says(small.refuses(&[same, first]), other.into(), DeltaFault::SiblingTwice);
    // Only one node claims to be the first child: it moves to the front.
    let first = small.with(other.into(), |state| node(state).previous_sibling = None);
    small.scene.apply(&forge(&[first])).unwrap();
    assert_eq!(small.scene.children(root).unwrap().collect::<Vec<_>>(), [other, key(arm)]);
    small.scene.validate().unwrap();
}

#[test]
fn forged_keys_allocate_nothing() {
    let mut small = Small::new();
    let state = small.scene.state(small.hand);
    let forged = |slot: u64, generation: u64| -> NodeKey { slotmap::KeyData::from_ffi(generation << 32 | slot).into() };
    for slot in [u64::from(u32::MAX) - 1, 1 << 31, 1 << 24] {
        assert!(matches!(small.refuses(&[(forged(slot, 1).into(), state.clone())]), Error::Limit { .. }));
    }
    assert!(matches!(small.refuses(&[(forged(0, 1).into(), state.clone())]), Error::Delta { .. }));
    assert!(matches!(small.refuses(&[(forged(u64::from(u32::MAX), 1).into(), state.clone())]), Error::Delta { .. }));
    // Two generations in one slot, one of which may live there.
    let two = [1, 3].map(|generation| {
        let key: CoreKey = slotmap::KeyData::from_ffi(generation << 32 | 9).into();
        (key.into(), Some(ObjectState::Core(Core::Group)))
    });
    assert!(matches!(small.refuses(&two), Error::Delta { .. }));
    // Another generation lives there.
    assert!(matches!(small.refuses(&[(forged(1, 3).into(), state)]), Error::Delta { .. }));
}

/// Which children a switch shows depends on their places: a mirror that loses the first shows the second.
#[test]
fn children_change_places() {
    let (mut scene, mut mirror, mut cursor) = (Scene::new(), Scene::new(), ChangeCursor::default());
    let switch = scene.add(scene.root(), Switch::One(0)).unwrap();
    let [first, second] = [0, 1].map(|_| scene.add(switch, Core::Group).unwrap());
    mirror.apply(&scene.delta_since(&mut cursor)).unwrap();
    let is_shown = |scene: &mut Scene, node: NodeKey| {
        let hierarchy = scene.hierarchy().unwrap();
        hierarchy.resolved()[hierarchy.entry(node).unwrap()].visible
    };
    assert!(is_shown(&mut mirror, first) && !is_shown(&mut mirror, second));
    let mut of_mirror = ChangeCursor::default();
    let _ = mirror.changes_since(&mut of_mirror);

    scene.remove(first).unwrap();
    mirror.apply(&scene.delta_since(&mut cursor)).unwrap();
    assert!(is_shown(&mut mirror, second));
    let Changes::Since(changes) = mirror.changes_since(&mut of_mirror) else { panic!("it has read before") };
    assert!(changes.contains(&(switch.into(), Change::CHILDREN)));
}

/// One delta reverses the order of a chain of 100,000 nodes, and another restores it.
#[test]
fn deep_and_wide() {
    const COUNT: usize = 100_000;
    let mut scene = Scene::new();
    scene.enable_undo();
    let mut chain = vec![scene.root()];
    for _ in 0..COUNT {
        chain.push(scene.add(*chain.last().unwrap(), Core::Group).unwrap());
    }
    scene.end_undo_group("a chain");
    let (mut mirror, mut cursor) = (Scene::new(), ChangeCursor::default());
    mirror.apply(&scene.delta_since(&mut cursor)).unwrap();
    for &node in &chain[1..] {
        scene.reparent(node, scene.root(), KeepTransform::Local).unwrap();
    }
    scene.end_undo_group("a comb");
    mirror.apply(&scene.delta_since(&mut cursor)).unwrap();
    assert!(content(&mirror) == content(&scene));
    for pair in chain[1..].windows(2) {
        scene.reparent(pair[0], pair[1], KeepTransform::Local).unwrap();
    }
    scene.end_undo_group("upside down");
    mirror.apply(&scene.delta_since(&mut cursor)).unwrap();
    assert!(content(&mirror) == content(&scene));
    for _ in 0..3 {
        scene.undo().unwrap();
        mirror.apply(&scene.delta_since(&mut cursor)).unwrap();
        assert!(content(&mirror) == content(&scene));
        scene.validate().unwrap();
    }
    assert_eq!(mirror.node_count(), 1);
}

/// A delta between two states of a scene, of which one entry is changed, dropped or swapped with another: if it is
/// accepted, the scene is valid; if it is refused, the scene is as before.
#[test]
fn damaged_deltas() {
    let scene = sample();
    let whole = content(&scene);
    let (applied, refused) = (Cell::new(0), Cell::new(0));
    let config = ProptestConfig { cases: 4000, failure_persistence: None, ..ProptestConfig::default() };
    let outcome = TestRunner::new(config).run(&(vec(damage(), 1..4), any::<bool>()), |(damages, onto_itself)| {
        let mut objects = whole.clone();
        damages.iter().for_each(|damage| damage.to(&mut objects));
        let mut target = Scene::new();
        if onto_itself {
            target.apply(&scene.snapshot()).unwrap();
        }
        target.enable_undo();
        let before = content(&target);
        match target.apply(&forge(&objects)) {
            Ok(()) => {
                applied.set(applied.get() + 1);
                let _ = target.hierarchy();
                target.validate().unwrap();
                target.undo().unwrap();
            }
            Err(_) => refused.set(refused.get() + 1),
        }
        assert_eq!(content(&target), before);
        target.validate().unwrap();
        Ok(())
    });
    outcome.unwrap_or_else(|failure| panic!("{failure}"));
    assert!(applied.get() > 200 && refused.get() > 200, "{applied:?} {refused:?}");
}

/// Damages a delta by means of two of its entries: one loses its state or takes over the other's, both states are
/// swapped, or entries are dropped.
#[derive(Clone, Debug)]
struct Damage(Index, Index, u8, bool);

fn damage() -> impl Strategy<Value = Damage> {
    (any::<Index>(), any::<Index>(), 0..5_u8, any::<bool>()).prop_map(|(a, b, kind, alike)| Damage(a, b, kind, alike))
}

impl Damage {
    fn to(&self, objects: &mut Vec<(ObjectKey, Option<ObjectState>)>) {
        let (a, b) = (self.0.index(objects.len()), self.1.index(objects.len()));
        let alike = std::mem::discriminant(&objects[a].0) == std::mem::discriminant(&objects[b].0);
        match self.2 {
            _ if alike != self.3 => {}
            0 => objects[a].1 = None,
            1 => objects[a].1 = objects[b].1.clone(),
            2 if objects.len() > 1 => drop(objects.remove(a)),
            2 => {}
            3 => {
                let (of_a, of_b) = (objects[a].1.take(), objects[b].1.take());
                (objects[a].1, objects[b].1) = (of_b, of_a);
            }
            _ => objects.truncate(a + 1),
        }
    }
}
