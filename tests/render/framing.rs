//! What a scene is framed by, and from where.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use glam::{DAffine3, DQuat, DVec3, Vec3};
use ropewalk::graph::Switch;
use ropewalk::math::Bounds;
use ropewalk::{Core, Geometry, Material, NodeKey, Scene, Transform, View};
use ropewalk_testkit::{Mesh, Random};

fn put(scene: &mut Scene, below: NodeKey, mesh: &Mesh, place: DAffine3, double_sided: bool) -> NodeKey {
    let geometry = scene.add_geometry(Geometry::new(mesh.positions.clone(), mesh.indices.clone())).unwrap();
    let material = scene.add_material(Material { double_sided, ..Material::default() }).unwrap();
    let node = scene.add(below, Transform::Matrix(place)).unwrap();
    scene.add(node, Core::Geometry { geometry, material }).unwrap()
}

/// The box around all vertices.
fn brute_force(meshes: &[(Mesh, DAffine3)]) -> Bounds {
    let points = meshes.iter().flat_map(|(mesh, place)| {
        mesh.indices.as_flattened().iter().map(|&v| place.transform_point3(mesh.positions[v as usize].as_dvec3()))
    });
    points.fold(Bounds::EMPTY, |bounds, p| bounds.union(Bounds { min: p, max: p }))
}

#[test]
fn a_turned_sphere_is_as_large_as_one_that_is_not() {
    let mut scene = Scene::new();
    let root = scene.root();
    let turned = DAffine3::from_rotation_z(FRAC_PI_4);
    put(&mut scene, root, &Mesh::icosphere(4), turned, true);
    let bounds = scene.visible_bounds(root).unwrap();
    assert!(bounds.max.max_element() < 1.0 + 1e-6 && bounds.min.min_element() > -1.0 - 1e-6, "{bounds:?}");
    assert!((scene.world_bounds(root).unwrap().max.x - 2f64.sqrt()).abs() < 0.01, "the box of the turned box");
}

#[test]
fn bounds_are_those_of_all_vertices() {
    let mut random = Random::new(3);
    let (mut scene, mut placed) = (Scene::new(), Vec::new());
    let root = scene.root();
    for i in 0..40 {
        let mesh = if i % 2 == 0 { Mesh::icosphere(2) } else { Mesh::cube() };
        let (axis, offset) = (random.in_cube().as_dvec3().normalize(), random.in_cube().as_dvec3() * 9.0);
        let scale = random.in_cube().as_dvec3() * 2.0;
        let place =
            DAffine3::from_scale_rotation_translation(scale, DQuat::from_axis_angle(axis, f64::from(i)), offset);
        put(&mut scene, root, &mesh, place, true);
        placed.push((mesh, place));
    }
    assert_eq!(scene.visible_bounds(root).unwrap(), brute_force(&placed));
}

#[test]
fn what_is_hidden_does_not_count() {
    let mut scene = Scene::new();
    let root = scene.root();
    let switch = scene.add(root, Switch::One(0)).unwrap();
    put(&mut scene, switch, &Mesh::cube(), DAffine3::IDENTITY, true);
    put(&mut scene, switch, &Mesh::cube(), DAffine3::from_translation(DVec3::X * 100.0), true);
    let hidden = put(&mut scene, root, &Mesh::cube(), DAffine3::from_translation(DVec3::Y * 100.0), true);
    let masked = put(&mut scene, root, &Mesh::cube(), DAffine3::from_translation(DVec3::Z * 100.0), true);
    scene.set_visible(hidden, false).unwrap();
    scene.set_mask(masked, 0).unwrap();
    assert_eq!(scene.visible_bounds(root).unwrap(), Bounds { min: DVec3::NEG_ONE, max: DVec3::ONE });
    assert_eq!(scene.world_bounds(root).unwrap().max, DVec3::splat(101.0));
    // The camera is near the cube that is seen.
    let view = View::framing(&mut scene, 64, 64).unwrap();
    assert!(view.world_from_view.translation.length() < 12.0, "{:?}", view.world_from_view.translation);
    // Below a node.
    assert!(scene.visible_bounds(hidden).unwrap().is_empty());
}

#[test]
fn flat_scenes_are_seen_face_on() {
    let square = Mesh {
        positions: vec![
            Vec3::new(-1.0, -1.0, 0.0),
            Vec3::new(1.0, -1.0, 0.0),
            Vec3::ONE.with_z(0.0),
            Vec3::new(-1.0, 1.0, 0.0),
        ],
        indices: vec![[0, 1, 2], [0, 2, 3]],
    };
    let (x, y) = (DAffine3::from_rotation_x, DAffine3::from_rotation_y);
    let mirrored = DAffine3::from_scale(DVec3::new(1.0, 1.0, -1.0));
    // The placement of a square that faces +Z, whether it is double-sided, and the direction to the camera.
    for (place, double_sided, expected) in [
        (DAffine3::IDENTITY, true, DVec3::Z),
        (DAffine3::IDENTITY, false, DVec3::Z),
        (y(PI), true, DVec3::Z),
        (y(PI), false, DVec3::NEG_Z),
        (y(FRAC_PI_2), false, DVec3::X),
        (y(-FRAC_PI_2), false, DVec3::NEG_X),
        (x(-FRAC_PI_2), false, DVec3::Y),
        (x(FRAC_PI_2), false, DVec3::NEG_Y),
        (mirrored, false, DVec3::NEG_Z),
        (y(PI) * mirrored, false, DVec3::Z),
    ] {
        let mut scene = Scene::new();
        let root = scene.root();
        let place = DAffine3::from_translation(DVec3::new(300.0, -20.0, 7.0)) * place;
        put(&mut scene, root, &square, place, double_sided);
        let view = View::framing(&mut scene, 40, 30).unwrap();
        let camera = view.world_from_view;
        assert!((camera.matrix3.z_axis - expected).length() < 1e-9, "{place:?}: from {:?}", camera.matrix3.z_axis);
        assert!((camera.translation - DVec3::new(300.0, -20.0, 7.0)).normalize().dot(expected) > 1.0 - 1e-9);
    }
    // A box is not flat, a slab of less than a thousandth is.
    for (thickness, is_flat) in [(0.01, false), (0.0009, true)] {
        let mut scene = Scene::new();
        let root = scene.root();
        put(&mut scene, root, &Mesh::cube(), DAffine3::from_scale(DVec3::new(1.0, 1.0, thickness)), true);
        let camera = View::framing(&mut scene, 40, 30).unwrap().world_from_view;
        assert_eq!(camera.matrix3.z_axis.z > 0.999, is_flat, "{thickness}");
    }
}
