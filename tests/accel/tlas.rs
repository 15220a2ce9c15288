//! Building the TLAS: each leaf holds one instance, whatever the boxes.

use glam::Vec3;
use proptest::prelude::*;
use ropewalk::accel::{BvhError, RebuildReason, Tlas, TlasUpdate};
use ropewalk::device::DeviceBuffer;
use ropewalk::device::layout::{NONE, Node, PrimitiveRange};
use ropewalk::math::Aabb;

/// A TLAS and its nodes.
#[derive(Default)]
pub(crate) struct Built {
    pub(crate) tlas: Tlas,
    pub(crate) nodes: DeviceBuffer<Node>,
}

pub(crate) fn build(boxes: &[Aabb]) -> Built {
    let mut built = Built::default();
    built.tlas.build(&mut built.nodes, boxes);
    built
}

impl Built {
    pub(crate) fn update(&mut self, boxes: &[Aabb], changed: &[u32]) -> TlasUpdate {
        self.tlas.update(&mut self.nodes, boxes, changed)
    }

    pub(crate) fn validate(&self, boxes: &[Aabb]) -> Result<(), BvhError> {
        self.tlas.validate(&self.nodes, boxes)
    }

    /// The instances in the leaves, in ascending order.
    pub(crate) fn slots(&self) -> Vec<u32> {
        let leaves = self.nodes.iter().filter(|n| n.primitives != PrimitiveRange::INNER);
        let mut slots: Vec<u32> = leaves.map(|n| n.primitives.first_primitive()).collect();
        slots.sort_unstable();
        slots
    }
}

pub(crate) fn cube(center: Vec3, half: f32) -> Aabb {
    Aabb { min: center - half, max: center + half }
}

#[test]
fn nothing_gives_no_nodes() {
    for boxes in [&[][..], &[Aabb::EMPTY; 3]] {
        let mut built = build(boxes);
        assert_eq!(*built.nodes, []);
        assert_eq!((built.tlas.instance_count(), built.tlas.stats(&built.nodes).node_count), (0, 0));
        assert_eq!(built.update(boxes, &[0, 1, 2]), TlasUpdate::Kept);
        assert_eq!(built.tlas.sah_cost(&built.nodes), 0.0);
    }
}

#[test]
fn one_instance_is_one_leaf() {
    let boxes = [Aabb::EMPTY, cube(Vec3::ONE, 0.0)];
    let built = build(&boxes);
    assert_eq!(built.nodes.len(), 1);
    assert_eq!((built.nodes[0].primitives, built.nodes[0].escape_index), (PrimitiveRange::leaf(1, 1), NONE));
    assert_eq!(built.tlas.sah_cost(&built.nodes), 2.0);
}

#[test]
fn boxes_that_cannot_be_hit_are_left_out_and_infinite_ones_cut() {
    let nan = Aabb { min: Vec3::ZERO, max: Vec3::new(1.0, f32::NAN, 1.0) };
    let everything = Aabb { min: Vec3::NEG_INFINITY, max: Vec3::INFINITY };
    let far = Aabb { min: Vec3::INFINITY, max: Vec3::INFINITY };
    let boxes = [cube(Vec3::X, 1.0), Aabb::EMPTY, nan, everything, cube(Vec3::Y, 0.0), far];
    let built = build(&boxes);
    assert_eq!(built.slots(), [0, 3, 4, 5]);
    assert!(built.nodes.iter().all(|n| n.min.iter().chain(&n.max).all(|c| c.is_finite())));
    assert!(built.nodes.iter().all(|n| !n.is_empty()));
    assert_eq!(built.validate(&boxes), Ok(()));
}

#[test]
fn many_boxes_in_one_place() {
    let boxes = vec![cube(Vec3::Z, 2.0); 100_000];
    let built = build(&boxes);
    assert_eq!(built.validate(&boxes), Ok(()));
    assert_eq!(built.tlas.stats(&built.nodes).depth, 18);
}

#[test]
fn chains_do_not_make_it_deep() {
    // Each box is nearer to the one before than to the next.
    let series: Vec<Aabb> = (-120..120).map(|i| cube(Vec3::splat(2f32.powi(i)), 2f32.powi(i - 3))).collect();
    let concentric: Vec<Aabb> = (1..=20_000).map(|i| cube(Vec3::ZERO, i as f32)).collect();
    let line: Vec<Aabb> = (0..30_000).map(|i| cube(Vec3::X * (i as f32).powi(2), 0.1)).collect();
    for boxes in [series, concentric, line] {
        let built = build(&boxes);
        assert_eq!(built.validate(&boxes), Ok(()));
        let depth = built.tlas.stats(&built.nodes).depth;
        assert!(depth <= 60, "{} boxes: {depth} levels", boxes.len());
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let mut random = ropewalk_testkit::Random::new(5);
    let boxes: Vec<Aabb> = (0..100_000).map(|_| cube(random.in_cube(), 0.01)).collect();
    let build_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| build(&boxes))
    };
    let alone = build_with(1);
    assert_eq!(alone.nodes.len(), 199_999);
    for threads in [2, 5, 16] {
        let built = build_with(threads);
        assert!(*built.nodes == *alone.nodes, "{threads} threads");
        let cost = |b: &Built| b.tlas.sah_cost(&b.nodes).to_bits();
        assert_eq!(cost(&built), cost(&alone), "{threads} threads");
    }
}

#[test]
fn validation_finds_a_lost_a_doubled_and_an_uncovered_instance() {
    let boxes: Vec<Aabb> = (0..9).map(|i| cube(Vec3::splat(i as f32), 0.25)).collect();
    let built = build(&boxes);
    let leaves: Vec<usize> = (0..17).filter(|&i| built.nodes[i].primitives.primitive_count() > 0).collect();
    assert_eq!(leaves.len(), 9);

    let mut doubled = built.nodes.to_vec();
    doubled[leaves[1]].primitives = doubled[leaves[0]].primitives;
    assert!(built.tlas.validate(&doubled, &boxes).is_err());
    let mut lost = built.nodes.to_vec();
    lost[leaves[1]] = Node::unused_leaf(lost[leaves[1]].escape_index);
    assert!(built.tlas.validate(&lost, &boxes).is_err());
    let mut unused_last = built.nodes.to_vec();
    unused_last[leaves[8]] = Node::unused_leaf(NONE);
    assert!(matches!(built.tlas.validate(&unused_last, &boxes), Err(BvhError::Escape { .. })));
    let more = [&boxes[..], &boxes[3..4]].concat();
    assert_eq!(built.validate(&more), Err(BvhError::Missing { primitive: 9 }));
    let mut grown = boxes.clone();
    grown[3] = cube(Vec3::splat(3.0), 0.5);
    assert!(matches!(built.validate(&grown), Err(BvhError::Box { .. })));
}

/// A coordinate of any magnitude, often one of a few.
pub(crate) fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => -1.0f32..1.0,
        2 => prop::sample::select(vec![0.0f32, 1.0, -1.0, 1e-30, -1e30, f32::MAX, -f32::MAX, f32::MIN_POSITIVE, 1e-45]),
        1 => prop::num::f32::NORMAL | prop::num::f32::SUBNORMAL | prop::num::f32::ZERO,
    ]
}

pub(crate) fn any_box() -> impl Strategy<Value = Aabb> {
    prop::array::uniform6(coordinate()).prop_map(|[a, b, c, d, e, f]| {
        let (p, q) = (Vec3::new(a, b, c), Vec3::new(d, e, f));
        Aabb { min: p.min(q), max: p.max(q) }
    })
}

proptest! {
    #[test]
    fn any_boxes(boxes in prop::collection::vec(any_box(), 0..400)) {
        let built = build(&boxes);
        prop_assert_eq!(built.validate(&boxes), Ok(()));
        prop_assert_eq!(built.slots(), (0..boxes.len() as u32).collect::<Vec<_>>());
        prop_assert_eq!(built.nodes.len(), (2 * boxes.len()).saturating_sub(1));
        let stats = built.tlas.stats(&built.nodes);
        prop_assert!(stats.depth <= Tlas::MAX_DEPTH);
        let cost = built.tlas.sah_cost(&built.nodes);
        prop_assert!((cost - stats.sah_cost).abs() <= 1e-9 * cost, "{} is not {}", cost, stats.sah_cost);
    }
}

#[test]
fn an_empty_tlas_is_built_by_the_first_update() {
    let mut built = Built::default();
    let boxes = [cube(Vec3::X, 1.0), cube(Vec3::Y, 1.0)];
    assert_eq!(built.update(&boxes, &[0, 1]), TlasUpdate::Rebuilt(RebuildReason::Empty));
    assert_eq!(built.slots(), [0, 1]);
    assert_eq!(built.update(&[], &[0, 1]), TlasUpdate::Rebuilt(RebuildReason::Sparse));
    assert_eq!(built.nodes.len(), 0);
}
