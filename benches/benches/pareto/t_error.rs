//! Rays a second against the error of t, by precision, and how the error grows with the distance that rays come from.
//!
//! The exact t is that of the triangle which a tracer reports, and known to 2^-38, 4e-12, of itself: of what is more
//! exact than that, no more can be said.

use fastrand::Rng;
use ropewalk::render::Precision;
use ropewalk_bench::aim::{any, direction, inside, ray};
use ropewalk_bench::embree::Embree;
use ropewalk_bench::meshes::corners_of;
use ropewalk_bench::shapes::bumpy_sphere;
use ropewalk_bench::{Report, Result, Target, thread_pool};

use crate::Run;
use crate::chart::{Axis, Better, Chart, Curve, Panel, Point, Scale};
use crate::tracers::{Batches, Contender, Exact, peers};
use crate::verdicts::{Case, Tally};

/// In radii of the surface.
const DISTANCES: [f32; 5] = [3.0, 30.0, 300.0, 3e3, 3e4];
const TRIANGLES: u32 = 20_000;

/// The figures of a tracer at all distances.
struct Measured {
    contender: Point,
    tallies: Vec<Tally>,
    /// Of rays from the nearest distance.
    rays_per_second: f64,
}

pub fn measure(run: &Run, report: &mut Report) -> Result<Chart> {
    let (rays, samples) = if run.is_quick { (5_000, 1) } else { (100_000, 5) };
    let embree = Embree::open(0).map_err(|error| error.to_string());
    if let Err(error) = &embree {
        report.note(format!("t-error: without Embree: {error}"));
    }
    let triangles = corners_of(&bumpy_sphere(TRIANGLES));
    let mut contenders = Vec::new();
    for precision in [Precision::Fast, Precision::Refined] {
        let batches = Batches { triangles: triangles.clone(), precision };
        let is_default = precision == Precision::default();
        contenders.push(Contender::new("ours", format!("batches, {precision:?}"), batches).with_default(is_default));
    }
    contenders.push(Contender::new("ours", "queries", Exact::new(&triangles)?));
    contenders.extend(peers(&triangles, embree.as_ref().map_err(String::as_str))?);
    let new = |contender: &Contender<'_>| Measured {
        contender: contender.point(),
        tallies: Vec::new(),
        rays_per_second: 0.0,
    };
    let mut measured: Vec<Measured> = contenders.iter().map(new).collect();
    for distance in DISTANCES {
        let mut random = Rng::with_seed(1);
        let aimed = (0..rays).map(|_| {
            let corners = any(&mut random, &triangles);
            let origin = direction(&mut random) * distance;
            ray(origin, inside(&mut random, corners) - origin)
        });
        let case = Case::new(triangles.clone(), aimed.collect());
        for (contender, measured) in contenders.iter().zip(&mut measured) {
            measured.tallies.push(case.judge(contender.tracing.as_ref())?);
        }
        if distance == DISTANCES[0] {
            let seconds = case.seconds(&thread_pool(1)?, &contenders, rays, samples)?;
            seconds.iter().zip(&mut measured).for_each(|(s, measured)| measured.rays_per_second = rays as f64 / s);
        }
        run.progress(&format!("t-error, from {distance:e} radii"));
    }
    goals(&measured, report);
    Ok(chart(&measured))
}

fn goals(measured: &[Measured], report: &mut Report) {
    for (at, distance) in DISTANCES.iter().enumerate() {
        for (name, error) in [("worst", Tally::worst_error as fn(&Tally) -> f64), ("median", Tally::median_error)] {
            let [fast, refined] = [0, 1].map(|which: usize| error(&measured[which].tallies[at]));
            let name = format!("t_error_{name}_refined_by_fast_from_{distance:e}");
            report.goal(name, refined / fast, Target::AtMost(0.01), "x");
        }
    }
}

fn chart(measured: &[Measured]) -> Chart {
    let of = |name: &str, error: fn(&Tally) -> f64| {
        let point = |measured: &Measured| Point {
            x: measured.rays_per_second * 1e-6,
            y: error(&measured.tallies[0]),
            detail: format!("{} hits", measured.tallies[0].errors.len()),
            ..measured.contender.clone()
        };
        vec![Curve { name: name.to_owned(), is_joined: false, points: measured.iter().map(point).collect() }]
    };
    let by_distance = |measured: &Measured| {
        let points = DISTANCES.iter().zip(&measured.tallies).map(|(&distance, tally)| Point {
            x: distance.into(),
            y: tally.worst_error(),
            is_default: measured.contender.is_default,
            detail: format!("median {:.1e}, {} hits", tally.median_error(), tally.errors.len()),
            ..Point::default()
        });
        Curve { name: measured.contender.label.clone(), is_joined: true, points: points.collect() }
    };
    let y = Axis { name: "error of t, as a share of t", scale: Scale::Log };
    let at_once = |title, curves| {
        let x = Axis { name: "million rays a second, one thread", scale: Scale::Linear };
        Panel { title, x, y, front: Some(Better::More), curves }
    };
    Chart {
        name: "t-error",
        panels: vec![
            at_once("Median error, rays from 3 radii away", of("median", Tally::median_error)),
            at_once("Worst error, rays from 3 radii away", of("worst", Tally::worst_error)),
            Panel {
                title: "Worst error by distance",
                x: Axis { name: "distance that rays come from, in radii of the surface", scale: Scale::Log },
                y,
                front: None,
                curves: measured.iter().map(by_distance).collect(),
            },
        ],
    }
}
