//! Bottom-level structures are whole: every triangle in one leaf, every box around what is in it, escape indices in
//! order.

use std::collections::HashSet;

use glam::Vec3;
use ropewalk::Error;
use ropewalk::accel::{Blas, BlasBuildParams, BvhError, MAX_BLAS_DEPTH};
use ropewalk::device::layout::{NONE, Node, PrimitiveRange};
use ropewalk::graph::{BlasKind, Geometry, Quality};

use super::meshes::{STRUCTURES, adversarial, beyond_arithmetic, concentric, geometry, grid, identical};
use ropewalk_testkit::oracle::has_area;
use ropewalk_testkit::{Mesh, Random};

const PARAMS: [BlasBuildParams; 3] = [
    BlasBuildParams::PAPER.with_max_leaf_size(15),
    BlasBuildParams::PAPER,
    BlasBuildParams::PAPER.with_max_leaf_size(15).with_triangle_cost(0.1),
];

/// The triangles that a ray can hit: those with an area, and of those that coincide the first.
fn hittable(mesh: &Mesh) -> Vec<u32> {
    let mut seen = HashSet::new();
    let is_hittable = |&i: &u32| {
        let [a, b, c] = mesh.triangle(i as usize);
        let bits = |corner: Vec3| (corner + 0.0).to_array().map(f32::to_bits);
        let turned = [[a, b, c], [b, c, a], [c, a, b]].map(|corners| corners.map(bits)).into_iter().min();
        has_area([a, b, c]) && seen.insert(turned)
    };
    (0..mesh.indices.len() as u32).filter(is_hittable).collect()
}

fn check(name: &str, mesh: &Mesh, params: &BlasBuildParams) {
    let blas = Blas::build(&geometry(mesh), params).unwrap();
    assert_eq!(blas.validate(), Ok(()), "{name}");
    let mut primitives: Vec<u32> = blas.triangles.iter().map(|t| t.primitive).collect();
    primitives.sort_unstable();
    let all = primitives.len();
    primitives.dedup();
    assert_eq!(primitives, hittable(mesh), "{name}");
    assert_eq!(blas.has_duplicates, all > primitives.len(), "{name}");
    assert_eq!(blas.stats().duplicate_count, all - primitives.len(), "{name}");
    let room = match params.structure {
        BlasKind::Bvh(Quality::High) => 0.3,
        BlasKind::KdTree => 1.0,
        BlasKind::Bvh(_) => 0.0,
    };
    assert!(all as f32 <= primitives.len() as f32 * (1.0 + room), "{name}: {all} of {}", primitives.len());
    for triangle in &blas.triangles {
        let corners = mesh.triangle(triangle.primitive as usize).map(|p| p.to_array());
        assert_eq!([triangle.v0, triangle.v1, triangle.v2], corners, "{name}");
    }
    let stats = blas.stats();
    assert!(stats.depth <= MAX_BLAS_DEPTH, "{name}: {} levels", stats.depth);
    assert!(stats.max_leaf_size <= params.max_leaf_size, "{name}: {} in a leaf", stats.max_leaf_size);
    assert_eq!(stats.primitive_count, blas.triangles.len(), "{name}");
    assert_eq!(stats.bytes, 32 * blas.nodes.len() + 96 * blas.wide_nodes.len() + 48 * blas.triangles.len());
}

#[test]
fn adversarial_meshes() {
    for (name, mesh) in adversarial().into_iter().chain(beyond_arithmetic()) {
        assert!(!mesh.indices.is_empty());
        for (params, structure) in PARAMS.iter().flat_map(|p| STRUCTURES.map(|s| (p, s))) {
            check(&format!("{name}, {structure:?}"), &mesh, &params.with_structure(structure));
        }
    }
}

#[test]
fn a_million_identical_triangles() {
    let geometry = geometry(&identical(1_000_000));
    for structure in STRUCTURES {
        let blas = Blas::build(&geometry, &BlasBuildParams::new(structure)).unwrap();
        assert_eq!((blas.triangles.len(), blas.triangles[0].primitive, blas.coincident_count()), (1, 0, 999_999));
    }
}

#[test]
fn a_million_triangles_with_one_centre() {
    let geometry = geometry(&concentric(1_000_000));
    for structure in [Quality::Low, Quality::Medium].map(BlasKind::Bvh) {
        let stats = Blas::build(&geometry, &BlasBuildParams::new(structure)).unwrap().stats();
        assert_eq!((stats.primitive_count, stats.max_leaf_size.max(15)), (1_000_000, 15));
        // Halving a million down to 15 takes 17 levels.
        assert!(stats.depth <= 19, "{structure:?}: {} levels", stats.depth);
    }
}

#[test]
fn nothing_to_hit_gives_no_nodes() {
    let nothing = Geometry::default();
    let unused = Geometry::new([Vec3::ONE; 3], []);
    let without_area = Geometry::new([Vec3::ONE, Vec3::X], [[0, 0, 1], [1, 1, 1]]);
    for geometry in [nothing, unused, without_area] {
        let blas = Blas::build(&geometry, &BlasBuildParams::default()).unwrap();
        assert!(blas.nodes.is_empty() && blas.triangles.is_empty() && blas.bounds.is_empty());
        assert_eq!((blas.validate(), blas.stats().node_count), (Ok(()), 0));
    }
}

#[test]
fn invalid_geometry_is_refused() {
    let missing = Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 2], [0, 1, 3]]);
    let infinite = Geometry::new([Vec3::ZERO, Vec3::X, Vec3::splat(f32::INFINITY)], [[0, 1, 2]]);
    let not_a_number = Geometry::new([Vec3::ZERO, Vec3::NAN, Vec3::Y], [[0, 1, 2]]);
    for (geometry, at) in [(missing, ("indices", 1)), (infinite, ("positions", 2)), (not_a_number, ("positions", 1))] {
        match Blas::build(&geometry, &BlasBuildParams::default()) {
            Err(Error::InvalidGeometry { what, index, .. }) => assert_eq!((what, index), at),
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn leaf_size_is_clamped() {
    let mesh = Mesh::soup(3, 500);
    for (asked, largest) in [(0, 1), (1, 1), (4, 4), (1000, 15)] {
        let params = BlasBuildParams::default().with_max_leaf_size(asked).with_triangle_cost(1e-3);
        let blas = Blas::build(&geometry(&mesh), &params).unwrap();
        assert_eq!(blas.stats().max_leaf_size.max(largest), largest);
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    // More than 65,536 triangles, so that threads share the uppermost nodes.
    let mut sphere = Mesh::displaced_icosphere(6);
    sphere.indices.extend(vec![[5, 5, 6]; 100]);
    for mesh in [sphere, grid(300, 200, 1, 0.5)] {
        assert!(mesh.indices.len() > 1 << 16);
        for structure in STRUCTURES {
            let build = |threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| Blas::build(&geometry(&mesh), &BlasBuildParams::new(structure)).unwrap())
            };
            let alone = build(1);
            assert!(alone.nodes.len() > 10_000);
            for threads in [2, 5] {
                assert!(build(threads) == alone, "{structure:?}, {threads} threads");
            }
        }
    }
}

#[test]
fn a_subtree_starts_with_its_larger_child() {
    let blas = Blas::build(&geometry(&Mesh::soup(1, 2000)), &BlasBuildParams::default()).unwrap();
    let area = |i: usize| {
        let [x, y, z] = [0, 1, 2].map(|axis| blas.nodes[i].max[axis] - blas.nodes[i].min[axis]);
        x * y + y * z + z * x
    };
    // Below nodes with two children, pruning removed nothing.
    let end = |i: usize| (blas.nodes[i].escape_index as usize).min(blas.nodes.len());
    let inner = (0..blas.nodes.len()).filter(|&i| blas.nodes[i].primitives == PrimitiveRange::INNER);
    let pairs = inner.filter(|&i| end(end(i + 1)) == end(i));
    let pairs: Vec<_> = pairs.map(|i| (area(i + 1), area(end(i + 1)))).collect();
    assert!(pairs.len() > 100);
    // Padding may reverse the order of boxes of equal area.
    assert!(pairs.iter().all(|(first, second)| *first >= second * 0.9999));
}

/// Applies a change to a valid hierarchy and returns the error that validation finds.
fn verdict(spoil: impl FnOnce(&mut Blas)) -> BvhError {
    // No triangle of this soup is degenerate, so all 300 are in the structure.
    let mut blas = Blas::build(&geometry(&Mesh::soup(4, 300)), &BlasBuildParams::default()).unwrap();
    assert_eq!(blas.validate(), Ok(()));
    spoil(&mut blas);
    blas.validate().unwrap_err()
}

#[test]
fn validation_finds_every_kind_of_fault() {
    use BvhError::{Box, Escape, Leaf, Missing, Repeated};
    let first_leaf = |blas: &Blas| blas.nodes.iter().position(|n| n.primitives != PrimitiveRange::INNER).unwrap();

    // Escape order.
    assert!(matches!(verdict(|b| b.nodes[1].escape_index = 1), Escape { node: 1, .. }));
    assert!(matches!(verdict(|b| b.nodes[1].escape_index += 1), Escape { .. }));
    assert!(matches!(verdict(|b| b.nodes[1].escape_index -= 1), Escape { .. }));
    assert!(matches!(verdict(|b| b.nodes[0].escape_index = b.nodes.len() as u32), Escape { node: 0, .. }));
    assert!(matches!(verdict(|b| b.nodes[3].escape_index = 1 << 30), Escape { node: 3, .. }));
    assert!(matches!(verdict(|b| b.nodes[2].escape_index = NONE), Escape { node: 2, .. }));
    assert!(matches!(verdict(|b| b.nodes.truncate(9)), Escape { .. }));
    // Boxes.
    assert!(matches!(verdict(|b| b.nodes[0].min[1] = b.nodes[0].max[1]), Box { node: 0, .. }));
    assert!(matches!(verdict(|b| b.nodes[0].max[2] = f32::INFINITY), Box { node: 0, .. }));
    assert!(matches!(verdict(|b| b.nodes[0].max[2] = f32::NAN), Box { node: 0, .. }));
    assert!(matches!(verdict(|b| b.nodes[5].max[0] = b.nodes[0].max[0].next_up()), Box { node: 5, .. }));
    let without_margin = |b: &mut Blas| {
        let leaf = first_leaf(b);
        let range = b.nodes[leaf].primitives;
        let triangles = &b.triangles[range.first_primitive() as usize..][..range.primitive_count() as usize];
        b.nodes[leaf].min[0] = triangles.iter().flat_map(|t| [t.v0[0], t.v1[0], t.v2[0]]).fold(f32::MAX, f32::min);
    };
    assert!(matches!(verdict(without_margin), Box { .. }));
    // Primitives.
    let shifted = |b: &mut Blas| {
        let leaf = first_leaf(b);
        b.nodes[leaf].primitives = PrimitiveRange::leaf(1, b.nodes[leaf].primitives.primitive_count());
    };
    assert!(matches!(verdict(shifted), Leaf { first: 1, .. }));
    assert!(matches!(verdict(|b| b.triangles.truncate(299)), Leaf { .. }));
    assert!(matches!(verdict(|b| b.triangles.push(b.triangles[7])), Repeated { .. }));
    assert!(matches!(verdict(|b| b.triangles[0].primitive = b.triangles[1].primitive), Repeated { .. }));
    let extra = |b: &mut Blas| {
        b.triangles.push(b.triangles[7]);
        b.triangles[300].primitive = 300;
    };
    assert!(matches!(verdict(extra), Missing { primitive: 300 }));
}

#[test]
fn validation_finds_what_is_missing_of_a_triangle() {
    let good = Blas::build(&geometry(&Mesh::soup(1, 300)), &BlasBuildParams::new(BlasKind::KdTree)).unwrap();
    assert!(good.has_duplicates && good.validate() == Ok(()));
    let times = |primitive: u32| good.triangles.iter().filter(|t| t.primitive == primitive).count();
    let repeated = (0..300).find(|&p| times(p) > 1).unwrap();
    // A structure without duplicates.
    let mut once = good.clone();
    once.has_duplicates = false;
    let verdict = once.validate();
    assert!(matches!(verdict, Err(BvhError::Repeated { .. })), "{verdict:?}");
    // One copy of a triangle after the other is replaced by another triangle of the structure: then something is not
    // covered, or is in a leaf twice.
    let mut found = 0;
    for (i, _) in good.triangles.iter().enumerate().filter(|(_, t)| t.primitive == repeated) {
        let mut spoilt = good.clone();
        spoilt.triangles[i] = spoilt.triangles[if i == 0 { 1 } else { i - 1 }];
        found += usize::from(spoilt.validate().is_err());
    }
    assert!(found * 2 > times(repeated), "{found} of {}", times(repeated));
}

#[test]
fn every_point_of_a_triangle_is_in_a_leaf_that_holds_it() {
    let (mut points, mut parts) = (0, 0);
    for (seed, (name, mesh)) in adversarial().into_iter().enumerate() {
        for structure in [BlasKind::Bvh(Quality::High), BlasKind::KdTree] {
            let blas = Blas::build(&geometry(&mesh), &BlasBuildParams::new(structure)).unwrap();
            parts += blas.stats().duplicate_count;
            let mut leaves = vec![Vec::new(); mesh.indices.len()];
            for node in blas.nodes.iter().filter(|node| node.primitives != PrimitiveRange::INNER) {
                let first = node.primitives.first_primitive() as usize;
                for triangle in &blas.triangles[first..][..node.primitives.primitive_count() as usize] {
                    leaves[triangle.primitive as usize].push(node);
                }
            }
            let mut random = Random::new(seed as u64);
            for (primitive, leaves) in leaves.iter().enumerate().filter(|(_, leaves)| leaves.len() > 1) {
                let [a, b, c] = mesh.triangle(primitive).map(Vec3::as_dvec3);
                for _ in 0..20 {
                    let (u, v) = (f64::from(random.unsigned()), f64::from(random.unsigned()));
                    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                    let point = a + (b - a) * u + (c - a) * v;
                    let contains = |node: &&&Node| {
                        let [min, max] = [node.min, node.max].map(|corner| Vec3::from(corner).as_dvec3());
                        min.cmple(point).all() && max.cmpge(point).all()
                    };
                    assert!(leaves.iter().any(|node| contains(&node)), "{name}, {structure:?}: {point}");
                    points += 1;
                }
            }
        }
    }
    assert!(points > 50_000 && parts > 3_000, "{points} points, {parts} parts");
}
