//! Rays that start on the surface, or within its boxes.

use fastrand::Rng;
use glam::Vec3;
use ropewalk::device::layout::RayRecord;
use ropewalk_bench::Result;

use crate::row::{Goal, Recipe, Row};
use ropewalk_bench::aim::{any, corner, direction, inside, on_edge, point, quantised, ray};
use ropewalk_bench::meshes::{bumpy, cube, round};

pub const ROWS: [Recipe; 8] = [
    Recipe { name: "vulkan: inside_aabbs", goal: Goal::NoLeaks, make: inside_boxes },
    Recipe {
        name: "starts on faces of a cube, inward",
        goal: Goal::Zero,
        make: |rays| inward(rays, cube(8), inside_of_cube),
    },
    Recipe {
        name: "starts on faces of a sphere, inward",
        goal: Goal::NoLeaks,
        make: |rays| inward(rays, round(), inside),
    },
    Recipe {
        name: "starts on faces of a cube, outward",
        goal: Goal::Zero,
        make: |rays| outward(rays, cube(8), inside_of_cube),
    },
    Recipe { name: "starts on edges, inward", goal: Goal::Zero, make: |rays| inward(rays, cube(8), on_edge) },
    Recipe { name: "starts on edges, outward", goal: Goal::Zero, make: |rays| outward(rays, cube(8), on_edge) },
    Recipe { name: "starts on corners, inward", goal: Goal::NoLeaks, make: |rays| inward(rays, round(), corner) },
    Recipe { name: "starts on corners, outward", goal: Goal::NoLeaks, make: |rays| outward(rays, round(), corner) },
];

/// A start on a triangle.
type Start = fn(&mut Rng, [Vec3; 3]) -> Vec3;

/// Within the boxes of the triangles of a sphere, and mostly not on them, towards anywhere.
fn inside_boxes(rays: usize) -> Result<Row> {
    let mut random = Rng::with_seed(60);
    let triangles = bumpy();
    let aimed = (0..rays).map(|_| {
        let [a, b, c] = any(&mut random, &triangles);
        let (min, max) = (a.min(b).min(c), a.max(b).max(c));
        let share = Vec3::new(random.f32(), random.f32(), random.f32());
        ray(quantised(min + (max - min) * share), direction(&mut random))
    });
    let rays = aimed.collect();
    Ok(Row::new(triangles, rays))
}

/// A point of a side of the cube, exactly.
fn inside_of_cube(random: &mut Rng, corners: [Vec3; 3]) -> Vec3 {
    quantised(inside(random, corners))
}

/// To a point deep inside a closed convex surface, from a range that starts off the surface: the far side is hit.
fn inward(rays: usize, triangles: Vec<[Vec3; 3]>, start: Start) -> Result<Row> {
    let mut random = Rng::with_seed(61);
    let aimed = (0..rays).map(|i| {
        let corners = any(&mut random, &triangles);
        let origin = start(&mut random, corners);
        let target = quantised(point(&mut random) * 0.5);
        let ray = ray(origin, target - origin);
        // Every second range includes the start itself.
        if i % 2 == 0 { ray } else { RayRecord { t_min: 1e-3, ..ray } }
    });
    let rays = aimed.collect();
    Ok(Row::new(triangles, rays))
}

/// Away from a point deep inside: nothing is hit but what the ray starts on, and nothing at all a little later.
fn outward(rays: usize, triangles: Vec<[Vec3; 3]>, start: Start) -> Result<Row> {
    let mut random = Rng::with_seed(62);
    let aimed = (0..rays).map(|_| {
        let corners = any(&mut random, &triangles);
        let origin = start(&mut random, corners);
        let center = quantised(point(&mut random) * 0.5);
        RayRecord { t_min: 1e-3, ..ray(origin, origin - center) }
    });
    let rays = aimed.collect();
    Ok(Row::new(triangles, rays))
}
