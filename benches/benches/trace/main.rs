//! How fast each executor traces each kind of ray, and what a ray costs it.
//!
//! The first row of each block is the paper's own method: ropes in one fixed order, one triangle a leaf, one ray after the
//! other. Counts are those of the replicas in `ropewalk_bench::layouts`. With the cargo feature `gpu` the executor `gpu` is measured
//! too, where there is a GPU.

#[cfg(feature = "gpu")]
mod gpu;

use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use rayon::{ThreadPool, ThreadPoolBuilder};
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::Ray;
use ropewalk::trace::{Cpu, Emulated};
use ropewalk_bench::layouts::{Layout, LayoutScene, Totals, paper_arrays};
use ropewalk_bench::rays::{Differences, RayKind, RaySets, true_answers};
use ropewalk_bench::runner::{Runner, Traced};
use ropewalk_bench::scenes::{BenchScene, SCENES};
use ropewalk_bench::{Contender, Options, Report, Result, medians};

const QUICK_NAMES: [&str; 2] = ["sphere", "bunny"];

#[derive(Debug, Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
    /// Only these scenes.
    #[arg(long, value_name = "NAME")]
    scene: Vec<String>,
    /// Only these rays.
    #[arg(long, value_name = "KIND")]
    rays: Vec<RayKind>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match measure_all(&arguments) {
        Ok(report) => report.finish(&arguments.options),
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn measure_all(arguments: &Arguments) -> Result<Report> {
    let columns = [
        "scene",
        "triangles",
        "bytes",
        "rays",
        "count",
        "executor",
        "Mrays/s",
        "times paper's",
        "nodes a ray",
        "boxes a ray",
        "triangles a ray",
        "bytes a ray",
        "lockstep %",
        "other hits",
    ];
    let mut report = Report::new(&columns);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let pools = [1, threads].map(|threads| ThreadPoolBuilder::new().num_threads(threads).build());
    let [one, all] = pools;
    let pools = [one?, all?];
    for recipe in &SCENES {
        let is_named = arguments.scene.iter().any(|name| name == recipe.name);
        let is_default = !arguments.options.quick || QUICK_NAMES.contains(&recipe.name);
        if is_named || arguments.scene.is_empty() && is_default {
            measure_scene(&mut recipe.load()?, arguments, &pools, &mut report)?;
        }
    }
    Ok(report)
}

/// An executor over some arrays, with what a ray does there where a replica tells.
struct Entry<'a> {
    name: String,
    runner: Box<dyn Runner + 'a>,
    counts: Option<Totals>,
}

fn measure_scene(
    scene: &mut BenchScene,
    arguments: &Arguments,
    pools: &[ThreadPool; 2],
    report: &mut Report,
) -> Result<()> {
    let kinds = if arguments.rays.is_empty() { &RayKind::ALL[..] } else { &arguments.rays };
    let samples = if arguments.options.quick { 3 } else { 7 };
    let sets = RaySets::new(scene)?;
    #[cfg_attr(not(feature = "gpu"), expect(unused_mut, reason = "for the upload"))]
    let mut paper = paper_arrays(scene.arrays())?;
    #[cfg(feature = "gpu")]
    let gpus = open_gpus(&mut paper, scene);
    let scene = &*scene;
    for &kind in kinds {
        let rays = sets.of(kind);
        let mut entries = vec![
            emulated("paper: emulated, 1 triangle a leaf", &pools[0], &paper, rays, kind),
            emulated("emulated", &pools[0], scene.arrays(), rays, kind),
        ];
        entries.extend(pools.iter().map(|pool| cpu(pool, scene.arrays(), rays, kind)));
        #[cfg(feature = "gpu")]
        for (gpu, (arrays, how)) in
            gpus.iter().zip([(&paper, "paper: gpu, 1 triangle a leaf"), (scene.arrays(), "gpu")])
        {
            let counts = counts(arrays, rays, kind);
            if let Some(resident) = gpu.resident(rays, kind) {
                entries.push(Entry { name: how.to_owned(), runner: Box::new(resident), counts });
            }
            let runner = Box::new(gpu.transferred(arrays, rays, kind));
            entries.push(Entry { name: format!("{how}, with transfers"), runner, counts });
        }
        let mut contenders: Vec<Contender> =
            entries.iter_mut().map(|entry| Box::new(|| entry.runner.run()) as Contender).collect();
        let times = medians(samples, &mut contenders);
        drop(contenders);
        let truth = true_answers(scene, rays, kind)?;
        for (entry, time) in entries.iter().zip(&times) {
            add_row(scene, kind, &truth, entry, [*time, times[0]], report);
        }
    }
    Ok(())
}

fn emulated<'a>(
    name: &str,
    pool: &'a ThreadPool,
    arrays: &'a DeviceArrays,
    rays: &'a [Ray],
    kind: RayKind,
) -> Entry<'a> {
    let runner = Box::new(Traced::new(Emulated::default(), pool, arrays, rays, kind));
    Entry { name: name.to_owned(), runner, counts: counts(arrays, rays, kind) }
}

/// What the rays do in the arrays' ropes.
fn counts(arrays: &DeviceArrays, rays: &[Ray], kind: RayKind) -> Option<Totals> {
    Some(LayoutScene::new(arrays, Layout::Rope, Layout::Rope).trace(rays, kind.is_any_hit()).1)
}

/// The GPU with the paper's arrays, and with the shipped ones; none where there is no GPU, or one too small.
#[cfg(feature = "gpu")]
fn open_gpus(paper: &mut DeviceArrays, scene: &mut BenchScene) -> Vec<gpu::Gpu> {
    let opened = gpu::Gpu::open(paper).and_then(|first| Ok(vec![first, gpu::Gpu::open(scene.compiler.arrays_mut())?]));
    match &opened {
        Ok(gpus) => println!("{}: gpu: {}", scene.name, gpus[0].name()),
        Err(error) => println!("{}: gpu: skipped: {error}", scene.name),
    }
    opened.unwrap_or_default()
}

fn cpu<'a>(pool: &'a ThreadPool, arrays: &'a DeviceArrays, rays: &'a [Ray], kind: RayKind) -> Entry<'a> {
    let threads = pool.current_num_threads();
    let name = if threads == 1 { "cpu, 1 thread".to_owned() } else { format!("cpu, {threads} threads") };
    Entry { name, runner: Box::new(Traced::new(Cpu::default(), pool, arrays, rays, kind)), counts: None }
}

fn add_row(
    scene: &BenchScene,
    kind: RayKind,
    truth: &[f32],
    entry: &Entry<'_>,
    [time, paper_time]: [Duration; 2],
    report: &mut Report,
) {
    let rays = truth.len() as f64;
    let differences = Differences::between(truth, &entry.runner.answers());
    let a_ray = |count: fn(&Totals) -> u64, decimals: usize| {
        entry.counts.as_ref().map_or(String::new(), |totals| format!("{:.decimals$}", count(totals) as f64 / rays))
    };
    report.row([
        scene.name.to_owned(),
        scene.triangle_count().to_string(),
        scene.arrays().byte_count().to_string(),
        kind.name().to_owned(),
        truth.len().to_string(),
        entry.name.clone(),
        format!("{:.2}", rays / time.as_secs_f64() * 1e-6),
        format!("{:.2}", paper_time.as_secs_f64() / time.as_secs_f64()),
        a_ray(|totals| totals.counts.nodes, 2),
        a_ray(|totals| totals.counts.boxes, 2),
        a_ray(|totals| totals.counts.triangles, 2),
        a_ray(|totals| totals.counts.bytes, 0),
        entry.counts.map_or(String::new(), |totals| format!("{:.1}", totals.lockstep_efficiency * 100.0)),
        (differences.distances + differences.verdicts).to_string(),
    ]);
}
