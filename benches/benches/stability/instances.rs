//! Instances: alike, scaled, sheared, far away.

use fastrand::Rng;
use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use ropewalk::device::layout::RayRecord;
use ropewalk_bench::Result;

use crate::row::{Goal, Recipe, Row, Subject};
use crate::world::World;
use ropewalk_bench::aim::{any, at_all_parts, inside, point, quantised, ray};
use ropewalk_bench::meshes::{bumpy, cube, round};

pub const ROWS: [Recipe; 12] = [
    Recipe { name: "instances that coincide", goal: Goal::Zero, make: coincide },
    Recipe { name: "instances with one plane in common", goal: Goal::Zero, make: coplanar },
    Recipe {
        name: "instance scaled by 1e-9",
        goal: Goal::NoLeaks,
        make: |rays| placed(rays, DMat3::from_diagonal(DVec3::splat(1e-9))),
    },
    Recipe {
        name: "instance scaled by 1e9",
        goal: Goal::NoLeaks,
        make: |rays| placed(rays, DMat3::from_diagonal(DVec3::splat(1e9))),
    },
    Recipe { name: "instance scaled by 1, 1, 1e-6", goal: Goal::NoLeaks, make: |rays| placed(rays, flat(1e-6)) },
    Recipe { name: "instance scaled by 1, 1, 1e-12", goal: Goal::NoLeaks, make: |rays| placed(rays, flat(1e-12)) },
    Recipe {
        name: "instance scaled by 1, 1, 1e-6 and turned",
        goal: Goal::Open,
        make: |rays| placed(rays, turned(flat(1e-6))),
    },
    Recipe { name: "sheared instance, 1 to 1e3", goal: Goal::Open, make: |rays| placed(rays, sheared(1e3)) },
    Recipe { name: "sheared instance, 1 to 1e6", goal: Goal::Open, make: |rays| placed(rays, sheared(1e6)) },
    Recipe { name: "batches far from the scene's centre, 2^10", goal: Goal::Zero, make: |rays| far(rays, 10) },
    Recipe { name: "batches far from the scene's centre, 2^20", goal: Goal::Zero, make: |rays| far(rays, 20) },
    Recipe { name: "batches far from the scene's centre, 2^30", goal: Goal::Zero, make: |rays| far(rays, 30) },
];

/// Four spheres at one place, each a node of its own.
fn coincide(rays: usize) -> Result<Row> {
    let mut world = World::default();
    let triangles = round();
    for _ in 0..4 {
        world.add(&triangles, DAffine3::IDENTITY)?;
    }
    let rays = at_all_parts(&mut Rng::with_seed(100), rays, &triangles, |random| quantised(point(random) * 0.5));
    world.row(rays)
}

/// Cubes side by side, whose sides are in one plane and meet at edges.
fn coplanar(rays: usize) -> Result<Row> {
    let mut world = World::default();
    let triangles = cube(4);
    for i in 0..27 {
        let place = DVec3::new(f64::from(i % 3), f64::from(i / 3 % 3), f64::from(i / 9)) * 2.0;
        world.add(&triangles, DAffine3::from_translation(place))?;
    }
    let inside = |random: &mut Rng| quantised(point(random) * 0.9);
    let mut rays = at_all_parts(&mut Rng::with_seed(101), rays, &triangles, inside);
    // In the cube in the middle.
    for ray in &mut rays {
        ray.origin = (Vec3::from_array(ray.origin) + 2.0).to_array();
    }
    world.row(rays)
}

fn flat(scale: f64) -> DMat3 {
    DMat3::from_diagonal(DVec3::new(1.0, 1.0, scale))
}

fn turned(matrix: DMat3) -> DMat3 {
    DMat3::from_quat(turn(0.7)) * matrix
}

/// Turned, scaled by up to `most`, and turned again: no axis stays perpendicular to another.
fn sheared(most: f64) -> DMat3 {
    let scale = DMat3::from_diagonal(DVec3::new(1.0, most.sqrt(), most));
    DMat3::from_quat(turn(1.0)) * scale * DMat3::from_quat(turn(2.0))
}

fn turn(angle: f64) -> DQuat {
    DQuat::from_axis_angle(DVec3::new(0.3, -0.5, 0.8).normalize(), angle)
}

/// From within a closed surface under a matrix.
fn placed(rays: usize, matrix: DMat3) -> Result<Row> {
    let mut world = World::default();
    let triangles = bumpy();
    world.add(&triangles, DAffine3::from_mat3(matrix))?;
    let mut random = Rng::with_seed(102);
    let place = |p: Vec3| (matrix * p.as_dvec3()).as_vec3();
    let aimed = (0..rays).map(|_| {
        let origin = place(point(&mut random) * 0.4);
        let corners = any(&mut random, &triangles);
        let target = place(inside(&mut random, corners));
        ray(origin, target - origin)
    });
    let rays = aimed.filter(|ray| ray.direction != [0.0; 3]).collect();
    world.row(rays)
}

/// From within a ball so far from a cube at the world's origin, before anybody has rendered either.
fn far(rays: usize, exponent: i32) -> Result<Row> {
    let away = DVec3::new(1.0, -0.75, 0.25) * 2.0_f64.powi(exponent);
    let mut world = World::default();
    let triangles = round();
    world.add(&triangles, DAffine3::from_translation(away))?;
    world.add(&cube(1), DAffine3::IDENTITY)?;
    let rays: Vec<RayRecord> =
        at_all_parts(&mut Rng::with_seed(103), rays, &triangles, |random| quantised(point(random) * 0.5));
    let (placed, triangles) = world.compile_without_view(away)?;
    Ok(Row { subject: Subject::Far(Box::new(placed), triangles), ..Row::new(Vec::new(), rays) })
}
