//! Fuzz targets: what Ropewalk reads from elsewhere, fed with bytes that nobody wrote.
//!
//! A [`Target`] is a function of bytes that panics if something is wrong, whatever the bytes are. What it returns is
//! the *outcome*, in words: an input with a new outcome is kept and mutated further, which stands in for the coverage
//! that only instrumented builds can measure. [`fuzz`] runs on stable Rust: for a fixed number of inputs as an ordinary
//! test, and for as long as you like by
//!
//! ```sh
//! cargo run --release -p ropewalk-fuzz -- import --seconds 600 --seed 7
//! ```
//!
//! A finding is made small and written to a file, and `--input FILE` runs it again. Put it, made in code, into the
//! tests of the folder in question (`tests/gltf/hostile.rs`, `tests/graph/transfer/`).

mod mutate;
mod seeds;
pub mod targets;

use std::collections::HashSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use mutate::mutate;
pub use targets::TARGETS;

/// Something that is fuzzed.
pub struct Target {
    /// Its name on the command line.
    pub name: &'static str,
    /// Inputs to begin with.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Runs one input; returns the outcome, and panics if something is wrong.
    pub run: fn(&[u8]) -> String,
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub enum Until {
    /// After so many inputs.
    Inputs(u64),
    /// After a time.
    Elapsed(Duration),
}

/// What a run without findings has done.
#[derive(Debug, Default)]
pub struct Summary {
    /// The number of inputs.
    pub inputs: u64,
    /// The outcomes, each once.
    pub outcomes: HashSet<String>,
    /// The longest time that one input took.
    pub slowest: Duration,
}

/// An input that the target does not withstand.
#[derive(Debug)]
pub struct Finding {
    /// The input, made as small as it could be.
    pub input: Vec<u8>,
    /// The message of the panic, or how long it took.
    pub cause: String,
}

/// An input that takes longer than this is a finding.
const MAX_TIME: Duration = Duration::from_secs(10);
/// The most inputs that are kept to be mutated.
const MAX_POOL: usize = 2000;

/// Runs mutations of a target's seeds. The same `seed` gives the same inputs.
///
/// # Errors
/// The first finding.
pub fn fuzz(target: &Target, seed: u64, until: Until) -> Result<Summary, Finding> {
    let mut random = fastrand::Rng::with_seed(seed);
    let mut pool = (target.seeds)();
    let mut summary = Summary::default();
    // The seeds themselves come first.
    for input in &pool {
        run_one(target, input, &mut summary)?;
    }
    let start = Instant::now();
    loop {
        match until {
            Until::Inputs(count) if summary.inputs >= count => return Ok(summary),
            Until::Elapsed(time) if start.elapsed() >= time => return Ok(summary),
            _ => {}
        }
        let input = mutate(&pool, &mut random);
        if run_one(target, &input, &mut summary)? && pool.len() < MAX_POOL {
            pool.push(input);
        }
    }
}

/// Runs one input; returns whether its outcome is new.
fn run_one(target: &Target, input: &[u8], summary: &mut Summary) -> Result<bool, Finding> {
    let start = Instant::now();
    let outcome = outcome(target, input).map_err(|cause| Finding { input: shrink(target, input), cause })?;
    let time = start.elapsed();
    if time > MAX_TIME {
        return Err(Finding { input: input.to_owned(), cause: format!("it takes {time:?}") });
    }
    summary.inputs += 1;
    summary.slowest = summary.slowest.max(time);
    Ok(summary.outcomes.insert(outcome))
}

/// The outcome, or the message of the panic.
pub fn outcome(target: &Target, input: &[u8]) -> Result<String, String> {
    catch_unwind(AssertUnwindSafe(|| (target.run)(input))).map_err(|panic| {
        let text = panic.downcast_ref::<String>().cloned();
        text.or_else(|| panic.downcast_ref::<&str>().map(|&text| text.to_owned())).unwrap_or_default()
    })
}

/// Cuts parts out of an input, ever smaller ones, as long as it still panics.
fn shrink(target: &Target, input: &[u8]) -> Vec<u8> {
    let mut input = input.to_owned();
    let mut part = input.len() / 2;
    while part > 0 {
        let mut start = 0;
        while start + part <= input.len() {
            let shorter = [&input[..start], &input[start + part..]].concat();
            if outcome(target, &shorter).is_err() {
                input = shorter;
            } else {
                start += part;
            }
        }
        part /= 2;
    }
    input
}
