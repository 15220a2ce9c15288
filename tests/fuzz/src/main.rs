//! Fuzzes a target for some time, or runs one input: see the library.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use ropewalk_fuzz::{Finding, TARGETS, Target, Until, fuzz, outcome};

const USAGE: &str = "ropewalk-fuzz TARGET [--seconds N] [--seed N] [--input FILE]";

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::from(2)
        }
    }
}

fn run() -> Result<(), String> {
    let (mut target, mut seconds, mut seed, mut input) = (None, 60, 0, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or_else(|| format!("{argument} needs a value"));
        match argument.as_str() {
            "--seconds" => seconds = value()?.parse().map_err(|_| "--seconds needs a number")?,
            "--seed" => seed = value()?.parse().map_err(|_| "--seed needs a number")?,
            "--input" => input = Some(PathBuf::from(value()?)),
            name => target = TARGETS.iter().find(|target| target.name == name),
        }
    }
    let names: Vec<&str> = TARGETS.iter().map(|target| target.name).collect();
    let target = target.ok_or_else(|| format!("usage: {USAGE}; targets: {}", names.join(", ")))?;
    match input {
        Some(path) => {
            let bytes = std::fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?;
            println!("{}", outcome(target, &bytes)?);
            Ok(())
        }
        None => run_for(target, seed, seconds),
    }
}

fn run_for(target: &Target, seed: u64, seconds: u64) -> Result<(), String> {
    match fuzz(target, seed, Until::Elapsed(Duration::from_secs(seconds))) {
        Ok(summary) => {
            let (inputs, outcomes) = (summary.inputs, summary.outcomes.len());
            println!("{}: {inputs} inputs, {outcomes} outcomes, {:?} at most", target.name, summary.slowest);
            Ok(())
        }
        Err(Finding { input, cause }) => {
            let path = PathBuf::from(format!("finding-{}-{seed}", target.name));
            std::fs::write(&path, input).map_err(|error| format!("{}: {error}", path.display()))?;
            Err(format!("{}: {cause}", path.display()))
        }
    }
}
