//! The same rays traced by Ropewalk's executor `cpu` and by its peers, one thread each.
//!
//! All are built over the same triangles: where a scene has instances, peers get them flattened into one level, which
//! spares them the second. Every material is opaque and has two sides. Rays are laid out for each as it takes them
//! before the clock starts.

mod crates;
mod embree;
#[cfg(feature = "embree3")]
mod embree3;
mod peer;

use std::process::ExitCode;

use clap::Parser;
use glam::Vec3;
use rayon::ThreadPool;
use ropewalk::device::layout::RayRecord;
use ropewalk::trace::Cpu;
use ropewalk_bench::embree::Embree;
use ropewalk_bench::peers::{Bvh, Parry};
use ropewalk_bench::rays::{Differences, RayKind, RaySets};
use ropewalk_bench::runner::Traced;
use ropewalk_bench::scenes::{BenchScene, ImageSize, Recipe, SCENES};
use ropewalk_bench::{Contender, Options, Report, Result, Target, finish, medians, thread_pool};

use crates::ObvhsPresets;
use embree::Embree4;
use peer::{Entry, Peer, Role};

/// The scenes of this benchmark: those that fit into memory without instances.
const NAMES: [&str; 5] = ["bunny", "dragon-res2", "dragon", "sponza", "kitchen"];
const QUICK_NAMES: [&str; 1] = ["bunny"];
/// The scenes that the goals are about.
const GOAL_NAMES: [&str; 2] = ["bunny", "dragon"];
/// The goal for several threads: this share of one thread's rate times their number, so 3.6 times that rate with 4
/// threads.
const SCALING: f64 = 0.9;
const MAX_THREADS: usize = 4;

#[derive(Debug, Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
    /// Only these scenes.
    #[arg(long, value_name = "NAME", value_parser = NAMES)]
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
    let names = if arguments.options.quick { &QUICK_NAMES[..] } else { &NAMES };
    let is_wanted = |recipe: &&Recipe| {
        if arguments.scene.is_empty() {
            names.contains(&recipe.name)
        } else {
            arguments.scene.iter().any(|name| name == recipe.name)
        }
    };
    let kinds = if arguments.rays.is_empty() { &RayKind::ALL[..] } else { &arguments.rays };
    let columns = [
        "scene",
        "triangles",
        "size",
        "rays",
        "count",
        "who",
        "Mrays/s",
        "ours / theirs",
        "hits",
        "other t",
        "other verdict",
    ];
    let mut report = Report::new(&columns);
    let embree = Embree::open(0)?;
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(MAX_THREADS);
    let pools = [thread_pool(1)?, thread_pool(threads)?];
    for recipe in SCENES.iter().filter(is_wanted) {
        let scene = recipe.load(arguments.size)?;
        let triangles = scene.triangles();
        let peers = build_peers(&embree, &triangles)?;
        let sets = RaySets::new(&scene)?;
        let mut scaling = [0.0; 2];
        for &kind in kinds {
            let rays = sets.of(kind);
            let mut entries = Vec::from(ours(&scene, rays, kind, &pools));
            entries.extend(peers.iter().flat_map(|peer| peer.entries(rays, kind)));
            let times = measure(&scene, &triangles, kind, entries, arguments, &mut report);
            scaling[0] += times[0];
            scaling[1] += times[1];
        }
        if GOAL_NAMES.contains(&scene.name) {
            let goal = Target::AtLeast(SCALING * threads as f64);
            report.goal(format!("threads_{threads}_{}", scene.name), scaling[0] / scaling[1], goal, "x");
        }
    }
    Ok(report)
}

fn build_peers<'a>(embree: &'a Embree, triangles: &[[Vec3; 3]]) -> Result<Vec<Box<dyn Peer + 'a>>> {
    Ok(vec![
        Box::new(Embree4::build(embree, triangles)?),
        #[cfg(feature = "embree3")]
        Box::new(embree3::Embree3::build(triangles)?),
        Box::new(ObvhsPresets::build(triangles)),
        Box::new(Bvh::build(triangles)),
        Box::new(Parry::build(triangles)?),
    ])
}

fn ours<'a>(scene: &'a BenchScene, rays: &'a [RayRecord], kind: RayKind, pools: &'a [ThreadPool; 2]) -> [Entry<'a>; 2] {
    [(Role::Ours, &pools[0]), (Role::Other, &pools[1])].map(|(role, pool)| {
        let threads = pool.current_num_threads();
        let name = if threads == 1 { "ropewalk".to_owned() } else { format!("ropewalk, {threads} threads") };
        Entry { name, role, runner: Box::new(Traced::new(Cpu::default(), pool, scene.arrays(), rays, kind)) }
    })
}

/// Adds a row for each executor and peer, ours first, and the goals. Returns all times in seconds.
fn measure(
    scene: &BenchScene,
    triangles: &[[Vec3; 3]],
    kind: RayKind,
    mut entries: Vec<Entry<'_>>,
    arguments: &Arguments,
    report: &mut Report,
) -> Vec<f64> {
    let samples = if arguments.options.quick { 5 } else { 9 };
    let mut contenders: Vec<Contender> =
        entries.iter_mut().map(|entry| Box::new(|| entry.runner.run()) as Contender).collect();
    let times = medians(samples, &mut contenders);
    drop(contenders);
    let times: Vec<f64> = times.iter().map(std::time::Duration::as_secs_f64).collect();

    let truth = entries[0].runner.answers();
    for (entry, time) in entries.iter().zip(&times) {
        let answers = entry.runner.answers();
        let differences = Differences::between(&truth, &answers);
        report.row([
            scene.name.to_owned(),
            triangles.len().to_string(),
            arguments.size.name().to_owned(),
            kind.name().to_owned(),
            truth.len().to_string(),
            entry.name.clone(),
            format!("{:.2}", truth.len() as f64 / time * 1e-6),
            format!("{:.2}", time / times[0]),
            answers.iter().filter(|t| t.is_finite()).count().to_string(),
            differences.distances.to_string(),
            differences.verdicts.to_string(),
        ]);
    }

    if GOAL_NAMES.contains(&scene.name) {
        let (target, rivals) = rivals(kind);
        for (who, roles) in rivals {
            let theirs = entries.iter().zip(&times).filter(|(entry, _)| roles.contains(&entry.role));
            let best = theirs.map(|(_, &time)| time).fold(f64::INFINITY, f64::min);
            let name = format!("{}_{}_against_{who}", kind.name(), scene.name);
            report.goal(name, best / times[0], Target::AtLeast(target), "x");
        }
    }
    times
}

/// Goals: our rate in units of that of the fastest peer of each group. Embree's packets of 16 have two goals: with its
/// defaults, and with its flag for coherent rays.
fn rivals(kind: RayKind) -> (f64, &'static [(&'static str, &'static [Role])]) {
    const COHERENT: (&str, &[Role]) = ("embree_16_coherent", &[Role::Embree16Coherent]);
    match kind {
        RayKind::Primary => (2.0, &[("embree_16", &[Role::Embree16]), COHERENT]),
        RayKind::Shadow | RayKind::Mirror => (1.5, &[("embree_1_and_16", &[Role::Embree1, Role::Embree16]), COHERENT]),
        RayKind::Diffuse => (1.0, &[("embree_1", &[Role::Embree1])]),
    }
}
