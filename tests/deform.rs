//! Geometries that deform, and the structures they get.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use std::sync::Arc;

use glam::Vec3;
use ropewalk::{Change, Changes, Core, Cursor, Delta, Error, Geometry, Material, Object, Quality, Scene, Structure};

const CORNERS: [Vec3; 4] = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE];

fn two_triangles() -> Geometry {
    Geometry::new(CORNERS, [[0, 1, 2], [1, 3, 2]])
}

#[test]
fn set_positions_keeps_the_triangles_and_can_be_undone() {
    let mut scene = Scene::new();
    let key = scene.add_geometry(two_triangles()).unwrap();
    let material = scene.add_material(Material::default()).unwrap();
    let node = scene.add(scene.root(), Core::Geometry { geometry: key, material }).unwrap();
    let before = scene.geometry(key).unwrap().clone();
    let version = scene.geometry_version(key).unwrap();
    scene.enable_undo();
    let mut cursor = Cursor::default();
    let _ = scene.changes_since(&mut cursor);

    scene.set_positions(key, CORNERS, None).unwrap();
    assert_eq!(scene.changes_since(&mut cursor), Changes::Since(vec![]), "set to what it was");
    scene.set_positions(key, CORNERS.map(|p| p * 2.0), Some(Arc::new([Vec3::Z; 4]))).unwrap();
    let after = scene.geometry(key).unwrap().clone();
    assert!(Arc::ptr_eq(&after.indices, &before.indices));
    assert_eq!((after.positions[3], after.normals.as_deref()), (Vec3::splat(2.0), Some(&[Vec3::Z; 4][..])));
    assert!(scene.geometry_version(key).unwrap() > version);
    assert_eq!(scene.world_bounds(node).unwrap().max, glam::DVec3::splat(2.0), "boxes above follow");
    assert_eq!(scene.changes_since(&mut cursor), Changes::Since(vec![(Object::Geometry(key), Change::DATA)]));

    scene.set_positions(key, CORNERS, None).unwrap();
    assert_eq!(scene.geometry(key).unwrap().normals, after.normals, "the normals stay");
    scene.end_undo_group("deform");
    scene.undo().unwrap();
    assert_eq!(*scene.geometry(key).unwrap(), before);
    scene.redo().unwrap();
    assert_eq!(scene.geometry(key).unwrap().normals, after.normals);
    scene.validate().unwrap();
}

#[test]
fn bad_positions_are_refused() {
    let mut scene = Scene::new();
    let key = scene.add_geometry(two_triangles()).unwrap();
    let before = format!("{scene:?}");
    let mut broken = CORNERS;
    broken[2].y = f32::INFINITY;
    let cases: [(&[Vec3], Option<Arc<[Vec3]>>, _); 4] = [
        (&CORNERS[..3], None, ("positions", 3)),
        (&broken, None, ("positions", 2)),
        (&CORNERS, Some(Arc::new([Vec3::Z; 5])), ("normals", 5)),
        (&CORNERS, Some(Arc::new([Vec3::NAN; 4])), ("normals", 0)),
    ];
    for (positions, normals, at) in cases {
        match scene.set_positions(key, positions, normals) {
            Err(Error::InvalidGeometry { what, index, .. }) => assert_eq!((what, index), at),
            other => assert!(other.is_err(), "{at:?} was taken"),
        }
    }
    assert_eq!(format!("{scene:?}"), before);
    scene.remove_unused();
    assert!(matches!(scene.set_positions(key, CORNERS, None), Err(Error::StaleKey { .. })));
}

#[test]
fn the_choice_of_a_structure_travels() {
    let mut scene = Scene::new();
    let key = scene.add_geometry(two_triangles().with_structure(Structure::KdTree)).unwrap();
    let mut cursor = Cursor::default();
    let mut mirror = Scene::new();
    mirror.apply(&scene.delta_since(&mut cursor)).unwrap();
    assert_eq!(mirror.geometry(key).unwrap().structure, Some(Structure::KdTree));

    // A change of nothing else is one.
    let best = Structure::Bvh(Quality::Best);
    scene.set_geometry(key, scene.geometry(key).unwrap().clone().with_structure(best)).unwrap();
    mirror.apply(&scene.delta_since(&mut cursor)).unwrap();
    assert_eq!(mirror.geometry(key).unwrap().structure, Some(best), "though all arrays are shared");

    scene.set_geometry(key, scene.geometry(key).unwrap().clone().with_structure(None)).unwrap();
    let delta = scene.delta_since(&mut cursor);
    let delta: Delta = serde_json::from_slice(&serde_json::to_vec(&delta).unwrap()).unwrap();
    mirror.apply(&delta).unwrap();
    assert_eq!(mirror.geometry(key).unwrap().structure, None);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ropewalk");
    scene.set_geometry(key, two_triangles().with_structure(Structure::KdTree)).unwrap();
    scene.save(&path).unwrap();
    assert_eq!(Scene::load(&path).unwrap().geometry(key).unwrap().structure, Some(Structure::KdTree));
}
