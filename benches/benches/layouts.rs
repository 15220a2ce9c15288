//! What a ray reads and tests in each node layout. These are counts, so other load on the machine does not change them.
//!
//! What the shipped traversals read is counted by the executor `emulated`. Hypothetical layouts
//! (`ropewalk_bench::layouts`) hold the hierarchies of the shipped builders, in both levels; their hits are checked
//! against those of `emulated` (`other hits`).

use std::process::ExitCode;

use clap::Parser;
use ropewalk::trace::Traversal;
use ropewalk_bench::kernel_counts::KernelCounts;
use ropewalk_bench::layouts::{Layout, LayoutScene, Totals, paper_arrays};
use ropewalk_bench::rays::{Differences, RayKind, RaySets, true_answers};
use ropewalk_bench::scenes::{BenchScene, ImageSize, SCENES};
use ropewalk_bench::{Options, Report, Result, finish};

/// What the kernel traverses: the arrays as the paper builds them or as shipped.
const SHIPPED: [(&str, Traversal, bool); 3] = [
    ("paper: rope, 1 triangle a leaf", Traversal::Rope, true),
    ("rope", Traversal::Rope, false),
    ("wide", Traversal::Wide, false),
];

const QUICK_NAMES: [&str; 3] = ["sphere", "bunny", "sponza"];
/// With `--quick`, one of this many groups of rays is traced.
const QUICK_SHARE: usize = 8;
/// Rays that step together.
const GROUP: usize = 32;

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
    finish(count_all(&arguments), &arguments.options)
}

fn count_all(arguments: &Arguments) -> Result<Report> {
    let quick = arguments.options.quick;
    let kinds = if arguments.rays.is_empty() { &RayKind::ALL[..] } else { &arguments.rays };
    let columns = [
        "scene",
        "rays",
        "layout",
        "nodes a ray",
        "boxes a ray",
        "triangles a ray",
        "bytes a ray",
        "lockstep %",
        "deepest stack",
        "node bytes a triangle",
        "other hits",
    ];
    let mut report = Report::new(&columns);
    for recipe in &SCENES {
        let is_named = arguments.scene.iter().any(|name| name == recipe.name);
        if is_named || arguments.scene.is_empty() && (!quick || QUICK_NAMES.contains(&recipe.name)) {
            count(&recipe.load(ImageSize::Paper)?, kinds, quick, &mut report)?;
        }
    }
    Ok(report)
}

fn count(scene: &BenchScene, kinds: &[RayKind], quick: bool, report: &mut Report) -> Result<()> {
    let sets = RaySets::new(scene)?;
    let paper = paper_arrays(scene.arrays())?;
    let hypothetical = Layout::ALL.map(|layout| (layout, LayoutScene::new(scene.arrays(), layout)));
    for &kind in kinds {
        let groups = sets.of(kind).chunks(GROUP).step_by(if quick { QUICK_SHARE } else { 1 });
        let rays: Vec<_> = groups.flatten().copied().collect();
        let mut row = |layout: &str, a_ray: [u64; 4], lockstep: f64, rest: [String; 3]| {
            let [nodes, boxes, triangles, bytes] = a_ray.map(|count| count as f64 / rays.len() as f64);
            let [stack, node_bytes, other_hits] = rest;
            report.row([
                scene.name.to_owned(),
                kind.name().to_owned(),
                layout.to_owned(),
                format!("{nodes:.2}"),
                format!("{boxes:.2}"),
                format!("{triangles:.2}"),
                format!("{bytes:.0}"),
                format!("{:.1}", lockstep * 100.0),
                stack,
                node_bytes,
                other_hits,
            ]);
        };
        for (name, traversal, is_paper) in SHIPPED {
            let arrays = if is_paper { &paper } else { scene.arrays() };
            let KernelCounts { counts, lockstep_efficiency } = KernelCounts::of(arrays, &rays, kind, traversal);
            let node_bytes = match traversal {
                Traversal::Rope => size_of_val(&*arrays.blas_nodes),
                Traversal::Wide => size_of_val(&*arrays.wide_nodes),
            } as f64
                / arrays.triangles.len() as f64;
            let a_ray = [counts.nodes, counts.boxes, counts.triangles, counts.bytes];
            row(name, a_ray, lockstep_efficiency, ["-".to_owned(), format!("{node_bytes:.1}"), "-".to_owned()]);
        }
        let truth = true_answers(scene, &rays, kind)?;
        for (layout, laid_out) in &hypothetical {
            let (answers, Totals { counts, lockstep_efficiency }) = laid_out.trace(&rays, kind.is_any_hit());
            let Differences { distances, verdicts } = Differences::between(&truth, &answers);
            let a_ray = [counts.nodes, counts.boxes, counts.triangles, counts.bytes];
            let node_bytes = format!("{:.1}", laid_out.node_bytes_a_triangle());
            let rest = [counts.stack.to_string(), node_bytes, (distances + verdicts).to_string()];
            row(layout.name(), a_ray, lockstep_efficiency, rest);
        }
    }
    Ok(())
}
