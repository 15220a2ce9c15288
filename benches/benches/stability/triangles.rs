//! Triangles that are small, narrow, large, alike, or garbage.

use fastrand::Rng;
use glam::Vec3;
use ropewalk_bench::Result;

use crate::row::{Goal, Recipe, Row};
use ropewalk_bench::aim::{any, at_all_parts, direction, inside, point, quantised, ray, signed};
use ropewalk_bench::meshes::{cube, grid, moved, round, turn};

pub const ROWS: [Recipe; 12] = [
    Recipe { name: "embree: small_triangle_hit, 1e-6", goal: Goal::Open, make: |rays| small(rays, 1e-6) },
    Recipe { name: "embree: small_triangle_hit, 1e-12", goal: Goal::Open, make: |rays| small(rays, 1e-12) },
    Recipe { name: "embree: overlapping_primitives", goal: Goal::Zero, make: overlapping },
    Recipe { name: "coplanar triangles, turned", goal: Goal::NoLeaks, make: coplanar },
    Recipe { name: "embree: triangle_split_epsilon", goal: Goal::NoLeaks, make: split },
    Recipe { name: "embree: build_garbage_geom, 1e-5 to 1e5", goal: Goal::Open, make: |rays| garbage(rays, 5.0) },
    Recipe { name: "embree: build_garbage_geom, 1e-30 to 1e30", goal: Goal::Open, make: |rays| garbage(rays, 30.0) },
    Recipe { name: "needles, 1e4 times longer than wide", goal: Goal::NoLeaks, make: |rays| needles(rays, 1e-4) },
    Recipe { name: "needles, 1e8 times longer than wide", goal: Goal::Open, make: |rays| needles(rays, 1e-8) },
    Recipe { name: "above a triangle of 1e6", goal: Goal::Zero, make: above_huge },
    Recipe { name: "quantised nodes: details of 1e-6 in a unit cube", goal: Goal::NoLeaks, make: details },
    Recipe { name: "quantised nodes: flat boxes at 1e6", goal: Goal::Open, make: flat_boxes },
];

/// A triangle of that size at each of 1,000 places, aimed at from near by.
fn small(rays: usize, size: f32) -> Result<Row> {
    let mut random = Rng::with_seed(40);
    let triangles: Vec<[Vec3; 3]> = (0..1000)
        .map(|i| {
            let place = Vec3::new((i % 10) as f32, (i / 10 % 10) as f32, (i / 100) as f32) * (4.0 * size);
            [0; 3].map(|_| place + point(&mut random) * size)
        })
        .collect();
    let rays = at_all_parts(&mut random, rays, &triangles, |random| direction(random) * (100.0 * size));
    Ok(Row::new(triangles, rays))
}

/// Each triangle of a cube eight times, some wound the other way.
fn overlapping(rays: usize) -> Result<Row> {
    let cube = cube(4);
    let triangles: Vec<[Vec3; 3]> = (0..8)
        .flat_map(|i| cube.iter().map(move |&[a, b, c]| if i % 2 == 0 { [a, b, c] } else { [b, a, c] }))
        .collect();
    let rays = at_all_parts(&mut Rng::with_seed(41), rays, &triangles, |random| quantised(point(random) * 0.9));
    Ok(Row::new(triangles, rays))
}

/// Two grids of different cells in one plane, turned, so that their corners are rounded differently.
fn coplanar(rays: usize) -> Result<Row> {
    let mut triangles = grid(16, |_, _| 0.0);
    triangles.extend(grid(11, |_, _| 0.0));
    let triangles = moved(&triangles, |p| turn() * p);
    let origin = |random: &mut Rng| turn() * Vec3::new(signed(random), signed(random), 1.0);
    let rays = at_all_parts(&mut Rng::with_seed(42), rays, &triangles, origin);
    Ok(Row::new(triangles, rays))
}

/// Long triangles across each other: what spatial splits cut into many parts. Fewer rays, since each meets many boxes.
fn split(rays: usize) -> Result<Row> {
    let mut random = Rng::with_seed(43);
    let triangle = |_| {
        let (from, along) = (point(&mut random), point(&mut random));
        [from, from + along, from + along * 0.5 + point(&mut random) * 0.02]
    };
    let triangles: Vec<[Vec3; 3]> = (0..2000).map(triangle).collect();
    let rays = at_all_parts(&mut random, rays / 4, &triangles, |random| direction(random) * 3.0);
    Ok(Row::new(triangles, rays))
}

/// Corners whose coordinates have any magnitude up to ten to this power, each by itself. Fewer rays: most triangles are
/// in the way of most of them.
fn garbage(rays: usize, decades: f32) -> Result<Row> {
    let mut random = Rng::with_seed(44);
    let number = |random: &mut Rng| {
        let magnitude = 10f32.powf(decades * signed(random));
        if random.bool() { magnitude } else { -magnitude }
    };
    let corner = |random: &mut Rng| Vec3::from_array([0; 3].map(|_| number(random)));
    let triangles: Vec<[Vec3; 3]> = (0..1000).map(|_| [0; 3].map(|_| corner(&mut random))).collect();
    let aimed = (0..(rays / 100).max(1000)).map(|_| {
        let origin = corner(&mut random);
        ray(origin, direction(&mut random))
    });
    let rays = aimed.collect();
    Ok(Row::new(triangles, rays))
}

/// Long triangles in all directions, each so much narrower than long. Fewer rays, since each meets many boxes.
fn needles(rays: usize, width: f32) -> Result<Row> {
    let mut random = Rng::with_seed(45);
    let triangle = |_| {
        let (center, along) = (point(&mut random), direction(&mut random));
        let across = along.cross(direction(&mut random)).normalize() * width;
        [center - along, center + along, center + along + across]
    };
    let triangles: Vec<[Vec3; 3]> = (0..1000).map(triangle).collect();
    let rays = at_all_parts(&mut random, rays / 4, &triangles, |random| direction(random) * 4.0);
    Ok(Row::new(triangles, rays))
}

/// From within millimetres of a corner of a triangle of 1,000 km, in all directions.
fn above_huge(rays: usize) -> Result<Row> {
    let mut random = Rng::with_seed(46);
    let size = 5e5;
    let triangles = vec![[Vec3::ZERO, Vec3::new(size, 0.0, size), Vec3::new(size, 0.0, 0.0)]];
    let aimed = (0..rays).map(|_| ray(point(&mut random) * 4e-3, direction(&mut random)));
    let rays = aimed.collect();
    Ok(Row::new(triangles, rays))
}

/// A thousand triangles of a millionth of the size of the cube around them.
fn details(rays: usize) -> Result<Row> {
    let mut random = Rng::with_seed(47);
    let mut triangles = cube(2);
    let detail = |_| {
        let place = point(&mut random) * 0.9;
        [0; 3].map(|_| place + point(&mut random) * 1e-6)
    };
    let details: Vec<[Vec3; 3]> = (0..1000).map(detail).collect();
    let rays = at_all_parts(&mut random, rays, &details, |random| quantised(point(random) * 0.5));
    triangles.extend(details);
    Ok(Row::new(triangles, rays))
}

/// A sphere far from the origin of its geometry, flattened to a few steps of f32.
fn flat_boxes(rays: usize) -> Result<Row> {
    let offset = Vec3::new(1e6, -7e5, 3e5);
    let triangles = moved(&round(), |p| p * Vec3::new(10.0, 10.0, 0.25) + offset);
    let mut random = Rng::with_seed(48);
    let aimed = (0..rays).map(|_| {
        let corners = any(&mut random, &triangles);
        let origin = offset + point(&mut random) * 30.0;
        let target = inside(&mut random, corners);
        ray(origin, target - origin)
    });
    let rays = aimed.filter(|ray| ray.direction != [0.0; 3]).collect();
    Ok(Row::new(triangles, rays))
}
