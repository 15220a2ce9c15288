//! Where methods fail: exact hits, decided by exact arithmetic, against those of Ropewalk in all its forms and of its
//! peers.
//!
//! A row is a case: triangles and rays, named after the test of Embree (`embree:`) or of Vulkan's conformance suite
//! (`vulkan:`) that it mirrors, where there is one. A column is a tracer. What counts as a false miss, a false hit and
//! a wrong triangle is defined in `ropewalk_bench::exact`. The goal of each row that must be zero is that none of our
//! columns has any of the three. `docs/STABILITY.md` explains the table.

mod agreement;
mod chains;
mod instances;
mod limits;
mod markdown;
mod numbers;
mod refits;
mod row;
mod rules;
mod starts;
mod tally;
mod tracers;
mod triangles;
mod watertight;
mod world;

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use ropewalk_bench::{Options, Report, Result, Target, finish};

use row::{Goal, Recipe};
use tally::Tally;
use tracers::Tracers;

/// Rays a row with `--quick`. A row may trace fewer than it is asked to, and the table says how many.
const QUICK_RAYS: usize = 10_000;

#[derive(Debug, Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
    /// How many rays a row: the faults that are rarer are not seen. A million take about 15 s a row on two cores.
    #[arg(long, value_name = "COUNT", default_value_t = 1_000_000)]
    rays: usize,
    /// Only the rows whose names contain this.
    #[arg(long, value_name = "TEXT")]
    row: Vec<String>,
    /// Write the tables to this file, as they are in docs/STABILITY.md.
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Write the first faulty ray of each of our columns in each row to this file, to be traced again.
    #[arg(long, value_name = "FILE")]
    faults: Option<PathBuf>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    finish(measure_all(&arguments), &arguments.options)
}

fn recipes() -> impl Iterator<Item = &'static Recipe> {
    let groups: [&[Recipe]; 9] = [
        &watertight::ROWS,
        &triangles::ROWS,
        &starts::ROWS,
        &numbers::ROWS,
        &agreement::ROWS,
        &instances::ROWS,
        &chains::ROWS,
        &refits::ROWS,
        &rules::ROWS,
    ];
    groups.into_iter().flatten()
}

fn measure_all(arguments: &Arguments) -> Result<Report> {
    let rays = if arguments.options.quick { QUICK_RAYS } else { arguments.rays };
    let is_wanted = |recipe: &&Recipe| {
        arguments.row.is_empty() || arguments.row.iter().any(|text| recipe.name.contains(text.as_str()))
    };
    let mut report = Report::new(&tally::COLUMNS);
    let tracers = Tracers::open(&arguments.options);
    tracers.missing().into_iter().for_each(|note| report.note(note));
    let (mut rows, mut faults) = (Vec::new(), String::new());
    for recipe in recipes().filter(is_wanted) {
        let start = Instant::now();
        let row = (recipe.make)(rays)?;
        let cells = tracers.measure(&row)?;
        cells.iter().filter(|cell| cell.is_ours()).for_each(|cell| faults += &cell.first_fault(recipe.name));
        let sum = |count: fn(&Tally) -> u64| cells.iter().filter(|cell| cell.is_ours()).map(|c| count(&c.tally)).sum();
        let faults: Option<u64> = match recipe.goal {
            Goal::Zero => Some(sum(Tally::faults)),
            Goal::NoLeaks => Some(sum(|tally| tally.false_misses + tally.false_hits)),
            Goal::Open => None,
        };
        if let Some(faults) = faults {
            report.goal(recipe.name.replace([' ', ','], "_"), faults as f64, Target::AtMost(0.0), "faults");
        }
        cells.iter().for_each(|cell| report.row(cell.line(recipe.name, row.rays())));
        eprintln!("{}, {:.1} s", recipe.name, start.elapsed().as_secs_f64());
        rows.push((recipe.name, row.rays(), recipe.goal, cells));
    }
    let limits = limits::all()?;
    if let Some(path) = &arguments.markdown {
        std::fs::write(path, markdown::tables(&rows, &limits))?;
    }
    if let Some(path) = &arguments.faults {
        std::fs::write(path, faults)?;
    }
    limits.iter().for_each(|limit| report.note(limit.to_string()));
    Ok(report)
}
