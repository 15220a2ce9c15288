//! The hits of the executor `cpu` compared with f64: the triangle and the distance t. Beside it the test of Möller and
//! Trumbore in f32, on the triangle that f64 finds.
//!
//! The error of t is given twice: that of the triangle test alone, relative to the ray in the instance's space as f32
//! represents it, and the whole error, relative to the ray in the world.

mod oracle;

use std::process::ExitCode;

use clap::Parser;
use glam::Vec3;
use rayon::prelude::*;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{HitRecord, NONE, RayRecord};
use ropewalk::trace::{Cpu, Tracer as _};
use ropewalk_bench::rays::{RayKind, RaySets, meet};
use ropewalk_bench::scenes::{ImageSize, SCENES};
use ropewalk_bench::{Options, Report, Result, Target, finish};

const NAMES: [&str; 4] = ["bunny", "dragon", "sponza", "kitchen"];
const QUICK_NAMES: [&str; 2] = ["bunny", "sponza"];
const KINDS: [RayKind; 3] = [RayKind::Primary, RayKind::Mirror, RayKind::Diffuse];
/// Two triangles this near to each other, relatively, are the same place: an edge, or two that coincide.
const SAME_PLACE: f64 = 1e-5;
/// Of a million rays.
const MOST_WRONG: f64 = 10.0;
const MOST_FAR_OFF: f64 = 10.0;

fn main() -> ExitCode {
    let options = Options::parse();
    finish(measure_all(&options), &options)
}

/// The result of comparing some rays.
#[derive(Default)]
struct Tally {
    hits: usize,
    false_misses: usize,
    false_hits: usize,
    /// Rays for which another triangle is nearer, or the triangle is not hit.
    wrong_triangles: usize,
    /// Of each hit, the error of the test: relative, and in units of the last place.
    errors: Vec<[f64; 2]>,
    /// The relative error of each hit, that of the transform included.
    whole_errors: Vec<f64>,
}

impl Tally {
    fn hit(&mut self, t: f32, [truth, truth_in_instance]: [f64; 2]) {
        self.hits += 1;
        let error = (f64::from(t) - truth_in_instance).abs();
        let ulp = f64::from(t.next_up() - t);
        self.errors.push([error / truth_in_instance.abs(), error / ulp]);
        self.whole_errors.push((f64::from(t) - truth).abs() / truth.abs());
    }

    fn off_by_more_than(&self, bound: f64) -> usize {
        self.errors.iter().filter(|[relative, _]| *relative > bound).count()
    }

    fn row(&self, scene: &str, kind: RayKind, rays: usize, who: &str) -> [String; 14] {
        let mut ulps: Vec<f64> = self.errors.iter().map(|[_, ulps]| *ulps).collect();
        ulps.sort_by(f64::total_cmp);
        let percentile = |share: f64| ulps.get((ulps.len() as f64 * share) as usize).copied().unwrap_or_default();
        [
            scene.to_owned(),
            kind.name().to_owned(),
            rays.to_string(),
            who.to_owned(),
            self.hits.to_string(),
            self.false_misses.to_string(),
            self.false_hits.to_string(),
            self.wrong_triangles.to_string(),
            self.off_by_more_than(1e-4).to_string(),
            self.off_by_more_than(1e-5).to_string(),
            format!("{:.2}", percentile(0.5)),
            format!("{:.1}", percentile(0.99)),
            format!("{:.1e}", self.errors.iter().map(|[relative, _]| *relative).fold(0.0, f64::max)),
            self.whole_errors.iter().filter(|&&relative| relative > 1e-4).count().to_string(),
        ]
    }
}

fn measure_all(options: &Options) -> Result<Report> {
    let mut report = Report::new(&[
        "scene",
        "rays",
        "count",
        "who",
        "hits",
        "false miss",
        "false hit",
        "wrong triangle",
        "t off by 1e-4",
        "by 1e-5",
        "ulp, median",
        "ulp, 99 %",
        "most, relative",
        "with transform by 1e-4",
    ]);
    let names = if options.quick { &QUICK_NAMES[..] } else { &NAMES };
    for recipe in SCENES.iter().filter(|recipe| names.contains(&recipe.name)) {
        let scene = recipe.load(ImageSize::Paper)?;
        let arrays = scene.arrays();
        let sets = RaySets::new(&scene)?;
        let (mut rays_traced, mut wrong, mut far_off) = (0, 0, 0);
        for kind in KINDS {
            let rays = sets.of(kind);
            let truth: Vec<_> = rays.par_iter().map(|ray| oracle::closest(arrays, ray)).collect();
            let hits = Cpu::default().closest_hits(arrays, rays, NONE)?;
            let ours = tally(arrays, rays, &hits, &truth);
            report.row(ours.row(scene.name, kind, rays.len(), "ropewalk"));
            let theirs = tally_moeller_trumbore(arrays, rays, &truth);
            report.row(theirs.row(scene.name, kind, rays.len(), "Möller, Trumbore"));
            rays_traced += rays.len();
            wrong += ours.false_misses + ours.wrong_triangles;
            far_off += ours.off_by_more_than(1e-4);
        }
        let of_a_million = |count: usize| count as f64 * 1e6 / rays_traced as f64;
        report.goal(format!("{}_wrong", scene.name), of_a_million(wrong), Target::AtMost(MOST_WRONG), "of a million");
        let name = format!("{}_t_off", scene.name);
        report.goal(name, of_a_million(far_off), Target::AtMost(MOST_FAR_OFF), "of a million");
    }
    Ok(report)
}

fn tally(arrays: &DeviceArrays, rays: &[RayRecord], hits: &[HitRecord], truth: &[Option<oracle::Exact>]) -> Tally {
    let mut tally = Tally::default();
    for ((ray, hit), truth) in rays.iter().zip(hits).zip(truth) {
        if hit.instance == NONE {
            tally.false_misses += usize::from(truth.is_some());
            continue;
        }
        let distances = oracle::distances(arrays, ray, hit.instance, hit.triangle);
        tally.hit(hit.t, distances);
        match truth {
            None => tally.false_hits += 1,
            Some(truth) if (truth.instance, truth.primitive) != (hit.instance, hit.primitive) => {
                tally.wrong_triangles += usize::from((distances[0] - truth.t).abs() > SAME_PLACE * truth.t);
            }
            Some(_) => {}
        }
    }
    tally
}

/// This test is only applied to the right triangles, so it has no wrong ones.
fn tally_moeller_trumbore(arrays: &DeviceArrays, rays: &[RayRecord], truth: &[Option<oracle::Exact>]) -> Tally {
    let mut tally = Tally::default();
    for (ray, truth) in rays.iter().zip(truth) {
        let Some(truth) = truth else { continue };
        let triangle = &arrays.triangles[truth.triangle as usize];
        let corners = [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from_array);
        match meet(&oracle::local_ray(arrays, ray, truth.instance), &corners, f32::INFINITY) {
            Some(t) => tally.hit(t, oracle::distances(arrays, ray, truth.instance, truth.triangle)),
            None => tally.false_misses += 1,
        }
    }
    tally
}
