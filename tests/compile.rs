//! The compiler: edit by edit equals from nothing, and each kind of edit costs what it should.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

#[path = "support/canonical.rs"]
mod canonical;

use std::sync::Arc;

use canonical::Canonical;
use glam::{DQuat, DVec3, Vec2, Vec3, Vec4};
use proptest::prelude::*;
use ropewalk::accel::{Rebuild, Update};
use ropewalk::compile::{Compiler, ImageHeight, Needs, Observer};
use ropewalk::{
    AlphaMode, Billboard, Camera, Core, Geometry, GeometryKey, Keep, Light, LightKind, Lod, Material, MaterialKey,
    NodeKey, Scene, Switch, Texture, TextureKey, TextureRef, Transform,
};

const EYE: DVec3 = DVec3::new(0.0, 0.0, 10.0);

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, ..ProptestConfig::default() })]

    /// ARCHITECTURE, invariants: the scene compiled edit by edit equals the scene compiled from nothing.
    #[test]
    fn random_edits_compile_as_from_nothing(edits in prop::collection::vec(edit(), 1..100), every in 1usize..8) {
        let mut world = World::new();
        let mut compiler = Compiler::new();
        let mut compared = 0;
        for (i, edit) in edits.iter().enumerate() {
            world.apply(edit);
            if i % every == 0 || i + 1 == edits.len() {
                // Some levels of detail depend on how large things are in the image.
                let height = ImageHeight::TimesDistance([0.1, 1.0, 10.0][i % 3]);
                let observer = Observer { height, ..EYE.into() };
                let report = compiler.compile(&mut world.scene, observer).unwrap();
                let mut fresh = Compiler::new();
                let fresh_report = fresh.compile(&mut world.scene, observer).unwrap();
                world.scene.validate().unwrap();
                prop_assert_eq!(Canonical::of(compiler.arrays()).difference(&Canonical::of(fresh.arrays())), None);
                prop_assert_eq!(report.needs, fresh_report.needs);
                prop_assert_eq!(report.instances, fresh_report.instances);
                prop_assert_eq!(report.singular_instances, fresh_report.singular_instances);
                prop_assert_eq!(report.scene_triangles, fresh_report.scene_triangles);
                prop_assert_eq!((report.lights, report.blas_count), (fresh_report.lights, fresh_report.blas_count));
                compared += 1;
            }
        }
        prop_assert!(compared > 0);
        // What is removed is freed: without nodes there is nothing on the device.
        for child in world.scene.children(world.scene.root()).unwrap().collect::<Vec<_>>() {
            world.scene.remove(child).unwrap();
        }
        compiler.compile(&mut world.scene, EYE).unwrap();
        prop_assert_eq!(compiler.arrays().byte_count(), 0);
    }
}

#[test]
fn canonical_form_sees_each_field() {
    // A planted difference in each array must show.
    let mut world = World::new();
    world.populate();
    let mut compiler = Compiler::new();
    compiler.compile(&mut world.scene, EYE).unwrap();
    let before = Canonical::of(compiler.arrays());
    assert!(before.instance_count() > 1);

    macro_rules! plant {
        ($array:ident, $change:expr) => {{
            let original = compiler.arrays().$array.to_vec();
            let mut changed = original.clone();
            edit_with(&mut changed, $change);
            assert!(changed != original, "{} was not changed", stringify!($array));
            compiler.arrays_mut().$array.write(0, &changed);
            assert!(
                Canonical::of(compiler.arrays()).difference(&before).is_some(),
                "{} is not compared",
                stringify!($array)
            );
            compiler.arrays_mut().$array.write(0, &original);
        }};
    }
    plant!(tlas_nodes, |nodes| nodes.iter_mut().for_each(|n| n.min[0] -= 1.0));
    plant!(instances, |instances| instances.iter_mut().for_each(|i| i.mask ^= 1));
    plant!(blas_nodes, |nodes| nodes.iter_mut().for_each(|n| n.max[2] += 1.0));
    plant!(triangles, |triangles| triangles.iter_mut().for_each(|t| t.v1[0] += 1.0));
    plant!(indices, |indices| indices.iter_mut().for_each(|i| *i = 0));
    plant!(normals, |normals| normals.iter_mut().for_each(|n| *n += 1.0));
    plant!(tex_coords, |tex_coords| tex_coords.iter_mut().for_each(|t| t[0] += 1.0));
    plant!(colors, |colors| colors.iter_mut().for_each(|c| c[1] ^= 1));
    plant!(materials, |materials| materials.iter_mut().for_each(|m| m.ior += 1.0));
    plant!(texture_infos, |infos| infos.iter_mut().for_each(|i| i.flags ^= 1));
    plant!(texels, |texels| texels.iter_mut().for_each(|t| *t ^= 1));
    plant!(lights, |lights| lights[0].color[1] += 1.0);
    assert_eq!(Canonical::of(compiler.arrays()).difference(&before), None);
}

#[test]
fn an_unchanged_scene_changes_nothing() {
    let mut world = World::new();
    world.populate();
    let mut compiler = Compiler::new();
    let first = compiler.compile(&mut world.scene, EYE).unwrap();
    assert_eq!(first.tlas, Update::Rebuilt(Rebuild::Empty));
    assert!(first.blas_built > 0 && dirty_bytes(&mut compiler) > 0);

    let second = compiler.compile(&mut world.scene, EYE).unwrap();
    assert_eq!((second.tlas, second.blas_built), (Update::Kept, 0));
    assert_eq!(dirty_bytes(&mut compiler), 0);
    // Nor does a camera that moves a little, or setting a value to what it was.
    let node = world.nodes[1];
    world.scene.set_local(node, world.scene.local(node).unwrap()).unwrap();
    let third = compiler.compile(&mut world.scene, EYE + DVec3::splat(0.01)).unwrap();
    assert_eq!((third.tlas, dirty_bytes(&mut compiler)), (Update::Kept, 0));
}

#[test]
fn a_moved_node_patches_the_top_level_only() {
    let mut scene = Scene::new();
    let (geometry, material) = (tetrahedron(&mut scene, 0), scene.add_material(Material::default()).unwrap());
    let nodes: Vec<NodeKey> = (0..1000)
        .map(|i| {
            let place = Transform::from_translation(DVec3::new(f64::from(i) * 3.0, 0.0, 0.0));
            let node = scene.add(scene.root(), place).unwrap();
            scene.add(node, Core::Geometry { geometry, material }).unwrap();
            node
        })
        .collect();
    let mut compiler = Compiler::new();
    let first = compiler.compile(&mut scene, EYE).unwrap();
    assert_eq!((first.blas_built, first.instances, first.scene_triangles), (1, 1000, 4000));
    dirty_bytes(&mut compiler);

    scene.set_local(nodes[500], Transform::from_translation(DVec3::new(1500.0, 1.0, 0.0))).unwrap();
    let report = compiler.compile(&mut scene, EYE).unwrap();
    assert!(matches!(report.tlas, Update::Patched { instances: 1, .. }));
    assert_eq!(report.blas_built, 0);
    let arrays = compiler.arrays_mut();
    assert_eq!(arrays.instances.take_dirty().iter().map(ExactSizeIterator::len).sum::<usize>(), 1);
    assert!(arrays.blas_nodes.take_dirty().is_empty() && arrays.triangles.take_dirty().is_empty());
}

#[test]
fn a_changed_material_keeps_the_top_level() {
    let mut world = World::new();
    world.populate();
    let mut compiler = Compiler::new();
    compiler.compile(&mut world.scene, EYE).unwrap();
    dirty_bytes(&mut compiler);
    let material = world.materials[0];
    world.scene.set_material(material, Material::glass(1.4)).unwrap();
    let report = compiler.compile(&mut world.scene, EYE).unwrap();
    assert_eq!((report.tlas, report.blas_built), (Update::Kept, 0));
    assert!(report.needs.contains(Needs::REFRACTION));
    assert!(dirty_bytes(&mut compiler) > 0);
}

#[test]
fn removing_nodes_frees_what_nobody_else_uses() {
    let mut scene = Scene::new();
    let material = scene.add_material(Material::default()).unwrap();
    let geometries = [tetrahedron(&mut scene, 0), tetrahedron(&mut scene, 1)];
    let nodes = [0, 1, 1]
        .map(|g: usize| scene.add(scene.root(), Core::Geometry { geometry: geometries[g], material }).unwrap());
    let mut compiler = Compiler::new();
    assert_eq!(compiler.compile(&mut scene, EYE).unwrap().blas_count, 2);
    let full = compiler.arrays().byte_count();

    scene.remove(nodes[1]).unwrap();
    let report = compiler.compile(&mut scene, EYE).unwrap();
    assert_eq!((report.blas_count, report.blas_freed), (2, 0));
    scene.remove(nodes[2]).unwrap();
    let report = compiler.compile(&mut scene, EYE).unwrap();
    assert_eq!((report.blas_count, report.blas_freed, report.blas_built), (1, 1, 0));
    assert!(compiler.arrays().byte_count() < full);
}

#[test]
fn a_singular_instance_is_left_out_and_reported() {
    let mut scene = Scene::new();
    let (geometry, material) = (tetrahedron(&mut scene, 0), scene.add_material(Material::default()).unwrap());
    for scale in [DVec3::ONE, DVec3::new(1.0, 0.0, 1.0), DVec3::splat(1e-60)] {
        let node = scene.add(scene.root(), Transform::from_scale(scale)).unwrap();
        scene.add(node, Core::Geometry { geometry, material }).unwrap();
    }
    let report = Compiler::new().compile(&mut scene, EYE).unwrap();
    assert_eq!((report.instances, report.singular_instances), (1, 2));
}

#[test]
fn a_camera_that_goes_far_moves_the_render_origin() {
    let mut world = World::new();
    world.populate();
    let mut compiler = Compiler::new();
    compiler.compile(&mut world.scene, EYE).unwrap();
    let far = EYE + DVec3::splat(1e7);
    world.scene.set_local(world.nodes[1], Transform::from_translation(DVec3::splat(1e7))).unwrap();
    compiler.compile(&mut world.scene, EYE).unwrap();
    let report = compiler.compile(&mut world.scene, far).unwrap();
    assert!(report.rebased && report.blas_built == 0);
    assert_eq!(compiler.origin(), far);
}

#[test]
fn another_scene_is_compiled_from_nothing() {
    let (mut one, mut other) = (World::new(), World::new());
    one.populate();
    other.apply(&Edit::Insert(0, 1, 2));
    let mut compiler = Compiler::new();
    compiler.compile(&mut one.scene, EYE).unwrap();
    let report = compiler.compile(&mut other.scene, EYE).unwrap();
    assert_eq!(report.tlas, Update::Rebuilt(Rebuild::Empty));
    let mut fresh = Compiler::new();
    fresh.compile(&mut other.scene, EYE).unwrap();
    assert_eq!(Canonical::of(compiler.arrays()).difference(&Canonical::of(fresh.arrays())), None);
    assert_eq!(compiler.arrays().byte_count(), fresh.arrays().byte_count());
}

/// One random edit; numbers choose among what there is.
#[derive(Clone, Debug)]
enum Edit {
    Insert(usize, usize, usize),
    Shine(usize, usize),
    Share(usize, usize),
    Move(usize, i8, i8),
    Scale(usize, i8),
    Remove(usize),
    Reparent(usize, usize),
    SetMask(usize, u32),
    SetVisible(usize, bool),
    SetMaterial(usize, usize),
    SetGeometry(usize, usize),
    SetTexture(usize, u8),
    SwapCore(usize, usize, usize),
    ChangeCore(usize, usize, usize),
}

fn edit() -> impl Strategy<Value = Edit> {
    let n = 0usize..64;
    prop_oneof![
        6 => (n.clone(), n.clone(), n.clone()).prop_map(|(a, b, c)| Edit::Insert(a, b, c)),
        1 => (n.clone(), n.clone()).prop_map(|(a, b)| Edit::Shine(a, b)),
        2 => (n.clone(), n.clone()).prop_map(|(a, b)| Edit::Share(a, b)),
        4 => (n.clone(), any::<i8>(), any::<i8>()).prop_map(|(a, x, y)| Edit::Move(a, x, y)),
        2 => (n.clone(), any::<i8>()).prop_map(|(a, s)| Edit::Scale(a, s)),
        2 => n.clone().prop_map(Edit::Remove),
        2 => (n.clone(), n.clone()).prop_map(|(a, b)| Edit::Reparent(a, b)),
        1 => (n.clone(), any::<u32>()).prop_map(|(a, m)| Edit::SetMask(a, m)),
        2 => (n.clone(), any::<bool>()).prop_map(|(a, v)| Edit::SetVisible(a, v)),
        2 => (n.clone(), n.clone()).prop_map(|(a, b)| Edit::SetMaterial(a, b)),
        1 => (n.clone(), n.clone()).prop_map(|(a, b)| Edit::SetGeometry(a, b)),
        1 => (n.clone(), any::<u8>()).prop_map(|(a, t)| Edit::SetTexture(a, t)),
        2 => (n.clone(), n.clone(), n.clone()).prop_map(|(a, b, c)| Edit::SwapCore(a, b, c)),
        3 => (n.clone(), n.clone(), n).prop_map(|(a, b, c)| Edit::ChangeCore(a, b, c)),
    ]
}

/// A scene and the keys to edit it by; stale keys are asked for again.
struct World {
    scene: Scene,
    nodes: Vec<NodeKey>,
    geometries: Vec<GeometryKey>,
    materials: Vec<MaterialKey>,
    textures: Vec<TextureKey>,
}

impl World {
    fn new() -> Self {
        let scene = Scene::new();
        let nodes = vec![scene.root()];
        Self { scene, nodes, geometries: Vec::new(), materials: Vec::new(), textures: Vec::new() }
    }

    /// A little of everything.
    fn populate(&mut self) {
        for i in 0..12 {
            self.apply(&Edit::Insert(i / 2, i, i));
        }
        self.apply(&Edit::Shine(0, 1));
    }

    fn apply(&mut self, edit: &Edit) {
        match *edit {
            Edit::Insert(parent, geometry, material) => {
                let parent = self.node(parent);
                let core = self.core(geometry, material);
                let place = Transform::from_translation(DVec3::new(geometry as f64, material as f64, 0.5));
                let node = self.scene.add(parent, place).unwrap();
                self.scene.add(node, core).unwrap();
                self.nodes.push(node);
            }
            Edit::Shine(parent, kind) => {
                let cone = LightKind::Spot { inner_cone_angle: 0.1, outer_cone_angle: 0.5 };
                let kind = [LightKind::Point, cone, LightKind::Directional][kind % 3];
                let light = Light { kind, color: Vec3::ONE, intensity: 10.0, range: None };
                let parent = self.node(parent);
                self.scene.add(parent, light).unwrap();
            }
            Edit::Share(parent, source) => {
                let (parent, source) = (self.node(parent), self.node(source));
                let core = self.scene.core_key(source).unwrap();
                // An instance must not show itself.
                self.nodes.extend(self.scene.add(parent, core).ok());
            }
            Edit::Move(node, x, y) => {
                let node = self.node(node);
                let place = Transform::from_translation(DVec3::new(f64::from(x), f64::from(y), 1.0) / 8.0);
                // The root and geometry nodes have no transform: an error that leaves the scene as it was.
                let _ = self.scene.set_local(node, place);
            }
            Edit::Scale(node, scale) => {
                let node = self.node(node);
                let (x, rotation) = (f64::from(scale) / 16.0, DQuat::from_rotation_z(f64::from(scale)));
                let place = Transform::Trs { translation: DVec3::X, rotation, scale: DVec3::new(x, 1.0, -1.0) };
                let _ = self.scene.set_local(node, place);
            }
            Edit::Remove(node) => {
                let node = self.node(node);
                let _ = self.scene.remove(node);
                let scene = &self.scene;
                self.nodes.retain(|&n| scene.contains(n));
            }
            Edit::Reparent(node, parent) => {
                let (node, parent) = (self.node(node), self.node(parent));
                let _ = self.scene.reparent(node, parent, Keep::Local);
            }
            Edit::SetMask(node, mask) => {
                let node = self.node(node);
                self.scene.set_mask(node, mask).unwrap();
            }
            Edit::SetVisible(node, visible) => {
                let node = self.node(node);
                self.scene.set_visible(node, visible).unwrap();
            }
            Edit::SetMaterial(which, value) => {
                let (key, texture) = (self.material(which), self.texture(value));
                self.scene.set_material(key, material(value, texture)).unwrap();
            }
            Edit::SetGeometry(which, value) => {
                let key = self.geometry(which);
                self.scene.set_geometry(key, mesh(value)).unwrap();
            }
            Edit::SetTexture(which, value) => {
                let key = self.texture(which);
                self.scene.set_texture(key, texture(value)).unwrap();
            }
            Edit::SwapCore(node, geometry, material) => {
                let node = self.node(node);
                let core = self.core(geometry, material);
                let _ = self.scene.set_core(node, core);
            }
            Edit::ChangeCore(node, kind, i) => {
                let key = self.scene.core_key(self.node(node)).unwrap();
                let core = self.any_core(kind, i);
                let _ = self.scene.edit_core(key, core);
            }
        }
    }

    /// A core of any kind.
    fn any_core(&mut self, kind: usize, i: usize) -> Core {
        match kind % 12 {
            0 => Core::Group,
            5 => Core::Switch(Switch::One(i as u32 % 3)),
            6 => Core::Switch(Switch::Set([1, 2].into())),
            7 => Core::MaterialGroup(self.material(i)),
            8 => Core::Instance(self.node(i)),
            9 => Core::Lod(Lod::by_distance([i as f64 / 4.0 + 0.1])),
            10 => Core::Lod(Lod::by_projected_size(1.0, [i as f64 / 64.0 + 0.01])),
            11 => Core::Billboard(if i.is_multiple_of(2) { Billboard::Free } else { Billboard::Axis(DVec3::Y) }),
            1 => Core::Transform(Transform::from_translation(DVec3::X * i as f64)),
            2 => Core::Camera(Camera::default()),
            3 => Core::Light(Light { kind: LightKind::Point, color: Vec3::ONE, intensity: i as f32, range: None }),
            _ => self.core(i, i),
        }
    }

    fn node(&self, i: usize) -> NodeKey {
        self.nodes[i % self.nodes.len()]
    }

    fn core(&mut self, geometry: usize, material: usize) -> Core {
        Core::Geometry { geometry: self.geometry(geometry), material: self.material(material) }
    }

    /// One of four geometries, made again where it was freed.
    fn geometry(&mut self, i: usize) -> GeometryKey {
        let scene = &self.scene;
        self.geometries.retain(|&key| scene.geometry(key).is_ok());
        if self.geometries.len() < 4 {
            self.geometries.push(self.scene.add_geometry(mesh(i)).unwrap());
        }
        self.geometries[i % self.geometries.len()]
    }

    fn material(&mut self, i: usize) -> MaterialKey {
        let scene = &self.scene;
        self.materials.retain(|&key| scene.material(key).is_ok());
        if self.materials.len() < 4 {
            let value = material(i, self.texture(i));
            self.materials.push(self.scene.add_material(value).unwrap());
        }
        self.materials[i % self.materials.len()]
    }

    fn texture(&mut self, i: usize) -> TextureKey {
        let scene = &self.scene;
        self.textures.retain(|&key| scene.texture(key).is_ok());
        if self.textures.len() < 2 {
            self.textures.push(self.scene.add_texture(texture(i as u8)).unwrap());
        }
        self.textures[i % self.textures.len()]
    }
}

/// Materials of every kind the compiler tells apart.
fn material(i: usize, texture: TextureKey) -> Material {
    let textured = Some(TextureRef::new(texture));
    match i % 6 {
        0 => Material { base_color_texture: textured, ..Material::diffuse(Vec3::splat(0.5)) },
        1 => Material::mirror(Vec3::ONE),
        2 => Material::glass(1.5),
        3 => Material {
            alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
            base_color_texture: textured,
            ..Material::default()
        },
        4 => Material { alpha_mode: AlphaMode::Blend, double_sided: false, ..Material::default() },
        _ => Material { normal_texture: textured, emissive_texture: textured, unlit: true, ..Material::default() },
    }
}

fn texture(i: u8) -> Texture {
    Texture { width: 2, height: 1, texels: Arc::new([[i, 1, 2, 255], [3, i, 5, 128]]) }
}

/// A tetrahedron with the streams that `i` says.
fn mesh(i: usize) -> Geometry {
    let corner = 1.0 + i as f32 * 0.1;
    let mut geometry =
        Geometry::new([Vec3::ZERO, Vec3::X * corner, Vec3::Y, Vec3::Z], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]);
    if i & 1 != 0 {
        geometry.normals = Some(Arc::new([Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X]));
        geometry.tex_coords[0] = Some(Arc::new([Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE]));
    }
    if i & 2 != 0 {
        geometry.tex_coords[1] = Some(Arc::new([Vec2::ONE, Vec2::X, Vec2::Y, Vec2::ZERO]));
        geometry.colors = Some(Arc::new([Vec4::ONE, Vec4::X, Vec4::Y, Vec4::splat(0.25)]));
    }
    geometry
}

fn tetrahedron(scene: &mut Scene, i: usize) -> GeometryKey {
    scene.add_geometry(mesh(i)).unwrap()
}

/// Lets the compiler infer the element type of a planted change.
fn edit_with<T>(values: &mut Vec<T>, change: impl FnOnce(&mut Vec<T>)) {
    change(values);
}

/// Takes the dirty ranges of all arrays and adds up their bytes.
fn dirty_bytes(compiler: &mut Compiler) -> usize {
    let arrays = compiler.arrays_mut();
    macro_rules! total {
        ($($array:ident)*) => {
            0 $(+ arrays.$array.take_dirty().iter().map(|r| size_of_val(&arrays.$array[r.clone()])).sum::<usize>())*
        };
    }
    total!(tlas_nodes instances blas_nodes triangles geometries indices normals tex_coords colors materials texture_infos texels lights)
}
