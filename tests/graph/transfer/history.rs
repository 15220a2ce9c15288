//! Undo and redo, case by case.

use std::panic::{AssertUnwindSafe, catch_unwind};

use glam::{DVec3, Vec3};
use ropewalk::graph::KeepTransform;
use ropewalk::{Core, Error, Geometry, Material, Scene, Transform};

use super::content;

#[test]
fn groups_have_names_and_a_limit() {
    let mut scene = Scene::new();
    scene.set_mask(scene.root(), 1).unwrap();
    assert_eq!((scene.undo().unwrap(), scene.redo().unwrap()), (None, None));

    scene.enable_undo();
    assert_eq!(scene.undo().unwrap(), None, "what was before stays");
    for mask in 2..10 {
        scene.set_mask(scene.root(), mask).unwrap();
        scene.end_undo_group(format!("mask {mask}"));
        scene.end_undo_group("nothing");
    }
    scene.set_undo_limit(3);
    for mask in (7..10).rev() {
        assert_eq!(scene.undo().unwrap(), Some(format!("mask {mask}")));
        assert_eq!(scene.mask(scene.root()).unwrap(), mask - 1);
    }
    assert_eq!((scene.undo().unwrap(), scene.next_redo()), (None, Some("mask 7")));
    assert_eq!(scene.redo().unwrap().as_deref(), Some("mask 7"));

    // Edits outside of a named group form a group without a name, and discard what could be redone.
    scene.set_mask(scene.root(), 100).unwrap();
    assert_eq!((scene.next_undo(), scene.next_redo()), (Some(""), None));
    assert_eq!(scene.redo().unwrap(), None);
    assert_eq!(scene.undo().unwrap().as_deref(), Some(""));
    assert_eq!((scene.mask(scene.root()).unwrap(), scene.next_redo()), (7, Some("")));
    scene.disable_undo();
    assert_eq!((scene.undo().unwrap(), scene.redo().unwrap()), (None, None));
}

#[test]
fn removed_objects_come_back_under_their_keys_with_their_streams() {
    let mut scene = Scene::new();
    let geometry = scene.add_geometry(Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 2]])).unwrap();
    let material = scene.add_material(Material::default()).unwrap();
    let nodes: Vec<_> =
        (0..3).map(|_| scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap()).collect();
    let streams = scene.geometry(geometry).unwrap().clone();
    let version = scene.geometry_version(geometry).unwrap();
    let before = content(&scene);

    scene.enable_undo();
    nodes.iter().for_each(|&node| scene.remove(node).unwrap());
    // Other objects reuse the slots.
    let newcomer = scene.add_geometry(Geometry::default()).unwrap();
    let others: Vec<_> = (0..3).map(|_| scene.add(scene.root(), Core::Group).unwrap()).collect();
    scene.reparent(others[0], others[1], KeepTransform::Local).unwrap();
    scene.undo().unwrap();
    assert_eq!(content(&scene), before);
    assert!(
        std::sync::Arc::ptr_eq(&streams.positions, &scene.geometry(geometry).unwrap().positions),
        "shared, not copied"
    );
    assert!(scene.geometry_version(geometry).unwrap() > version, "what was derived from another version is not taken");
    assert!(scene.geometry(newcomer).is_err() && !scene.contains(others[0]));

    scene.redo().unwrap();
    assert!(scene.contains(others[0]) && scene.geometry(newcomer).is_ok() && scene.geometry(geometry).is_err());
    let last = scene.add(scene.root(), Core::Group).unwrap();
    assert!(!nodes.contains(&last) && !others.contains(&last));
}

#[test]
fn a_panic_takes_a_transaction_back() {
    let mut scene = Scene::new();
    scene.enable_undo();
    let before = content(&scene);
    let result = catch_unwind(AssertUnwindSafe(|| {
        scene.transaction(|scene| {
            scene.add(scene.root(), Core::Group)?;
            scene.transaction(|scene| scene.set_mask(scene.root(), 0))?;
            std::panic::resume_unwind(Box::new("a defect in the application"));
            #[expect(unreachable_code, reason = "it tells the type")]
            Ok(())
        })
    }));
    assert!(result.is_err());
    assert_eq!((content(&scene), scene.next_undo()), (before, None));
    scene.validate().unwrap();
    scene.set_mask(scene.root(), 5).unwrap();
    assert_eq!(scene.undo().unwrap().as_deref(), Some(""), "no transaction is open");
}

#[test]
fn a_transaction_is_part_of_its_group() {
    let mut scene = Scene::new();
    scene.enable_undo();
    let node = scene.add(scene.root(), Core::Group).unwrap();
    let name = |scene: &mut Scene, name: &str| -> ropewalk::Result<()> {
        scene.set_name(node, name)?;
        scene.end_undo_group("within a transaction this does nothing");
        if name == "bad" { Err(Error::QueueClosed) } else { Ok(()) }
    };
    scene.transaction(|scene| name(scene, "good")).unwrap();
    scene.transaction(|scene| name(scene, "bad")).unwrap_err();
    assert_eq!(scene.name(node).unwrap(), "good");
    scene.end_undo_group("one");
    assert_eq!(scene.undo().unwrap().as_deref(), Some("one"));
    assert!(!scene.contains(node));
    scene.redo().unwrap();
    assert_eq!(scene.name(node).unwrap(), "good");
}

/// The node is removed and restored between two updates of the hierarchy.
#[test]
fn an_instanced_node_goes_and_comes_back_unseen() {
    let mut scene = Scene::new();
    let (a, b) = (Transform::from_translation(DVec3::X), Transform::from_scale(DVec3::splat(0.5)));
    let a = scene.add(scene.root(), a).unwrap();
    let b = scene.add(scene.root(), b).unwrap();
    let instance = scene.add(scene.root(), Core::Instance(a)).unwrap();
    scene.hierarchy().unwrap();
    let result = scene.transaction(|scene| {
        scene.reparent(a, b, KeepTransform::World)?;
        scene.remove(b)?;
        assert_eq!(*scene.node_core(instance)?, Core::Group);
        Err::<(), _>(Error::QueueClosed)
    });
    assert!(result.is_err());
    assert_eq!(*scene.node_core(instance).unwrap(), Core::Instance(a));
    scene.hierarchy().unwrap();
    scene.validate().unwrap();
}
