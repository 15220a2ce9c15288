//! Closed and connected surfaces: no ray passes between two triangles.

use fastrand::Rng;
use glam::Vec3;
use ropewalk_bench::Result;

use crate::row::{Goal, Recipe, Row};
use ropewalk_bench::aim::{at_all_parts, point, quantised, ray, signed};
use ropewalk_bench::meshes::{bumpy, cube, fan, grid, moved, round, turn};

pub const ROWS: [Recipe; 11] = [
    Recipe { name: "embree: watertight_closed, cube", goal: Goal::Zero, make: |rays| closed(cube(8), 0.9, rays) },
    Recipe { name: "embree: watertight_closed, bumps", goal: Goal::NoLeaks, make: |rays| closed(bumpy(), 0.4, rays) },
    Recipe { name: "embree: watertight_sphere", goal: Goal::Zero, make: |rays| closed(round(), 0.5, rays) },
    Recipe { name: "embree: watertight_plane", goal: Goal::Zero, make: |rays| above(grid(64, |_, _| 0.0), rays) },
    Recipe { name: "vulkan: watertightness random", goal: Goal::NoLeaks, make: rough },
    Recipe { name: "vulkan: closedFan", goal: Goal::Zero, make: |rays| above(fan(64, Vec3::ZERO), rays) },
    Recipe {
        name: "vulkan: closedFan2",
        goal: Goal::Zero,
        make: |rays| above(fan(64, Vec3::new(0.25, 0.125, -0.5)), rays),
    },
    Recipe { name: "vulkan: nomiss", goal: Goal::Zero, make: |rays| from_far(cube(16), rays) },
    Recipe { name: "vulkan: singlehit", goal: Goal::Zero, make: single_hit },
    Recipe {
        name: "turned sphere, f32 corners",
        goal: Goal::NoLeaks,
        make: |rays| closed(moved(&round(), |p| turn() * p), 0.5, rays),
    },
    Recipe { name: "cube with fillers at T-junctions", goal: Goal::Zero, make: fillers },
];

/// From within, some through corners and edges exactly.
fn closed(triangles: Vec<[Vec3; 3]>, radius: f32, rays: usize) -> Result<Row> {
    let rays = at_all_parts(&mut Rng::with_seed(1), rays, &triangles, |random| quantised(point(random) * radius));
    Ok(Row::new(triangles, rays))
}

/// From above a surface that is seen from there without gaps.
fn above(triangles: Vec<[Vec3; 3]>, rays: usize) -> Result<Row> {
    let origin = |random: &mut Rng| quantised(Vec3::new(signed(random), signed(random), 1.0 + random.f32()));
    let rays = at_all_parts(&mut Rng::with_seed(2), rays, &triangles, origin);
    Ok(Row::new(triangles, rays))
}

/// A height field with slopes up to vertical, seen from above.
fn rough(rays: usize) -> Result<Row> {
    let mut random = Rng::with_seed(3);
    let heights: Vec<f32> = (0..33 * 33).map(|_| quantised(Vec3::splat(0.25 * signed(&mut random))).x).collect();
    let index = |x: f32| (16.0 * (x + 1.0)) as usize;
    above(grid(32, |x, y| heights[33 * index(y) + index(x)]), rays)
}

/// From ten sizes away.
fn from_far(triangles: Vec<[Vec3; 3]>, rays: usize) -> Result<Row> {
    let origin = |random: &mut Rng| {
        let away = point(random);
        quantised(away + away.signum() * 10.0)
    };
    let rays = at_all_parts(&mut Rng::with_seed(4), rays, &triangles, origin);
    Ok(Row::new(triangles, rays))
}

/// Straight down on corners, edges and cells of a fan, each of which is crossed once.
fn single_hit(rays: usize) -> Result<Row> {
    let triangles = fan(48, Vec3::ZERO);
    let mut random = Rng::with_seed(5);
    let aimed = at_all_parts(&mut random, rays, &triangles, |_| Vec3::Z);
    let down = |aimed: &ropewalk::device::layout::RayRecord| {
        let [x, y, _] = aimed.direction;
        ray(Vec3::new(x, y, 1.0), Vec3::NEG_Z)
    };
    Ok(Row::new(triangles, aimed.iter().map(down).collect()))
}

/// A closed cube, of which each edge is filled by triangles without area: these are never hit.
fn fillers(rays: usize) -> Result<Row> {
    let mut triangles = cube(4);
    let without_area = triangles.iter().map(|&[a, b, _]| [a, a + (b - a) * 0.5, b]).collect::<Vec<_>>();
    triangles.extend(without_area);
    closed(triangles, 0.9, rays)
}
