//! `closest_hit` compared with brute force in f64: every hit is right, except where rounding decides (the tie band).

#![allow(clippy::panic, clippy::unwrap_used, reason = "a test fails by panicking")]

use glam::{DAffine3, DQuat, DVec3};
use rayon::prelude::*;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{InstanceFlags, NONE, RayRecord};
use ropewalk::trace::Tracer;
use ropewalk_testkit::corpus::scenes;
use ropewalk_testkit::oracle::{Candidate, Fault, Verdict, candidates, fault, is_sure};
use ropewalk_testkit::{Mesh, Placed, Random, arrays, tracers};

/// The result of a comparison.
#[derive(Default, Debug)]
struct Tally {
    rays: usize,
    hits: usize,
    /// Rays for which rounding decides whether some triangle is met.
    ties: usize,
    faults: Vec<(Fault, RayRecord)>,
    /// |t - exact t| in units of the last place of t, of each hit.
    t_errors: Vec<f64>,
}

fn compare(tracer: &mut dyn Tracer, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32, truth: &Truth) -> Tally {
    let hits = tracer.closest_hits(arrays, rays, ray_mask).unwrap();
    assert_eq!(hits.len(), rays.len());
    let mut tally = Tally::default();
    for ((ray, hit), candidates) in rays.iter().zip(&hits).zip(truth) {
        tally.rays += 1;
        tally.ties += usize::from(candidates.iter().any(|c| c.verdict == Verdict::Tie));
        tally.faults.extend(fault(ray, hit, candidates).map(|f| (f, *ray)));
        if hit.instance == NONE {
            continue;
        }
        tally.hits += 1;
        if let Some(own) = candidates.iter().find(|c| (c.instance, c.primitive) == (hit.instance, hit.primitive)) {
            let ulp = f64::from(hit.t.next_up() - hit.t);
            tally.t_errors.push((f64::from(hit.t) - own.t).abs() / ulp);
        }
    }
    tally.t_errors.sort_by(f64::total_cmp);
    tally
}

/// The triangles that each ray may hit.
type Truth = Vec<Vec<Candidate>>;

/// Compares the hits of every executor with f64, and prints the counts and errors.
fn check(what: &str, arrays: &mut DeviceArrays, rays: &[RayRecord], ray_mask: u32) {
    let truth: Truth = rays.par_iter().map(|ray| candidates(arrays, ray, ray_mask)).collect();
    for tracer in &mut tracers() {
        tracer.upload(arrays).unwrap();
        let tally = compare(tracer.as_mut(), arrays, rays, ray_mask, &truth);
        let percentile = |p: usize| tally.t_errors.get(tally.t_errors.len() * p / 100).copied().unwrap_or(0.0);
        println!(
            "{what}, {}: {} rays, {} hits, {} near an edge, {} wrong; t off by {:.2} ulp (median), {:.1} (99 %)",
            tracer.device().executor,
            tally.rays,
            tally.hits,
            tally.ties,
            tally.faults.len(),
            percentile(50),
            percentile(99),
        );
        assert!(tally.faults.is_empty(), "{what}: {} wrong, as {:?}", tally.faults.len(), tally.faults[0]);
        assert!(tally.hits * 20 > tally.rays, "{what}: only {} of {} rays hit", tally.hits, tally.rays);
        assert!(tally.ties * 10 < tally.rays, "{what}: the band hides {} of {} rays", tally.ties, tally.rays);
    }
}

/// Rays from outside of a ball at `center` into it, and some from its inside; directions have all lengths.
fn rays(random: &mut Random, center: DVec3, radius: f64, count: usize) -> Vec<RayRecord> {
    let mut ray = || {
        let (from, to) = (random.direction().as_dvec3(), random.in_cube().as_dvec3());
        let distance = [0.5, 1.5, 10.0][random.index(3)];
        let direction = (to - from * distance) * radius * 10f64.powi(random.index(7) as i32 - 3);
        RayRecord {
            origin: (center + from * distance * radius).as_vec3().to_array(),
            t_min: 0.0,
            direction: direction.as_vec3().to_array(),
            t_max: f32::MAX,
        }
    };
    (0..count).map(|_| ray()).collect()
}

#[test]
fn random_triangles() {
    for seed in 0..4 {
        let mut arrays = arrays(&[Mesh::soup(seed, 700)], &[Placed::new(0, DAffine3::IDENTITY)]);
        let rays = rays(&mut Random::new(seed), DVec3::ZERO, 1.0, 4000);
        check(&format!("soup {seed}"), &mut arrays, &rays, 1);
    }
}

#[test]
fn geometry_of_any_size() {
    for scale in [1e-20, 1e-6, 1e6, 1e15, 1e20] {
        let mut arrays = arrays(&[Mesh::soup(9, 500).scaled(scale)], &[Placed::new(0, DAffine3::IDENTITY)]);
        let rays = rays(&mut Random::new(3), DVec3::ZERO, f64::from(scale), 3000);
        check(&format!("soup x {scale:e}"), &mut arrays, &rays, 1);
    }
}

/// Instances under products of transforms: rotated, mirrored, sheared by non-uniform scale, far from the origin.
fn placed(random: &mut Random, count: usize, spread: f64) -> Vec<Placed> {
    let mut placed = Vec::new();
    for i in 0..count {
        let mut world_from_local = DAffine3::IDENTITY;
        for _ in 0..3 {
            let mut scale = random.in_cube().as_dvec3() * 0.75 + DVec3::ONE;
            if i % 2 == 1 {
                scale.x = -scale.x;
            }
            let rotation = DQuat::from_axis_angle(random.direction().as_dvec3(), f64::from(random.signed()) * 3.0);
            world_from_local *= DAffine3::from_scale_rotation_translation(scale, rotation, random.in_cube().as_dvec3());
        }
        world_from_local.translation += random.in_cube().as_dvec3() * spread;
        placed.push(Placed { mask: 1 << (i % 3), ..Placed::new(i % 2, world_from_local) });
    }
    placed
}

#[test]
fn nested_and_mirrored_transforms() {
    let meshes = [Mesh::soup(1, 40), Mesh::icosphere(1)];
    for seed in 0..4 {
        let mut random = Random::new(seed);
        let placed = placed(&mut random, 40, 4.0);
        let mirrored = placed.iter().filter(|p| p.world_from_local.matrix3.determinant() < 0.0).count();
        assert!(mirrored > 10 && mirrored < 30);
        let mut arrays = arrays(&meshes, &placed);
        let rays = rays(&mut random, DVec3::ZERO, 5.0, 2000);
        check(&format!("instances {seed}"), &mut arrays, &rays, 1);
        check(&format!("instances {seed}, all masks"), &mut arrays, &rays, 7);
    }
}

#[test]
fn back_faces_are_culled_as_gltf_defines_them() {
    let mut random = Random::new(11);
    let mut placed = placed(&mut random, 30, 3.0);
    for p in &mut placed {
        p.mesh = 0;
        p.flags = InstanceFlags::CULL_BACK;
    }
    let mut arrays = arrays(&[Mesh::icosphere(1)], &placed);
    check("culled", &mut arrays, &rays(&mut random, DVec3::ZERO, 4.0, 4000), 7);
}

#[test]
fn far_from_the_origin() {
    let center = DVec3::new(3000.0, -2000.0, 1000.0);
    let world_from_local =
        DAffine3::from_scale_rotation_translation(DVec3::splat(100.0), DQuat::from_rotation_x(1.0), center);
    let mut arrays = arrays(&[Mesh::icosphere(2)], &[Placed::new(0, world_from_local)]);
    check("far", &mut arrays, &rays(&mut Random::new(5), center, 100.0, 3000), 1);
}

#[test]
fn hits_lie_between_t_min_and_t_max() {
    let mut arrays = arrays(&[Mesh::soup(2, 500)], &[Placed::new(0, DAffine3::IDENTITY)]);
    let mut random = Random::new(8);
    let mut rays = rays(&mut random, DVec3::ZERO, 1.0, 4000);
    for ray in &mut rays {
        let length = glam::Vec3::from_array(ray.direction).length();
        ray.t_min = random.unsigned() * 2.0 / length;
        ray.t_max = ray.t_min + random.unsigned() * 10.0 / length;
    }
    check("interval", &mut arrays, &rays, 1);
}

#[test]
fn any_hit_agrees_with_f64() {
    let meshes = [Mesh::soup(1, 40), Mesh::icosphere(1)];
    let mut random = Random::new(6);
    let mut arrays = arrays(&meshes, &placed(&mut random, 40, 4.0));
    let mut rays = rays(&mut random, DVec3::ZERO, 5.0, 3000);
    for ray in &mut rays {
        ray.t_max = random.unsigned() * 20.0 / glam::Vec3::from_array(ray.direction).length();
    }
    for tracer in &mut tracers() {
        tracer.upload(&mut arrays).unwrap();
        let blocked = tracer.any_hits(&arrays, &rays, 3).unwrap();
        assert_eq!(blocked.len(), rays.len());
        let (mut surely_blocked, mut surely_free) = (0, 0);
        for (ray, &blocked) in rays.iter().zip(&blocked) {
            let candidates = candidates(&arrays, ray, 3);
            let range = f64::from(ray.t_min)..=f64::from(ray.t_max);
            let may_hit = |c: &Candidate| c.t + c.t_error >= *range.start() && c.t - c.t_error <= *range.end();
            if candidates.iter().any(|c| is_sure(c, ray)) {
                surely_blocked += 1;
                assert!(blocked, "{ray:?}");
            } else if !candidates.iter().any(may_hit) {
                surely_free += 1;
                assert!(!blocked, "{ray:?}");
            }
        }
        assert!(surely_blocked > 300 && surely_free > 300, "{surely_blocked} blocked, {surely_free} free");
    }
}

#[test]
fn bunny() {
    let Some(scenes) = scenes("bunny") else { return };
    let mesh = Mesh::glb(&scenes.join("meshes/stanford-bunny.glb"));
    assert_eq!(mesh.indices.len(), 69_451);
    let bounds = ropewalk::math::Aabb::from_points(mesh.positions.iter().copied());
    let radius = f64::from((bounds.max - bounds.min).length()) / 2.0;
    let center = bounds.center().as_dvec3();
    let mut arrays = arrays(&[mesh], &[Placed::new(0, DAffine3::IDENTITY)]);
    check("bunny", &mut arrays, &rays(&mut Random::new(1), center, radius, 1500), 1);
}

#[test]
fn of_equal_hits_the_lower_instance_and_primitive_wins() {
    // Twelve copies of each triangle of a cube in one geometry, and twelve instances of that.
    let mut mesh = Mesh::cube();
    mesh.indices = mesh.indices.iter().cycle().take(144).copied().collect();
    let mut arrays = arrays(&[mesh], &vec![Placed::new(0, DAffine3::IDENTITY); 12]);
    let rays = rays(&mut Random::new(4), DVec3::ZERO, 1.0, 2000);
    for tracer in &mut tracers() {
        tracer.upload(&mut arrays).unwrap();
        let hits = tracer.closest_hits(&arrays, &rays, 1).unwrap();
        let hits: Vec<_> = hits.iter().filter(|h| h.instance != NONE).collect();
        assert!(hits.len() > 500);
        assert!(hits.iter().all(|h| h.instance == 0 && h.primitive < 12), "{}", tracer.device().executor);
    }
}
