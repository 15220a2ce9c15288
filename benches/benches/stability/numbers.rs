//! Numbers at their limits: scales, distances, lengths of directions, zeros, ranges.

use fastrand::Rng;
use glam::Vec3;
use ropewalk::device::layout::RayRecord;
use ropewalk_bench::Result;
use ropewalk_bench::exact::Ends;

use crate::row::{Goal, Recipe, Row};
use ropewalk_bench::aim::{at_all_parts, direction, point, quantised, ray, signed};
use ropewalk_bench::meshes::{bumpy, cube, moved, round};

pub const ROWS: [Recipe; 24] = [
    Recipe { name: "embree: nan_test", goal: Goal::NoLeaks, make: |rays| broken(rays, f32::NAN) },
    Recipe { name: "embree: inf_test", goal: Goal::NoLeaks, make: |rays| broken(rays, f32::INFINITY) },
    Recipe {
        name: "vulkan: direction_length, 2^-30 to 2^30",
        goal: Goal::NoLeaks,
        make: |rays| lengths(rays, -30..=30),
    },
    Recipe { name: "directions of 2^60 to 2^98", goal: Goal::NoLeaks, make: |rays| lengths(rays, 60..=98) },
    Recipe { name: "directions of 2^-98 to 2^-60", goal: Goal::NoLeaks, make: |rays| lengths(rays / 10, -98..=-60) },
    Recipe { name: "scale 1e-18", goal: Goal::NoLeaks, make: |rays| scaled(rays, 1e-18) },
    Recipe { name: "scale 1e-9", goal: Goal::NoLeaks, make: |rays| scaled(rays, 1e-9) },
    Recipe { name: "scale 1e-3", goal: Goal::NoLeaks, make: |rays| scaled(rays, 1e-3) },
    Recipe { name: "scale 1e3", goal: Goal::NoLeaks, make: |rays| scaled(rays, 1e3) },
    Recipe { name: "scale 1e9", goal: Goal::NoLeaks, make: |rays| scaled(rays, 1e9) },
    Recipe { name: "scale 1e18", goal: Goal::NoLeaks, make: |rays| scaled(rays, 1e18) },
    Recipe { name: "from 1e3 sizes away", goal: Goal::NoLeaks, make: |rays| from_afar(rays, 1e3) },
    Recipe { name: "from 1e6 sizes away", goal: Goal::NoLeaks, make: |rays| from_afar(rays, 1e6) },
    Recipe { name: "from 1e9 sizes away", goal: Goal::NoLeaks, make: |rays| along_axes_from(rays, 1e9) },
    Recipe { name: "from 1e12 sizes away", goal: Goal::NoLeaks, make: |rays| along_axes_from(rays, 1e12) },
    Recipe { name: "from 1e15 sizes away", goal: Goal::Open, make: |rays| along_axes_from(rays, 1e15) },
    Recipe { name: "directions with +0 and -0, cube", goal: Goal::Zero, make: |rays| zeros(rays, cube(8)) },
    Recipe { name: "directions with +0 and -0, sphere", goal: Goal::Zero, make: |rays| zeros(rays, round()) },
    Recipe { name: "directions with subnormal components", goal: Goal::Zero, make: subnormal },
    Recipe { name: "ranges that end at the hit", goal: Goal::Zero, make: |rays| ends(rays, End::Last) },
    Recipe { name: "ranges that start at the hit", goal: Goal::Zero, make: |rays| ends(rays, End::First) },
    Recipe { name: "ranges that end before the hit", goal: Goal::Zero, make: |rays| ends(rays, End::Before) },
    Recipe { name: "unit ball beside a corner at 1e20", goal: Goal::Zero, make: |rays| beside_corner(rays, 1e20) },
    Recipe { name: "ball of 1e-3 on a floor of 1e6", goal: Goal::NoLeaks, make: ball_on_floor },
];

/// Every eighth ray has such a number. The others, which may be in one packet with it, are judged.
fn broken(rays: usize, number: f32) -> Result<Row> {
    let mut random = Rng::with_seed(20);
    let triangles = bumpy();
    let mut rays = at_all_parts(&mut random, rays, &triangles, |random| quantised(point(random) * 0.4));
    for ray in rays.iter_mut().step_by(8) {
        let number = if random.bool() { number } else { -number };
        match random.u32(0..8) {
            i @ 0..=2 => ray.origin[i as usize] = number,
            i @ 3..=5 => ray.direction[i as usize - 3] = number,
            6 => ray.t_min = f32::NAN,
            _ => ray.t_max = f32::NAN,
        }
    }
    Ok(Row::new(triangles, rays))
}

/// From within a closed surface, along directions of so many powers of two. Fewer rays where these are tiny, since some
/// peers then find all boxes in the way.
fn lengths(rays: usize, exponents: std::ops::RangeInclusive<i32>) -> Result<Row> {
    let mut random = Rng::with_seed(21);
    let triangles = bumpy();
    let aimed = (0..rays).map(|_| {
        let length = 2.0_f64.powi(random.i32(exponents.clone()));
        let direction = (direction(&mut random).as_dvec3() * length).as_vec3();
        let direction = if direction == Vec3::ZERO { Vec3::X * f32::from_bits(1) } else { direction };
        ray(point(&mut random) * 0.4, direction)
    });
    let rays = aimed.collect();
    Ok(Row::new(triangles, rays))
}

fn scaled(rays: usize, scale: f32) -> Result<Row> {
    let triangles = moved(&bumpy(), |p| p * scale);
    let rays = at_all_parts(&mut Rng::with_seed(22), rays, &triangles, |random| point(random) * (0.4 * scale));
    Ok(Row::new(triangles, rays))
}

/// At a sphere, from all sides. What the rounded rays hit is for the oracle to say.
fn from_afar(rays: usize, distance: f32) -> Result<Row> {
    let triangles = round();
    let rays = at_all_parts(&mut Rng::with_seed(23), rays, &triangles, |random| direction(random) * distance);
    Ok(Row::new(triangles, rays))
}

/// The same along the axes, where f32 can still aim.
fn along_axes_from(rays: usize, distance: f32) -> Result<Row> {
    let mut random = Rng::with_seed(24);
    let aimed = (0..rays).map(|_| {
        let mut origin = point(&mut random) * 1.1;
        let mut direction = Vec3::ZERO;
        let axis = random.usize(0..3);
        direction[axis] = if random.bool() { 1.0 } else { -1.0 };
        origin[axis] = -distance * direction[axis];
        ray(origin, direction)
    });
    Ok(Row::new(round(), aimed.collect()))
}

/// Along axes, and between two, from within, in the planes of edges too.
fn zeros(rays: usize, triangles: Vec<[Vec3; 3]>) -> Result<Row> {
    let mut random = Rng::with_seed(25);
    let aimed = (0..rays).map(|i| {
        let mut direction = Vec3::from_array([0; 3].map(|_| f32::from(random.i8(-1..=1))));
        direction[random.usize(0..3)] = if random.bool() { 1.0 } else { -1.0 };
        direction[random.usize(0..3)] *= 1.0 + random.f32();
        for component in direction.as_mut() {
            if *component == 0.0 && random.bool() {
                *component = -0.0;
            }
        }
        let origin = point(&mut random) * 0.5;
        // Every second origin is in the planes of the cube's grid.
        ray(if i % 2 == 0 { (origin * 8.0).round() / 8.0 } else { origin }, direction)
    });
    let rays = aimed.collect();
    Ok(Row::new(triangles, rays))
}

/// One component is 1, the others are subnormal, or 1e-20.
fn subnormal(rays: usize) -> Result<Row> {
    let mut random = Rng::with_seed(26);
    let triangles = cube(8);
    let aimed = (0..rays).map(|i| {
        let small = if i % 2 == 0 { 1e-41 } else { 1e-20 };
        let mut direction = Vec3::from_array([0; 3].map(|_| small * signed(&mut random)));
        direction[random.usize(0..3)] = if random.bool() { 1.0 } else { -1.0 };
        ray((point(&mut random) * 4.0).round() / 8.0, direction)
    });
    let rays = aimed.collect();
    Ok(Row::new(triangles, rays))
}

#[derive(Clone, Copy)]
enum End {
    /// `t_max` is the t of the hit.
    Last,
    /// `t_min` is.
    First,
    /// `t_max` is the number before.
    Before,
}

/// Along the axes of a cube, from multiples of 2^-12, so that t is one too.
fn ends(rays: usize, end: End) -> Result<Row> {
    let mut random = Rng::with_seed(27);
    let aimed = (0..rays).map(|_| {
        let origin = quantised(point(&mut random) * 0.9);
        let (axis, sign) = (random.usize(0..3), if random.bool() { 1.0 } else { -1.0 });
        let mut direction = Vec3::ZERO;
        direction[axis] = sign;
        let t = 1.0 - sign * origin[axis];
        let ray = ray(origin, direction);
        match end {
            End::Last => RayRecord { t_max: t, ..ray },
            End::First => RayRecord { t_min: t, ..ray },
            End::Before => RayRecord { t_max: t * (1.0 - 1e-5), ..ray },
        }
    });
    Ok(Row { ends: Ends::Closed, ..Row::new(cube(8), aimed.collect()) })
}

/// In one geometry with a triangle so far away, from within the ball.
fn beside_corner(rays: usize, distance: f32) -> Result<Row> {
    let mut triangles = round();
    let mut random = Rng::with_seed(28);
    let rays = at_all_parts(&mut random, rays, &triangles, |random| quantised(point(random) * 0.5));
    triangles.push([Vec3::splat(distance), Vec3::new(distance, 0.9 * distance, distance), Vec3::splat(0.9 * distance)]);
    Ok(Row::new(triangles, rays))
}

/// From within the ball, which lies on two triangles of that size.
fn ball_on_floor(rays: usize) -> Result<Row> {
    let (size, radius) = (1e6, 1e-3);
    let mut triangles = moved(&round(), |p| (p + Vec3::Z) * radius);
    let mut random = Rng::with_seed(29);
    let rays = at_all_parts(&mut random, rays, &triangles, |random| (point(random) * 0.5 + Vec3::Z) * radius);
    let corner = |x: f32, y: f32| Vec3::new(x * size, y * size, 0.0);
    triangles.extend([
        [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0)],
        [corner(-1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
    ]);
    Ok(Row::new(triangles, rays))
}
