//! Rays through the built structures hit what brute force hits.

use glam::{DAffine3, DQuat, DVec3, Vec3};
use rayon::prelude::*;
use ropewalk::accel::{Blas, BlasBuildParams, Tlas};
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{HitRecord, NONE, Node, PrimitiveRange, RayRecord};
use ropewalk::math::Aabb;
use ropewalk::trace::{Emulated, Tracer};

use super::meshes::{STRUCTURES, adversarial, geometry, grid};
use ropewalk_testkit::corpus::scenes;
use ropewalk_testkit::oracle::{Verdict, candidates, fault};
use ropewalk_testkit::{Mesh, Placed, Random, arrays};

/// The arrays of `placed`, with hierarchies by the builders under test.
fn built(meshes: &[Mesh], placed: &[Placed], params: &BlasBuildParams) -> DeviceArrays {
    let mut arrays = arrays(meshes, placed);
    let (mut nodes, mut triangles, mut instances) = (Vec::new(), Vec::new(), arrays.instances.to_vec());
    for (mesh_index, mesh) in meshes.iter().enumerate() {
        let blas = Blas::build(&geometry(mesh), params).unwrap();
        for (instance, _) in instances.iter_mut().zip(placed).filter(|(_, p)| p.mesh == mesh_index) {
            (instance.first_node, instance.first_triangle) = (nodes.len() as u32, triangles.len() as u32);
        }
        nodes.extend(blas.nodes);
        triangles.extend(blas.triangles);
    }
    let world_box = |p: &Placed| {
        let world = |v: &Vec3| p.world_from_local.transform_point3(v.as_dvec3()).as_vec3();
        let bounds = Aabb::from_points(meshes[p.mesh].positions.iter().map(world));
        let pad = bounds.min.abs().max(bounds.max.abs()).max_element() * f32::EPSILON;
        Aabb { min: bounds.min - pad, max: bounds.max + pad }
    };
    let boxes: Vec<Aabb> = placed.iter().map(world_box).collect();
    Tlas::default().build(&mut arrays.tlas_nodes, &boxes);
    arrays.blas_nodes.replace(&nodes);
    arrays.triangles.replace(&triangles);
    arrays.instances.replace(&instances);
    arrays
}

/// A hierarchy for brute force: a chain of leaves of one triangle each, all with the box of the whole mesh, so that a
/// ray that enters that box tests every triangle.
fn brute_force(arrays: &DeviceArrays) -> DeviceArrays {
    assert_eq!(arrays.instances.len(), 1);
    let root = arrays.blas_nodes[0];
    let starts: Vec<u32> = (0..arrays.triangles.len() as u32).step_by(15).collect();
    let leaf = |(i, &first): (usize, &u32)| {
        let count = (arrays.triangles.len() as u32 - first).min(15);
        let escape_index = if i + 1 == starts.len() { NONE } else { i as u32 + 1 };
        Node { escape_index, primitives: PrimitiveRange::leaf(first, count), ..root }
    };
    let chain: Vec<Node> = starts.iter().enumerate().map(leaf).collect();
    let mut brute = DeviceArrays::default();
    brute.tlas_nodes.replace(&arrays.tlas_nodes);
    brute.instances.replace(&arrays.instances);
    brute.triangles.replace(&arrays.triangles);
    brute.blas_nodes.replace(&chain);
    brute
}

fn trace(arrays: &mut DeviceArrays, rays: &[RayRecord]) -> Vec<HitRecord> {
    let mut tracer = Emulated::default();
    tracer.upload(arrays).unwrap();
    tracer.closest_hits(arrays, rays, 1).unwrap()
}

/// Compares hits with the oracle in f64, and, where the oracle is sure, bit for bit with brute force by the same
/// kernel.
fn check(name: &str, mesh: &Mesh, params: &BlasBuildParams, rays: &[RayRecord]) {
    // Executors refuse rays without a direction, as there are some at a mesh of one point.
    let rays: Vec<RayRecord> = rays.iter().filter(|ray| ray.validate().is_ok()).copied().collect();
    let mut built = built(std::slice::from_ref(mesh), &[Placed::new(0, DAffine3::IDENTITY)], params);
    let hits = trace(&mut built, &rays);
    let brute_hits = trace(&mut brute_force(&built), &rays);
    let truth: Vec<_> = rays.par_iter().map(|ray| candidates(&built, ray, 1)).collect();

    let (mut sure, mut hit_count) = (0, 0);
    for (((ray, hit), brute), candidates) in rays.iter().zip(&hits).zip(&brute_hits).zip(&truth) {
        assert_eq!(fault(ray, hit, candidates), None, "{name}: {ray:?} gives {hit:?}, brute force {brute:?}");
        hit_count += usize::from(hit.instance != NONE);
        if candidates.iter().all(|c| c.verdict != Verdict::Tie) {
            sure += 1;
            // Where a triangle occurs more than once, either copy may be hit.
            let mut same_triangle = *hit;
            same_triangle.triangle = brute.triangle;
            assert_eq!(same_triangle, *brute, "{name}: {ray:?}");
        }
    }
    println!("{name}: {} rays, {hit_count} hits, {sure} compared bit for bit", rays.len());
    assert!(hit_count * 50 > rays.len(), "{name}: only {hit_count} of {} rays hit", rays.len());
    assert!(sure * 2 > rays.len(), "{name}: rounding decides for {} of {} rays", rays.len() - sure, rays.len());
}

/// Rays at points on the triangles, half of them from far away in all directions and half from close by.
fn rays_at(mesh: &Mesh, random: &mut Random, count: usize) -> Vec<RayRecord> {
    let bounds = Aabb::from_points(mesh.positions.iter().copied());
    let size = (bounds.max - bounds.min).max_element();
    let mut ray = |_| {
        let [a, b, c] = mesh.triangle(random.index(mesh.indices.len()));
        let (u, v) = (random.unsigned(), random.unsigned());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let target = a + (b - a) * u + (c - a) * v;
        let near = (b - a).abs().max((c - a).abs()).max_element();
        let origin = target + random.direction() * [2.0 * size, 3.0 * near][random.index(2)];
        RayRecord { origin: origin.to_array(), t_min: 0.0, direction: (target - origin).to_array(), t_max: f32::MAX }
    };
    (0..count).map(&mut ray).collect()
}

#[test]
fn adversarial_meshes_are_hit_as_brute_force_hits_them() {
    for (i, (name, mesh)) in adversarial().into_iter().enumerate() {
        let rays = rays_at(&mesh, &mut Random::new(i as u64), 1500);
        check(name, &mesh, &BlasBuildParams::PAPER, &rays);
        for structure in STRUCTURES {
            check(&format!("{name}, {structure:?}"), &mesh, &BlasBuildParams::new(structure), &rays);
        }
    }
}

#[test]
fn rays_in_face_planes_of_boxes_hit() {
    // The rays lie in a plane in which many boxes have a face: along a lattice line, where the triangles' boxes end.
    let mut hits = 0;
    let places = (0..3).flat_map(|a| [0.0, 3.0].into_iter().flat_map(move |l| [1e-20, 1.0, 1e18].map(|s| (a, l, s))));
    for ((axis, level, scale), structure) in places.flat_map(|place| STRUCTURES.map(|structure| (place, structure))) {
        let mesh = grid(16, 12, axis, level).scaled(scale);
        let mut arrays = built(&[mesh], &[Placed::new(0, DAffine3::IDENTITY)], &BlasBuildParams::new(structure));
        let mut rays = Vec::new();
        for (column, row) in (0..=32).flat_map(|c| (0..=24).map(move |r| (c as f32 / 2.0, r as f32 / 2.0))) {
            let mut origin = Vec3::splat(level);
            (origin[(axis + 1) % 3], origin[(axis + 2) % 3]) = (column, row);
            for side in [-1.0, 1.0] {
                let direction = Vec3::AXES[axis] * side;
                let origin = (origin - direction * 7.0) * scale;
                rays.push(RayRecord {
                    origin: origin.to_array(),
                    t_min: 0.0,
                    direction: direction.to_array(),
                    t_max: f32::MAX,
                });
            }
        }
        let missed = trace(&mut arrays, &rays).iter().zip(&rays).filter(|(h, _)| h.instance == NONE).count();
        assert_eq!(missed, 0, "of {} rays along axis {axis} at level {level}, scale {scale:e}", rays.len());
        hits += rays.len();
    }
    assert!(hits > 10_000);
}

#[test]
fn instances_are_hit_as_f64_hits_them() {
    let meshes = [Mesh::soup(1, 60), Mesh::icosphere(1), Mesh::cube()];
    let mut random = Random::new(5);
    let placed: Vec<Placed> = (0..80)
        .map(|i| {
            let scale = random.in_cube().as_dvec3() * 0.4 + DVec3::splat(0.6);
            let rotation = DQuat::from_axis_angle(random.direction().as_dvec3(), f64::from(random.signed()) * 3.0);
            let at = random.in_cube().as_dvec3() * 4.0;
            Placed::new(i % 3, DAffine3::from_scale_rotation_translation(scale, rotation, at))
        })
        .collect();
    let mut arrays = built(&meshes, &placed, &BlasBuildParams::default());
    let ray = |_| {
        let (origin, target) = (random.direction() * 10.0, random.in_cube() * 4.0);
        RayRecord { origin: origin.to_array(), t_min: 0.0, direction: (target - origin).to_array(), t_max: f32::MAX }
    };
    let rays: Vec<RayRecord> = (0..3000).map(ray).collect();
    let hits = trace(&mut arrays, &rays);
    let truth: Vec<_> = rays.par_iter().map(|ray| candidates(&arrays, ray, 1)).collect();
    for ((ray, hit), candidates) in rays.iter().zip(&hits).zip(&truth) {
        assert_eq!(fault(ray, hit, candidates), None, "{ray:?} gives {hit:?}");
    }
    assert!(hits.iter().filter(|h| h.instance != NONE).count() > 1000);
}

#[test]
fn bunny() {
    let Some(scenes) = scenes("bunny") else { return };
    let mesh = Mesh::glb(&scenes.join("meshes/stanford-bunny.glb"));
    assert_eq!(mesh.indices.len(), 69_451);
    let rays = rays_at(&mesh, &mut Random::new(1), 1000);
    for structure in STRUCTURES {
        check(&format!("bunny, {structure:?}"), &mesh, &BlasBuildParams::new(structure), &rays);
    }
}
