//! Rays a second against rays that go wrong: structures, formats of nodes, padding of boxes, precision, triangle tests,
//! and peers.
//!
//! Closed surfaces seen from within, and one from ten sizes away. A quarter of the rays aim at a corner, a quarter at
//! an edge, exactly so where the numbers allow it; the others are ordinary ones. And rays that start beside an edge at
//! which they aim.

use fastrand::Rng;
use glam::Vec3;
use ropewalk::accel::BlasBuildParams;
use ropewalk::graph::{BlasKind, Quality};
use ropewalk::render::Precision;
use ropewalk::trace::Traversal;
use ropewalk_bench::aim::{any, at_all_parts, on_edge, point, quantised, ray};
use ropewalk_bench::embree::Embree;
use ropewalk_bench::meshes::{corners_of, cube, moved, round, turn};
use ropewalk_bench::shapes::bumpy_sphere;
use ropewalk_bench::{Report, Result, Target, thread_pool};

use crate::Run;
use crate::chart::{Axis, Better, Chart, Curve, Panel, Point, Scale};
use crate::tracers::{Batches, Contender, Exact, Executor, OverArrays, peers};
use crate::verdicts::{Case, Tally};

/// The shares of a box's longest side by which it is padded.
const MARGINS: [(&str, f32); 4] = [
    ("not padded", 0.0),
    ("2^-22", 1.0 / (1 << 22) as f32),
    ("2^-18", BlasBuildParams::DEFAULT_BOX_MARGIN),
    ("2^-14", 1.0 / (1 << 14) as f32),
];

pub const STRUCTURES: [(&str, BlasKind); 4] = [
    ("Low", BlasKind::Bvh(Quality::Low)),
    ("Medium", BlasKind::Bvh(Quality::Medium)),
    ("High", BlasKind::Bvh(Quality::High)),
    ("kd-tree", BlasKind::KdTree),
];

pub fn measure(run: &Run, report: &mut Report) -> Result<Chart> {
    let (rays, timed, samples) = if run.is_quick { (5_000, 2_000, 1) } else { (200_000, 50_000, 5) };
    let embree = Embree::open(0).map_err(|error| error.to_string());
    if let Err(error) = &embree {
        report.note(format!("hits: without Embree: {error}"));
    }
    let pool = thread_pool(1)?;
    let mut sums: Vec<Sum> = Vec::new();
    let cases = cases(rays);
    for (name, case) in &cases {
        let contenders = contenders(&case.triangles, embree.as_ref().map_err(String::as_str))?;
        let seconds = case.seconds(&pool, &contenders, timed, samples)?;
        for (i, (contender, seconds)) in contenders.iter().zip(seconds).enumerate() {
            let tally = case.judge(contender.tracing.as_ref())?;
            if i == sums.len() {
                sums.push(Sum { curve: contender.curve, point: contender.point(), ..Sum::default() });
            }
            if contender.is_default {
                let (label, wrong) = (&contender.label, tally.wrong_hits);
                report.note(format!("hits, {name}, {label}: {} leaks, {wrong} wrong hits of {rays}", tally.leaks));
            }
            let sum = &mut sums[i];
            sum.tally = std::mem::take(&mut sum.tally).plus(tally);
            sum.seconds += seconds / timed as f64;
        }
        run.progress(&format!("hits, {name}"));
    }
    for sum in &mut sums {
        sum.point.x = cases.len() as f64 / sum.seconds * 1e-6;
    }
    let leaks = |is_wanted: &dyn Fn(&Point) -> bool| {
        sums.iter().filter(|sum| is_wanted(&sum.point)).map(|sum| sum.tally.leaks).sum::<usize>() as f64
    };
    report.goal("hits_default_leaks", leaks(&|point| point.is_default), Target::AtMost(0.0), "rays");
    report.goal("hits_textbook_leaks", leaks(&|point| point.label == "textbook"), Target::AtLeast(1.0), "rays");
    let curves = curves(&sums);
    Ok(Chart {
        name: "hits",
        panels: vec![Panel {
            title: "Speed against rays that go wrong",
            x: Axis { name: "million rays a second, one thread", scale: Scale::Linear },
            y: Axis { name: "leaks and wrong hits per million rays", scale: Scale::Log },
            front: Some(Better::More),
            curves,
        }],
    })
}

/// The figures of a tracer over all cases.
#[derive(Default)]
struct Sum {
    curve: &'static str,
    point: Point,
    tally: Tally,
    /// Of one ray of each case.
    seconds: f64,
}

fn curves(sums: &[Sum]) -> Vec<Curve> {
    let point = |sum: &Sum| {
        let Tally { rays, leaks, wrong_hits, .. } = sum.tally;
        let detail = format!("{leaks} leaks, {wrong_hits} wrong hits of {rays} rays");
        Point { y: sum.tally.faults_per_million(), detail, ..sum.point.clone() }
    };
    let of_one_curve = sums.chunk_by(|a, b| a.curve == b.curve).map(|sums| Curve {
        name: sums[0].curve.to_owned(),
        is_joined: false,
        points: sums.iter().map(point).collect(),
    });
    of_one_curve.collect()
}

fn cases(rays: usize) -> [(&'static str, Case); 5] {
    let within = |seed: u64, triangles: Vec<[Vec3; 3]>, radius: f32| {
        let origin = |random: &mut Rng| quantised(point(random) * radius);
        let rays = at_all_parts(&mut Rng::with_seed(seed), rays, &triangles, origin);
        Case::new(triangles, rays)
    };
    let from_afar = |random: &mut Rng| {
        let away = point(random);
        quantised(away + away.signum() * 10.0)
    };
    let ball = moved(&round(), |p| turn() * p);
    let rays_at_ball = at_all_parts(&mut Rng::with_seed(3), rays, &ball, from_afar);
    [
        ("cube", within(1, cube(32), 0.9)),
        ("bumpy sphere", within(2, moved(&corners_of(&bumpy_sphere(100_000)), quantised), 0.4)),
        ("ball from afar", Case::new(ball.clone(), rays_at_ball)),
        ("ball", within(4, ball, 0.5)),
        ("beside edges", beside_edges(rays)),
    ]
}

/// A turned cube of twelve triangles, and rays that start much nearer to one of its edges than the triangles are large.
fn beside_edges(rays: usize) -> Case {
    let triangles = moved(&cube(1), |p| turn() * p);
    let mut random = Rng::with_seed(5);
    let aimed = (0..rays).map(|_| {
        let corners = any(&mut random, &triangles);
        let target = on_edge(&mut random, corners);
        let origin = target + (point(&mut random) * 0.5 - target) * 10f32.powf(-5.0 * random.f32());
        ray(origin, target - origin)
    });
    let rays = aimed.collect();
    Case::new(triangles, rays)
}

fn contenders<'a>(
    triangles: &[[Vec3; 3]],
    embree: std::result::Result<&'a Embree, &str>,
) -> Result<Vec<Contender<'a>>> {
    let over = |params: &BlasBuildParams, executor| OverArrays::new(triangles, params, executor);
    let default = BlasBuildParams::default();
    let mut contenders = Vec::new();
    for (name, structure) in STRUCTURES {
        let column = over(&default.with_structure(structure), Executor::Cpu)?;
        let is_default = structure == default.structure;
        contenders.push(Contender::new("cpu: structure", name, column).with_default(is_default));
    }
    for (name, margin) in MARGINS {
        let column = over(&default.with_box_margin(margin), Executor::Emulated(Traversal::Rope))?;
        contenders.push(Contender::new("emulated, binary nodes: padding", name, column));
    }
    for (name, margin) in [MARGINS[0], MARGINS[2]] {
        let column = over(&default.with_box_margin(margin), Executor::Emulated(Traversal::Wide))?;
        contenders.push(Contender::new("emulated, quantised nodes: padding", name, column));
    }
    let column = over(&default, Executor::MoellerTrumbore)?;
    contenders.push(Contender::new("triangle test", "Möller, Trumbore on our nodes", column));
    for (name, precision) in [("batches, Fast", Precision::Fast), ("batches, Refined", Precision::Refined)] {
        let is_default = precision == Precision::default();
        let column = Batches { triangles: triangles.to_vec(), precision };
        contenders.push(Contender::new("precision", name, column).with_default(is_default));
    }
    contenders.push(Contender::new("precision", "queries", Exact::new(triangles)?));
    contenders.extend(peers(triangles, embree)?);
    Ok(contenders)
}
