//! The rate of rays as scenes grow: in triangles of one geometry, and in instances of a small geometry.
//!
//! The same bumpy sphere of ever more triangles, seen from one place: the same pixels hit, and the bumps hide the same.
//! Copies of a small one in a cube, ever smaller, so that their boxes fill as much of the cube whatever their number;
//! what hits grows up to all of the cube.

mod chart;
mod fit;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use glam::DVec3;
use rayon::ThreadPool;
use rayon::prelude::*;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{NONE, RayRecord};
use ropewalk::trace::{Cpu, Emulated, Traversal, TraversalCounts};
use ropewalk::{Camera, Scene, View};
#[cfg(feature = "gpu")]
use ropewalk_bench::gpu::Gpu;
use ropewalk_bench::rays::{Differences, RayKind, RaySets, true_answers};
use ropewalk_bench::runner::{Runner, Traced};
use ropewalk_bench::scenes::{BenchScene, ImageSize};
use ropewalk_bench::shapes::{add_copies, bumpy_sphere, geometry_core};
use ropewalk_bench::{Contender, Options, Report, Result, finish, medians, milliseconds, thread_pool, time};

use fit::{Line, fit};

/// Sizes are powers of 4 up to these powers of 2.
const MOST: [(Series, u32, u32); 2] = [(Series::Triangles, 10, 24), (Series::Instances, 0, 20)];
/// The same with `--quick`.
const QUICK_MOST: [(Series, u32, u32); 2] = [(Series::Triangles, 10, 14), (Series::Instances, 0, 6)];
/// Of the geometry with instances.
const COPIED_TRIANGLES: u32 = 1 << 10;
/// The boxes of all instances together, in volumes of their cube.
const OVERLAP: f64 = 1.0;
const KINDS: [RayKind; 2] = [RayKind::Primary, RayKind::Diffuse];

#[derive(Debug, Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
    /// Draw rates and fits to this file, as SVG.
    #[arg(long, value_name = "FILE")]
    chart: Option<PathBuf>,
}

/// What grows in a series of scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Series {
    /// Of one geometry.
    Triangles,
    /// Of a small geometry.
    Instances,
}

impl Series {
    fn name(self) -> &'static str {
        match self {
            Self::Triangles => "triangles",
            Self::Instances => "instances",
        }
    }

    fn scene(self, count: u32) -> Result<BenchScene> {
        let mut scene = Scene::new();
        let eye = match self {
            Self::Triangles => {
                let core = geometry_core(&mut scene, bumpy_sphere(count))?;
                scene.add(scene.root(), core)?;
                DVec3::new(1.2, 0.9, 2.6)
            }
            Self::Instances => {
                add_copies(&mut scene, bumpy_sphere(COPIED_TRIANGLES), count, OVERLAP)?;
                DVec3::new(0.66, 0.5, 1.46)
            }
        };
        let [width, height] = ImageSize::Paper.pixels();
        let view = View::look_at(eye, DVec3::ZERO, DVec3::Y, Camera::default(), width, height);
        BenchScene::compile(self.name(), &mut scene, view, DVec3::new(-2.0, 3.0, 2.0))
    }
}

/// A measured rate.
pub struct Point {
    series: Series,
    /// Triangles or instances.
    count: f64,
    kind: RayKind,
    executor: String,
    nanoseconds_a_ray: f64,
    nodes_a_ray: Option<f64>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let measured = measure_all(&arguments.options).and_then(|(report, points)| {
        if let Some(path) = &arguments.chart {
            chart::draw(path, &points)?;
        }
        Ok(report)
    });
    finish(measured, &arguments.options)
}

fn measure_all(options: &Options) -> Result<(Report, Vec<Point>)> {
    let columns = [
        "series",
        "triangles",
        "instances",
        "bytes",
        "bytes a triangle",
        "ready ms",
        "rays",
        "count",
        "hits",
        "executor",
        "Mrays/s",
        "nodes a ray",
        "boxes a ray",
        "triangles a ray",
        "bytes a ray",
        "other hits",
    ];
    let mut report = Report::new(&columns);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let pools = [thread_pool(1)?, thread_pool(threads)?];
    let mut points = Vec::new();
    for (series, least, most) in if options.quick { QUICK_MOST } else { MOST } {
        for exponent in (least..=most).step_by(2) {
            measure_size(series, 1 << exponent, options, &pools, &mut report, &mut points)?;
        }
    }
    for line in fits(&points) {
        report.note(line);
    }
    Ok((report, points))
}

/// An executor, and what the kernel counts where it can.
struct Entry<'a> {
    name: String,
    runner: Box<dyn Runner + 'a>,
    counts: Option<TraversalCounts>,
}

fn measure_size(
    series: Series,
    count: u32,
    options: &Options,
    pools: &[ThreadPool; 2],
    report: &mut Report,
    points: &mut Vec<Point>,
) -> Result<()> {
    let mut made = Err("not made".into());
    let ready = time(|| made = series.scene(count));
    #[cfg_attr(not(feature = "gpu"), expect(unused_mut, reason = "for the upload"))]
    let mut scene = made?;
    #[cfg(feature = "gpu")]
    let gpu = Gpu::new(options, scene.compiler.arrays_mut(), Traversal::default())
        .inspect_err(|error| println!("{count} {}: gpu: skipped: {error}", series.name()));
    let (arrays, sets) = (scene.arrays(), RaySets::new(&scene)?);
    let (stored, instances) = (arrays.triangles.len(), arrays.instances.len());
    for kind in KINDS {
        let rays = sets.of(kind);
        let mut entries: Vec<Entry> = Vec::new();
        for (name, traversal) in [("emulated, rope", Traversal::Rope), ("emulated, wide", Traversal::Wide)] {
            let kernel = Emulated::default().with_traversal(traversal);
            let counts = Some(work(&kernel, arrays, rays));
            let runner = Box::new(Traced::new(kernel, &pools[0], arrays, rays, kind));
            entries.push(Entry { name: name.to_owned(), runner, counts });
        }
        for pool in pools {
            let name = match pool.current_num_threads() {
                1 => "cpu, 1 thread".to_owned(),
                threads => format!("cpu, {threads} threads"),
            };
            let runner = Box::new(Traced::new(Cpu::default(), pool, arrays, rays, kind));
            entries.push(Entry { name, runner, counts: None });
        }
        #[cfg(feature = "gpu")]
        if let Ok(gpu) = &gpu
            && let Some(resident) = gpu.resident(rays, kind)
        {
            let counts = entries[1].counts;
            entries.push(Entry { name: format!("{}, wide", gpu.label()), runner: Box::new(resident), counts });
        }
        let mut contenders: Vec<Contender> =
            entries.iter_mut().map(|entry| Box::new(|| entry.runner.run()) as Contender).collect();
        let times = medians(if options.quick { 3 } else { 5 }, &mut contenders);
        drop(contenders);
        let truth = true_answers(&scene, rays, kind)?;
        let hits = truth.iter().filter(|t| t.is_finite()).count();
        for (entry, time) in entries.iter().zip(times) {
            let differences = Differences::between(&truth, &entry.runner.answers());
            let a_ray = |count: u64| count as f64 / rays.len() as f64;
            let counted = |count: fn(&TraversalCounts) -> u64| {
                entry.counts.map_or(String::new(), |counts| format!("{:.1}", a_ray(count(&counts))))
            };
            report.row([
                series.name().to_owned(),
                stored.to_string(),
                instances.to_string(),
                arrays.byte_count().to_string(),
                format!("{:.1}", arrays.byte_count() as f64 / stored as f64),
                milliseconds(ready),
                kind.name().to_owned(),
                rays.len().to_string(),
                hits.to_string(),
                entry.name.clone(),
                format!("{:.3}", rays.len() as f64 / time.as_secs_f64() * 1e-6),
                counted(|counts| counts.nodes),
                counted(|counts| counts.boxes),
                counted(|counts| counts.triangles),
                counted(|counts| counts.bytes),
                (differences.distances + differences.verdicts).to_string(),
            ]);
            points.push(Point {
                series,
                count: if series == Series::Triangles { stored } else { instances } as f64,
                kind,
                executor: entry.name.clone(),
                nanoseconds_a_ray: time.as_secs_f64() * 1e9 / rays.len() as f64,
                nodes_a_ray: entry.counts.map(|counts| a_ray(counts.nodes)),
            });
        }
    }
    Ok(())
}

/// The kernel's counts of the rays, computed by all threads.
fn work(kernel: &Emulated, arrays: &DeviceArrays, rays: &[RayRecord]) -> TraversalCounts {
    const CHUNK: usize = 1 << 12;
    let counts: Vec<TraversalCounts> =
        rays.par_chunks(CHUNK).map(|rays| kernel.count_closest_hits(arrays, rays, NONE)).collect();
    counts.into_iter().fold(TraversalCounts::default(), |mut sum, counts| {
        sum += counts;
        sum
    })
}

/// The points of each curve, in the order in which curves first appear.
fn curves(points: &[Point], series: Series) -> Vec<Vec<&Point>> {
    let mut curves: Vec<Vec<&Point>> = Vec::new();
    for point in points.iter().filter(|point| point.series == series) {
        let is_same = |curve: &&mut Vec<&Point>| (curve[0].kind, &curve[0].executor) == (point.kind, &point.executor);
        match curves.iter_mut().find(is_same) {
            Some(curve) => curve.push(point),
            None => curves.push(vec![point]),
        }
    }
    curves
}

/// A fit of the time of a ray by c n^k.
fn power(curve: &[&Point]) -> Line {
    fit(curve.iter().map(|point| [point.count.ln(), point.nanoseconds_a_ray.ln()]))
}

/// How times and counts grow, curve by curve.
fn fits(points: &[Point]) -> Vec<String> {
    let mut lines = Vec::new();
    for curve in [Series::Triangles, Series::Instances].into_iter().flat_map(|series| curves(points, series)) {
        let Point { series, kind, executor, .. } = curve[0];
        let Line { slope, at_0, r_squared } = power(&curve);
        lines.push(format!(
            "FIT {}, {}, {executor}: {:.0} ns n^{slope:.3} a ray (R2 {r_squared:.3})",
            series.name(),
            kind.name(),
            at_0.exp(),
        ));
        let nodes: Option<Vec<[f64; 2]>> =
            curve.iter().map(|point| Some([point.count.log2(), point.nodes_a_ray?])).collect();
        if let Some(nodes) = nodes {
            let Line { slope, at_0, r_squared } = fit(nodes);
            lines.push(format!("    nodes a ray: {at_0:.1} + {slope:.2} log2 n (R2 {r_squared:.3})"));
        }
    }
    lines
}
