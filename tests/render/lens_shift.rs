//! Lens shift: a shifted camera sees a part of what a larger camera without shift sees from the same place.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use glam::{DVec3, Vec2, Vec3};
use ropewalk::{
    Camera, Core, DeviceChoice, Geometry, Material, NodeKey, Renderer, RendererOptions, Scene, Transform, View,
};

/// A lattice of tetrahedra, each of its own size.
fn scene() -> Scene {
    let mut scene = Scene::new();
    let corners = [Vec3::new(1.0, 1.0, 1.0), Vec3::new(1.0, -1.0, -1.0), Vec3::new(-1.0, 1.0, -1.0), Vec3::NEG_ONE];
    let geometry = Geometry::new(corners, [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]);
    let geometry = scene.add_geometry(geometry).unwrap();
    let material = scene.add_material(Material::diffuse(Vec3::ONE)).unwrap();
    for i in 0..9 * 7 * 3 {
        let at = DVec3::new(f64::from(i % 9 - 4), f64::from(i / 9 % 7 - 3), f64::from(-(i / 63)) * 1.7);
        let scale = 0.2 + 0.3 * (f64::from(i) * 0.37).sin().abs();
        let place = scene.add(scene.root(), Transform::from_translation(at)).unwrap();
        let place = scene.add(place, Transform::from_scale(DVec3::splat(scale))).unwrap();
        scene.add(place, Core::Geometry { geometry, material }).unwrap();
    }
    scene
}

/// Node and triangle of each pixel.
fn ids(scene: &mut Scene, camera: Camera, [width, height]: [u32; 2]) -> Vec<(NodeKey, u32)> {
    let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu)).unwrap();
    let view = View::look_at(DVec3::new(1.0, 1.5, 8.0), DVec3::new(0.3, 0.2, 0.0), DVec3::Y, camera, width, height);
    let aovs = renderer.render(scene, &View { aovs: true, ..view }).unwrap().image().unwrap().aovs.unwrap();
    aovs.node.into_iter().zip(aovs.triangle).collect()
}

#[test]
fn a_shifted_camera_sees_a_crop_of_a_larger_image() {
    let mut scene = scene();
    // The larger image is twice as wide and three times as high.
    let (width, height) = (64, 40);
    let third = |y_fov: f32| 2.0 * ((y_fov / 2.0).tan() / 3.0).atan();
    let cameras = [
        (Camera::perspective(0.9), Camera::perspective(third(0.9))),
        (Camera::orthographic(3.2, 3.0), Camera::orthographic(1.6, 1.0)),
    ];
    for (large, small) in cameras {
        let whole = ids(&mut scene, large, [2 * width, 3 * height]);
        let mut hits = 0;
        for [left, top] in [[0, 0], [64, 80], [32, 40], [11, 67]] {
            let center = [left + width / 2, top + height / 2].map(|x| x as f32);
            let shift = Vec2::new(center[0] / width as f32 * 2.0 - 2.0, 3.0 - center[1] / height as f32 * 2.0);
            let tile = ids(&mut scene, small.with_lens_shift(shift), [width, height]);
            let row = |y: u32| &whole[((top + y) * 2 * width + left) as usize..][..width as usize];
            let crop: Vec<_> = (0..height).flat_map(row).copied().collect();
            hits += crop.iter().filter(|(_, triangle)| *triangle != u32::MAX).count();
            assert!(tile == crop, "{small:?} at {left}, {top}");
        }
        assert!(hits > 1000, "{hits} pixels to compare");
    }
}
