//! Updating the TLAS: after any sequence of updates it is valid, its boxes are tight, and the cost that it reports is
//! its SAH cost.

use glam::Vec3;
use proptest::prelude::*;
use ropewalk::accel::{RebuildReason, Tlas, TlasUpdate};
use ropewalk::device::layout::{NONE, Node, PrimitiveRange};
use ropewalk::math::Aabb;

use super::tlas::{Built, any_box, build, cube};
use ropewalk_testkit::Random;

/// The nodes as an executor has them, which copies only the ranges marked as changed.
fn catch_up(copy: &mut Vec<Node>, built: &mut Built) -> usize {
    let nothing: Node = bytemuck::Zeroable::zeroed();
    copy.resize(built.nodes.len(), nothing);
    let dirty = built.nodes.take_dirty();
    for range in &dirty {
        copy[range.clone()].copy_from_slice(&built.nodes[range.clone()]);
    }
    dirty.iter().map(ExactSizeIterator::len).sum()
}

fn same(a: &[Node], b: &[Node]) -> bool {
    bytemuck::cast_slice::<_, u8>(a) == bytemuck::cast_slice::<_, u8>(b)
}

/// Checks all invariants between two updates.
fn check(built: &Built, boxes: &[Aabb]) {
    assert_eq!(built.validate(boxes), Ok(()));
    let expected: Vec<u32> = (0..boxes.len() as u32).filter(|&slot| !boxes[slot as usize].is_empty()).collect();
    assert_eq!(built.slots(), expected);
    assert_eq!(built.tlas.instance_count(), expected.len());
    check_tight(built, boxes);
    let (cost, measured) = (built.tlas.sah_cost(&built.nodes), built.tlas.stats(&built.nodes));
    let measured_cost = measured.sah_cost;
    assert!((cost - measured_cost).abs() <= 1e-6 * cost, "{cost} is not {measured_cost}");
    assert!(measured.depth <= Tlas::MAX_DEPTH);
}

/// Checks that each leaf has the box that a new TLAS would give it, and each inner node the box around its children.
fn check_tight(built: &Built, boxes: &[Aabb]) {
    let fresh = build(boxes);
    let mut expected = vec![None; boxes.len()];
    for node in fresh.nodes.iter().filter(|n| n.primitives != PrimitiveRange::INNER) {
        expected[node.primitives.first_primitive() as usize] = Some((node.min, node.max));
    }
    let nodes = &built.nodes;
    for (i, node) in nodes.iter().enumerate() {
        if node.primitives != PrimitiveRange::INNER {
            assert_eq!(Some((node.min, node.max)), expected[node.primitives.first_primitive() as usize], "leaf {i}");
        } else if node.escape_index as usize != i + 1 {
            let children = [nodes[i + 1], nodes[nodes[i + 1].escape_index as usize]];
            let used = children.iter().filter(|child| !child.is_empty());
            let around = Aabb::from_points(used.flat_map(|c| [Vec3::from(c.min), Vec3::from(c.max)]));
            if around.is_empty() {
                assert!(node.is_empty(), "{i}");
            } else {
                assert_eq!((Vec3::from(node.min), Vec3::from(node.max)), (around.min, around.max), "inner node {i}");
            }
        }
    }
}

/// The instances whose boxes a ray enters, traversed as the kernel does it, and the number of nodes fetched.
fn walk(nodes: &[Node], origin: Vec3, direction: Vec3) -> (Vec<u32>, usize) {
    let (mut entered, mut fetched, mut index) = (Vec::new(), 0, 0);
    while index != NONE && !nodes.is_empty() {
        let node = nodes[index as usize];
        fetched += 1;
        if !meets(&node, origin, direction) {
            index = node.escape_index;
        } else if node.primitives == PrimitiveRange::INNER {
            index += 1;
        } else {
            entered.push(node.primitives.first_primitive());
            index = node.escape_index;
        }
    }
    entered.sort_unstable();
    (entered, fetched)
}

fn meets(node: &Node, origin: Vec3, direction: Vec3) -> bool {
    let a = (Vec3::from(node.min) - origin) / direction;
    let b = (Vec3::from(node.max) - origin) / direction;
    a.min(b).max_element().max(0.0) <= a.max(b).min_element()
}

/// Checks that rays enter each instance whose box they meet once, and no other. One ray goes along the diagonal towards
/// the boxes of unused nodes.
fn check_rays(built: &Built, random: &mut Random) {
    let leaves: Vec<Node> = built.nodes.iter().filter(|n| n.primitives != PrimitiveRange::INNER).copied().collect();
    for i in 0..8 {
        let (origin, direction) =
            if i == 0 { (Vec3::ZERO, Vec3::splat(16.0)) } else { (random.in_cube() * 2.0, random.in_cube()) };
        let met =
            leaves.iter().filter(|leaf| meets(leaf, origin, direction)).map(|leaf| leaf.primitives.first_primitive());
        let mut met: Vec<u32> = met.collect();
        met.sort_unstable();
        assert_eq!(walk(&built.nodes, origin, direction).0, met);
    }
}

/// One update, of several instances at once.
#[derive(Clone, Debug)]
enum Edit {
    /// Each of these instances (modulo their number) gets this box.
    Set(Vec<(usize, Aabb)>),
    /// All instances move a little.
    MoveAll(u64),
    Remove(Vec<usize>),
    /// Removed instances are added again.
    Restore(Vec<usize>),
    /// New instances at the end.
    Append(Vec<Aabb>),
    /// The last instances are removed.
    Truncate(usize),
}

fn edits(bounds: impl Strategy<Value = Aabb> + Clone + 'static) -> impl Strategy<Value = Vec<Edit>> {
    let slots = || prop::collection::vec(0usize..1000, 1..12);
    let edit = prop_oneof![
        6 => prop::collection::vec((0usize..1000, bounds.clone()), 1..6).prop_map(Edit::Set),
        1 => any::<u64>().prop_map(Edit::MoveAll),
        3 => slots().prop_map(Edit::Remove),
        3 => slots().prop_map(Edit::Restore),
        2 => prop::collection::vec(bounds, 1..6).prop_map(Edit::Append),
        1 => (1usize..4).prop_map(Edit::Truncate),
    ];
    prop::collection::vec(edit, 1..60)
}

fn small_box() -> impl Strategy<Value = Aabb> + Clone {
    (-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0, 0.0f32..0.1).prop_map(|(x, y, z, half)| cube(Vec3::new(x, y, z), half))
}

/// The expected state: the box of each instance, and which instances are hidden.
struct Model {
    boxes: Vec<Aabb>,
    hidden: Vec<Aabb>,
}

impl Model {
    /// Applies the update and returns the instances that may have changed.
    fn apply(&mut self, edit: &Edit) -> Vec<u32> {
        let count = self.boxes.len();
        let of = |i: &usize| i % count.max(1);
        match edit {
            _ if count == 0 && !matches!(edit, Edit::Append(_)) => Vec::new(),
            Edit::Set(sets) => {
                sets.iter().for_each(|(i, b)| self.boxes[of(i)] = *b);
                sets.iter().map(|(i, _)| of(i) as u32).collect()
            }
            Edit::MoveAll(seed) => {
                let mut random = Random::new(*seed);
                for b in self.boxes.iter_mut().filter(|b| !b.is_empty()) {
                    let by = random.in_cube() * 0.05;
                    *b = Aabb { min: b.min + by, max: b.max + by };
                }
                (0..count as u32).rev().collect()
            }
            Edit::Remove(slots) => {
                for i in slots.iter().map(of) {
                    if !self.boxes[i].is_empty() {
                        self.hidden[i] = std::mem::replace(&mut self.boxes[i], Aabb::EMPTY);
                    }
                }
                slots.iter().map(|i| of(i) as u32).collect()
            }
            Edit::Restore(slots) => {
                for i in slots.iter().map(of) {
                    if self.boxes[i].is_empty() {
                        self.boxes[i] = self.hidden[i];
                    }
                }
                slots.iter().map(|i| of(i) as u32).collect()
            }
            Edit::Append(boxes) => {
                self.boxes.extend(boxes);
                self.hidden.extend(boxes);
                (count as u32..self.boxes.len() as u32).collect()
            }
            Edit::Truncate(by) => {
                let left = count.saturating_sub(*by);
                self.boxes.truncate(left);
                self.hidden.truncate(left);
                (left as u32..count as u32).collect()
            }
        }
    }
}

fn check_edits(boxes: Vec<Aabb>, edits: &[Edit], rays: bool) {
    let mut built = build(&boxes);
    let (mut copy, mut random) = (Vec::new(), Random::new(1));
    catch_up(&mut copy, &mut built);
    let mut model = Model { hidden: boxes.clone(), boxes };
    for edit in edits {
        let changed = model.apply(edit);
        let before = built.nodes.to_vec();
        let update = built.update(&model.boxes, &changed);
        check(&built, &model.boxes);
        assert_eq!(update == TlasUpdate::Kept, same(&before, &built.nodes), "{update:?}");
        catch_up(&mut copy, &mut built);
        assert!(same(&copy, &built.nodes), "{update:?} did not mark all that it changed");
        if rays {
            check_rays(&built, &mut random);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn after_any_updates(boxes in prop::collection::vec(small_box(), 0..200), edits in edits(small_box())) {
        check_edits(boxes, &edits, true);
    }

    #[test]
    fn after_updates_with_boxes_of_any_size(boxes in prop::collection::vec(any_box(), 0..60), edits in edits(any_box().boxed())) {
        check_edits(boxes, &edits, false);
    }
}

fn field(count: usize) -> Vec<Aabb> {
    let mut random = Random::new(3);
    (0..count).map(|_| cube(random.in_cube(), 0.01)).collect()
}

/// The instances whose boxes differ between `before` and `after`.
fn move_by(boxes: &mut [Aabb], slots: impl IntoIterator<Item = u32>, by: Vec3) -> Vec<u32> {
    let slots: Vec<u32> = slots.into_iter().collect();
    for &slot in &slots {
        let b = &mut boxes[slot as usize];
        *b = Aabb { min: b.min + by, max: b.max + by };
    }
    slots
}

#[test]
fn one_moved_instance_changes_its_leaf_and_few_others() {
    let mut boxes = field(20_000);
    let mut built = build(&boxes);
    let mut copy = Vec::new();
    catch_up(&mut copy, &mut built);
    for slot in (0..20_000).step_by(499) {
        let changed = move_by(&mut boxes, [slot], Vec3::splat(0.001));
        let TlasUpdate::Patched { instances: 1, nodes } = built.update(&boxes, &changed) else { panic!() };
        assert!(nodes <= 25, "{nodes}");
        assert_eq!(catch_up(&mut copy, &mut built), nodes);
    }
    check(&built, &boxes);
    assert_eq!(built.update(&boxes, &[1, 2, 3, 4, 19_999, 40_000]), TlasUpdate::Kept);
    assert_eq!(catch_up(&mut copy, &mut built), 0);
}

/// In each round half of the instances are hidden; in one of the rounds the instance of the last node is among them.
#[test]
fn half_of_the_instances_go_and_come_back() {
    for remainder in 0..2 {
        let mut boxes = field(300);
        let all = boxes.clone();
        let mut built = build(&boxes);
        let slots: Vec<u32> = (0..300).filter(|slot| slot % 2 == remainder).collect();
        slots.iter().for_each(|&slot| boxes[slot as usize] = Aabb::EMPTY);
        assert_eq!(built.update(&boxes, &slots), TlasUpdate::Refitted { instances: slots.len() });
        check(&built, &boxes);
        assert_eq!(built.update(&all, &slots), TlasUpdate::Refitted { instances: slots.len() });
        check(&built, &all);
    }
}

#[test]
fn many_moved_instances_refit() {
    let mut boxes = field(50_000);
    let mut built = build(&boxes);
    let mut copy = Vec::new();
    catch_up(&mut copy, &mut built);
    let changed = move_by(&mut boxes, (0..50_000).step_by(3), Vec3::splat(0.0005));
    assert_eq!(built.update(&boxes, &changed), TlasUpdate::Refitted { instances: changed.len() });
    catch_up(&mut copy, &mut built);
    assert!(same(&copy, &built.nodes));
    check(&built, &boxes);

    // One refit gives the same nodes as a patch for each instance.
    let mut patched = build(&field(50_000));
    for slots in changed.chunks(100) {
        assert!(matches!(patched.update(&boxes, slots), TlasUpdate::Patched { .. }));
    }
    assert!(same(&patched.nodes, &built.nodes));
}

#[test]
fn a_cost_that_grows_rebuilds() {
    let mut boxes = field(2000);
    let mut built = build(&boxes);
    let mut random = Random::new(9);
    let (mut rebuilt, mut dearest) = (0, 0.0f64);
    for _ in 0..2000 {
        let slot = random.index(boxes.len());
        boxes[slot] = cube(random.in_cube(), 0.01);
        match built.update(&boxes, &[slot as u32]) {
            TlasUpdate::Rebuilt(reason) => {
                assert_eq!(reason, RebuildReason::CostGrown);
                rebuilt += 1;
            }
            update => assert!(matches!(update, TlasUpdate::Patched { instances: 1, .. }), "{update:?}"),
        }
        dearest = dearest.max(built.tlas.sah_cost(&built.nodes) / build(&boxes).tlas.sah_cost(&build(&boxes).nodes));
    }
    check(&built, &boxes);
    assert!(rebuilt > 3, "{rebuilt} rebuilds");
    assert!(dearest < 1.7, "{dearest} times the cost of a new one");
}

#[test]
fn one_that_flies_off_is_noticed_and_rebuilt_once() {
    let mut boxes = field(5000);
    let mut built = build(&boxes);
    let mut rebuilt = 0;
    for _ in 0..1000 {
        let changed = move_by(&mut boxes, [77], Vec3::X);
        rebuilt += usize::from(matches!(built.update(&boxes, &changed), TlasUpdate::Rebuilt(RebuildReason::CostGrown)));
    }
    assert!((1..=2).contains(&rebuilt), "{rebuilt}");
    let fresh = build(&boxes);
    let (cost, fresh_cost) = (built.tlas.sah_cost(&built.nodes), fresh.tlas.sah_cost(&fresh.nodes));
    assert!(cost <= 1.01 * fresh_cost, "{cost}, {fresh_cost} when built anew");
}

#[test]
fn what_is_hidden_and_shown_again_is_where_it_was() {
    let boxes = field(3000);
    let mut built = build(&boxes);
    let before = built.nodes.to_vec();
    let group: Vec<u32> = (100..900).collect();
    let mut hidden = boxes.clone();
    group.iter().for_each(|&slot| hidden[slot as usize] = Aabb::EMPTY);
    for _ in 0..3 {
        for (boxes, count) in [(&hidden, 2200), (&boxes, 3000)] {
            assert!(matches!(built.update(boxes, &group), TlasUpdate::Refitted { instances: 800 }));
            check(&built, boxes);
            assert_eq!(built.tlas.instance_count(), count);
        }
        assert!(same(&built.nodes, &before));
    }
}

#[test]
fn instances_come_without_a_rebuild_once_there_is_room() {
    let mut boxes = field(6400);
    let mut built = build(&boxes);
    let mut random = Random::new(4);
    let mut grow = |built: &mut Built, boxes: &mut Vec<Aabb>| {
        boxes.push(cube(random.in_cube(), 0.01));
        built.update(boxes, &[boxes.len() as u32 - 1])
    };
    // A new TLAS has no spare nodes: the first insertion rebuilds it with some.
    assert_eq!(built.nodes.len(), 2 * boxes.len() - 1);
    assert_eq!(grow(&mut built, &mut boxes), TlasUpdate::Rebuilt(RebuildReason::NoUnusedLeaf));
    for _ in 0..100 {
        let update = grow(&mut built, &mut boxes);
        assert!(matches!(update, TlasUpdate::Patched { instances: 1, .. }), "{update:?}");
        check(&built, &boxes);
        check_rays(&built, &mut Random::new(8));
    }
    assert_eq!(grow(&mut built, &mut boxes), TlasUpdate::Rebuilt(RebuildReason::NoUnusedLeaf));
    check(&built, &boxes);
}

#[test]
fn instances_go_without_a_rebuild_until_half_are_gone() {
    // Removal from the end of the array, from its start, and in random order.
    let orders: [fn(&mut Vec<u32>); 3] = [|_| {}, |order| order.reverse(), |order| order.sort_unstable()];
    for order in orders {
        let mut boxes = field(500);
        let mut built = build(&boxes);
        let leaves = built.nodes.iter().rev().filter(|n| n.primitives != PrimitiveRange::INNER);
        let mut slots: Vec<u32> = leaves.map(|n| n.primitives.first_primitive()).collect();
        order(&mut slots);
        for (gone, slot) in (1..).zip(slots) {
            boxes[slot as usize] = Aabb::EMPTY;
            let update = built.update(&boxes, &[slot]);
            match gone {
                251 | 376 => assert_eq!(update, TlasUpdate::Rebuilt(RebuildReason::Sparse)),
                ..=300 => assert!(matches!(update, TlasUpdate::Patched { instances: 1, .. }), "{gone}: {update:?}"),
                _ => {}
            }
            check(&built, &boxes);
            check_rays(&built, &mut Random::new(gone));
        }
        assert_eq!(built.nodes.len(), 0);
    }
}

#[test]
fn a_giant_leaves_no_trace_in_the_cost() {
    let mut boxes = field(300);
    let mut built = build(&boxes);
    let mut compared = 0;
    for i in 0..2000 {
        let old = boxes[i % 300];
        for bounds in [cube(Vec3::ZERO, 1e18), old] {
            boxes[i % 300] = bounds;
            built.update(&boxes, &[(i % 300) as u32]);
            let (cost, measured) = (built.tlas.sah_cost(&built.nodes), built.tlas.stats(&built.nodes).sah_cost);
            assert!((cost - measured).abs() <= 1e-6 * cost, "{cost} is not {measured}");
            compared += 1;
        }
    }
    assert_eq!(compared, 4000);
}

#[test]
fn the_last_leaf_can_go_while_many_others_move() {
    let mut boxes = field(200);
    let mut built = build(&boxes);
    while built.tlas.instance_count() > 110 {
        let last = built.nodes.last().unwrap().primitives.first_primitive();
        let changed = move_by(&mut boxes, 0..200, Vec3::splat(0.001));
        boxes[last as usize] = Aabb::EMPTY;
        assert!(matches!(built.update(&boxes, &changed), TlasUpdate::Refitted { .. }));
        check(&built, &boxes);
        check_rays(&built, &mut Random::new(2));
    }
}
