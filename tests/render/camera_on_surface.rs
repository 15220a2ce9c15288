//! Where a camera begins to see: at a distance, and on a surface.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use glam::{DAffine3, DQuat, DVec3, Vec3};
use ropewalk::compile::Compiler;
use ropewalk::trace::FrameRequest;
use ropewalk::{
    Camera, Core, DeviceChoice, Geometry, GeometryKey, Material, Renderer, RendererOptions, Scene, Sky, Transform, View,
};
use ropewalk_testkit::tracers;

fn put(scene: &mut Scene, geometry: GeometryKey, color: Vec3, place: DAffine3) {
    let material = Material { base_color: color.extend(1.0), unlit: true, ..Material::default() };
    let material = scene.add_material(material).unwrap();
    let node = scene.add(scene.root(), Transform::Matrix(place)).unwrap();
    scene.add(node, Core::Geometry { geometry, material }).unwrap();
}

/// A floor of 2 by 2 triangles in the plane y = 0, from -`half` to `half`.
fn floor(half: f32) -> Geometry {
    let [a, b, c, d] = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)].map(|(x, z)| Vec3::new(x, 0.0, z) * half);
    Geometry::new([a, b, c, d, Vec3::ZERO], [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
}

/// One pixel, without perspective.
fn pixel(eye: DVec3, direction: DVec3) -> View {
    let up = direction.any_orthonormal_vector();
    let view = View::look_at(eye, eye + direction * 100.0, up, Camera::orthographic(1e-9, 1e-9), 1, 1);
    View { sky: Sky::uniform(Vec3::Z), aovs: true, ..view }
}

const RED: Vec3 = Vec3::X;
const GREEN: Vec3 = Vec3::Y;

#[test]
fn a_camera_on_a_floor_sees_what_lies_before_it() {
    let mut rng = fastrand::Rng::with_seed(7);
    let mut number = || rng.f64() * 2.0 - 1.0;
    let mut tracers: Vec<_> = tracers().into_iter().map(|tracer| (tracer, Compiler::new())).collect();
    let mut on_floor = 0;
    for (half, distance) in [(1.0f32, 0.0), (1000.0, 0.0), (1.0, 1e6), (0.01, 0.3), (1e5, 1e5)] {
        for turned in [false, true] {
            // 1. A floor somewhere, turned or not; beyond it, to both sides, something green.
            let mut scene = Scene::new();
            let geometry = scene.add_geometry(floor(half)).unwrap();
            let axis = DVec3::new(number(), number(), number()).normalize();
            let turn = if turned { DQuat::from_axis_angle(axis, number() * 3.0) } else { DQuat::IDENTITY };
            let place = DAffine3::from_rotation_translation(turn, DVec3::new(number(), number(), number()) * distance);
            put(&mut scene, geometry, RED, place);
            for side in [-3.0, 3.0] {
                let beyond = DAffine3::from_translation(DVec3::Y * side * f64::from(half));
                let wide = DAffine3::from_scale(DVec3::splat(1e4));
                put(&mut scene, geometry, GREEN, place * beyond * wide);
            }
            for _ in 0..100 {
                // 2. A camera on it, to within the rounding of f64, that looks to a side of it.
                let at = DVec3::new(number(), 0.0, number()) * f64::from(half) * 0.9;
                let (eye, along) = (place.transform_point3(at), DVec3::new(number(), 0.0, number()));
                let height = if number() > 0.0 { 0.002 + number().abs() } else { -0.002 - number().abs() };
                let direction = place.transform_vector3(along + DVec3::Y * height).normalize();
                let view = pixel(eye, direction);
                // 3. Every executor sees green.
                for (tracer, compiler) in &mut tracers {
                    let needs = compiler.compile(&mut scene, view.viewpoint()).unwrap().needs;
                    let request = FrameRequest::new(view.frame_params(compiler.origin(), 0), needs).with_aovs(true);
                    tracer.upload(compiler.arrays_mut()).unwrap();
                    tracer.render(compiler.arrays(), &request).unwrap();
                    let image = tracer.read_image().unwrap();
                    let name = &tracer.device().executor;
                    assert_eq!(image.color[0][..3], GREEN.to_array(), "{name}: {half} at {distance}, {height}");
                    let seen = f64::from(image.aovs.unwrap().depth[0]);
                    assert!(seen > 0.9 * f64::from(half), "{name}: {seen}");
                }
                on_floor += 1;
            }
        }
    }
    assert_eq!(on_floor, 1000);
}

fn cpu() -> Renderer {
    Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu)).unwrap()
}

fn seen(renderer: &mut Renderer, scene: &mut Scene, view: &View) -> (Vec3, Option<f64>) {
    let color = Vec3::from_slice(&renderer.render(scene, view).unwrap().image().unwrap().color[0]);
    (color, renderer.pick(scene, view, [0, 0]).unwrap().map(|hit| hit.distance))
}

#[test]
fn a_camera_above_a_floor_sees_it() {
    let mut scene = Scene::new();
    let geometry = scene.add_geometry(floor(1e4)).unwrap();
    put(&mut scene, geometry, RED, DAffine3::IDENTITY);
    // However low it is, and however far it looks along the floor. A new renderer has its render origin at the camera.
    for height in [1.0, 1e-3, 1e-6, 1e-9] {
        for slope in [1.0, 1e-2, 1e-4] {
            if height / slope < 8e3 {
                let view = pixel(DVec3::new(123.0, height, 457.0), DVec3::new(1.0, -slope, 0.0).normalize());
                let (color, picked) = seen(&mut cpu(), &mut scene, &view);
                assert_eq!((color, picked.is_some()), (RED, true), "{height} above, slope {slope}");
            }
        }
    }
}

#[test]
fn a_camera_sees_nothing_that_is_nearer_than_it_says() {
    let mut scene = Scene::new();
    let geometry = scene.add_geometry(floor(1.0)).unwrap();
    put(&mut scene, geometry, RED, DAffine3::IDENTITY);
    put(&mut scene, geometry, GREEN, DAffine3::from_translation(DVec3::Y * -2.0));
    let mut renderer = cpu();
    let from_above = pixel(DVec3::Y, DVec3::NEG_Y);
    for (near, color, distance) in
        [(0.0, RED, Some(1.0)), (1.0, RED, Some(1.0)), (1.1, GREEN, Some(3.0)), (3.1, Vec3::Z, None)]
    {
        let view = View { near, ..from_above.clone() };
        assert_eq!(seen(&mut renderer, &mut scene, &view), (color, distance), "near {near}");
    }
}
