//! The range of sizes within one geometry, and of distances and directions of rays.
#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use glam::{DAffine3, Quat, Vec3};
use ropewalk::Error;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{NONE, RayRecord};
use ropewalk_testkit::{Builder, Mesh, Placed, Random, arrays_by, tracers};

/// Rays at a ball of radius 1 from so far away.
fn rays(count: usize, distance: f32) -> Vec<RayRecord> {
    let mut random = Random::new(3);
    let mut ray = || {
        let (from, to) = (random.direction() * distance, random.in_cube() * 0.4);
        RayRecord { origin: from.to_array(), t_min: 0.0, direction: (to - from).to_array(), t_max: f32::MAX }
    };
    (0..count).map(|_| ray()).collect()
}

/// Every executor finds the ball on each of these rays, from 4 radii away.
fn all_hit_the_ball(arrays: &mut DeviceArrays, rays: &[RayRecord], case: &str) {
    for mut tracer in tracers() {
        tracer.upload(arrays).unwrap();
        let hits = tracer.closest_hits(arrays, rays, NONE).unwrap();
        let on_ball = hits.iter().filter(|hit| hit.primitive != NONE && hit.t > 0.6 && hit.t < 0.95).count();
        assert_eq!(on_ball, rays.len(), "{case}, {}", tracer.device().executor);
    }
}

#[test]
fn a_ball_is_hit_above_a_floor_a_thousand_million_times_as_wide() {
    for (size, angle) in [(1e6f32, 0.0), (1e9, 0.0), (1e6, 0.3), (1e9, 0.3)] {
        // A ball above a floor, both tilted; and rays at the ball from above its middle.
        let tilt = Quat::from_rotation_x(angle) * Quat::from_rotation_z(angle);
        let center = Vec3::Y * 1.5;
        let mut mesh = Mesh::icosphere(2);
        let first = mesh.positions.len() as u32;
        mesh.positions.iter_mut().for_each(|p| *p += center);
        mesh.positions.extend([(-1.0, -1.0), (-1.0, 1.2), (1.0, -1.0)].map(|(x, z)| Vec3::new(x, 0.0, z) * size));
        mesh.positions.iter_mut().for_each(|p| *p = tilt * *p);
        mesh.indices.push([first, first + 1, first + 2]);
        let mut arrays = arrays_by(Builder::Product, &[mesh], &[Placed::new(0, DAffine3::IDENTITY)]);
        let from_above = |ray: RayRecord| {
            let [from, along] = [ray.origin, ray.direction].map(Vec3::from);
            let side = (tilt * Vec3::Y).dot(from).signum();
            let from = from * side + tilt * center;
            RayRecord { origin: from.to_array(), direction: (along * side).to_array(), ..ray }
        };
        let rays: Vec<RayRecord> = rays(2000, 4.0).into_iter().map(from_above).collect();
        all_hit_the_ball(&mut arrays, &rays, &format!("{size:e}, {angle}"));
    }
}

#[test]
fn a_ball_is_hit_beside_a_vertex_that_is_1e20_away() {
    for size in [1e3f32, 1e10, 1e20] {
        let mut mesh = Mesh::icosphere(2);
        let first = mesh.positions.len() as u32;
        let far = [(0.0, 0.0), (0.1, 0.0), (0.0, 0.1)].map(|(y, z)| Vec3::new(1.0, y, z) * size);
        mesh.positions.extend(far);
        mesh.indices.push([first, first + 1, first + 2]);
        for builder in Builder::BOTH {
            let mut arrays = arrays_by(builder, &[mesh.clone()], &[Placed::new(0, DAffine3::IDENTITY)]);
            all_hit_the_ball(&mut arrays, &rays(1000, 4.0), &format!("{size:e}, {builder:?}"));
        }
    }
}

#[test]
fn rays_are_right_or_refused() {
    let mut arrays = arrays_by(Builder::Product, &[Mesh::icosphere(2)], &[Placed::new(0, DAffine3::IDENTITY)]);
    for mut tracer in tracers() {
        tracer.upload(&mut arrays).unwrap();
        // From up to 1e6 radii, with directions of any length that is not refused.
        for (distance, length) in [(4.0, 1.0), (1e3, 1.0), (1e6, 1.0), (4.0, 1e-29), (4.0, 1e29)] {
            let scaled = |ray: RayRecord| RayRecord { direction: ray.direction.map(|d| d * length), ..ray };
            let rays: Vec<RayRecord> = rays(1000, distance).into_iter().map(scaled).collect();
            let hits = tracer.closest_hits(&arrays, &rays, NONE).unwrap();
            assert!(hits.iter().all(|hit| hit.instance != NONE), "{distance:e}, {length:e}");
        }
        let good = rays(1, 4.0)[0];
        let bad = [
            ("ray direction", RayRecord { direction: [0.0; 3], ..good }),
            ("ray direction", RayRecord { direction: [1e-36, 0.0, 0.0], ..good }),
            ("ray direction", RayRecord { direction: [0.0, 1e31, 0.0], ..good }),
            ("ray direction", RayRecord { direction: [f32::NAN, 1.0, 0.0], ..good }),
            ("ray direction", RayRecord { direction: [1.0, 0.0, f32::INFINITY], ..good }),
            ("ray origin", RayRecord { origin: [0.0, f32::NAN, 0.0], ..good }),
            ("ray interval", RayRecord { t_min: -1.0, ..good }),
            ("ray interval", RayRecord { t_min: f32::NAN, ..good }),
            ("ray interval", RayRecord { t_max: f32::NAN, ..good }),
        ];
        for (expected, ray) in bad {
            let closest = tracer.closest_hits(&arrays, &[good, ray], NONE).map(|_| ());
            let any = tracer.any_hits(&arrays, &[good, ray], NONE).map(|_| ());
            for found in [closest, any] {
                assert!(matches!(found, Err(Error::OutOfRange { what, .. }) if what == expected), "{ray:?}");
            }
        }
    }
}
