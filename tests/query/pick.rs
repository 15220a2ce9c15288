//! Picking: the node and the point that a frame shows at a pixel.

use std::collections::BTreeSet;

use glam::{DQuat, DVec3, Vec2, Vec3, Vec4};
use ropewalk::graph::AlphaMode;
use ropewalk::graph::Lod;
use ropewalk::query::Overlap;
use ropewalk::query::{Queries, Region};
use ropewalk::{
    Camera, Core, DeviceChoice, Geometry, Material, NodeKey, Ray, Renderer, RendererOptions, Scene, Transform, View,
};

use ropewalk_testkit::{Mesh, Random};

/// Balls and triangle soups of all kinds of material, with and without alpha masks, around a point.
fn scene(center: DVec3) -> Scene {
    let mut scene = Scene::new();
    let mut random = Random::new(2);
    let solid = Material { double_sided: false, ..Material::default() };
    let glass = Vec4::new(1.0, 1.0, 1.0, 0.4);
    let materials = [
        solid.clone(),
        Material { alpha_mode: AlphaMode::Mask { cutoff: 0.5 }, ..Material::default() },
        Material { alpha_mode: AlphaMode::Blend, base_color: glass, ..Material::default() },
        Material { transmission: 1.0, ..solid },
    ];
    for i in 0..40 {
        let mesh = if i % 2 == 0 { Mesh::icosphere(1) } else { Mesh::soup(i, 50) };
        let alpha: Vec<Vec4> = mesh.positions.iter().map(|_| Vec4::ONE * random.unsigned()).collect();
        let geometry = Geometry { colors: Some(alpha.into()), ..Geometry::new(mesh.positions, mesh.indices) };
        let geometry = scene.add_geometry(geometry).unwrap();
        let material = scene.add_material(materials[random.index(4)].clone()).unwrap();
        let place = Transform::Trs {
            translation: center + random.in_cube().as_dvec3() * 2.0,
            rotation: DQuat::from_rotation_y(f64::from(random.signed()) * 3.0),
            scale: DVec3::new([0.5, -0.7][random.index(2)], 1.5, 1.0),
        };
        let place = scene.add(scene.root(), place).unwrap();
        scene.set_mask(place, 1 << (i % 3)).unwrap();
        scene.add(place, Core::Geometry { geometry, material }).unwrap();
    }
    scene
}

fn views(center: DVec3) -> [View; 2] {
    let cameras = [Camera::perspective(0.9), Camera::orthographic(5.0, 4.0).with_lens_shift(Vec2::new(0.3, -0.2))];
    cameras.map(|camera| View {
        aovs: true,
        ray_mask: 3,
        ..View::look_at(center + DVec3::new(3.0, 4.0, 9.0), center, DVec3::Y, camera, 64, 48)
    })
}

/// Checks that picking at every pixel of a frame finds what the frame shows there.
fn check(renderer: &mut Renderer, center: DVec3) {
    let mut scene = scene(center);
    for view in views(center) {
        let aovs = renderer.render(&mut scene, &view).unwrap().image().unwrap().aovs.unwrap();
        let mut hits = 0;
        for (i, (x, y)) in (0..view.height).flat_map(|y| (0..view.width).map(move |x| (x, y))).enumerate() {
            let hit = renderer.pick(&mut scene, &view, [x, y]).unwrap();
            let seen = hit.as_ref().map(|hit| (hit.path.node, hit.triangle));
            let expected = (aovs.triangle[i] != u32::MAX).then_some((aovs.node[i], aovs.triangle[i]));
            assert_eq!(seen, expected, "at {x}, {y} on {}", renderer.device_info().executor);
            let Some(hit) = hit else { continue };
            hits += 1;
            assert_eq!(hit.distance as f32, aovs.depth[i]);
            let eye = view.world_from_view.translation;
            let ahead = -view.world_from_view.matrix3.z_axis;
            let depth = match view.camera {
                Camera::Perspective { .. } => hit.position.distance(eye),
                Camera::Orthographic { .. } => (hit.position - eye).dot(ahead),
            };
            assert!((depth - hit.distance).abs() < 1e-4, "{depth} is not {}", hit.distance);
        }
        assert!(hits > 500, "{hits} hits");
    }
}

fn renderer(device: DeviceChoice) -> Renderer {
    Renderer::new(&RendererOptions::default().with_device(device)).unwrap()
}

#[test]
fn each_pixel_is_picked_as_it_is_drawn() {
    check(&mut renderer(DeviceChoice::Cpu), DVec3::ZERO);
    check(&mut renderer(DeviceChoice::Emulated), DVec3::ZERO);
}

#[cfg(feature = "gpu")]
#[test]
fn each_pixel_is_picked_as_a_gpu_draws_it() {
    if let Some(tracer) = ropewalk_testkit::gpu::tracer() {
        check(&mut Renderer::with_tracer(tracer), DVec3::ZERO);
    }
}

#[test]
fn picking_far_from_the_origin_is_as_good() {
    check(&mut renderer(DeviceChoice::Cpu), DVec3::new(1e7, -3e6, 5e6));
}

#[test]
fn queries_far_from_the_origin_are_as_good() {
    let center = DVec3::new(1e7, -3e6, 5e6);
    let mut renderer = renderer(DeviceChoice::Cpu);
    let [mut near, mut far] = [DVec3::ZERO, center].map(scene);
    let [near_hit, far_hit] = [(&mut near, DVec3::ZERO), (&mut far, center)].map(|(scene, center)| {
        // Nothing was rendered yet, so picking must choose the render origin.
        let queries = renderer.queries(scene).unwrap();
        let hit = queries.nearest(center + DVec3::new(0.5, 9.0, 0.25), f64::INFINITY).unwrap().unwrap();
        (hit.triangle, hit.position - center, hit.distance)
    });
    assert_eq!(near_hit.0, far_hit.0);
    // Near 1e7, f64 has a precision of 2e-9; f32 has one of 6e-7 at the scene's radius.
    assert!(near_hit.1.distance(far_hit.1) < 1e-6 && (near_hit.2 - far_hit.2).abs() < 1e-6);
}

#[test]
fn picking_catches_up_with_the_scene() {
    let mut scene = scene(DVec3::ZERO);
    let mut renderer = renderer(DeviceChoice::Cpu);
    let view = &views(DVec3::ZERO)[0];
    let mut removed = BTreeSet::new();
    for y in 0..view.height {
        while let Some(hit) = renderer.pick(&mut scene, view, [32, y]).unwrap() {
            assert!(removed.insert(hit.path.node));
            scene.set_visible(hit.path.node, false).unwrap();
        }
    }
    assert!(removed.len() > 3, "{removed:?}");
}

/// Levels of detail by projected size, and billboards: picking and later queries see the scene as the view does.
#[test]
fn queries_see_the_levels_that_were_drawn() {
    let mut scene = Scene::new();
    let mesh = Mesh::cube();
    let geometry = scene.add_geometry(Geometry::new(mesh.positions, mesh.indices)).unwrap();
    let material = scene.add_material(Material::default()).unwrap();
    let core = scene.add_core(Core::Geometry { geometry, material }).unwrap();
    let lod = scene.add(scene.root(), Lod::by_projected_size(2.0, [0.5])).unwrap();
    let levels = [scene.add(lod, core).unwrap(), scene.add(lod, core).unwrap()];
    let mut renderer = renderer(DeviceChoice::Cpu);
    let ray = Ray::new(DVec3::new(0.1, 0.2, 9.0), DVec3::NEG_Z);
    for (y_fov, level) in [(0.3, levels[0]), (1.5, levels[1]), (0.3, levels[0])] {
        let camera = Camera::perspective(y_fov);
        let view = View::look_at(DVec3::Z * 9.0, DVec3::ZERO, DVec3::Y, camera, 33, 33);
        let picked = renderer.pick(&mut scene, &view, [16, 16]).unwrap().unwrap();
        let frame = renderer.render(&mut scene, &View { aovs: true, ..view }).unwrap();
        let drawn = frame.image().unwrap().aovs.unwrap().node[16 * 33 + 16];
        let found = renderer.queries(&mut scene).unwrap().closest_hit(&ray).unwrap().unwrap();
        assert_eq!([picked.path.node, drawn, found.path.node], [level; 3]);
    }
}

/// The nodes seen through some pixels are among those that a query of the pixels' frustum finds.
#[test]
fn a_rubber_band_selects_what_is_seen_through_it() {
    let mut scene = scene(DVec3::ZERO);
    let mut renderer = renderer(DeviceChoice::Cpu);
    for view in views(DVec3::ZERO) {
        let aovs = renderer.render(&mut scene, &view).unwrap().image().unwrap().aovs.unwrap();
        let queries = renderer.queries(&mut scene).unwrap().with_ray_mask(view.ray_mask);
        let mut selected = 0;
        for (columns, rows) in [(0..64, 0..48), (10..30, 5..20), (40..41, 30..31), (0..5, 0..48)] {
            let region = view.pixel_frustum(columns.clone(), rows.clone()).unwrap();
            let found: BTreeSet<_> =
                queries.overlapping(&region, Overlap::Touching).into_iter().map(|p| p.node).collect();
            let pixels = rows.flat_map(|y| columns.clone().map(move |x| (y * 64 + x) as usize));
            let seen: BTreeSet<_> = pixels.filter(|&i| aovs.triangle[i] != u32::MAX).map(|i| aovs.node[i]).collect();
            assert!(seen.is_subset(&found), "{seen:?} is seen, {found:?} is found");
            selected += seen.len();
        }
        assert!(selected > 15, "{selected}");
    }
}

/// A place, its node and the node of the cube there.
type Cube = (DVec3, NodeKey, NodeKey);

fn check_cubes(queries: &Queries<'_>, cubes: &[Cube]) {
    for (at, _, node) in cubes {
        assert_eq!(queries.nearest(*at, f64::INFINITY).unwrap().unwrap().path.node, *node);
    }
    let everywhere = Region::new([]).unwrap();
    assert_eq!(queries.overlapping(&everywhere, Overlap::Touching).len(), cubes.len());
    let along = Ray { t_min: f64::NEG_INFINITY, ..Ray::new(DVec3::new(0.0, 0.1, 0.2), DVec3::X) };
    assert_eq!(queries.all_hits(&along).unwrap().len(), 2 * cubes.len());
    assert_eq!(queries.bounds().is_empty(), cubes.is_empty());
}

#[test]
fn a_slot_names_the_node_that_has_it_after_edits() {
    let mut scene = Scene::new();
    let mut renderer = renderer(DeviceChoice::Cpu);
    let mesh = Mesh::cube();
    let geometry = scene.add_geometry(Geometry::new(mesh.positions, mesh.indices)).unwrap();
    let material = scene.add_material(Material::diffuse(Vec3::ONE)).unwrap();
    let core = scene.add_core(Core::Geometry { geometry, material }).unwrap();
    let mut random = Random::new(2);
    let mut cubes: Vec<Cube> = Vec::new();
    for step in 0..60 {
        if step % 3 == 2 {
            let (_, place, _) = cubes.swap_remove(random.index(cubes.len()));
            scene.remove(place).unwrap();
        } else {
            let at = DVec3::new(f64::from(step) * 4.0, 0.0, 0.0);
            let place = scene.add(scene.root(), Transform::from_translation(at)).unwrap();
            cubes.push((at, place, scene.add(place, core).unwrap()));
        }
        check_cubes(&renderer.queries(&mut scene).unwrap(), &cubes);
    }
    // Nodes are removed until one is left, so that queries pass unused leaves.
    while let Some((_, place, _)) = cubes.pop() {
        scene.remove(place).unwrap();
        check_cubes(&renderer.queries(&mut scene).unwrap(), &cubes);
    }
}
