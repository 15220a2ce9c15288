//! The world box of an instance: how long it takes to compute, and how much smaller it is than the box around the
//! corners of the transformed local box.

use std::process::ExitCode;

use clap::Parser;
use glam::{DAffine3, DQuat, DVec3};
use ropewalk::accel::{Blas, BlasBuildParams, SupportFunction};
use ropewalk::math::Bounds;
use ropewalk::{Geometry, Scene, gltf};
use ropewalk_bench::scenes::scenes_folder;
use ropewalk_bench::{Contender, Options, Report, Target, medians, time};

/// The goal for the time of a call.
const MICROSECONDS: f64 = 1.0;
const MESHES: [&str; 2] = ["stanford-bunny", "stanford-dragon"];

fn main() -> ExitCode {
    let options = Options::parse();
    let scenes = scenes_folder();
    let mut report =
        Report::new(&["mesh", "triangles", "prepare ms", "box ns", "of corners ns", "area", "area of corners"]);
    for name in MESHES {
        let path = scenes.join(format!("meshes/{name}.glb"));
        let mut scene = Scene::new();
        let root = scene.root();
        if let Err(error) = gltf::import(&path, &mut scene, root) {
            eprintln!("{}: {error} (set ROPEWALK_SCENES)", path.display());
            return ExitCode::FAILURE;
        }
        for (_, geometry) in scene.geometries() {
            measure(name, geometry, if options.quick { 5 } else { 25 }, &mut report);
        }
    }
    report.finish(&options)
}

fn measure(name: &str, geometry: &Geometry, samples: usize, report: &mut Report) {
    const CALLS: usize = 1000;
    let Ok(blas) = Blas::build(geometry, &BlasBuildParams::default()) else { return };
    let (support, bounds) = (SupportFunction::new(&blas), Bounds::from(blas.bounds));
    let mut random = fastrand::Rng::with_seed(3);
    let mut signed = || random.f64() * 2.0 - 1.0;
    let placements: Vec<DAffine3> = (0..CALLS)
        .map(|_| {
            let rotation = DQuat::from_xyzw(signed(), signed(), signed(), signed()).normalize();
            DAffine3::from_rotation_translation(rotation, DVec3::new(signed(), signed(), signed()))
        })
        .collect();
    let sum = |of: &dyn Fn(&DAffine3) -> Bounds| placements.iter().map(|p| half_area(&of(p))).sum::<f64>();
    let mut contenders: Vec<Contender> = vec![
        Box::new(|| time(|| SupportFunction::new(&blas))),
        Box::new(|| time(|| sum(&|placement| support.world_bounds(placement)))),
        Box::new(|| time(|| sum(&|placement| bounds.transformed(placement)))),
    ];
    let times = medians(samples, &mut contenders);
    drop(contenders);
    // The exact box, for some of them.
    let exact = |placement: &DAffine3| {
        geometry.positions.iter().fold(Bounds::EMPTY, |bounds, p| {
            let p = placement.transform_point3(p.as_dvec3());
            bounds.union(Bounds { min: p, max: p })
        })
    };
    let some = &placements[..50];
    let total = |of: &dyn Fn(&DAffine3) -> Bounds| some.iter().map(|p| half_area(&of(p))).sum::<f64>();
    let truth = total(&exact);
    let [tight, corners] = [total(&|p| support.world_bounds(p)) / truth, total(&|p| bounds.transformed(p)) / truth];
    let nanoseconds = |i: usize| times[i].as_secs_f64() * 1e9 / CALLS as f64;
    report.row([
        name.into(),
        geometry.indices.len().to_string(),
        format!("{:.2}", times[0].as_secs_f64() * 1e3),
        format!("{:.0}", nanoseconds(1)),
        format!("{:.0}", nanoseconds(2)),
        format!("{tight:.4}"),
        format!("{corners:.3}"),
    ]);
    report.goal(format!("world_box_{name}"), nanoseconds(1) * 1e-3, Target::AtMost(MICROSECONDS), "us");
}

fn half_area(b: &Bounds) -> f64 {
    let d = b.max - b.min;
    d.x * d.y + d.y * d.z + d.z * d.x
}
