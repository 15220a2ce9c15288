//! Building time and quality of bottom-level structures, of Ropewalk's builders and of its peers'.
//!
//! All get the same triangles, three corners each, and end with what their own traversal reads: ours with both of its
//! layouts, obvhs with its triangles in the order of the leaves, as its own examples have them. Every one uses all
//! threads that it knows to use. Two measures of quality: the surface area heuristic's cost, by one function for all
//! whose tree can be read, and the rate of one thread on diffuse rays where a peer's is known from the benchmark
//! `peers`: that of Embree.

mod cost;
mod peers;

use std::process::ExitCode;
use std::time::Duration;

use clap::Parser as _;
use glam::Vec3;
use ropewalk::Geometry;
use ropewalk::accel::{Blas, BlasBuildParams};
use ropewalk::graph::{BlasKind, Quality};
use ropewalk::trace::Cpu;
use ropewalk_bench::embree::{self, Batch as _, Closest1, Embree};
use ropewalk_bench::rays::{RayKind, RaySets};
use ropewalk_bench::runner::{Runner as _, Traced};
use ropewalk_bench::scenes::{BenchScene, ImageSize, Recipe, SCENES};
use ropewalk_bench::{Contender, Options, Report, Result, Target, finish, medians, milliseconds, thread_pool, time};

use peers::Peer;

const NAMES: [&str; 4] = ["bunny", "dragon-res2", "dragon", "sponza"];
const QUICK_NAMES: [&str; 2] = ["bunny", "sponza"];

const OURS: [(&str, BlasKind); 4] = [
    ("ropewalk, low", BlasKind::Bvh(Quality::Low)),
    ("ropewalk, medium", BlasKind::Bvh(Quality::Medium)),
    ("ropewalk, high", BlasKind::Bvh(Quality::High)),
    ("ropewalk, kd-tree", BlasKind::KdTree),
];

const EMBREE: [(&str, embree::Quality); 3] = [
    ("Embree 4, low", embree::Quality::Low),
    ("Embree 4, medium", embree::Quality::Medium),
    ("Embree 4, high", embree::Quality::High),
];

fn main() -> ExitCode {
    let options = Options::parse();
    finish(measure_all(&options), &options)
}

fn measure_all(options: &Options) -> Result<Report> {
    let names = if options.quick { &QUICK_NAMES[..] } else { &NAMES };
    let columns = ["scene", "triangles", "who", "ms", "Mtriangles/s", "SAH cost", "diffuse Mrays/s"];
    let mut report = Report::new(&columns);
    for recipe in SCENES.iter().filter(|recipe| names.contains(&recipe.name)) {
        measure(recipe, if options.quick { 3 } else { 7 }, &mut report)?;
    }
    Ok(report)
}

/// The figures of a builder.
struct Point {
    name: &'static str,
    time: Duration,
    /// Less is better.
    cost: Option<f64>,
    /// Rays a second; more is better.
    rate: Option<f64>,
}

fn measure(recipe: &Recipe, samples: usize, report: &mut Report) -> Result<()> {
    let triangles = recipe.load(ImageSize::Paper)?.triangles();
    let embree = Embree::open(0)?;
    let peers = peers::all();
    let times = build_times(&triangles, &embree, &peers, samples);
    let rates = rates(recipe, &triangles, &embree, samples)?;

    let geometry = soup(&triangles);
    let mut points = Vec::new();
    for ((name, structure), (&time, &rate)) in OURS.into_iter().zip(times.iter().zip(&rates)) {
        let blas = Blas::build(&geometry, &BlasBuildParams::new(structure))?;
        points.push(Point { name, time, cost: Some(cost::of_ours(&blas.nodes)), rate: Some(rate) });
    }
    for ((name, _), (&time, &rate)) in EMBREE.into_iter().zip(times[4..].iter().zip(&rates[4..])) {
        points.push(Point { name, time, cost: None, rate: Some(rate) });
    }
    for (peer, &time) in peers.iter().zip(&times[7..]) {
        points.push(Point { name: peer.name, time, cost: (peer.build)(&triangles).cost(), rate: None });
    }
    for point in &points {
        report.row([
            recipe.name.to_owned(),
            triangles.len().to_string(),
            point.name.to_owned(),
            milliseconds(point.time),
            format!("{:.2}", triangles.len() as f64 / point.time.as_secs_f64() * 1e-6),
            point.cost.map_or(String::new(), |cost| format!("{cost:.2}")),
            point.rate.map_or(String::new(), |rate| format!("{:.2}", rate * 1e-6)),
        ]);
    }
    // For each of our builders, the peer that comes nearest to being both faster and better, and the factor by which it
    // fails to be one of them.
    let (ours, theirs) = points.split_at(OURS.len());
    for our in ours {
        let name = our.name.replace("ropewalk, ", "").replace('-', "_");
        let least = |margin: fn(&Point, &Point) -> Option<f64>| {
            let margins = theirs.iter().filter_map(|their| {
                let time = their.time.as_secs_f64() / our.time.as_secs_f64();
                margin(our, their).map(|quality| quality.max(time))
            });
            margins.fold(f64::INFINITY, f64::min)
        };
        let cost = least(|our, their| their.cost.zip(our.cost).map(|(their, our)| their / our));
        let rate = least(|our, their| our.rate.zip(their.rate).map(|(our, their)| our / their));
        report.goal(format!("front_by_cost_{}_{name}", recipe.name), cost, Target::AtLeast(1.0), "x");
        report.goal(format!("front_by_rate_{}_{name}", recipe.name), rate, Target::AtLeast(1.0), "x");
    }
    Ok(())
}

fn soup(triangles: &[[Vec3; 3]]) -> Geometry {
    let indices: Vec<[u32; 3]> = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Geometry::new(triangles.as_flattened(), indices)
}

/// Building times of our builders, Embree's and all other peers', measured in turns.
fn build_times(triangles: &[[Vec3; 3]], embree: &Embree, peers: &[Peer], samples: usize) -> Vec<Duration> {
    let geometry = &soup(triangles);
    let mut contenders: Vec<Contender> = Vec::new();
    for (_, structure) in OURS {
        contenders.push(Box::new(move || time(|| Blas::build(geometry, &BlasBuildParams::new(structure)))));
    }
    for (_, quality) in EMBREE {
        contenders.push(Box::new(move || time(|| embree.scene(triangles, quality, false).is_ok())));
    }
    for peer in peers {
        contenders.push(Box::new(move || (peer.time)(triangles)));
    }
    medians(samples, &mut contenders)
}

/// Diffuse rays a second on one thread, of our structures and Embree's, measured in turns.
fn rates(recipe: &Recipe, triangles: &[[Vec3; 3]], embree: &Embree, samples: usize) -> Result<Vec<f64>> {
    let scene = recipe.load(ImageSize::Paper)?;
    let sets = RaySets::new(&scene)?;
    let rays = sets.of(RayKind::Diffuse);
    let pool = thread_pool(1)?;
    let scenes: Vec<BenchScene> =
        OURS.into_iter().map(|(_, structure)| with_structure(recipe, structure)).collect::<Result<_>>()?;
    let theirs: Vec<embree::Scene<'_>> =
        EMBREE.into_iter().map(|(_, quality)| embree.scene(triangles, quality, false)).collect::<Result<_>>()?;
    let mut contenders: Vec<Contender> = Vec::new();
    for scene in &scenes {
        let mut runner = Traced::new(Cpu::default(), &pool, scene.arrays(), rays, RayKind::Diffuse);
        contenders.push(Box::new(move || runner.run()));
    }
    for scene in &theirs {
        let mut batch = Closest1::default();
        contenders.push(Box::new(move || {
            batch.write(rays);
            time(|| batch.trace(scene, false))
        }));
    }
    let times = medians(samples, &mut contenders);
    Ok(times.into_iter().map(|time| rays.len() as f64 / time.as_secs_f64()).collect())
}

/// The device arrays of one geometry with this structure.
fn with_structure(recipe: &Recipe, structure: BlasKind) -> Result<BenchScene> {
    let mut scene = recipe.load(ImageSize::Paper)?;
    // The same triangles in the same order as they were given.
    let arrays = scene.compiler.arrays_mut();
    let mut triangles: Vec<_> = arrays.triangles.to_vec();
    triangles.sort_by_key(|triangle| triangle.primitive);
    let corners: Vec<[Vec3; 3]> = triangles.iter().map(|t| [t.v0, t.v1, t.v2].map(Vec3::from_array)).collect();
    let blas = Blas::build(&soup(&corners), &BlasBuildParams::new(structure))?;
    arrays.blas_nodes.replace(&blas.nodes);
    arrays.wide_nodes.replace(&blas.wide_nodes);
    arrays.triangles.replace(&blas.triangles);
    Ok(scene)
}
