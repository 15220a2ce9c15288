//! Speed against accuracy: a chart for each choice that Ropewalk makes between the two, with what else could have been
//! chosen, and its peers.
//!
//! Each chart is written as SVG and CSV; `docs/ACCURACY.md` shows them and says which default follows from each. Goals
//! are about accuracy, and so do not depend on the clock.

mod builders;
#[path = "../../../examples/render/builtin/mod.rs"]
mod builtin;
mod chart;
mod deform;
mod hits;
mod image;
mod labels;
mod t_error;
mod tracers;
mod verdicts;
mod worlds;

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use ropewalk_bench::{Options, Report, Result, finish};

use chart::Chart;

#[derive(Debug, Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
    /// Only the charts of these names.
    #[arg(long, value_name = "NAME")]
    chart: Vec<String>,
    /// The folder for the charts.
    #[arg(long, value_name = "FOLDER", default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/charts"))]
    out: PathBuf,
}

/// What a chart needs to know while it is measured.
struct Run {
    is_quick: bool,
    start: Instant,
}

impl Run {
    /// Says on standard error what has been done.
    fn progress(&self, done: &str) {
        eprintln!("{:6.1} s: {done}", self.start.elapsed().as_secs_f64());
    }
}

type Measure = fn(&Run, &mut Report) -> Result<Chart>;

const CHARTS: [(&str, Measure); 6] = [
    ("hits", hits::measure),
    ("t-error", t_error::measure),
    ("deform", deform::measure),
    ("builders", builders::measure),
    ("worlds", worlds::measure),
    ("image", image::measure),
];

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    finish(measure_all(&arguments), &arguments.options)
}

fn measure_all(arguments: &Arguments) -> Result<Report> {
    if let Some(unknown) = arguments.chart.iter().find(|name| CHARTS.iter().all(|(chart, _)| chart != name)) {
        let names: Vec<&str> = CHARTS.iter().map(|(name, _)| *name).collect();
        return Err(format!("there is no chart {unknown}, but {}", names.join(", ")).into());
    }
    std::fs::create_dir_all(&arguments.out)?;
    let run = Run { is_quick: arguments.options.quick, start: Instant::now() };
    let mut report = Report::new(&chart::COLUMNS);
    for (name, measure) in CHARTS {
        if !arguments.chart.is_empty() && !arguments.chart.iter().any(|wanted| wanted == name) {
            continue;
        }
        let chart = measure(&run, &mut report)?;
        chart.draw(&arguments.out.join(name).with_extension("svg"))?;
        std::fs::write(arguments.out.join(name).with_extension("csv"), chart.csv())?;
        chart.rows().into_iter().for_each(|row| report.row(row));
        run.progress(name);
    }
    Ok(report)
}
