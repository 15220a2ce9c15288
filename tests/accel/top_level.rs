//! Top-level structures: one instance a leaf, whatever the boxes.

use glam::Vec3;
use proptest::prelude::*;
use ropewalk::accel::{MAX_DEPTH, StructureError, Tlas};
use ropewalk::device::layout::{NONE, PrimitiveRange};
use ropewalk::math::Aabb;

/// The instances in the leaves, ascending.
fn instances_of(tlas: &Tlas) -> Vec<u32> {
    let leaves = tlas.nodes.iter().filter(|n| n.primitives != PrimitiveRange::INNER);
    let mut instances: Vec<u32> = leaves.map(|n| n.primitives.first()).collect();
    instances.sort_unstable();
    instances
}

fn cube(center: Vec3, half: f32) -> Aabb {
    Aabb { min: center - half, max: center + half }
}

#[test]
fn nothing_gives_no_nodes() {
    assert_eq!(Tlas::build(&[], &[]).nodes, []);
    assert_eq!(Tlas::build(&[Aabb::EMPTY], &[3]).nodes, []);
    assert_eq!(Tlas::build(&[], &[]).stats().node_count, 0);
}

#[test]
fn one_instance_is_one_leaf() {
    let tlas = Tlas::build(&[cube(Vec3::ONE, 0.0)], &[17]);
    assert_eq!(tlas.nodes.len(), 1);
    assert_eq!((tlas.nodes[0].primitives, tlas.nodes[0].escape_index), (PrimitiveRange::leaf(17, 1), NONE));
}

#[test]
fn boxes_that_cannot_be_hit_are_left_out_and_infinite_ones_cut() {
    let nan = Aabb { min: Vec3::ZERO, max: Vec3::new(1.0, f32::NAN, 1.0) };
    let everything = Aabb { min: Vec3::NEG_INFINITY, max: Vec3::INFINITY };
    let boxes = [cube(Vec3::X, 1.0), Aabb::EMPTY, nan, everything, cube(Vec3::Y, 0.0)];
    let tlas = Tlas::build(&boxes, &[4, 5, 6, 7, 8]);
    assert_eq!(instances_of(&tlas), [4, 7, 8]);
    assert!(tlas.nodes.iter().all(|n| n.min.iter().chain(&n.max).all(|c| c.is_finite())));
}

#[test]
fn many_boxes_in_one_place() {
    let (boxes, instances): (Vec<_>, Vec<_>) = (0..100_000).map(|i| (cube(Vec3::Z, 2.0), i)).unzip();
    let tlas = Tlas::build(&boxes, &instances);
    assert_eq!(tlas.validate(&boxes, &instances), Ok(()));
    assert_eq!(tlas.stats().depth, 18);
}

#[test]
fn validation_finds_a_lost_a_doubled_and_an_uncovered_instance() {
    let boxes: Vec<Aabb> = (0..9).map(|i| cube(Vec3::splat(i as f32), 0.25)).collect();
    let instances: Vec<u32> = (20..29).collect();
    let tlas = Tlas::build(&boxes, &instances);
    let leaves: Vec<usize> = (0..17).filter(|&i| tlas.nodes[i].primitives.count() > 0).collect();
    assert_eq!(leaves.len(), 9);

    let mut doubled = tlas.clone();
    doubled.nodes[leaves[1]] =
        ropewalk::device::layout::Node { primitives: tlas.nodes[leaves[0]].primitives, ..tlas.nodes[leaves[1]] };
    assert!(doubled.validate(&boxes, &instances).is_err());
    let mut more = instances.clone();
    more.push(40);
    let mut more_boxes = boxes.clone();
    more_boxes.push(boxes[3]);
    assert_eq!(tlas.validate(&more_boxes, &more), Err(StructureError::Missing { primitive: 40 }));
    let mut grown = boxes.clone();
    grown[3] = cube(Vec3::splat(3.0), 0.5);
    assert!(matches!(tlas.validate(&grown, &instances), Err(StructureError::Box { .. })));
}

/// A coordinate of any magnitude, often one of a few.
fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => -1.0f32..1.0,
        2 => prop::sample::select(vec![0.0f32, 1.0, -1.0, 1e-30, -1e30, f32::MAX, -f32::MAX, f32::MIN_POSITIVE, 1e-45]),
        1 => prop::num::f32::NORMAL | prop::num::f32::SUBNORMAL | prop::num::f32::ZERO,
    ]
}

fn any_box() -> impl Strategy<Value = Aabb> {
    prop::array::uniform6(coordinate()).prop_map(|[a, b, c, d, e, f]| {
        let (p, q) = (Vec3::new(a, b, c), Vec3::new(d, e, f));
        Aabb { min: p.min(q), max: p.max(q) }
    })
}

proptest! {
    #[test]
    fn any_boxes(boxes in prop::collection::vec(any_box(), 0..400), stride in 1u32..1000) {
        let instances: Vec<u32> = (0..boxes.len() as u32).map(|i| 5 + i * stride).collect();
        let tlas = Tlas::build(&boxes, &instances);
        prop_assert_eq!(tlas.validate(&boxes, &instances), Ok(()));
        prop_assert_eq!(instances_of(&tlas), instances);
        prop_assert_eq!(tlas.nodes.len(), (2 * boxes.len()).saturating_sub(1));
        prop_assert!(tlas.stats().depth <= MAX_DEPTH);
    }
}
