//! What a ray does in each layout of the hierarchies: counts, which no load on the machine changes.
//!
//! Replicas walk the shipped builders' hierarchies (see `ropewalk_bench::layouts`). The top level is in the paper's layout, and
//! where there is more than one instance also in the bottom level's. Hits are checked against the executor `emulated`.

use std::process::ExitCode;

use clap::Parser;
use ropewalk_bench::layouts::{Layout, LayoutScene, paper_arrays};
use ropewalk_bench::rays::{Differences, RayKind, RaySets, true_answers};
use ropewalk_bench::scenes::{BenchScene, ImageSize, SCENES};
use ropewalk_bench::{Options, Report, Result, finish};

const QUICK_NAMES: [&str; 3] = ["sphere", "bunny", "sponza"];
/// With `--quick`, one ray of so many, in runs of a whole lockstep group.
const QUICK_SHARE: usize = 8;
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
        "top level",
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
    let mut rows =
        vec![("paper: rope, 1 triangle a leaf", "rope", LayoutScene::new(&paper, Layout::Rope, Layout::Rope))];
    for layout in Layout::ALL {
        rows.push((layout.name(), "rope", LayoutScene::new(scene.arrays(), Layout::Rope, layout)));
        if scene.arrays().tlas_nodes.len() > 1 && layout != Layout::Rope {
            rows.push((layout.name(), "same", LayoutScene::new(scene.arrays(), layout, layout)));
        }
    }
    for &kind in kinds {
        let groups = sets.of(kind).chunks(GROUP).step_by(if quick { QUICK_SHARE } else { 1 });
        let rays: Vec<_> = groups.flatten().copied().collect();
        let truth = true_answers(scene, &rays, kind)?;
        let a_ray = |count: u64| count as f64 / rays.len() as f64;
        for (layout, top, laid_out) in &rows {
            let (answers, totals) = laid_out.trace(&rays, kind.is_any_hit());
            let differences = Differences::between(&truth, &answers);
            let counts = totals.counts;
            report.row([
                scene.name.to_owned(),
                kind.name().to_owned(),
                (*layout).to_owned(),
                (*top).to_owned(),
                format!("{:.2}", a_ray(counts.nodes)),
                format!("{:.2}", a_ray(counts.boxes)),
                format!("{:.2}", a_ray(counts.triangles)),
                format!("{:.0}", a_ray(counts.bytes)),
                format!("{:.1}", totals.lockstep_efficiency * 100.0),
                counts.stack.to_string(),
                format!("{:.1}", laid_out.node_bytes_a_triangle()),
                (differences.distances + differences.verdicts).to_string(),
            ]);
        }
    }
    Ok(())
}
