//! The compiler: compiling edit by edit gives what compiling from scratch gives, and each kind of edit costs what it
//! should.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use std::cell::Cell;

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use ropewalk::accel::{RebuildReason, TlasUpdate};
use ropewalk::compile::{Compiler, ViewHeight, Viewpoint};
use ropewalk::device::Needs;
use ropewalk::device::layout::{HitRecord, RayRecord};
use ropewalk::device::{DeviceArrays, DeviceBuffer};
use ropewalk::trace::{Emulated, Tracer};
use ropewalk::{Core, GeometryKey, Material, NodeKey, Scene, Transform};
use ropewalk_testkit::Random;
use ropewalk_testkit::canonical::Canonical;
use ropewalk_testkit::world::{Edit, World, edit, edit_with_geometries, mesh};

const EYE: DVec3 = DVec3::new(0.0, 0.0, 10.0);

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    /// ARCHITECTURE, invariants: the scene compiled edit by edit equals the scene compiled from scratch.
    #[test]
    fn random_edits_compile_as_from_nothing(edits in prop::collection::vec(edit(), 1..100), every in 1usize..8) {
        let mut world = World::new();
        let mut compiler = Compiler::new();
        let mut compared = 0;
        for (i, edit) in edits.iter().enumerate() {
            world.apply(edit);
            if i % every == 0 || i + 1 == edits.len() {
                // Some levels of detail depend on the projected size.
                let height = ViewHeight::Perspective([0.1, 1.0, 10.0][i % 3]);
                let viewpoint = Viewpoint { height, ..EYE.into() };
                let report = compiler.compile(&mut world.scene, viewpoint).unwrap();
                let mut fresh = Compiler::new();
                let fresh_report = fresh.compile(&mut world.scene, viewpoint).unwrap();
                world.scene.validate().unwrap();
                let exact = Canonical::exactly(compiler.arrays());
                prop_assert_eq!(exact.difference(&Canonical::exactly(fresh.arrays())), None);
                prop_assert_eq!(report.needs, fresh_report.needs);
                prop_assert_eq!(report.instances, fresh_report.instances);
                prop_assert_eq!(report.unhittable_instances, fresh_report.unhittable_instances);
                prop_assert_eq!(report.instanced_triangles, fresh_report.instanced_triangles);
                prop_assert_eq!((report.lights, report.blas_count), (fresh_report.lights, fresh_report.blas_count));
                compared += 1;
            }
        }
        prop_assert!(compared > 0);
        // Data without users is freed: a scene without nodes leaves all arrays empty.
        for child in world.scene.children(world.scene.root()).unwrap().collect::<Vec<_>>() {
            world.scene.remove(child).unwrap();
        }
        compiler.compile(&mut world.scene, EYE).unwrap();
        prop_assert_eq!(compiler.arrays().byte_count(), 0);
    }
}

/// A geometry that has changed may have another structure than one built from scratch, but with the same triangles, and
/// rays hit the same.
#[test]
fn random_deformations_show_what_is_compiled_from_nothing() {
    let (refitted, built) = (Cell::new(0), Cell::new([0; 3]));
    let (hits, same) = (Cell::new(0), Cell::new(0));
    let config = ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() };
    let strategy = (prop::collection::vec(edit_with_geometries(), 1..60), 1usize..6);
    let outcome = TestRunner::new(config).run(&strategy, |(edits, every)| {
        let mut world = World::new();
        world.populate();
        let (mut compiler, mut copies) = (Compiler::new(), Copies::default());
        for (i, edit) in edits.iter().enumerate() {
            world.apply(edit);
            if i % every == 0 || i + 1 == edits.len() {
                let report = compiler.compile(&mut world.scene, EYE).unwrap();
                prop_assert_eq!(copies.catch_up(compiler.arrays_mut()), None);
                let mut fresh = Compiler::new();
                let fresh_report = fresh.compile(&mut world.scene, EYE).unwrap();
                prop_assert_eq!(Canonical::of(compiler.arrays()).difference(&Canonical::of(fresh.arrays())), None);
                prop_assert_eq!(
                    (report.needs, report.unique_triangles),
                    (fresh_report.needs, fresh_report.unique_triangles)
                );
                let rays = rays_at(fresh.arrays());
                let [ours, theirs] = [&mut compiler, &mut fresh].map(|c| hits_in(c.arrays_mut(), &rays));
                prop_assert_eq!(ours.0, theirs.0);
                // Copies of a geometry at the same place are equally far away, and then the order of instances decides
                // which is hit.
                same.set(same.get() + ours.1.iter().zip(&theirs.1).filter(|(a, b)| a.is_some() && a == b).count());
                hits.set(hits.get() + ours.1.iter().flatten().count());
                refitted.set(refitted.get() + report.blas_refitted);
                let builds = report.blas_builds;
                let reasons = [builds.triangles_changed, builds.cost_grown, builds.structure_changed];
                prop_assert_eq!(builds.new + reasons.iter().sum::<usize>(), report.blas_built);
                built.set([0, 1, 2].map(|i| built.get()[i] + reasons[i]));
            }
        }
        Ok(())
    });
    outcome.unwrap_or_else(|failure| panic!("{failure}"));
    println!(
        "{refitted:?} refitted, {built:?} built for other triangles, cost, structure; {hits:?} hits, {same:?} the same"
    );
    assert!(hits.get() > 10_000 && same.get() * 10 > hits.get() * 9);
    assert!(refitted.get() > 1000 && built.get().iter().all(|&count| count > 3));
}

/// The arrays as an executor has them, which copies only the ranges marked as changed.
#[derive(Default)]
struct Copies {
    nodes: Vec<u8>,
    wide_nodes: Vec<u8>,
    triangles: Vec<u8>,
    normals: Vec<u8>,
    geometries: Vec<u8>,
}

impl Copies {
    /// Copies what is marked as changed; returns the name of the first array that then differs from the copy.
    fn catch_up(&mut self, arrays: &mut DeviceArrays) -> Option<&'static str> {
        fn is_equal<T: bytemuck::Pod>(copy: &mut Vec<u8>, array: &mut DeviceBuffer<T>) -> bool {
            copy.resize(size_of_val::<[T]>(array), 0xff);
            for range in array.take_dirty() {
                let bytes = range.start * size_of::<T>()..range.end * size_of::<T>();
                copy[bytes].copy_from_slice(bytemuck::cast_slice(&array[range]));
            }
            *copy == bytemuck::cast_slice::<T, u8>(array)
        }
        [
            ("nodes", is_equal(&mut self.nodes, &mut arrays.blas_nodes)),
            ("wide nodes", is_equal(&mut self.wide_nodes, &mut arrays.wide_nodes)),
            ("triangles", is_equal(&mut self.triangles, &mut arrays.triangles)),
            ("normals", is_equal(&mut self.normals, &mut arrays.normals)),
            ("geometries", is_equal(&mut self.geometries, &mut arrays.geometries)),
        ]
        .into_iter()
        .find_map(|(name, is_equal)| (!is_equal).then_some(name))
    }
}

/// Rays at points in the boxes of instances, from near and from far.
fn rays_at(arrays: &DeviceArrays) -> Vec<RayRecord> {
    let mut random = Random::new(1);
    let leaves = arrays.tlas_nodes.iter().filter(|node| node.primitives.primitive_count() > 0);
    let boxes: Vec<_> = leaves.map(|leaf| (Vec3::from(leaf.min), Vec3::from(leaf.max))).collect();
    let mut ray = |i: usize| {
        let (min, max) = boxes[i % boxes.len()];
        let mut in_unit_cube = || Vec3::new(random.unsigned(), random.unsigned(), random.unsigned());
        let target = min + (max - min) * in_unit_cube();
        let direction = in_unit_cube() - 0.5;
        let origin = target - direction * [1.0, 30.0][i % 2];
        RayRecord { origin: origin.to_array(), t_min: 0.0, direction: direction.to_array(), t_max: f32::MAX }
    };
    let count = if boxes.is_empty() { 0 } else { 50 };
    (0..count).map(&mut ray).collect()
}

/// The distance (as bits), the node and the triangle of each ray's hit.
fn hits_in(arrays: &mut DeviceArrays, rays: &[RayRecord]) -> (Vec<u32>, Vec<Option<[u32; 2]>>) {
    let mut tracer = Emulated::default();
    tracer.upload(arrays).unwrap();
    let hits = tracer.closest_hits(arrays, rays, u32::MAX).unwrap();
    let told = |hit: &HitRecord| Some([arrays.instances.get(hit.instance as usize)?.node_key[0], hit.primitive]);
    (hits.iter().map(|hit| hit.t.to_bits()).collect(), hits.iter().map(told).collect())
}

#[test]
fn canonical_form_sees_each_field() {
    // A difference planted in each array must be found.
    let mut world = World::new();
    world.populate();
    let mut compiler = Compiler::new();
    compiler.compile(&mut world.scene, EYE).unwrap();
    let before = [Canonical::of(compiler.arrays()), Canonical::exactly(compiler.arrays())];
    assert!(before[0].instance_count() > 1);

    macro_rules! plant {
        ($array:ident, $change:expr) => {{
            plant!($array, $change, [true, true]);
        }};
        ($array:ident, $change:expr, $seen:expr) => {{
            let original = compiler.arrays().$array.to_vec();
            let mut changed = original.clone();
            edit_with(&mut changed, $change);
            assert!(changed != original, "{} was not changed", stringify!($array));
            compiler.arrays_mut().$array.write(0, &changed);
            let loose = Canonical::of(compiler.arrays()).difference(&before[0]);
            let exact = Canonical::exactly(compiler.arrays()).difference(&before[1]);
            assert_eq!([loose.is_some(), exact.is_some()], $seen, "{}: {loose:?}, {exact:?}", stringify!($array));
            compiler.arrays_mut().$array.write(0, &original);
        }};
    }
    plant!(tlas_nodes, |nodes| nodes.iter_mut().for_each(|n| n.min[0] -= 1.0));
    plant!(instances, |instances| instances.iter_mut().for_each(|i| i.mask ^= 1));
    plant!(blas_nodes, |nodes| nodes.iter_mut().for_each(|n| n.max[2] += 1.0), [false, true]);
    plant!(blas_nodes, |nodes| nodes.iter_mut().for_each(|n| n.max[2] *= 0.999));
    plant!(wide_nodes, |nodes| nodes.iter_mut().for_each(|n| n.planes[1][1] = [0; 8]));
    plant!(triangles, |triangles| triangles.iter_mut().for_each(|t| t.v1[0] += 1.0));
    plant!(indices, |indices| indices.iter_mut().for_each(|i| *i = 0));
    plant!(normals, |normals| normals.iter_mut().for_each(|n| *n += 1.0));
    plant!(tex_coords, |tex_coords| tex_coords.iter_mut().for_each(|t| t[0] += 1.0));
    plant!(colors, |colors| colors.iter_mut().for_each(|c| c[1] ^= 1));
    plant!(materials, |materials| materials.iter_mut().for_each(|m| m.ior += 1.0));
    plant!(texture_infos, |infos| infos.iter_mut().for_each(|i| i.flags ^= 1));
    plant!(texels, |texels| texels.iter_mut().for_each(|t| *t ^= 1));
    plant!(lights, |lights| lights[0].color[1] += 1.0);
    assert_eq!(Canonical::of(compiler.arrays()).difference(&before[0]), None);
}

#[test]
fn an_unchanged_scene_changes_nothing() {
    let mut world = World::new();
    world.populate();
    let mut compiler = Compiler::new();
    let first = compiler.compile(&mut world.scene, EYE).unwrap();
    assert_eq!(first.tlas, TlasUpdate::Rebuilt(RebuildReason::Empty));
    assert!(first.blas_built > 0 && dirty_bytes(&mut compiler) > 0);

    let second = compiler.compile(&mut world.scene, EYE).unwrap();
    assert_eq!((second.tlas, second.blas_built), (TlasUpdate::Kept, 0));
    assert_eq!(dirty_bytes(&mut compiler), 0);
    // Nor is anything compiled for a camera that moves a little, or for a value that is set to what it was.
    let node = world.nodes[1];
    world.scene.set_local(node, world.scene.local(node).unwrap()).unwrap();
    let third = compiler.compile(&mut world.scene, EYE + DVec3::splat(0.01)).unwrap();
    assert_eq!((third.tlas, dirty_bytes(&mut compiler)), (TlasUpdate::Kept, 0));
}

#[test]
fn a_moved_node_patches_the_tlas_only() {
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
    assert_eq!((first.blas_built, first.instances, first.instanced_triangles), (1, 1000, 4000));
    dirty_bytes(&mut compiler);

    scene.set_local(nodes[500], Transform::from_translation(DVec3::new(1500.0, 1.0, 0.0))).unwrap();
    let report = compiler.compile(&mut scene, EYE).unwrap();
    assert!(matches!(report.tlas, TlasUpdate::Patched { instances: 1, .. }));
    assert_eq!(report.blas_built, 0);
    let arrays = compiler.arrays_mut();
    assert_eq!(arrays.instances.take_dirty().iter().map(ExactSizeIterator::len).sum::<usize>(), 1);
    assert!(arrays.blas_nodes.take_dirty().is_empty() && arrays.triangles.take_dirty().is_empty());
}

#[test]
fn a_changed_material_keeps_the_tlas() {
    let mut world = World::new();
    world.populate();
    let mut compiler = Compiler::new();
    compiler.compile(&mut world.scene, EYE).unwrap();
    dirty_bytes(&mut compiler);
    let material = world.materials[0];
    world.scene.set_material(material, Material::glass(1.4)).unwrap();
    let report = compiler.compile(&mut world.scene, EYE).unwrap();
    assert_eq!((report.tlas, report.blas_built), (TlasUpdate::Kept, 0));
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
fn an_instance_without_area_is_left_out_and_reported() {
    let mut scene = Scene::new();
    let (geometry, material) = (tetrahedron(&mut scene, 0), scene.add_material(Material::default()).unwrap());
    for scale in [DVec3::ONE, DVec3::new(1.0, 0.0, 1.0), DVec3::new(0.0, 0.0, 1.0), DVec3::splat(1e-60)] {
        let node = scene.add(scene.root(), Transform::from_scale(scale)).unwrap();
        scene.add(node, Core::Geometry { geometry, material }).unwrap();
    }
    let report = Compiler::new().compile(&mut scene, EYE).unwrap();
    // One flattened to a plane is drawn.
    assert_eq!((report.instances, report.unhittable_instances), (2, 2));
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
    // It moves to the next point of a grid that f32 holds.
    assert!(compiler.origin().distance(far) < 0.1 * far.distance(EYE));
    assert_eq!(compiler.origin().as_vec3().as_dvec3(), compiler.origin());
}

#[test]
fn another_scene_is_compiled_from_nothing() {
    let (mut one, mut other) = (World::new(), World::new());
    one.populate();
    other.apply(&Edit::Insert(0, 1, 2));
    let mut compiler = Compiler::new();
    compiler.compile(&mut one.scene, EYE).unwrap();
    let report = compiler.compile(&mut other.scene, EYE).unwrap();
    assert_eq!(report.tlas, TlasUpdate::Rebuilt(RebuildReason::Empty));
    let mut fresh = Compiler::new();
    fresh.compile(&mut other.scene, EYE).unwrap();
    assert_eq!(Canonical::of(compiler.arrays()).difference(&Canonical::of(fresh.arrays())), None);
    assert_eq!(compiler.arrays().byte_count(), fresh.arrays().byte_count());
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
