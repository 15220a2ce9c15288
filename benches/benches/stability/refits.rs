//! Geometry that changes: structures are refitted, and the hits are those of the new triangles.

use fastrand::Rng;
use glam::{DAffine3, DVec3, Mat3, Vec3};
use ropewalk::graph::{BlasKind, Quality};
use ropewalk::{Material, Scene, Transform};
use ropewalk_bench::Result;
use ropewalk_bench::columns::Placed;
use ropewalk_bench::exact::widened;

use crate::row::{Goal, Recipe, Row};
use crate::world::World;
use ropewalk_bench::aim::{at_all_parts, point, quantised};
use ropewalk_bench::meshes::{bumpy, moved, round};

pub const ROWS: [Recipe; 6] = [
    Recipe { name: "embree: update", goal: Goal::NoLeaks, make: |rays| deformed(rays, None, breathing) },
    Recipe {
        name: "vulkan: update, spatial splits",
        goal: Goal::NoLeaks,
        make: |rays| deformed(rays, BlasKind::Bvh(Quality::High), breathing),
    },
    Recipe { name: "refit after a twist", goal: Goal::NoLeaks, make: |rays| deformed(rays, None, twisted) },
    Recipe { name: "refit after stretching by 1e6", goal: Goal::NoLeaks, make: |rays| deformed(rays, None, stretched) },
    Recipe {
        name: "refit after collapse and return",
        goal: Goal::NoLeaks,
        make: |rays| deformed(rays, None, collapsed),
    },
    Recipe { name: "update of instances, 100 moves", goal: Goal::Zero, make: moves },
];

/// Steps of a deformation, of which only the last is traced.
const STEPS: u32 = 10;

/// The place of a corner at a step.
type Motion = fn(Vec3, u32) -> Vec3;

fn breathing(p: Vec3, step: u32) -> Vec3 {
    quantised(p * (1.0 + 0.05 * step as f32))
}

fn twisted(p: Vec3, step: u32) -> Vec3 {
    Mat3::from_rotation_z(p.z * step as f32) * p
}

fn stretched(p: Vec3, step: u32) -> Vec3 {
    p * Vec3::new(1.0, 1.0, 10f32.powi(step.min(6) as i32))
}

/// All on one line, and back.
fn collapsed(p: Vec3, step: u32) -> Vec3 {
    if step % 2 == 1 { Vec3::new(p.x, 0.0, 0.0) } else { p }
}

/// From within a closed surface after its motion.
fn deformed(rays: usize, kind: impl Into<Option<BlasKind>>, motion: Motion) -> Result<Row> {
    let original = bumpy();
    let mut placed = Placed::of_triangles(&original, kind)?;
    for step in 1..=STEPS {
        placed.edit(|scene| set_corners(scene, &moved(&original, |p| motion(p, step))))?;
    }
    let mut random = Rng::with_seed(140);
    let origin = |random: &mut Rng| motion(quantised(point(random) * 0.4), STEPS);
    let triangles = moved(&original, |p| motion(p, STEPS));
    let rays = at_all_parts(&mut random, rays, &triangles, origin);
    Ok(Row::of_scene(placed, widened(&triangles), rays))
}

fn set_corners(scene: &mut Scene, triangles: &[[Vec3; 3]]) -> Result<()> {
    let key = scene.geometries().next().map(|(key, _)| key).ok_or("no geometry")?;
    Ok(scene.set_positions(key, triangles.as_flattened(), None)?)
}

/// Sixty-four spheres that change places a hundred times; the rays are in the one that is in the middle at last.
fn moves(rays: usize) -> Result<Row> {
    let mut world = World::default();
    let triangles = round();
    let core = world.core(&triangles, Material::default())?;
    let mut random = Rng::with_seed(141);
    let places: Vec<DVec3> =
        (0..64).map(|i| DVec3::new(f64::from(i % 4), f64::from(i / 4 % 4), f64::from(i / 16)) * 4.0).collect();
    let root = world.scene.root();
    let mut parents = Vec::new();
    for &place in &places {
        let parent = world.scene.add(root, Transform::from_translation(place))?;
        world.place(parent, core, &DAffine3::from_translation(place))?;
        parents.push(parent);
    }
    let (mut placed, triangles_of_all) = world.compile(DVec3::ZERO)?;
    let mut order: Vec<usize> = (0..places.len()).collect();
    for _ in 0..100 {
        random.shuffle(&mut order);
        placed.edit(|scene| {
            for (&parent, &place) in parents.iter().zip(&order) {
                scene.set_local(parent, Transform::from_translation(places[place]))?;
            }
            Ok(())
        })?;
    }
    // Each sphere is where the order has put it.
    let n = triangles.len();
    let moved = (0..places.len()).flat_map(|i| {
        let shift = places[order[i]] - places[i];
        triangles_of_all[i * n..][..n].iter().map(move |corners| corners.map(|corner| corner + shift))
    });
    let moved: Vec<[DVec3; 3]> = moved.collect();
    let mut rays = at_all_parts(&mut random, rays, &triangles, |random| quantised(point(random) * 0.5));
    for ray in &mut rays {
        ray.origin = (Vec3::from_array(ray.origin) + places[21].as_vec3()).to_array();
    }
    Ok(Row::of_scene(placed, moved, rays))
}
