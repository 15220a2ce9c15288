//! Matrices that shear: how far f32 displaces what they place, and what is said of it.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use glam::{DAffine3, DMat3, DQuat, DVec3};
use ropewalk::compile::{CompileReport, Compiler};
use ropewalk::query::Queries;
use ropewalk::{Core, Geometry, Material, Ray, Scene, Transform};
use ropewalk_testkit::Mesh;

fn turned(angle: f64) -> DMat3 {
    DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(0.3, -0.5, 0.8).normalize(), angle))
}

/// A cube under this matrix, compiled for an eye at the origin, and the greatest displacement of a corner: of the
/// inverse of the f32 `local_from_world` against the matrix, relative to the corner's coordinates and the translation.
fn compiled(place: DAffine3) -> (Scene, Compiler, CompileReport, f64) {
    let mut scene = Scene::new();
    let cube = Mesh::cube();
    let geometry = scene.add_geometry(Geometry::new(cube.positions.clone(), cube.indices)).unwrap();
    let material = scene.add_material(Material { double_sided: true, ..Material::default() }).unwrap();
    let node = scene.add(scene.root(), Transform::Matrix(place)).unwrap();
    scene.add(node, Core::Geometry { geometry, material }).unwrap();
    let mut compiler = Compiler::new();
    let report = compiler.compile(&mut scene, DVec3::ZERO).unwrap();
    let rows = compiler.arrays().instances[0].local_from_world.map(|row| row.map(f64::from));
    let linear = DMat3::from_cols_array_2d(&rows.map(|[x, y, z, _]| [x, y, z])).transpose();
    let drawn = DAffine3::from_mat3_translation(linear, DVec3::from_array(rows.map(|row| row[3]))).inverse();
    let displacement = |corner: DVec3| {
        let exact = place.transform_point3(corner);
        let coordinates = exact.abs().max_element() + place.translation.abs().max_element();
        (drawn.transform_point3(corner) - exact).abs().max_element() / coordinates
    };
    let greatest = cube.positions.iter().map(|p| displacement(p.as_dvec3())).fold(0.0, f64::max);
    (scene, compiler, report, greatest)
}

#[test]
fn what_is_turned_and_scaled_is_placed_as_promised_and_shears_are_reported() {
    let (mut reported, mut close) = (0, 0);
    for i in 0..400 {
        let k = 10f64.powi(i % 8);
        let (before, after) = (turned(f64::from(i)), turned(f64::from(i) * 2.3 + 1.0));
        let scale = DMat3::from_diagonal(DVec3::new(1.0, k.sqrt(), k));
        let translation = DVec3::new(3.0, -2.0, 1.0) * f64::from(i % 3);
        // Turned after the scale only: within 2^-22.
        let (_, _, report, displacement) = compiled(DAffine3::from_mat3_translation(after * scale, translation));
        assert!(displacement < 2f64.powi(-22), "{i}, {k:e}: {displacement:e}");
        assert_eq!((report.displaced_instances, report.greatest_displacement), (0, 0.0), "{i}, {k:e}");
        // Before and after: within the bound that is reported, and that is not far off.
        let (_, _, report, displacement) =
            compiled(DAffine3::from_mat3_translation(after * scale * before, translation));
        if report.displaced_instances == 0 {
            assert!(displacement < 2f64.powi(-20), "{i}, {k:e}: {displacement:e}");
        } else if report.greatest_displacement < 2f64.powi(-8) {
            let bound = report.greatest_displacement;
            assert!(displacement <= bound, "{i}, {k:e}: {displacement:e} of {bound:e}");
            (reported, close) = (reported + 1, close + usize::from(bound < 200.0 * displacement));
        }
    }
    assert!(reported > 100 && close > reported / 4, "{close} of {reported}");
}

#[test]
fn exact_queries_are_not_displaced() {
    let mut hits = 0;
    for i in 0..80 {
        let k = 10f64.powi(i % 10);
        let scale = DMat3::from_diagonal(DVec3::new(1.0, k.sqrt(), k));
        let place = DAffine3::from_mat3(turned(f64::from(i)) * scale * turned(2.0));
        let (mut scene, mut compiler, ..) = compiled(place);
        let queries = Queries::new(&mut compiler, &mut scene).unwrap();
        for j in 0..20 {
            // From outside at a point of the cube's face z = 1.
            let at = DVec3::new(f64::from(j) * 0.09 - 0.9, f64::from(j * 7 % 20) * 0.09 - 0.85, 1.0);
            let (from, to) = (place.transform_point3(at + DVec3::new(0.3, 0.2, 2.0)), place.transform_point3(at));
            let hit = queries.closest_hit(&Ray::new(from, to - from)).unwrap().unwrap();
            // The matrix is inverted in f64, and so displaces by as much as f64 does.
            assert!((hit.distance - 1.0).abs() < 1e-12 * k, "{i}, {k:e}: {}", hit.distance);
            hits += 1;
        }
    }
    assert_eq!(hits, 1600);
}
