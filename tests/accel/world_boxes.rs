//! World boxes of instances: they contain every corner, and are hardly larger than necessary.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use ropewalk::accel::{Blas, BlasBuildParams, SupportFunction};
use ropewalk::math::Bounds;

use super::meshes::{adversarial, beyond_arithmetic, geometry, grid};
use ropewalk_testkit::{Mesh, Random};

/// The exact world box, computed in f64 from every corner.
fn brute_force(blas: &Blas, world_from_local: &DAffine3) -> Bounds {
    let corners = blas.triangles.iter().flat_map(|t| [t.v0, t.v1, t.v2]);
    corners.fold(Bounds::EMPTY, |bounds, corner| {
        let corner = world_from_local.transform_point3(glam::Vec3::from(corner).as_dvec3());
        bounds.union(Bounds { min: corner, max: corner })
    })
}

fn random_affine(random: &mut Random) -> DAffine3 {
    let axis = random.direction().as_dvec3();
    let rotation = DQuat::from_axis_angle(axis.normalize(), f64::from(random.signed()) * 3.0);
    let scale = random.in_cube().as_dvec3() * 3.0;
    let shear =
        DMat3::from_cols_array(&std::array::from_fn(|i| f64::from(i % 4 == 0) + 0.3 * f64::from(random.signed())));
    DAffine3 {
        matrix3: DMat3::from_quat(rotation) * DMat3::from_diagonal(scale) * shear,
        translation: random.in_cube().as_dvec3() * 100.0,
    }
}

/// The greatest distance between a side of the box and the same side of the exact box, in units of half the length of
/// the local box's diagonal in the world. Fails if the box is too small.
fn excess(name: &str, blas: &Blas, support: &SupportFunction, world_from_local: &DAffine3) -> f64 {
    let (expected, found) = (brute_force(blas, world_from_local), support.world_bounds(world_from_local));
    let size = Bounds::from(blas.bounds).radius();
    let tolerance = 1e-12 * (size + expected.min.abs().max(expected.max.abs()).max_element());
    assert!((found.min - expected.min).max_element() <= tolerance, "{name}: {found:?}, {expected:?}");
    assert!((expected.max - found.max).max_element() <= tolerance, "{name}: {found:?}, {expected:?}");
    let rows = world_from_local.matrix3.transpose();
    let lengths = DVec3::new(rows.x_axis.length(), rows.y_axis.length(), rows.z_axis.length());
    let more = (expected.min - found.min).max(found.max - expected.max) - tolerance;
    (more / (lengths * size)).max_element()
}

#[test]
fn boxes_are_around_all_corners_and_tight() {
    let mut random = Random::new(7);
    let mut compared = 0;
    let meshes = [
        ("icosphere", Mesh::icosphere(4)),
        ("fine icosphere", Mesh::icosphere(6)),
        ("displaced", Mesh::displaced_icosphere(4)),
        ("tall grid", grid(90, 3, 1, 2.0)),
    ];
    for (name, mesh) in adversarial().into_iter().chain(beyond_arithmetic()).chain(meshes) {
        let blas = Blas::build(&geometry(&mesh), &BlasBuildParams::default()).unwrap();
        let support = SupportFunction::new(&blas);
        let mut worst = 0.0f64;
        for _ in 0..200 {
            worst = worst.max(excess(name, &blas, &support, &random_affine(&mut random)));
            compared += 1;
        }
        println!("{name}: {worst:.5}");
        let is_fine = blas.triangles.len() >= 16_384;
        assert!(worst <= if is_fine { 0.09 } else { 0.18 }, "{name}: {worst}");
        if name.ends_with("icosphere") {
            // Half the diagonal of a sphere's box is the square root of 3 times its radius.
            let of_radius = worst * 3f64.sqrt();
            assert!(of_radius <= if is_fine { 0.004 } else { 0.016 }, "{name}: {of_radius}");
        }
    }
    assert!(compared > 4000);
}

#[test]
fn few_corners_give_exact_boxes() {
    let mut random = Random::new(8);
    for mesh in [Mesh::soup(1, 1), Mesh::soup(2, 20), Mesh::icosphere(1), grid(7, 7, 0, 1.0)] {
        let blas = Blas::build(&geometry(&mesh), &BlasBuildParams::default()).unwrap();
        let support = SupportFunction::new(&blas);
        for _ in 0..100 {
            assert!(excess("few", &blas, &support, &random_affine(&mut random)) <= 0.0);
        }
    }
}

#[test]
fn without_rotation_boxes_are_exact() {
    let blas = Blas::build(&geometry(&Mesh::displaced_icosphere(4)), &BlasBuildParams::default()).unwrap();
    let support = SupportFunction::new(&blas);
    let turns = [
        DMat3::IDENTITY,
        DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X),
        DMat3::from_cols(-DVec3::Y, DVec3::X, DVec3::Z),
    ];
    for turn in turns {
        for scale in [DVec3::ONE, DVec3::new(2.0, -3.0, 1e-3)] {
            let affine = DAffine3 { matrix3: turn * DMat3::from_diagonal(scale), translation: DVec3::splat(7.0) };
            assert!(excess("turned", &blas, &support, &affine) <= 1e-7);
        }
    }
}

#[test]
fn nothing_has_an_empty_box_and_a_flat_matrix_a_flat_one() {
    let nothing =
        SupportFunction::new(&Blas::build(&ropewalk::Geometry::default(), &BlasBuildParams::default()).unwrap());
    assert!(nothing.world_bounds(&DAffine3::IDENTITY).is_empty());
    let sphere =
        SupportFunction::new(&Blas::build(&geometry(&Mesh::icosphere(4)), &BlasBuildParams::default()).unwrap());
    let flat = DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0));
    let bounds = sphere.world_bounds(&flat);
    assert_eq!((bounds.min.y, bounds.max.y), (0.0, 0.0));
    assert!(bounds.max.x > 0.99);
}
