//! Which transmissive instances are thin walls.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use glam::{DVec3, Vec3};
use ropewalk::compile::{Compiler, Viewpoint};
use ropewalk::device::layout::InstanceFlags;
use ropewalk::graph::WallKind;
use ropewalk::{Core, Geometry, Material, Scene};
use ropewalk_testkit::Mesh;
use ropewalk_testkit::corpus::scenes;

/// Whether the only instance of the scene is a thin wall.
fn is_thin(compiler: &mut Compiler, scene: &mut Scene) -> bool {
    compiler.compile(scene, Viewpoint::from(DVec3::Z * 5.0)).unwrap();
    let shown: Vec<_> = compiler.arrays().instances.iter().filter(|record| record.mask != 0).collect();
    assert_eq!(shown.len(), 1);
    InstanceFlags::from_bits_retain(shown[0].flags).contains(InstanceFlags::THIN)
}

fn scene_of(mesh: &Mesh, material: Material) -> Scene {
    let mut scene = Scene::new();
    let geometry = scene.add_geometry(Geometry::new(mesh.positions.clone(), mesh.indices.clone())).unwrap();
    let material = scene.add_material(material).unwrap();
    scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
    scene
}

#[test]
fn the_material_decides_and_else_the_geometry_as_it_is_now() {
    let (cube, mut open) = (Mesh::cube(), Mesh::cube());
    open.indices.truncate(10);
    for (mesh, auto) in [(cube, false), (open, true)] {
        let mut scene = scene_of(&mesh, Material::glass(1.5));
        let mut compiler = Compiler::new();
        assert_eq!(is_thin(&mut compiler, &mut scene), auto);
        let (key, _) = scene.materials().next().unwrap();
        for (wall, expected) in [(WallKind::Thin, true), (WallKind::Solid, false), (WallKind::Auto, auto)] {
            scene.set_material(key, Material { wall, ..Material::glass(1.5) }).unwrap();
            assert_eq!(is_thin(&mut compiler, &mut scene), expected, "{wall:?}");
        }
        // What does not transmit has no walls.
        scene.set_material(key, Material { wall: WallKind::Thin, ..Material::default() }).unwrap();
        assert!(!is_thin(&mut compiler, &mut scene));
    }
    // Flattened, it encloses nothing.
    let mut scene = scene_of(&Mesh::cube(), Material::glass(1.5));
    let mut compiler = Compiler::new();
    assert!(!is_thin(&mut compiler, &mut scene));
    let (key, positions) = (scene.geometries().next().unwrap().0, Mesh::cube().positions);
    let flat: Vec<Vec3> = positions.into_iter().map(|p| p.with_z(0.0)).collect();
    scene.set_positions(key, flat, None).unwrap();
    assert!(is_thin(&mut compiler, &mut scene));
}

/// A scan with five holes in its base.
#[test]
fn the_bunny_is_solid() {
    let Some(folder) = scenes("the_bunny_is_solid") else { return };
    let bunny = Mesh::glb(&folder.join("meshes/stanford-bunny.glb"));
    assert!(!is_thin(&mut Compiler::new(), &mut scene_of(&bunny, Material::glass(1.5))));
}
