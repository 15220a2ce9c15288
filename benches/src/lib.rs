//! What the benchmarks share: options, measurement in turns, tables, goals.
//!
//! A figure is a median of several samples, and what counts is the ratio of two figures of one run: everything that is
//! compared runs in turns, so that whatever else the machine does hits all of them alike.

pub mod aim;
pub mod bvh_shape;
pub mod columns;
pub mod embree;
pub mod exact;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod kernel_counts;
pub mod layouts;
pub mod meshes;
pub mod peers;
pub mod rays;
pub mod runner;
pub mod scenes;
pub mod shapes;

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Parser;
use comfy_table::Table;
use comfy_table::presets::ASCII_MARKDOWN;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde_json::{Value, json};

/// What went wrong, in words.
pub type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// The options that every benchmark takes.
#[derive(Clone, Debug, Parser)]
pub struct Options {
    /// Smaller sizes and fewer samples: under a minute.
    #[arg(long)]
    pub quick: bool,
    /// Write the table to this file, comma-separated.
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Write everything to this file as JSON, with the machine and, with the cargo feature `gpu`, the adapter.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Exit with an error if a goal is missed.
    #[arg(long)]
    pub strict: bool,
    /// Where there is no GPU, measure a software renderer instead, labelled as such: to try a benchmark, not for
    /// figures to quote.
    #[cfg(feature = "gpu")]
    #[arg(long)]
    pub software: bool,
    /// Given by `cargo bench`, without meaning here.
    #[arg(long, hide = true)]
    bench: bool,
}

/// Ends a benchmark: prints its report, or on standard error why there is none.
pub fn finish(measured: Result<Report>, options: &Options) -> ExitCode {
    match measured {
        Ok(report) => report.finish(options),
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// That many threads for an executor.
pub fn thread_pool(threads: usize) -> Result<ThreadPool> {
    Ok(ThreadPoolBuilder::new().num_threads(threads).build()?)
}

/// A function to measure: it prepares its input, and returns how long the rest took.
pub type Contender<'a> = Box<dyn FnMut() -> Duration + 'a>;

/// Runs the contenders in turns, `samples` times each after one that does not count, and returns their medians.
pub fn medians(samples: usize, contenders: &mut [Contender<'_>]) -> Vec<Duration> {
    let mut times = vec![Vec::with_capacity(samples); contenders.len()];
    for sample in 0..=samples {
        for (contender, times) in contenders.iter_mut().zip(&mut times) {
            let time = contender();
            if sample > 0 {
                times.push(time);
            }
        }
    }
    times.into_iter().map(median).collect()
}

/// The middle one of several durations; 0 of none.
pub fn median(mut times: Vec<Duration>) -> Duration {
    times.sort_unstable();
    times.get(times.len() / 2).copied().unwrap_or_default()
}

/// How long a function takes. Its result is dropped after the clock has stopped.
pub fn time<T>(function: impl FnOnce() -> T) -> Duration {
    let start = Instant::now();
    let result = std::hint::black_box(function());
    let elapsed = start.elapsed();
    drop(result);
    elapsed
}

/// A duration in milliseconds, with three significant digits.
pub fn milliseconds(time: Duration) -> String {
    let value = time.as_secs_f64() * 1e3;
    let decimals = (2.0 - value.max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{value:.decimals$}")
}

/// How a measured figure is to compare with its target.
#[derive(Clone, Copy, Debug)]
pub enum Target {
    /// At least this.
    AtLeast(f64),
    /// At most this.
    AtMost(f64),
}

/// The result of a benchmark: a table, and goals that were reached or missed.
pub struct Report {
    header: Vec<&'static str>,
    rows: Vec<Vec<String>>,
    notes: Vec<String>,
    goals: Vec<Goal>,
}

struct Goal {
    name: String,
    measured: f64,
    target: Target,
    unit: &'static str,
}

impl Goal {
    fn is_reached(&self) -> bool {
        match self.target {
            Target::AtLeast(target) => self.measured >= target,
            Target::AtMost(target) => self.measured <= target,
        }
    }

    /// Between the figure and its target, and the target.
    fn sign(&self) -> (&'static str, f64) {
        match self.target {
            Target::AtLeast(target) => (">=", target),
            Target::AtMost(target) => ("<=", target),
        }
    }
}

impl Report {
    /// An empty table with these columns.
    pub fn new(header: &[&'static str]) -> Self {
        Self { header: header.to_vec(), rows: Vec::new(), notes: Vec::new(), goals: Vec::new() }
    }

    /// Adds a row.
    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }

    /// Adds a goal: `measured` in `unit` against its target.
    pub fn goal(&mut self, name: impl Into<String>, measured: f64, target: Target, unit: &'static str) {
        self.goals.push(Goal { name: name.into(), measured, target, unit });
    }

    /// Adds a finding in words, for below the table.
    pub fn note(&mut self, finding: impl Into<String>) {
        self.notes.push(finding.into());
    }

    /// Prints everything, writes the files asked for, and returns the exit code of the program.
    pub fn finish(&self, options: &Options) -> ExitCode {
        println!("{}\n", machine());
        let mut table = Table::new();
        table.load_style(ASCII_MARKDOWN);
        table.set_header(&self.header).add_rows(&self.rows);
        println!("{table}\n");
        for (path, text) in [(&options.csv, Self::csv as fn(&Self) -> String), (&options.json, Self::json)] {
            if let Some(path) = path
                && let Err(error) = std::fs::write(path, text(self))
            {
                eprintln!("{}: {error}", path.display());
                return ExitCode::FAILURE;
            }
        }
        for note in &self.notes {
            println!("{note}");
        }
        for goal in &self.goals {
            let (Goal { name, measured, unit, .. }, (sign, target)) = (goal, goal.sign());
            let verdict = if goal.is_reached() { "PASS" } else { "FAIL" };
            println!("GOAL {name} {measured:.3} {sign} {target} {unit} {verdict}");
        }
        let all_reached = self.goals.iter().all(Goal::is_reached);
        if options.strict && !all_reached { ExitCode::FAILURE } else { ExitCode::SUCCESS }
    }

    fn csv(&self) -> String {
        let quoted = |cell: &String| if cell.contains(',') { format!("\"{cell}\"") } else { cell.clone() };
        let line = |row: &Vec<String>| row.iter().map(quoted).collect::<Vec<_>>().join(",");
        self.rows.iter().fold(self.header.join(",") + "\n", |csv, row| csv + &line(row) + "\n")
    }

    fn json(&self) -> String {
        let goals = self.goals.iter().map(|goal| {
            let (sign, target) = goal.sign();
            let Goal { name, measured, unit, .. } = goal;
            json!({ "name": name, "measured": measured, "sign": sign, "target": target, "unit": unit, "reached": goal.is_reached() })
        });
        let goals: Vec<Value> = goals.collect();
        let (columns, rows, notes) = (&self.header, &self.rows, &self.notes);
        let all = json!({ "machine": machine(), "adapter": adapter(), "columns": columns, "rows": rows, "notes": notes, "goals": goals });
        format!("{all:#}\n")
    }
}

/// The adapter that the executor `gpu` would run on, or a software one in its place; null without the cargo feature.
fn adapter() -> Value {
    #[cfg(feature = "gpu")]
    return gpu::adapter();
    #[cfg(not(feature = "gpu"))]
    Value::Null
}

/// The processor, as the system names it, and how many threads there are.
fn machine() -> String {
    let cpu_info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpu_info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    format!("{}, {threads} threads, {}", model.map_or(std::env::consts::ARCH, |(_, name)| name), std::env::consts::OS)
}
