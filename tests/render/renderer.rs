//! `Renderer::render`: its report, and that the scene's distance from the origin does not change the image.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use glam::{DAffine3, DQuat, DVec3, Vec3};
use ropewalk::accel::{RebuildReason, TlasUpdate};
use ropewalk::graph::LightKind;
use ropewalk::{
    Camera, Core, DeviceChoice, Error, Geometry, Light, Material, NodeKey, Renderer, RendererOptions, Scene, Transform,
    View,
};

/// A floor and a ring of cubes under one transform node.
fn scene() -> (Scene, NodeKey, Vec<NodeKey>) {
    let mut scene = Scene::new();
    let world = scene.add(scene.root(), Transform::IDENTITY).unwrap();
    let cube = scene.add_geometry(cube()).unwrap();
    let material = scene.add_material(Material::diffuse(Vec3::new(0.7, 0.5, 0.3))).unwrap();
    let mirror = scene.add_material(Material::mirror(Vec3::splat(0.9))).unwrap();
    let floor = Transform::Trs {
        translation: DVec3::new(0.0, -1.0, 0.0),
        rotation: DQuat::IDENTITY,
        scale: DVec3::new(10.0, 0.1, 10.0),
    };
    let floor = scene.add(world, floor).unwrap();
    scene.add(floor, Core::Geometry { geometry: cube, material: mirror }).unwrap();
    let cubes = (0..12)
        .map(|i| {
            let angle = f64::from(i) * std::f64::consts::TAU / 12.0;
            let place = Transform::Trs {
                translation: DVec3::new(angle.cos() * 3.0, 0.0, angle.sin() * 3.0),
                rotation: DQuat::from_rotation_y(angle * 3.0),
                scale: DVec3::splat(0.5),
            };
            let node = scene.add(world, place).unwrap();
            scene.add(node, Core::Geometry { geometry: cube, material }).unwrap();
            node
        })
        .collect();
    let sun = Transform::looking_at(DVec3::new(3.0, 8.0, 4.0), DVec3::ZERO, DVec3::Y);
    let sun = scene.add(world, sun).unwrap();
    let light = Light { kind: LightKind::Directional, color: Vec3::ONE, intensity: 2.0, range: None };
    scene.add(sun, light).unwrap();
    (scene, world, cubes)
}

fn cube() -> Geometry {
    let corner = |i: u32| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) * 2.0 - 1.0;
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles: Vec<[u32; 3]> = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Geometry::new((0..8).map(corner).collect::<Vec<_>>(), triangles)
}

fn view(offset: DVec3) -> View {
    let eye = offset + DVec3::new(4.0, 3.0, 7.0);
    View { aovs: true, ..View::look_at(eye, offset, DVec3::Y, Camera::default(), 96, 72) }
}

fn cpu() -> Renderer {
    Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu)).unwrap()
}

#[test]
fn each_edit_rebuilds_what_depends_on_it_and_says_why() {
    let (mut scene, _, cubes) = scene();
    let mut renderer = cpu();
    let view = view(DVec3::ZERO);
    let report = |renderer: &mut Renderer, scene: &mut Scene| renderer.render(scene, &view).unwrap().report().clone();

    let first = report(&mut renderer, &mut scene);
    assert_eq!(first.compile.tlas, TlasUpdate::Rebuilt(RebuildReason::Empty));
    assert_eq!((first.compile.blas_built, first.compile.instances, first.compile.instanced_triangles), (1, 13, 156));

    let second = report(&mut renderer, &mut scene);
    assert_eq!((second.compile.tlas, second.compile.blas_built), (TlasUpdate::Kept, 0));
    assert_eq!(second.uploaded_bytes, 0);

    scene.set_local(cubes[3], Transform::from_translation(DVec3::Y)).unwrap();
    let moved = report(&mut renderer, &mut scene);
    assert!(matches!(
        moved.compile.tlas,
        TlasUpdate::Patched { instances: 1, .. } | TlasUpdate::Refitted { instances: 1 }
    ));
    assert_eq!(moved.compile.blas_built, 0);
    assert!(moved.to_string().contains("instances: 1"), "{moved}");

    scene.set_visible(cubes[4], false).unwrap();
    let hidden = report(&mut renderer, &mut scene);
    assert!(matches!(hidden.compile.tlas, TlasUpdate::Patched { .. } | TlasUpdate::Refitted { .. }));
    assert_eq!((hidden.compile.instances, hidden.compile.blas_built), (12, 0));
}

#[test]
fn a_moved_node_is_seen_where_it_is() {
    let (mut scene, _, cubes) = scene();
    let (mut renderer, view) = (cpu(), view(DVec3::ZERO));
    let seen = |renderer: &mut Renderer, scene: &mut Scene, node: NodeKey| {
        let geometry = scene.children(node).unwrap().next().unwrap();
        let aovs = renderer.render(scene, &view).unwrap().image().unwrap().aovs.unwrap();
        aovs.node.iter().filter(|&&seen| seen == geometry).count()
    };
    assert!(seen(&mut renderer, &mut scene, cubes[2]) > 0);
    scene.set_local(cubes[2], Transform::from_translation(DVec3::new(0.0, 1e3, 0.0))).unwrap();
    assert_eq!(seen(&mut renderer, &mut scene, cubes[2]), 0);
}

/// ARCHITECTURE, numbers: a scene far from the origin looks as it does at the origin.
#[test]
fn a_scene_far_from_the_origin_looks_the_same() {
    let (mut scene, world, _) = scene();
    let mut renderer = cpu();
    let near = renderer.render(&mut scene, &view(DVec3::ZERO)).unwrap().image().unwrap();
    // Scene and camera jump between two frames.
    let offset = DVec3::new(1e7, -3e6, 5e6);
    scene.set_local(world, Transform::from_translation(offset)).unwrap();
    let far = renderer.render(&mut scene, &view(offset)).unwrap().image().unwrap();

    let errors = ropewalk_testkit::flip::flip(near.width, &near.to_rgba8(), &far.to_rgba8(), 67.0).unwrap();
    let flip = errors.iter().sum::<f32>() / errors.len() as f32;
    assert!(flip < 0.01, "FLIP {flip}");
    let (near, far) = (near.aovs.unwrap(), far.aovs.unwrap());
    let pixels = near.triangle.len();
    assert!(near.triangle.iter().filter(|&&t| t != u32::MAX).count() > pixels / 4, "nothing to compare");
    let different = (0..pixels).filter(|&i| (near.node[i], near.triangle[i]) != (far.node[i], far.triangle[i])).count();
    // Near 1e7, f64 has a precision of 2e-9: a ray that passes an edge at less than that may fall to the other side.
    assert_eq!(different, 0, "of {pixels} pixels");
}

#[test]
fn impossible_views_are_errors_and_harm_nothing() {
    let (mut scene, ..) = scene();
    let mut renderer = cpu();
    let good = view(DVec3::ZERO);
    for min_throughput in [-0.1, 1.1, f32::NAN] {
        let found = renderer.render(&mut scene, &View { min_throughput, ..good.clone() });
        assert!(matches!(found, Err(Error::OutOfRange { what: "min_throughput", .. })));
    }
    for near in [-0.1, f32::INFINITY, f32::NAN] {
        let found = renderer.render(&mut scene, &View { near, ..good.clone() });
        assert!(matches!(found, Err(Error::OutOfRange { what: "near", .. })));
    }
    let mut nowhere = good.clone();
    nowhere.world_from_view.translation.x = f64::NAN;
    assert!(matches!(renderer.render(&mut scene, &nowhere), Err(Error::OutOfRange { .. })));
    let flat = View { world_from_view: DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0)), ..good.clone() };
    assert!(matches!(renderer.render(&mut scene, &flat), Err(Error::OutOfRange { what: "camera pose", .. })));
    let mut dark = good.clone();
    dark.sky.horizon.y = f32::NAN;
    assert!(matches!(renderer.render(&mut scene, &dark), Err(Error::OutOfRange { what: "sky", .. })));
    let wide = View { camera: Camera::perspective(4.0), ..good.clone() };
    assert!(matches!(renderer.render(&mut scene, &wide), Err(Error::OutOfRange { .. })));
    let huge = View { width: u32::MAX, height: u32::MAX, ..good.clone() };
    assert!(matches!(renderer.render(&mut scene, &huge), Err(Error::Limit { .. })));
    let empty = View { width: 0, ..good.clone() };
    assert!(renderer.render(&mut scene, &empty).unwrap().image().unwrap().color.is_empty());
    assert!(renderer.render(&mut scene, &good).is_ok());
}

#[test]
fn an_empty_scene_is_sky() {
    let mut scene = Scene::new();
    let view = View::framing(&mut scene, 32, 24).unwrap();
    let image = cpu().render(&mut scene, &view).unwrap().image().unwrap();
    assert!(image.color.iter().all(|c| c[3] == 1.0 && c[2] > 0.0));
}
