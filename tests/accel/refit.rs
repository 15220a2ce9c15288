//! Structures that were refitted after their triangles moved: they are valid, their boxes are tight, and rays hit what
//! they hit in a new structure.

use glam::{DAffine3, Quat, Vec3};
use ropewalk::accel::{Blas, BlasBuildParams};
use ropewalk::device::layout::{HitRecord, NONE, RayRecord, Triangle};
use ropewalk::graph::Quality;
use ropewalk::graph::{BlasKind, Geometry};
use ropewalk::math::Aabb;
use ropewalk::trace::{Emulated, Tracer};

use super::meshes::{adversarial, beyond_arithmetic, geometry};
use ropewalk_testkit::{Mesh, Placed, Random, arrays};

const QUALITIES: [Quality; 2] = [Quality::Low, Quality::Medium];

fn build(geometry: &Geometry, quality: Quality) -> Blas {
    Blas::build(geometry, &BlasBuildParams::new(BlasKind::Bvh(quality))).unwrap()
}

/// The mesh twisted about an axis.
fn twisted(mesh: &Mesh, turn: f32) -> Mesh {
    let bounds = Aabb::from_points(mesh.positions.iter().copied());
    let height = (bounds.max.y - bounds.min.y).max(f32::MIN_POSITIVE);
    let twist = |p: &Vec3| Quat::from_rotation_y(turn * (p.y - bounds.min.y) / height) * *p;
    Mesh { positions: mesh.positions.iter().map(twist).collect(), indices: mesh.indices.clone() }
}

fn check(name: &str, mesh: &Mesh, moved: &Mesh, quality: Quality) {
    let built = build(&geometry(mesh), quality);
    let mut blas = built.clone();
    assert!(blas.refit(&geometry(moved)), "{name}");
    assert_eq!(blas.validate(), Ok(()), "{name}");
    // The order of nodes and triangles is that of the old structure; boxes and corners are those of the new shape.
    let links = |blas: &Blas| blas.nodes.iter().map(|n| (n.escape_index, n.primitives)).collect::<Vec<_>>();
    assert_eq!(links(&blas), links(&built));
    for (new, old) in blas.triangles.iter().zip(&built.triangles) {
        let corners = moved.triangle(old.primitive as usize).map(|p| p.to_array());
        assert_eq!(*new, Triangle::new(corners, old.primitive), "{name}");
    }
    let fresh = build(&geometry(moved), quality);
    assert_eq!(blas.bounds, fresh.bounds, "{name}");
    let extent = fresh.bounds.max - fresh.bounds.min;
    // A build with spatial splits widens boxes once more, by 2^-18 of a triangle's size.
    let slack = |a: [f32; 3], b: [f32; 3]| {
        (Vec3::from(a) - Vec3::from(b)).abs().cmple(extent.max_element() * 8e-6 + Vec3::from(b).abs() * 1e-6)
    };
    if let (Some(root), Some(expected)) = (blas.nodes.first(), fresh.nodes.first()) {
        assert!((slack(root.min, expected.min) & slack(root.max, expected.max)).all(), "{name}: {root:?} {expected:?}");
    }
}

#[test]
fn deformed_structures_are_whole() {
    let mut checked = 0;
    for (name, mesh) in adversarial().into_iter().chain(beyond_arithmetic()) {
        for quality in QUALITIES {
            check(name, &mesh, &mesh, quality);
            if name == "all of f32" || name == "subnormal" {
                continue;
            }
            check(name, &mesh, &mesh.clone().scaled(0.5), quality);
            checked += 1;
        }
    }
    for quality in QUALITIES {
        // A mesh that several threads refit, and one that is a single task.
        for subdivisions in [1, 3, 6] {
            let mesh = Mesh::displaced_icosphere(subdivisions);
            check("twisted", &mesh, &twisted(&mesh, 2.0), quality);
            checked += 1;
        }
    }
    assert!(checked > 30);
}

#[test]
fn what_has_not_moved_gets_the_same_leaves_and_no_larger_boxes() {
    let mesh = Mesh::displaced_icosphere(5);
    let built = build(&geometry(&mesh), Quality::Medium);
    let mut blas = built.clone();
    assert!(blas.refit(&geometry(&mesh)));
    assert_eq!(blas.triangles, built.triangles);
    for (new, old) in blas.nodes.iter().zip(&built.nodes) {
        let inside = Vec3::from(new.min).cmpge(old.min.into()) & Vec3::from(new.max).cmple(old.max.into());
        assert!(inside.all() && (new == old || old.primitives.primitive_count() == 0), "{new:?} {old:?}");
    }
    assert!((blas.stats().sah_cost / built.stats().sah_cost - 1.0).abs() < 1e-5);
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let mesh = Mesh::displaced_icosphere(6);
    let (built, moved) = (build(&geometry(&mesh), Quality::Medium), geometry(&twisted(&mesh, 1.0)));
    let refit = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut blas = built.clone();
        assert!(pool.install(|| blas.refit(&moved)));
        blas
    };
    assert_eq!(refit(1), refit(3));
}

/// A refit is refused if a triangle comes to have two equal corners, or no longer has: degenerate triangles are not in
/// a structure.
#[test]
fn triangles_that_come_and_go_are_noticed() {
    let mesh = Mesh::displaced_icosphere(4);
    let pinched = |vertex: usize| {
        let [a, b, _] = mesh.indices[0].map(|v| v as usize);
        let mut positions = mesh.positions.clone();
        positions[a] = positions[b];
        positions[vertex] *= 1.5;
        Mesh { positions, indices: mesh.indices.clone() }
    };
    let far = mesh.indices[mesh.indices.len() - 1][0] as usize;
    let mut round = build(&geometry(&mesh), Quality::Medium);
    assert!(!round.refit(&geometry(&pinched(far))), "two triangles went");
    let mut flat = build(&geometry(&pinched(far)), Quality::Medium);
    assert!(flat.triangles.len() < mesh.indices.len());
    assert!(flat.clone().refit(&geometry(&pinched(far - 1))), "the same ones are left out");
    assert!(!flat.refit(&geometry(&mesh)), "two triangles came");
    // Geometries with other triangles are refused, too.
    for other in [Mesh::soup(1, mesh.indices.len() - 1), Mesh::soup(1, 0)] {
        assert!(!build(&geometry(&mesh), Quality::Medium).refit(&geometry(&other)));
    }
}

/// The same for triangles whose three corners come to lie on one line, or no longer do.
#[test]
fn triangles_that_lose_or_regain_their_area_are_noticed() {
    let mesh = Mesh::displaced_icosphere(4);
    // The corners of one triangle are moved to a line through the origin; another vertex moves, too.
    let flattened = |triangle: usize, vertex: usize| {
        let [a, b, c] = mesh.indices[triangle].map(|v| v as usize);
        let mut positions = mesh.positions.clone();
        (positions[b], positions[c]) = (2.0 * positions[a], 4.0 * positions[a]);
        positions[vertex] *= 1.5;
        Mesh { positions, indices: mesh.indices.clone() }
    };
    let last = mesh.indices.len() - 1;
    let middle = mesh.indices[last / 2][0] as usize;
    for quality in QUALITIES {
        let mut round = build(&geometry(&mesh), quality);
        assert!(!round.refit(&geometry(&flattened(0, middle))), "a triangle went");
        let flat = build(&geometry(&flattened(0, middle)), quality);
        assert_eq!(flat.triangles.len(), last);
        assert!(flat.clone().refit(&geometry(&flattened(0, middle - 1))), "the same one is left out");
        assert!(!flat.clone().refit(&geometry(&mesh)), "a triangle came");
        assert!(!flat.clone().refit(&geometry(&flattened(last, middle))), "a triangle came, another one went");
    }
}

#[test]
fn rays_hit_what_they_hit_in_a_new_structure() {
    let mut random = Random::new(3);
    // Corners that are very close together may become equal by rounding when they are turned.
    let mut soup = Mesh::soup(2, 3000);
    let (positions, indices) = (&soup.positions, &mut soup.indices);
    indices.retain(|t| (0..3).all(|i| positions[t[i] as usize].distance(positions[t[(i + 1) % 3] as usize]) > 1e-4));
    for (name, mesh) in [("icosphere", Mesh::displaced_icosphere(5)), ("soup", soup)] {
        for turn in [0.1, 1.5, 6.0] {
            let moved = twisted(&mesh, turn);
            let mut blas = build(&geometry(&mesh), Quality::Medium);
            assert!(blas.refit(&geometry(&moved)));
            let rays: Vec<RayRecord> = (0..3000)
                .map(|_| {
                    let (origin, target) = (random.in_cube() * 3.0, random.in_cube());
                    let direction = (target - origin).to_array();
                    RayRecord { origin: origin.to_array(), t_min: 0.0, direction, t_max: f32::MAX }
                })
                .collect();
            let trace = |blas: &Blas| {
                let mut arrays = arrays(std::slice::from_ref(&moved), &[Placed::new(0, DAffine3::IDENTITY)]);
                arrays.blas_nodes.replace(&blas.nodes);
                arrays.triangles.replace(&blas.triangles);
                let mut tracer = Emulated::default();
                tracer.upload(&mut arrays).unwrap();
                let hits = tracer.closest_hits(&arrays, &rays, 1).unwrap();
                // The index in the array may differ, but not the primitive.
                let without_triangle = |mut hit: HitRecord| {
                    hit.triangle = 0;
                    hit
                };
                hits.into_iter().map(without_triangle).collect::<Vec<_>>()
            };
            let (hits, expected) = (trace(&blas), trace(&build(&geometry(&moved), Quality::Medium)));
            assert_eq!(hits, expected, "{name} turned by {turn}");
            assert!(hits.iter().filter(|hit| hit.instance != NONE).count() > 500, "{name}");
        }
    }
}
