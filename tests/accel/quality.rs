//! The SAH cost of the hierarchies, compared with that of a builder that tries every split.

use glam::DVec3;
use ropewalk::accel::{Blas, BlasBuildParams, MAX_CHILDREN};
use ropewalk::device::layout::{NONE, Node};
use ropewalk::math::Aabb;

use super::meshes::{adversarial, geometry};
use ropewalk_testkit::Mesh;

const PARAMS: BlasBuildParams = BlasBuildParams::PAPER.with_max_leaf_size(15);

fn half_area(aabb: &Aabb) -> f64 {
    let d: DVec3 = aabb.max.as_dvec3() - aabb.min.as_dvec3();
    d.x * d.y + d.y * d.z + d.z * d.x
}

fn union(boxes: &[Aabb]) -> Aabb {
    boxes.iter().fold(Aabb::EMPTY, |a, b| a.union(*b))
}

/// The SAH cost, in node fetches, of the tree that is split greedily at the best of all planes between sorted centres.
/// Both children of an inner node are fetched.
fn full_sweep_cost(boxes: &mut [Aabb]) -> f64 {
    let area = half_area(&union(boxes));
    let triangle_cost = f64::from(PARAMS.triangle_cost);
    let leaf_cost = area * boxes.len() as f64 * triangle_cost;
    let mut best = (f64::INFINITY, 0, 0);
    for axis in 0..3 {
        boxes.sort_by(|a, b| a.center()[axis].total_cmp(&b.center()[axis]));
        let mut right_areas = vec![0.0; boxes.len()];
        let mut right = Aabb::EMPTY;
        for i in (1..boxes.len()).rev() {
            right = right.union(boxes[i]);
            right_areas[i] = half_area(&right);
        }
        let mut left = Aabb::EMPTY;
        for i in 1..boxes.len() {
            left = left.union(boxes[i - 1]);
            let cost = half_area(&left) * i as f64 + right_areas[i] * (boxes.len() - i) as f64;
            if cost < best.0 {
                best = (cost, axis, i);
            }
        }
    }
    let (cost, axis, middle) = best;
    if boxes.len() == 1 || boxes.len() <= 15 && leaf_cost <= area * 2.0 + triangle_cost * cost {
        return leaf_cost;
    }
    boxes.sort_by(|a, b| a.center()[axis].total_cmp(&b.center()[axis]));
    let (left, right) = boxes.split_at_mut(middle);
    2.0 * area + full_sweep_cost(left) + full_sweep_cost(right)
}

#[test]
fn binning_loses_at_most_a_few_percent_to_a_full_sweep() {
    let meshes = [
        ("icosphere", Mesh::icosphere(4)),
        ("displaced", Mesh::displaced_icosphere(4)),
        ("soup", Mesh::soup(1, 5000)),
        ("bumpy grid", bumpy_grid()),
    ];
    for (name, mesh) in meshes {
        let mut boxes: Vec<Aabb> = (0..mesh.indices.len()).map(|i| Aabb::from_points(mesh.triangle(i))).collect();
        let root = half_area(&union(&boxes));
        let swept = 1.0 + full_sweep_cost(&mut boxes) / root;
        let binned = Blas::build(&geometry(&mesh), &PARAMS).unwrap().stats().sah_cost;
        println!("{name}: binned {binned:.2}, full sweep {swept:.2}, ratio {:.4}", binned / swept);
        assert!(binned < 1.04 * swept, "{name}: {binned} against {swept}");
        assert!(binned > 0.9 * swept, "{name}: {binned} against {swept}: one of the two costs is wrong");
    }
}

fn bumpy_grid() -> Mesh {
    let mut mesh = super::meshes::grid(60, 40, 2, 0.0);
    for p in &mut mesh.positions {
        p.z = (p.x * 0.7).sin() * (p.y * 0.9).cos() * 3.0;
    }
    mesh
}

#[test]
fn statistics_are_those_of_the_tree() {
    let mut compared = 0;
    for (name, mesh) in adversarial() {
        let blas = Blas::build(&geometry(&mesh), &PARAMS).unwrap();
        let stats = blas.stats();
        let (cost, depth, leaves) = walk(&blas.nodes, 0, blas.nodes.len());
        let cost = 1.0 + cost / node_area(&blas.nodes[0]);
        assert!((stats.sah_cost / cost - 1.0).abs() < 1e-6, "{name}: {} against {cost}", stats.sah_cost);
        assert_eq!((stats.depth, stats.leaf_count), (depth, leaves), "{name}");
        compared += 1;
    }
    assert!(compared > 10);
}

fn node_area(node: &Node) -> f64 {
    half_area(&Aabb { min: node.min.into(), max: node.max.into() })
}

/// The SAH cost (times the root's area), the depth and the number of leaves of the subtree in `nodes[index..end]`, by
/// recursion.
fn walk(nodes: &[Node], index: usize, end: usize) -> (f64, usize, usize) {
    let node = &nodes[index];
    let area = node_area(node);
    if node.primitives.primitive_count() > 0 {
        return (area * f64::from(node.primitives.primitive_count()) * f64::from(PARAMS.triangle_cost), 1, 1);
    }
    assert_eq!(if node.escape_index == NONE { nodes.len() } else { node.escape_index as usize }, end);
    let (mut sum, mut child, mut children) = ((0.0, 0, 0), index + 1, 0);
    while child < end {
        let next = (nodes[child].escape_index as usize).min(end);
        let (cost, depth, leaves) = walk(nodes, child, next);
        sum = (sum.0 + area + cost, sum.1.max(depth), sum.2 + leaves);
        (child, children) = (next, children + 1);
    }
    assert!((2..=MAX_CHILDREN).contains(&children));
    (sum.0, 1 + sum.1, sum.2)
}

/// For each inner node but the root: its surface area over that of its parent, and its number of children.
fn shares(nodes: &[Node]) -> Vec<(f64, usize)> {
    let mut shares = Vec::new();
    let mut ancestors: Vec<(usize, usize)> = Vec::new();
    for (index, node) in nodes.iter().enumerate() {
        ancestors.retain(|&(_, end)| index < end);
        if node.primitives.primitive_count() > 0 {
            continue;
        }
        let end = (node.escape_index as usize).min(nodes.len());
        let (mut child, mut children) = (index + 1, 0);
        while child < end {
            (child, children) = ((nodes[child].escape_index as usize).min(end), children + 1);
        }
        if let Some(&(parent, _)) = ancestors.last() {
            shares.push((node_area(node) / node_area(&nodes[parent]), children));
        }
        ancestors.push((index, end));
    }
    shares
}

#[test]
fn nodes_that_save_nothing_are_left_out() {
    for (name, mesh) in [("soup", Mesh::soup(1, 5000)), ("displaced", Mesh::displaced_icosphere(4))] {
        let blas = Blas::build(&geometry(&mesh), &PARAMS).unwrap();
        let stats = blas.stats();
        let (inner, binary) = (stats.node_count - stats.leaf_count, stats.leaf_count - 1);
        println!("{name}: {inner} inner nodes of {binary}");
        assert!(inner * 4 < binary * 3, "{name}: {inner} inner nodes of {binary}");
        // Each inner node that pruning kept saves fetches, except those that the limit on the number of children kept:
        // nodes with that many children, and nodes below one.
        let shares = shares(&blas.nodes);
        let useless = shares.iter().filter(|(share, children)| *children as f64 * (1.0 - share) < 0.99).count();
        assert!(shares.len() > 500 && useless * 20 < shares.len(), "{name}: {useless} of {}", shares.len());
    }
}
