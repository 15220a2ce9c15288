//! Ray queries: the closest hit, any hit, all hits.

use std::cell::Cell;

use glam::{DVec3, Vec3, Vec4};
use proptest::prelude::*;
use ropewalk::compile::Compiler;
use ropewalk::graph::AlphaMode;
use ropewalk::graph::NodePath;
use ropewalk::query::Queries;
use ropewalk::{Core, Geometry, Hit, Material, Ray, Scene};

use super::oracle::{Candidate, candidates};
use super::scenes::{Dice, Drawn, World, check, compiled, drawn};
use ropewalk_testkit::Mesh;

/// A ray from a random point, at a point of some triangle or in a random direction; directions have all lengths.
fn ray(dice: &mut Dice, drawn: &[Drawn], origin: DVec3) -> Ray {
    let from = dice.point();
    let mut to = dice.point();
    let targets: Vec<&Drawn> = drawn.iter().filter(|d| !d.triangles.is_empty()).collect();
    if !targets.is_empty() && dice.random.index(5) > 0 {
        let target = targets[dice.random.index(targets.len())];
        let [a, b, c] = target.world_triangle(dice.random.index(target.triangles.len()));
        let weights = [0, 1].map(|_| f64::from(dice.random.unsigned()));
        to = origin + a.lerp(b, weights[0]).lerp(c, weights[1]);
    }
    let direction = (to - from) * 10f64.powi(dice.random.index(9) as i32 - 4);
    let mut ray = Ray::new(from, direction);
    if dice.random.index(4) == 0 {
        let end = (to - from).length() / direction.length();
        (ray.t_min, ray.t_max) = (end * f64::from(dice.random.signed()), end * f64::from(dice.random.unsigned()) * 2.0);
    }
    ray
}

fn is_of(hit: &Hit, candidate: &Candidate) -> bool {
    (&candidate.path, candidate.triangle) == (&hit.path, hit.triangle)
}

/// Checks a hit's node, position, distance and normal against the triangle that it names.
fn check_hit(hit: &Hit, ray: &Ray, drawn: &[Drawn], truth: &[Candidate], origin: DVec3) -> Result<(), TestCaseError> {
    let own = truth.iter().find(|candidate| is_of(hit, candidate));
    prop_assert!(own.is_some(), "{hit:?} is surely missed");
    let own = own.unwrap();
    prop_assert!((own.t - hit.distance).abs() <= own.t_error, "{hit:?} is at {} within {}", own.t, own.t_error);
    prop_assert!(hit.distance >= ray.t_min && hit.distance <= ray.t_max);

    let of = drawn.iter().find(|drawn| drawn.path == hit.path).unwrap();
    prop_assert_eq!((hit.geometry, hit.material), (of.geometry, of.material));
    let index = of.triangles.iter().position(|(i, _)| *i == hit.triangle).unwrap();
    let [a, b, c] = of.world_triangle(index);
    let weights = hit.barycentrics;
    prop_assert!((weights.element_sum() - 1.0).abs() < 1e-12 && weights.min_element() >= 0.0);
    let size = a.length() + b.length() + c.length() + origin.length();
    let position = a * weights.x + b * weights.y + c * weights.z + origin;
    prop_assert!(position.distance(hit.position) <= 1e-13 * size, "{} is not {position}", hit.position);
    if own.is_sure {
        let on_ray = ray.origin + ray.direction * hit.distance;
        // The product of a matrix and its inverse is the identity within rounding.
        let error = own.t_error * ray.direction.length() + 1e-15 * of.condition() * (size + ray.origin.length());
        prop_assert!(on_ray.distance(hit.position) <= error, "{on_ray} is not {} by {error}", hit.position);
    }
    let mirrored = of.world_from_local.matrix3.determinant() < 0.0;
    let normal = (b - a).cross(c - a).normalize() * if mirrored { -1.0 } else { 1.0 };
    if own.is_sure {
        let height = normal.dot(ray.direction.normalize());
        prop_assert!(hit.geometric_normal.dot(normal) > 1.0 - 1e-6, "{} is not {normal}", hit.geometric_normal);
        prop_assert!(height.abs() < 1e-6 || hit.back_face == (height > 0.0));
        prop_assert_eq!(hit.shading_normal, hit.geometric_normal);
    }
    Ok(())
}

#[test]
fn rays_agree_with_brute_force() {
    let (hits, ties) = (Cell::new(0), Cell::new(0));
    check(400, |seed| {
        let World { mut scene, mut dice } = World::new(seed);
        let mask = dice.mask();
        let (mut compiler, origin) = compiled(&mut scene);
        let drawn = drawn(&mut scene, origin, mask);
        let queries = Queries::new(&mut compiler, &mut scene).unwrap().with_ray_mask(mask);
        for _ in 0..40 {
            let ray = ray(&mut dice, &drawn, origin);
            let truth = candidates(&drawn, origin, &ray);
            let all = queries.all_hits(&ray).unwrap();
            for hit in &all {
                check_hit(hit, &ray, &drawn, &truth, origin)?;
            }
            prop_assert!(all.is_sorted_by(|a, b| a.distance <= b.distance));
            for candidate in truth.iter().filter(|candidate| candidate.is_sure) {
                let count = all.iter().filter(|hit| is_of(hit, candidate)).count();
                prop_assert_eq!(count, 1, "{:?}", candidate);
            }
            let closest = queries.closest_hit(&ray).unwrap();
            prop_assert_eq!(closest.as_ref(), all.first());
            prop_assert_eq!(queries.any_hit(&ray).unwrap(), closest.is_some());
            hits.set(hits.get() + all.len());
            // For instances that are flattened almost to a plane, rounding decides every hit.
            let flat = |path: &NodePath| drawn.iter().any(|drawn| drawn.path == *path && drawn.condition() > 1e7);
            ties.set(ties.get() + truth.iter().filter(|tie| !tie.is_sure && !flat(&tie.path)).count());
        }
        Ok(())
    });
    println!("{} hits, {} ties", hits.get(), ties.get());
    assert!(hits.get() > 5_000 && ties.get() * 8 < hits.get(), "{} hits, {} ties", hits.get(), ties.get());
}

/// A ray from outside enters a closed convex surface as often as it leaves it, also if it runs through edges and
/// corners.
#[test]
fn a_convex_surface_is_crossed_twice_or_not_at_all() {
    let [missed, crossed] = [Cell::new(0), Cell::new(0)];
    check(60, |seed| {
        let World { mut scene, mut dice } = World::of_one(seed, Mesh::icosphere(1));
        let (mut compiler, origin) = compiled(&mut scene);
        let drawn = drawn(&mut scene, origin, u32::MAX);
        let queries = Queries::new(&mut compiler, &mut scene).unwrap();
        for drawn in &drawn {
            for i in 0..drawn.triangles.len() {
                let [a, b, c] = drawn.world_triangle(i).map(|corner| corner + origin);
                for target in [a, (a + b) * 0.5, (a + b + c) / 3.0] {
                    let from = dice.center + dice.random.direction().as_dvec3() * 100.0 * seed.unit;
                    let all = queries.all_hits(&Ray::new(from, target - from)).unwrap();
                    match &*all {
                        [] => missed.set(missed.get() + 1),
                        [first, second] if first.back_face != second.back_face => crossed.set(crossed.get() + 1),
                        _ => prop_assert!(false, "{:?}", all),
                    }
                }
            }
        }
        Ok(())
    });
    assert!(missed.get() > 10 && crossed.get() > 1000, "{} and {}", missed.get(), crossed.get());
}

/// A square of two triangles at z = 0, from (0, 0) to (1, 1).
fn square(scene: &mut Scene, geometry: Geometry, material: Material) {
    let geometry = scene.add_geometry(geometry).unwrap();
    let material = scene.add_material(material).unwrap();
    scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
}

fn square_geometry() -> Geometry {
    Geometry::new([Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y], [[0, 1, 2], [0, 2, 3]])
}

#[test]
fn holes_and_back_faces_are_passed_by_as_a_camera_does() {
    let mut scene = Scene::new();
    // A texture that is opaque where x is above a half.
    let alpha = [0.0, 1.0, 1.0, 0.0].map(|alpha| Vec4::new(1.0, 1.0, 1.0, alpha));
    let material = Material { alpha_mode: AlphaMode::Mask { cutoff: 0.5 }, double_sided: false, ..Material::default() };
    square(&mut scene, Geometry { colors: Some(alpha.into()), ..square_geometry() }, material);
    let mut compiler = Compiler::new();
    let queries = Queries::new(&mut compiler, &mut scene).unwrap();
    for (x, z, expected) in [(0.3, 1.0, 0), (0.7, 1.0, 1), (0.3, -1.0, 0), (0.7, -1.0, 0)] {
        let ray = Ray::new(DVec3::new(x, 0.4, z), DVec3::Z * -z);
        assert_eq!(queries.all_hits(&ray).unwrap().len(), expected, "{x}, {z}");
        assert_eq!(queries.any_hit(&ray).unwrap(), expected > 0);
    }
    // Queries of regions and points ignore alpha.
    assert_eq!(queries.nearest(DVec3::new(0.1, 0.5, -2.0), 3.0).unwrap().unwrap().distance, 2.0);
}

#[test]
fn shading_normals_lie_between_those_of_the_vertices() {
    let mut scene = Scene::new();
    let normals = [-0.5, 0.5, 0.5, -0.5].map(|x| Vec3::new(x, 0.0, 1.0).normalize());
    square(&mut scene, Geometry { normals: Some(normals.into()), ..square_geometry() }, Material::default());
    let mut compiler = Compiler::new();
    let queries = Queries::new(&mut compiler, &mut scene).unwrap();
    for x in [0.1, 0.5, 0.8] {
        for z in [1.0, -1.0] {
            let hit = queries.closest_hit(&Ray::new(DVec3::new(x, 0.3, z), DVec3::Z * -z)).unwrap().unwrap();
            let expected = DVec3::new(x - 0.5, 0.0, 1.0).normalize();
            assert!(hit.shading_normal.distance(expected) < 1e-6, "{}", hit.shading_normal);
            assert_eq!((hit.geometric_normal, hit.back_face), (DVec3::Z, z < 0.0));
        }
    }
}

/// Two squares at the same place: all hits are in the order in which `closest` prefers them, whichever was built first.
#[test]
fn equal_distances_are_ordered() {
    let mut scene = Scene::new();
    for _ in 0..3 {
        square(&mut scene, square_geometry(), Material::default());
    }
    let mut compiler = Compiler::new();
    let queries = Queries::new(&mut compiler, &mut scene).unwrap();
    let nodes: Vec<_> = queries.scene().children(queries.scene().root()).unwrap().collect();
    // A ray at the diagonal, which both triangles of a square share.
    let all = queries.all_hits(&Ray::new(DVec3::new(0.5, 0.5, 1.0), DVec3::NEG_Z)).unwrap();
    assert_eq!(all.iter().map(|hit| hit.path.node).collect::<Vec<_>>(), nodes);
}
