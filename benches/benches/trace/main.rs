//! The rate of each executor for each kind of ray, and the cost of a ray in nodes, boxes, triangles and bytes.
//!
//! The first row of each block is the paper's own method: ropes in one fixed order, one triangle a leaf, one ray after
//! the other. Counts are the kernel's own; the executor `cpu` traverses by packets, which have no count a ray. With the
//! cargo feature `gpu` the executor `gpu` is measured too, where there is a GPU.

use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use rayon::ThreadPool;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::RayRecord;
use ropewalk::trace::{Cpu, Emulated, Traversal, TraversalCounts};
#[cfg(feature = "gpu")]
use ropewalk_bench::gpu::Gpu;
use ropewalk_bench::kernel_counts::KernelCounts;
use ropewalk_bench::layouts::paper_arrays;
use ropewalk_bench::rays::{Differences, RayKind, RaySets, true_answers};
use ropewalk_bench::runner::{Runner, Traced};
use ropewalk_bench::scenes::{BenchScene, ImageSize, SCENES};
use ropewalk_bench::{Contender, Options, Report, Result, finish, medians, thread_pool};

/// The traversals of the kernel, and whether the arrays are the paper's or the shipped ones.
const TRAVERSALS: [(&str, Traversal, bool); 3] = [
    ("paper: rope of 1 triangle a leaf", Traversal::Rope, true),
    ("rope", Traversal::Rope, false),
    ("wide", Traversal::Wide, false),
];
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
    /// How many pixels primary rays go through.
    #[arg(long, value_name = "SIZE", default_value = "800x600")]
    size: ImageSize,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    finish(measure_all(&arguments), &arguments.options)
}

fn measure_all(arguments: &Arguments) -> Result<Report> {
    let columns = [
        "scene",
        "triangles",
        "bytes",
        "size",
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
    let pools = [thread_pool(1)?, thread_pool(threads)?];
    for recipe in &SCENES {
        let is_named = arguments.scene.iter().any(|name| name == recipe.name);
        let is_default = !arguments.options.quick || QUICK_NAMES.contains(&recipe.name);
        if is_named || arguments.scene.is_empty() && is_default {
            measure_scene(&mut recipe.load(arguments.size)?, arguments, &pools, &mut report)?;
        }
    }
    Ok(report)
}

/// An executor over some arrays, with what its rays read, where the kernel counts it.
struct Entry<'a> {
    name: String,
    runner: Box<dyn Runner + 'a>,
    work: Option<KernelCounts>,
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
    let gpus = open_gpus(&arguments.options, &mut paper, scene);
    let scene = &*scene;
    for &kind in kinds {
        let rays = sets.of(kind);
        let mut entries = Vec::new();
        for (how, traversal, is_paper) in TRAVERSALS {
            let arrays = if is_paper { &paper } else { scene.arrays() };
            let runner = Traced::new(Emulated::default().with_traversal(traversal), &pools[0], arrays, rays, kind);
            let work = Some(KernelCounts::of(arrays, rays, kind, traversal));
            entries.push(Entry { name: format!("emulated, {how}"), runner: Box::new(runner), work });
        }
        entries.extend(pools.iter().map(|pool| cpu(pool, scene.arrays(), rays, kind)));
        #[cfg(feature = "gpu")]
        for ((how, traversal, is_paper), gpu) in TRAVERSALS.into_iter().zip(&gpus) {
            let arrays = if is_paper { &paper } else { scene.arrays() };
            let work = Some(KernelCounts::of(arrays, rays, kind, traversal));
            if let Some(resident) = gpu.resident(rays, kind) {
                entries.push(Entry { name: format!("{}, {how}", gpu.label()), runner: Box::new(resident), work });
            }
            let runner = Box::new(gpu.transferred(arrays, rays, kind));
            entries.push(Entry { name: format!("{}, {how}, with transfers", gpu.label()), runner, work });
        }
        let mut contenders: Vec<Contender> =
            entries.iter_mut().map(|entry| Box::new(|| entry.runner.run()) as Contender).collect();
        let times = medians(samples, &mut contenders);
        drop(contenders);
        let truth = true_answers(scene, rays, kind)?;
        for (entry, time) in entries.iter().zip(&times) {
            add_row(scene, arguments.size, kind, &truth, entry, [*time, times[0]], report);
        }
    }
    Ok(())
}

/// The GPU with each of the traversals; none where there is no GPU, or one too small.
#[cfg(feature = "gpu")]
fn open_gpus(options: &Options, paper: &mut DeviceArrays, scene: &mut BenchScene) -> Vec<Gpu> {
    let opened = TRAVERSALS.map(|(_, traversal, is_paper)| {
        Gpu::new(options, if is_paper { &mut *paper } else { scene.compiler.arrays_mut() }, traversal)
    });
    let opened: Result<Vec<Gpu>> = opened.into_iter().collect();
    match &opened {
        Ok(gpus) => println!("{}: {}: {}", scene.name, gpus[0].label(), gpus[0].name()),
        Err(error) => println!("{}: gpu: skipped: {error}", scene.name),
    }
    opened.unwrap_or_default()
}

fn cpu<'a>(pool: &'a ThreadPool, arrays: &'a DeviceArrays, rays: &'a [RayRecord], kind: RayKind) -> Entry<'a> {
    let threads = pool.current_num_threads();
    let name = if threads == 1 { "cpu, 1 thread".to_owned() } else { format!("cpu, {threads} threads") };
    Entry { name, runner: Box::new(Traced::new(Cpu::default(), pool, arrays, rays, kind)), work: None }
}

fn add_row(
    scene: &BenchScene,
    size: ImageSize,
    kind: RayKind,
    truth: &[f32],
    entry: &Entry<'_>,
    [time, paper_time]: [Duration; 2],
    report: &mut Report,
) {
    let rays = truth.len() as f64;
    let differences = Differences::between(truth, &entry.runner.answers());
    let a_ray = |count: fn(&TraversalCounts) -> u64, decimals: usize| {
        entry.work.map_or(String::new(), |work| format!("{:.decimals$}", count(&work.counts) as f64 / rays))
    };
    report.row([
        scene.name.to_owned(),
        scene.triangle_count().to_string(),
        scene.arrays().byte_count().to_string(),
        size.name().to_owned(),
        kind.name().to_owned(),
        truth.len().to_string(),
        entry.name.clone(),
        format!("{:.2}", rays / time.as_secs_f64() * 1e-6),
        format!("{:.2}", paper_time.as_secs_f64() / time.as_secs_f64()),
        a_ray(|counts| counts.nodes, 2),
        a_ray(|counts| counts.boxes, 2),
        a_ray(|counts| counts.triangles, 2),
        a_ray(|counts| counts.bytes, 0),
        entry.work.map_or(String::new(), |work| format!("{:.1}", work.lockstep_efficiency * 100.0)),
        (differences.distances + differences.verdicts).to_string(),
    ]);
}
