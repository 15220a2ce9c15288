//! Edits of the scene: each test checks one rule.
#![expect(clippy::unwrap_used, reason = "helpers of tests")]

use std::f32::consts::PI;

use glam::{Affine2, DAffine3, DMat3, DQuat, DVec3, Vec2, Vec3, Vec4};
use ropewalk::graph::{AlphaMode, Changes, KeepTransform, LightKind, TextureRef};
use ropewalk::math::Bounds;
use ropewalk::{Camera, Core, Error, Geometry, Light, Material, NodeKey, Scene, Texture, Transform};

const X: DVec3 = DVec3::X;

fn place(scene: &Scene, node: NodeKey) -> DVec3 {
    scene.world_from_local(node).unwrap().translation
}

fn triangle(scene: &mut Scene) -> Core {
    let geometry = scene.add_geometry(Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 2]])).unwrap();
    Core::Geometry { geometry, material: scene.add_material(Material::default()).unwrap() }
}

/// Checks that a call fails and leaves the scene as it was.
fn assert_fails<T: std::fmt::Debug>(
    scene: &mut Scene,
    call: impl FnOnce(&mut Scene) -> ropewalk::Result<T>,
    is_expected: impl FnOnce(&Error) -> bool,
) {
    let before = format!("{scene:?}");
    let error = call(scene).unwrap_err();
    assert!(is_expected(&error), "{error}");
    assert_eq!(format!("{scene:?}"), before, "after: {error}");
}

fn out_of_range(error: &Error) -> bool {
    matches!(error, Error::OutOfRange { .. })
}

#[test]
fn scenes_can_be_told_apart_and_sent_to_threads() {
    let (one, other) = (Scene::new(), Scene::new());
    assert_ne!(one.id(), other.id());
    let id = one.id();
    assert_eq!(std::thread::spawn(move || one.id()).join().unwrap(), id);
}

#[test]
fn nodes_that_share_a_core_move_together() {
    let mut scene = Scene::new();
    let one = scene.add(scene.root(), Transform::from_translation(X)).unwrap();
    let core = scene.core_key(one).unwrap();
    let other = scene.add(one, core).unwrap();
    scene.set_local(one, Transform::from_translation(X * 2.0)).unwrap();
    assert_eq!((place(&scene, one), place(&scene, other)), (X * 2.0, X * 4.0));
}

#[test]
fn keeping_the_world_leaves_the_sharers_where_they_are() {
    let mut scene = Scene::new();
    let parent = scene.add(scene.root(), Transform::from_translation(X * 5.0)).unwrap();
    let one = scene.add(scene.root(), Transform::from_translation(X)).unwrap();
    let core = scene.core_key(one).unwrap();
    let other = scene.add(scene.root(), core).unwrap();

    scene.reparent(one, parent, KeepTransform::World).unwrap();
    assert_eq!((place(&scene, one), place(&scene, other)), (X, X));
    assert_eq!((scene.core_key(other).unwrap(), scene.local(one).unwrap().to_affine().translation), (core, X * -4.0));
    assert_ne!(scene.core_key(one).unwrap(), core);
    scene.validate().unwrap();
}

#[test]
fn keeping_the_world_works_under_shear_and_reflection() {
    let mut scene = Scene::new();
    let shear = DMat3::from_cols(DVec3::new(-3.0, 0.2, 0.0), DVec3::new(0.5, 1.0, 0.0), DVec3::new(0.0, 0.3, 1e-3));
    let parent = scene.add(scene.root(), Transform::Matrix(DAffine3 { matrix3: shear, translation: X * 1e7 })).unwrap();
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 1.0);
    let node = scene.add(scene.root(), Transform::from_rotation(turn)).unwrap();
    let world = scene.world_from_local(node).unwrap();
    scene.reparent(node, parent, KeepTransform::World).unwrap();
    let found = scene.world_from_local(node).unwrap();
    assert!(found.matrix3.abs_diff_eq(world.matrix3, 1e-10), "{found} is not {world}");
    assert!(found.translation.abs_diff_eq(world.translation, 1e-7), "{found} is not {world}");
}

#[test]
fn keeping_the_world_below_equal_worlds_changes_no_transform() {
    let mut scene = Scene::new();
    let group = scene.add(scene.root(), Core::Group).unwrap();
    let node = scene.add(scene.root(), Transform::from_scale(DVec3::new(0.1, 0.2, 0.3))).unwrap();
    let local = scene.local(node).unwrap();
    scene.reparent(node, group, KeepTransform::World).unwrap();
    assert_eq!((scene.local(node).unwrap(), scene.parent(node).unwrap()), (local, Some(group)));
}

#[test]
fn no_world_can_be_kept_below_a_singular_one() {
    let mut scene = Scene::new();
    let node = scene.add(scene.root(), Transform::from_translation(X)).unwrap();
    let turn = |angle: f64| DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), angle);
    let turned = scene.add(scene.root(), Transform::from_rotation(turn(1.0))).unwrap();
    let flat = scene.add(turned, Transform::from_scale(DVec3::new(1.0, 0.0, 1.0))).unwrap();
    let mut parents = vec![flat];
    // Singular matrices between rotations: the determinant of some is a rounding error instead of 0.
    for angle in 1..20 {
        parents.push(scene.add(flat, Transform::from_rotation(turn(f64::from(angle)))).unwrap());
    }
    assert!(parents.iter().any(|&parent| scene.world_from_local(parent).unwrap().matrix3.determinant() != 0.0));
    let vast = scene.add(scene.root(), Transform::from_scale(DVec3::splat(1e200))).unwrap();
    let infinite = scene.add(vast, Transform::from_scale(DVec3::splat(1e200))).unwrap();
    parents.push(infinite);
    for parent in parents {
        let is_singular = |error: &Error| *error == Error::Singular { node, parent };
        assert_fails(&mut scene, |scene| scene.reparent(node, parent, KeepTransform::World), is_singular);
    }
    scene.reparent(node, flat, KeepTransform::Local).unwrap();
}

#[test]
fn transforms_that_overflow_are_defined() {
    let mut scene = Scene::new();
    let vast = scene.add(scene.root(), Transform::from_scale(DVec3::splat(1e200))).unwrap();
    let vaster = scene.add(vast, Transform::from_scale(DVec3::splat(1e200))).unwrap();
    let core = triangle(&mut scene);
    let node = scene.add(vaster, core).unwrap();
    let walked = scene.world_from_local(node).unwrap();
    assert!(!walked.is_finite());
    let index = scene.hierarchy().unwrap().entry(node).unwrap();
    let bits = |world: DAffine3| world.to_cols_array().map(f64::to_bits);
    assert_eq!(bits(scene.hierarchy().unwrap().resolved()[index].world_from_local), bits(walked));
    let _ = scene.world_bounds(scene.root()).unwrap();
    scene.validate().unwrap();
}

#[test]
fn bounds_are_those_of_triangles_where_they_are() {
    let mut scene = Scene::new();
    let unused = Vec3::splat(9.0);
    let geometry = Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y, unused], [[0, 1, 2]]);
    let geometry = scene.add_geometry(geometry).unwrap();
    let material = scene.add_material(Material::default()).unwrap();
    let moved = scene.add(scene.root(), Transform::from_translation(X * 10.0)).unwrap();
    let shown = scene.add(moved, Core::Geometry { geometry, material }).unwrap();
    let hidden = scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
    scene.set_visible(hidden, false).unwrap();

    let bounds = |min, max| Bounds { min, max };
    assert_eq!(scene.geometry_bounds(geometry).unwrap(), bounds(DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0)));
    assert_eq!(scene.world_bounds(shown).unwrap(), bounds(X * 10.0, DVec3::new(11.0, 1.0, 0.0)));
    assert_eq!(scene.world_bounds(scene.root()).unwrap(), bounds(DVec3::ZERO, DVec3::new(11.0, 1.0, 0.0)));
    scene.set_geometry(geometry, Geometry::default()).unwrap();
    assert!(scene.world_bounds(scene.root()).unwrap().is_empty());
    assert_eq!(scene.geometry_version(geometry).unwrap(), 1);
}

#[test]
fn assets_live_while_they_are_used() {
    let mut scene = Scene::new();
    let texture = scene.add_texture(Texture { width: 1, height: 1, texels: [[0; 4]].into() }).unwrap();
    let base_color_texture = Some(TextureRef::new(texture));
    let textured = scene.add_material(Material { base_color_texture, ..Material::default() }).unwrap();
    let plain = scene.add_material(Material::default()).unwrap();
    let geometry = scene.add_geometry(Geometry::default()).unwrap();
    let never_used = scene.add_geometry(Geometry::default()).unwrap();
    let node = scene.add(scene.root(), Core::Geometry { geometry, material: textured }).unwrap();
    let other = scene.add(scene.root(), scene.core_key(node).unwrap()).unwrap();

    // The old material goes with its texture, the geometry is still in use.
    scene.set_core(scene.core_key(node).unwrap(), Core::Geometry { geometry, material: plain }).unwrap();
    assert!(scene.material(textured).is_err() && scene.texture(texture).is_err());
    scene.remove(node).unwrap();
    assert!(scene.geometry(geometry).is_ok() && scene.material(plain).is_ok());
    scene.assign_core(other, Core::Group).unwrap();
    assert!(scene.geometry(geometry).is_err() && scene.material(plain).is_err());

    assert!(scene.geometry(never_used).is_ok());
    scene.remove_unused();
    assert_eq!((scene.geometry_count(), scene.core_count()), (0, 2));
    scene.validate().unwrap();
}

#[test]
fn the_root_stays_what_it_is() {
    let mut scene = Scene::new();
    let root = scene.root();
    let group = scene.add(root, scene.core_key(root).unwrap()).unwrap();
    let transform = scene.add(root, Transform::IDENTITY).unwrap();
    let (group_core, transform_core) = (scene.core_key(group).unwrap(), scene.core_key(transform).unwrap());
    let is_root = |error: &Error| matches!(error, Error::Root { .. });
    assert_fails(&mut scene, |scene| scene.remove(root), is_root);
    assert_fails(&mut scene, |scene| scene.reparent(root, group, KeepTransform::Local), is_root);
    assert_fails(&mut scene, |scene| scene.assign_core(root, Transform::IDENTITY), is_root);
    assert_fails(&mut scene, |scene| scene.assign_core(root, transform_core), is_root);
    assert_fails(&mut scene, |scene| scene.set_core(group_core, Core::Camera(Camera::default())), is_root);
    scene.assign_core(root, Core::Group).unwrap();
    scene.set_core(group_core, Core::Camera(Camera::default())).unwrap();
    scene.validate().unwrap();
}

#[test]
fn bad_materials_are_refused() {
    let mut scene = Scene::new();
    let texture = scene.add_texture(Texture { width: 1, height: 1, texels: [[0; 4]].into() }).unwrap();
    let good = scene.add_material(Material::default()).unwrap();
    let reference = TextureRef::new(texture);
    let far = Affine2::from_translation(Vec2::splat(f32::INFINITY));
    let edits: [fn(&mut Material); 11] = [
        |m| m.base_color = Vec4::new(0.0, 0.0, 0.0, 1.1),
        |m| m.base_color.x = f32::NAN,
        |m| m.metallic = -0.1,
        |m| m.roughness = 2.0,
        |m| m.transmission = f32::NAN,
        |m| m.emissive.y = f32::INFINITY,
        |m| m.emissive.z = -1.0,
        |m| m.ior = 0.5,
        |m| m.ior = f32::INFINITY,
        |m| m.alpha_mode = AlphaMode::Mask { cutoff: f32::NAN },
        |m| m.normal_scale = f32::NEG_INFINITY,
    ];
    let mut bad: Vec<Material> = edits
        .into_iter()
        .map(|edit| {
            let mut material = Material::default();
            edit(&mut material);
            material
        })
        .collect();
    for reference in [TextureRef { tex_coord: 2, ..reference }, TextureRef { transform: far, ..reference }] {
        bad.push(Material { emissive_texture: Some(reference), ..Material::default() });
    }
    for material in bad {
        let (one, other) = (material.clone(), material);
        assert_fails(&mut scene, |scene| scene.add_material(one), out_of_range);
        assert_fails(&mut scene, |scene| scene.set_material(good, other), out_of_range);
    }
    let of_limits = Material { ior: 0.0, transmission: 1.0, roughness: 0.0, ..Material::default() };
    scene.set_material(good, of_limits).unwrap();
}

#[test]
fn bad_lights_cameras_transforms_and_textures_are_refused() {
    let light = |kind, intensity, range| Light { kind, color: Vec3::ONE, intensity, range };
    let spot = |inner, outer| LightKind::Spot { inner_cone_angle: inner, outer_cone_angle: outer };
    let perspective = |y_fov, aspect| Core::Camera(Camera::Perspective { y_fov, aspect, shift: Vec2::ZERO });
    let orthographic = |x_mag, y_mag| Core::Camera(Camera::orthographic(x_mag, y_mag));
    let dark = Light { color: Vec3::new(0.0, -1.0, 0.0), ..light(LightKind::Point, 1.0, None) };
    let bad = [
        Core::Light(dark),
        Core::Light(light(LightKind::Point, f32::NAN, None)),
        Core::Light(light(LightKind::Directional, -1.0, None)),
        Core::Light(light(LightKind::Point, 1.0, Some(0.0))),
        Core::Light(light(spot(0.1, 2.0), 1.0, None)),
        Core::Light(light(spot(0.2, 0.1), 1.0, None)),
        Core::Light(light(spot(0.0, 0.0), 1.0, None)),
        perspective(0.0, None),
        perspective(PI, None),
        perspective(1.0, Some(f32::NAN)),
        orthographic(0.0, 1.0),
        orthographic(1.0, f32::INFINITY),
        Core::Camera(Camera::default().with_lens_shift(Vec2::new(0.0, f32::NAN))),
        Core::Transform(Transform::from_scale(DVec3::new(1.0, f64::NAN, 1.0))),
        // Each factor is finite, but their product is not.
        Core::Transform(Transform::Trs { translation: X, rotation: DQuat::from_xyzw(1e200, 0.0, 0.0, 0.0), scale: X }),
    ];
    let mut scene = Scene::new();
    let node = scene.add(scene.root(), Transform::IDENTITY).unwrap();
    let key = scene.core_key(node).unwrap();
    for core in bad {
        for call in 0..3 {
            let core = core.clone();
            let edit = |scene: &mut Scene| match call {
                0 => scene.add(node, core).map(|_| ()),
                1 => scene.assign_core(node, core),
                _ => scene.set_core(key, core),
            };
            assert_fails(&mut scene, edit, out_of_range);
        }
    }
    for (width, height, texels) in [(0, 0, 0), (2, 2, 3), (0, 4, 0), (u32::MAX, u32::MAX, 1)] {
        let texture = Texture { width, height, texels: vec![[0; 4]; texels].into() };
        assert_fails(&mut scene, |scene| scene.add_texture(texture), out_of_range);
    }
}

#[test]
fn one_entry_for_many_edits_of_one_object() {
    let mut scene = Scene::new();
    let node = scene.add(scene.root(), Transform::IDENTITY).unwrap();
    let mut cursor = scene.subscribe();
    assert_eq!(scene.changes_since(&mut cursor), Changes::Everything);
    for i in 0..100 {
        scene.set_local(node, Transform::from_translation(X * f64::from(i))).unwrap();
        scene.set_mask(node, i).unwrap();
        let passing = scene.add(node, Core::Group).unwrap();
        scene.remove(passing).unwrap();
    }
    let Changes::Since(changes) = scene.changes_since(&mut cursor) else { panic!("it has read before") };
    assert_eq!(changes.len(), 2, "{changes:?}");
}
