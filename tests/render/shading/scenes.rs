//! Small scenes in code.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec2, Vec3};
use ropewalk::graph::LightKind;
use ropewalk::image::Image;
use ropewalk::{
    Camera, Core, DeviceChoice, Geometry, Light, Material, Renderer, RendererOptions, Scene, Sky, Transform, View,
};

/// A square in the plane z = 0 that faces +Z, from -`half` to `half`; texture coordinates as an upright image has them.
pub fn square(half: f32) -> Geometry {
    let corners = [(-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)];
    let positions: Vec<Vec3> = corners.iter().map(|&(x, y)| Vec3::new(x, y, 0.0) * half).collect();
    let tex_coords: Arc<[Vec2]> = corners.iter().map(|&(x, y)| Vec2::new(x * 0.5 + 0.5, 0.5 - y * 0.5)).collect();
    Geometry { tex_coords: [Some(tex_coords), None], ..Geometry::new(positions, [[0, 1, 2], [0, 2, 3]]) }
}

/// A sphere of radius 1 with vertex normals: an octahedron, each triangle divided into four `levels` times.
pub fn sphere(levels: u32) -> Geometry {
    let mut positions = vec![Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
    let mut triangles: Vec<[u32; 3]> =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..levels {
        let mut middles = HashMap::new();
        let mut middle = |i: u32, j: u32| {
            *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                positions.push((positions[i as usize] + positions[j as usize]).normalize());
                positions.len() as u32 - 1
            })
        };
        triangles = triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                let (x, y, z) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, x, z], [b, y, x], [c, z, y], [x, y, z]]
            })
            .collect();
    }
    let normals: Arc<[Vec3]> = positions.clone().into();
    Geometry { normals: Some(normals), ..Geometry::new(positions, triangles) }
}

/// The cube from -1 to 1, four corners a face.
pub fn cube() -> Geometry {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z] {
        let (u, v) = axis.any_orthonormal_pair();
        let (u, v) = if u.cross(v).dot(axis) > 0.0 { (u, v) } else { (v, u) };
        let first = positions.len() as u32;
        positions.extend([axis - u - v, axis + u - v, axis + u + v, axis - u + v]);
        triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    Geometry::new(positions, triangles)
}

/// Adds a geometry of its own with a material of its own.
pub fn put(scene: &mut Scene, geometry: Geometry, material: Material, place: DAffine3) {
    let geometry = scene.add_geometry(geometry).unwrap();
    let material = scene.add_material(material).unwrap();
    let node = scene.add(scene.root(), Transform::Matrix(place)).unwrap();
    scene.add(node, Core::Geometry { geometry, material }).unwrap();
}

pub fn at(x: f64, y: f64, z: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(x, y, z))
}

/// Adds a white light that stands at `eye` and looks at `target`.
pub fn put_light(scene: &mut Scene, kind: LightKind, intensity: f32, eye: DVec3, target: DVec3) {
    let node = scene.add(scene.root(), Transform::looking_at(eye, target, DVec3::Y)).unwrap();
    scene.add(node, Light { kind, color: Vec3::ONE, intensity, range: None }).unwrap();
}

/// From (0, 0, 10) along -Z at the square from -1 to 1, without perspective.
pub fn front(size: u32, sky: Sky) -> View {
    let camera = Camera::orthographic(1.0, 1.0);
    View { sky, ..View::look_at(DVec3::new(0.0, 0.0, 10.0), DVec3::ZERO, DVec3::Y, camera, size, size) }
}

pub fn black() -> Sky {
    Sky::uniform(Vec3::ZERO)
}

pub fn render(scene: &mut Scene, view: &View) -> Image {
    let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu)).unwrap();
    renderer.render(scene, view).unwrap().image().unwrap()
}

/// The colour in the middle of the view of [`front`].
pub fn middle(scene: &mut Scene, sky: Sky) -> Vec3 {
    Vec3::from_slice(&render(scene, &front(1, sky)).color[0])
}
