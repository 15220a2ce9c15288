//! A mesh that is twisted more in each frame: frames since it was built against what rays cost, and the time of updates
//! against the time of rays, when the structure is refitted always, never, or until its cost has grown by some factor.
//!
//! What rays cost is counted, not timed: nodes, and triangles at the weight that builders give them, in units of a
//! structure of medium quality that is built for the frame.

use std::time::Duration;

use fastrand::Rng;
use glam::{DVec3, Quat, Vec3};
use ropewalk::accel::BlasBuildParams;
use ropewalk::compile::{Compiler, RebuildLimits};
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{NONE, RayRecord};
use ropewalk::graph::{BlasKind, Quality};
use ropewalk::trace::{Cpu, Tracer as _, Traversal};
use ropewalk::{Core, Geometry, GeometryKey, Material, Scene};
use ropewalk_bench::aim::{direction, inside, ray};
use ropewalk_bench::kernel_counts::KernelCounts;
use ropewalk_bench::rays::RayKind;
use ropewalk_bench::shapes::bumpy_sphere;
use ropewalk_bench::{Report, Result, Target, median, time};

use crate::Run;
use crate::chart::{Axis, Better, Chart, Curve, Panel, Point, Scale};

/// Names, limits of the cost, and the structure that the geometry asks for, if it does.
const POLICIES: [(&str, f64, Option<BlasKind>); 7] = [
    ("refit always", f64::INFINITY, None),
    ("limit 2", 2.0, None),
    ("limit 1.5", 1.5, None),
    ("limit 1.25", 1.25, None),
    ("limit 1.1", 1.1, None),
    ("build always, as chosen", 0.0, None),
    ("build always, medium", 0.0, Some(BlasKind::Bvh(Quality::Medium))),
];
/// The twist of a frame, in radians from one pole to the other.
const TWIST: f32 = 0.1;

/// The figures of a policy.
struct Figures {
    /// What rays cost in each frame.
    costs: Vec<f64>,
    updates: Vec<Duration>,
    traces: Vec<Duration>,
    builds: usize,
}

pub fn measure(run: &Run, report: &mut Report) -> Result<Chart> {
    let (triangles, frames, rays) = if run.is_quick { (4_000, 20, 2_000) } else { (70_000, 60, 100_000) };
    let rest = bumpy_sphere(triangles);
    let meshes: Vec<Geometry> = (0..frames).map(|frame| twisted(&rest, TWIST * frame as f32)).collect();
    let rays: Vec<Vec<RayRecord>> = meshes.iter().map(|mesh| rays_at(mesh, rays)).collect();
    let mut figures = Vec::new();
    for (name, limit, structure) in POLICIES {
        figures.push(follow(&meshes, &rays, limit, structure)?);
        run.progress(&format!("deform, {name}"));
    }
    let fresh = figures[POLICIES.len() - 1].costs.clone();
    let ratios = |figures: &Figures| figures.costs.iter().zip(&fresh).map(|(c, f)| c / f).collect::<Vec<f64>>();
    let mean = |ratios: &[f64]| ratios.iter().sum::<f64>() / ratios.len() as f64;
    let [always, default] = [0, 3].map(|which: usize| ratios(&figures[which]));
    report.goal("deform_default_by_refit_always", mean(&default) / mean(&always), Target::AtMost(1.0), "x");

    let mut curves = Vec::new();
    let mut totals = Curve { name: "policies".to_owned(), is_joined: false, points: Vec::new() };
    for ((name, limit, _), figures) in POLICIES.into_iter().zip(&figures) {
        let is_default = limit == RebuildLimits::default().max_blas_cost_ratio;
        let ratios = ratios(figures);
        let point = |(frame, &y): (usize, &f64)| Point { x: frame as f64, y, is_default, ..Point::default() };
        let points = ratios.iter().enumerate().map(point).collect();
        curves.push(Curve { name: name.to_owned(), is_joined: true, points });
        let [update, trace] = [&figures.updates, &figures.traces].map(|times| milliseconds_a_frame(times));
        let middle = [&figures.updates, &figures.traces].map(|times| median(times.clone()).as_secs_f64() * 1e3);
        let detail = format!(
            "{:.1} ms a frame in all, medians {:.1} and {:.1}, {} builds, cost {:.3} of fresh",
            update + trace,
            middle[0],
            middle[1],
            figures.builds,
            mean(&ratios)
        );
        totals.points.push(Point { x: update, y: trace, label: name.to_owned(), is_default, detail });
    }
    Ok(Chart {
        name: "deform",
        panels: vec![
            Panel {
                title: "Cost of rays while a mesh is twisted",
                x: Axis { name: "frames since the first build", scale: Scale::Linear },
                y: Axis { name: "cost of rays, in units of a fresh build's", scale: Scale::Linear },
                front: None,
                curves,
            },
            Panel {
                title: "Time of updates and of rays",
                x: Axis { name: "update, milliseconds a frame", scale: Scale::Log },
                y: Axis { name: "rays, milliseconds a frame", scale: Scale::Linear },
                front: Some(Better::Less),
                curves: vec![totals],
            },
        ],
    })
}

fn milliseconds_a_frame(times: &[Duration]) -> f64 {
    times.iter().sum::<Duration>().as_secs_f64() * 1e3 / times.len() as f64
}

fn twisted(mesh: &Geometry, angle: f32) -> Geometry {
    let turn = |p: &Vec3| Quat::from_rotation_y(angle * 0.5 * (p.y + 1.0)) * *p;
    Geometry { positions: mesh.positions.iter().map(turn).collect(), normals: None, ..mesh.clone() }
}

/// From all around to points of the surface.
fn rays_at(mesh: &Geometry, count: usize) -> Vec<RayRecord> {
    let mut random = Rng::with_seed(7);
    let aimed = (0..count).map(|_| {
        let triangle = mesh.indices[random.usize(0..mesh.indices.len())];
        let target = inside(&mut random, triangle.map(|vertex| mesh.positions[vertex as usize]));
        let origin = direction(&mut random) * 3.0;
        ray(origin, target - origin)
    });
    aimed.collect()
}

/// Shows the mesh as it is in each frame, by one policy.
fn follow(meshes: &[Geometry], rays: &[Vec<RayRecord>], limit: f64, structure: Option<BlasKind>) -> Result<Figures> {
    let (mut scene, mut compiler, key) = shown(&meshes[0], structure)?;
    compiler.set_rebuild_limits(RebuildLimits::default().with_max_blas_cost_ratio(limit));
    let mut figures = Figures { costs: Vec::new(), updates: Vec::new(), traces: Vec::new(), builds: 0 };
    compiler.compile(&mut scene, DVec3::ZERO)?;
    for (frame, (mesh, rays)) in meshes.iter().zip(rays).enumerate() {
        if frame > 0 {
            scene.set_positions(key, mesh.positions.clone(), None)?;
            let mut compiled = None;
            figures.updates.push(time(|| compiled = Some(compiler.compile(&mut scene, DVec3::ZERO))));
            figures.builds += compiled.transpose()?.map_or(0, |report| report.blas_builds.cost_grown);
            compiler.arrays_mut().clear_dirty();
            figures.traces.push(time(|| Cpu::default().closest_hits(compiler.arrays(), rays, NONE).is_ok()));
        }
        figures.costs.push(cost(compiler.arrays(), &rays[..rays.len().min(4000)]));
    }
    Ok(figures)
}

fn shown(mesh: &Geometry, structure: Option<BlasKind>) -> Result<(Scene, Compiler, GeometryKey)> {
    let mut scene = Scene::new();
    let material = scene.add_material(Material { double_sided: true, ..Material::default() })?;
    let geometry = scene.add_geometry(mesh.clone().with_blas_kind(structure))?;
    scene.add(scene.root(), Core::Geometry { geometry, material })?;
    Ok((scene, Compiler::new(), geometry))
}

/// Nodes and triangles, weighted, that rays meet.
fn cost(arrays: &DeviceArrays, rays: &[RayRecord]) -> f64 {
    let counts = KernelCounts::of(arrays, rays, RayKind::Diffuse, Traversal::Wide).counts;
    counts.nodes as f64 + f64::from(BlasBuildParams::default().triangle_cost) * counts.triangles as f64
}
