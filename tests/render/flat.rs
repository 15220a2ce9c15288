//! What a scale of zero along one axis flattens is drawn as the plane that it becomes.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3, Vec4};
use ropewalk::image::Image;
use ropewalk::{
    Camera, Core, DeviceChoice, Geometry, Light, Material, Renderer, RendererOptions, Scene, Transform, View,
};

/// A box of 2 x 4 x 2 around the origin, so that axes cannot be confused.
const CORNER: Vec3 = Vec3::new(1.0, 2.0, 1.0);

fn solid_box() -> Geometry {
    let corner = |i: u32| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) * 2.0 - 1.0;
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles: Vec<[u32; 3]> = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Geometry::new((0..8).map(|i| corner(i) * CORNER).collect::<Vec<_>>(), triangles)
}

/// The triangles of the box where the matrix puts them, computed here in f64; those that it leaves no area are omitted.
fn flattened_box(matrix: &DAffine3) -> Geometry {
    let Geometry { positions, indices, .. } = solid_box();
    let positions: Vec<Vec3> = positions.iter().map(|p| matrix.transform_point3(p.as_dvec3()).as_vec3()).collect();
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| positions[i as usize].as_dvec3());
        (b - a).cross(c - a).length()
    };
    let kept: Vec<[u32; 3]> = indices.iter().filter(|t| area(t) > 1e-3).copied().collect();
    Geometry::new(positions, kept)
}

fn image(geometry: Geometry, place: DAffine3, device: DeviceChoice) -> Image {
    let mut scene = Scene::new();
    let geometry = scene.add_geometry(geometry).unwrap();
    let surface = Material { double_sided: true, ..Material::diffuse(Vec3::new(0.8, 0.5, 0.2)) };
    let material = scene.add_material(surface).unwrap();
    let node = scene.add(scene.root(), Transform::Matrix(place)).unwrap();
    scene.add(node, Core::Geometry { geometry, material }).unwrap();
    let sun = scene.add(scene.root(), Transform::looking_at(DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO, DVec3::Y)).unwrap();
    scene.add(sun, Light::directional(Vec3::ONE, 2.0)).unwrap();
    let view = View::look_at(DVec3::new(3.0, 2.0, 6.0), DVec3::ZERO, DVec3::Y, Camera::default(), 64, 64);
    let mut renderer = Renderer::new(&RendererOptions::default().with_device(device)).unwrap();
    renderer.render(&mut scene, &View { aovs: true, ..view }).unwrap().image().unwrap()
}

#[test]
fn a_box_that_is_flattened_looks_like_its_projection() {
    let turn = DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.5));
    let flat = DMat3::from_diagonal;
    for (name, matrix) in [
        ("along z", flat(DVec3::new(1.0, 1.0, 0.0))),
        ("mirrored, along z", flat(DVec3::new(-1.0, 1.0, 0.0))),
        ("along x, turned", turn * flat(DVec3::new(0.0, 1.0, 1.0))),
        ("along y, far smaller than it was", turn * turn * flat(DVec3::new(1.0, 0.0, 0.5))),
        ("along no axis of its own", turn * flat(DVec3::new(1.0, 1.0, 0.0)) * turn.transpose()),
    ] {
        let place = DAffine3::from_mat3_translation(matrix, DVec3::new(0.1, -0.2, 0.3));
        for device in [DeviceChoice::Cpu, DeviceChoice::Emulated] {
            let expected = image(flattened_box(&place), DAffine3::IDENTITY, device);
            let found = image(solid_box(), place, device);
            let (e, f) = (expected.aovs.unwrap(), found.aovs.unwrap());
            let is_hit = |depth: &f32| depth.is_finite();
            let hits = e.depth.iter().filter(|depth| is_hit(depth)).count();
            assert!(hits > 70, "{name}: only {hits} pixels to compare");
            // Pixels at the outline may fall to either side.
            let differ: Vec<_> = (0..e.depth.len()).filter(|&i| is_hit(&e.depth[i]) != is_hit(&f.depth[i])).collect();
            let places: Vec<_> = differ.iter().map(|i| (i % 64, i / 64, e.depth[*i], f.depth[*i])).collect();
            assert!(differ.len() <= hits / 50, "{name}, {device:?}: of {hits} pixels {places:?}");
            let both = (0..e.depth.len()).filter(|&i| is_hit(&e.depth[i]) && is_hit(&f.depth[i]));
            for i in both {
                // The box is up to 2 * 3 / 2^11 high on either side; a grazing ray meets that four times as early.
                assert!((e.depth[i] - f.depth[i]).abs() < 1.3e-2, "{name}: depth {} and {}", e.depth[i], f.depth[i]);
                let difference = (Vec4::from(expected.color[i]) - Vec4::from(found.color[i])).abs().max_element();
                assert!(difference < 0.02, "{name}, {device:?}: pixel {i} differs by {difference}");
            }
        }
    }
}
