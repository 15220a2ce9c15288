//! One ray, one answer: whatever the executor, the structure, the other rays of the batch, and their place in it.

use fastrand::Rng;
use glam::{Mat3, Vec3};
use rayon::prelude::*;
use ropewalk::device::layout::RayRecord;
use ropewalk_bench::Result;
use ropewalk_bench::columns::{Column as _, Executor, Placed, Traced};

use crate::row::{Goal, Recipe, Row};
use ropewalk_bench::aim::{any, at_all_parts, inside, point, quantised, ray};
use ropewalk_bench::meshes::{bumpy, grid, moved, turn};

pub const ROWS: [Recipe; 12] = [
    Recipe { name: "embree: ray_alignment_test", goal: Goal::Zero, make: alignment },
    Recipe { name: "in other company", goal: Goal::Zero, make: company },
    Recipe { name: "grazing a floor, 1 rad", goal: Goal::Zero, make: |rays| grazing(rays, 1.0, Mat3::IDENTITY) },
    Recipe { name: "grazing a floor, 1e-2 rad", goal: Goal::Zero, make: |rays| grazing(rays, 1e-2, Mat3::IDENTITY) },
    Recipe { name: "grazing a floor, 1e-4 rad", goal: Goal::Zero, make: |rays| grazing(rays, 1e-4, Mat3::IDENTITY) },
    Recipe { name: "grazing a floor, 1e-6 rad", goal: Goal::Zero, make: |rays| grazing(rays, 1e-6, Mat3::IDENTITY) },
    Recipe { name: "grazing a floor, 1e-8 rad", goal: Goal::Zero, make: |rays| grazing(rays, 1e-8, Mat3::IDENTITY) },
    Recipe {
        name: "grazing a turned floor, 1 rad",
        goal: Goal::NoLeaks,
        make: |rays| grazing(rays, 1.0, Mat3::from_quat(turn())),
    },
    Recipe {
        name: "grazing a turned floor, 1e-2 rad",
        goal: Goal::NoLeaks,
        make: |rays| grazing(rays, 1e-2, Mat3::from_quat(turn())),
    },
    Recipe {
        name: "grazing a turned floor, 1e-4 rad",
        goal: Goal::NoLeaks,
        make: |rays| grazing(rays, 1e-4, Mat3::from_quat(turn())),
    },
    Recipe {
        name: "grazing a turned floor, 1e-6 rad",
        goal: Goal::Open,
        make: |rays| grazing(rays, 1e-6, Mat3::from_quat(turn())),
    },
    Recipe {
        name: "grazing a turned floor, 1e-8 rad",
        goal: Goal::Open,
        make: |rays| grazing(rays, 1e-8, Mat3::from_quat(turn())),
    },
];

/// At random points of a floor, from up to two units away.
fn grazing(rays: usize, angle: f32, turn: Mat3) -> Result<Row> {
    let triangles = moved(&grid(16, |_, _| 0.0), |p| turn * p);
    let mut random = Rng::with_seed(80);
    let aimed = (0..rays).map(|_| {
        let corners = any(&mut random, &triangles);
        let target = inside(&mut random, corners);
        let (sine, cosine) = (std::f32::consts::TAU * random.f32()).sin_cos();
        let direction = turn * (Vec3::new(cosine, sine, 0.0) * angle.cos() - Vec3::Z * angle.sin());
        ray(target - direction * (2.0 * random.f32()), direction)
    });
    let rays = aimed.collect();
    Ok(Row::new(triangles, rays))
}

fn rays_in_bumps(rays: usize) -> Result<(Placed, Vec<RayRecord>)> {
    let triangles = bumpy();
    let rays = at_all_parts(&mut Rng::with_seed(81), rays, &triangles, |random| quantised(point(random) * 0.4));
    Ok((Placed::of_triangles(&triangles, None)?, rays))
}

/// Batches of one to 33 rays that start anywhere in memory: each ray has the hit that it has in the whole.
fn alignment(rays: usize) -> Result<Row> {
    let (placed, rays) = rays_in_bumps(rays / 10)?;
    let mut random = Rng::with_seed(82);
    let mut parts = Vec::new();
    let mut rest = rays.as_slice();
    while !rest.is_empty() {
        let (part, after) = rest.split_at(random.usize(1..=33).min(rest.len()));
        parts.push(part);
        rest = after;
    }
    let traced = Traced(Executor::Cpu, &placed);
    let whole = traced.closest(&rays)?;
    let mut hits = Vec::new();
    for part in parts {
        hits.extend(traced.closest(part)?);
    }
    let differing = whole.iter().zip(&hits).filter(|(a, b)| a != b).count();
    Ok(Row::counted(vec![("cpu", differing as u64)], rays.len()))
}

/// The same rays in another order, so that others share each packet.
fn company(rays: usize) -> Result<Row> {
    let (placed, rays) = rays_in_bumps(rays)?;
    let mut order: Vec<usize> = (0..rays.len()).collect();
    Rng::with_seed(83).shuffle(&mut order);
    let shuffled: Vec<RayRecord> = order.iter().map(|&i| rays[i]).collect();
    let traced = Traced(Executor::Cpu, &placed);
    let (whole, other) = (traced.closest(&rays)?, traced.closest(&shuffled)?);
    let differing = order.par_iter().zip(&other).filter(|&(&i, hit)| whole[i] != *hit).count();
    Ok(Row::counted(vec![("cpu", differing as u64)], rays.len()))
}
