//! Point queries: the boxes and the solids that contain a point.

use std::cell::Cell;

use glam::DVec3;
use proptest::prelude::*;
use ropewalk::compile::Compiler;
use ropewalk::math::Bounds;
use ropewalk::query::Queries;
use ropewalk::{Core, Geometry, Material, Scene};

use super::scenes::{World, check, compiled, drawn};
use ropewalk_testkit::Mesh;

#[test]
fn boxes_contain_what_is_in_them() {
    let [around, away] = [Cell::new(0), Cell::new(0)];
    check(300, |seed| {
        let World { mut scene, mut dice } = World::new(seed);
        let mask = dice.mask();
        let (mut compiler, origin) = compiled(&mut scene);
        let drawn = drawn(&mut scene, origin, mask);
        let queries = Queries::new(&mut compiler, &mut scene).unwrap().with_ray_mask(mask);
        for _ in 0..20 {
            let point = dice.point();
            let found = queries.boxes_containing(point).unwrap();
            prop_assert!(found.iter().all(|path| drawn.iter().any(|drawn| drawn.path == *path)));
            for drawn in drawn.iter().filter(|drawn| !drawn.triangles.is_empty()) {
                let is_found = found.contains(&drawn.path);
                // The tested box lies between the box of the transformed triangles and that of their transformed box.
                let corners: Vec<DVec3> = (0..drawn.triangles.len()).flat_map(|i| drawn.world_triangle(i)).collect();
                let tight = bounds(&corners);
                let local: Vec<DVec3> = drawn.triangles.iter().flat_map(|(_, corners)| *corners).collect();
                let loose = bounds(&local).transformed(&drawn.world_from_local);
                let band = 1e-5 * drawn.condition() * (loose.radius() + loose.center().length() + seed.unit);
                if contains(&tight, point - origin, 0.0) {
                    prop_assert!(is_found);
                    around.set(around.get() + 1);
                }
                if !contains(&loose, point - origin, band) {
                    prop_assert!(!is_found);
                    away.set(away.get() + 1);
                }
            }
        }
        Ok(())
    });
    assert!(around.get() > 500 && away.get() > 500, "{} and {}", around.get(), away.get());
}

fn bounds(points: &[DVec3]) -> Bounds {
    points.iter().fold(Bounds::EMPTY, |bounds, &p| bounds.union(Bounds { min: p, max: p }))
}

fn contains(bounds: &Bounds, point: DVec3, margin: f64) -> bool {
    (bounds.min - margin).cmple(point).all() && (bounds.max + margin).cmpge(point).all()
}

/// A point is inside a convex body if it is behind all of its faces, also if the body is mirrored.
#[test]
fn solids_enclose_what_is_in_them() {
    let [inside, outside] = [Cell::new(0), Cell::new(0)];
    check(300, |seed| {
        let mesh = if seed.seed % 2 == 0 { Mesh::icosphere(1) } else { Mesh::cube() };
        let World { mut scene, mut dice } = World::of_one(seed, mesh);
        let (mut compiler, origin) = compiled(&mut scene);
        let drawn = drawn(&mut scene, origin, u32::MAX);
        let queries = Queries::new(&mut compiler, &mut scene).unwrap();
        for drawn in &drawn {
            for _ in 0..40 {
                let local = dice.random.in_cube().as_dvec3() * 1.2;
                let point = drawn.world_from_local.transform_point3(local) + origin;
                let local = drawn.local_from_world.transform_point3(point - origin);
                let heights =
                    drawn.triangles.iter().map(|&(_, [a, b, c])| (local - a).dot((b - a).cross(c - a).normalize()));
                let greatest = heights.fold(f64::MIN, f64::max);
                if greatest.abs() < 1e-6 {
                    continue;
                }
                let is_inside = greatest < 0.0;
                prop_assert_eq!(
                    queries.solids_containing(point).unwrap().len(),
                    usize::from(is_inside),
                    "{} out",
                    greatest
                );
                let counter = if is_inside { &inside } else { &outside };
                counter.set(counter.get() + 1);
            }
        }
        Ok(())
    });
    assert!(inside.get() > 1000 && outside.get() > 1000, "{} and {}", inside.get(), outside.get());
}

/// Points of a lattice, so that the rays of the inside test run through edges and corners.
#[test]
fn a_lattice_of_points_is_told_apart() {
    let mut scene = Scene::new();
    let cube = Mesh::cube();
    let geometry = scene.add_geometry(Geometry::new(cube.positions, cube.indices)).unwrap();
    let material = scene.add_material(Material::default()).unwrap();
    scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
    let mut compiler = Compiler::new();
    let queries = Queries::new(&mut compiler, &mut scene).unwrap();
    for i in 0..9 * 9 * 9 {
        let point = DVec3::new(f64::from(i % 9), f64::from(i / 9 % 9), f64::from(i / 81)) / 4.0 - 1.125;
        let is_inside = point.abs().max_element() < 1.0;
        assert_eq!(queries.solids_containing(point).unwrap().len(), usize::from(is_inside), "{point}");
    }
}
