//! Chains of transforms.

use fastrand::Rng;
use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use ropewalk::{Material, Transform};
use ropewalk_bench::Result;

use crate::row::{Goal, Recipe, Row};
use crate::world::World;
use ropewalk_bench::aim::{at_all_parts, point, quantised};
use ropewalk_bench::meshes::round;

pub const ROWS: [Recipe; 2] = [
    Recipe { name: "chain of 10,000 quarter turns", goal: Goal::NoLeaks, make: |rays| chain(rays, quarter_turn()) },
    Recipe {
        name: "chain of 10,000 turns of a degree",
        goal: Goal::NoLeaks,
        make: |rays| chain(rays, turn_of_a_degree()),
    },
];

const LENGTH: usize = 10_000;

/// About z, and a step along it: all numbers of all products are exact.
fn quarter_turn() -> DAffine3 {
    let turn = DMat3::from_cols(DVec3::Y, DVec3::NEG_X, DVec3::Z);
    DAffine3::from_mat3_translation(turn, DVec3::new(0.25, 0.0, 1.0 / 1024.0))
}

fn turn_of_a_degree() -> DAffine3 {
    let axis = DVec3::new(0.3, -0.5, 0.8).normalize();
    DAffine3::from_rotation_translation(DQuat::from_axis_angle(axis, 1_f64.to_radians()), DVec3::splat(1e-3))
}

/// From within a sphere below so many transforms, each the child of the one before.
fn chain(rays: usize, link: DAffine3) -> Result<Row> {
    let mut world = World::default();
    let triangles = round();
    let core = world.core(&triangles, Material::default())?;
    let (mut node, mut matrix) = (world.scene.root(), DAffine3::IDENTITY);
    for _ in 0..LENGTH {
        node = world.scene.add(node, Transform::Matrix(link))?;
        matrix *= link;
    }
    world.place(node, core, &matrix)?;
    let mut rays = at_all_parts(&mut Rng::with_seed(120), rays, &triangles, |random| quantised(point(random) * 0.5));
    // Where the sphere has come to.
    let (placed, triangles) = world.compile(matrix.translation)?;
    let center = (matrix.translation - placed.origin()).as_vec3();
    for ray in &mut rays {
        ray.origin = (Vec3::from_array(ray.origin) + center).to_array();
    }
    Ok(Row::of_scene(placed, triangles, rays))
}
