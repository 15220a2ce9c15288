//! Renders a glTF file, or a scene made in code, to an image.
//!
//! `cargo run --release --example render` writes `out.png`; `-- --help` lists what can be said after it. Uses a GPU where there is
//! one. What goes wrong is told in one line on standard error, with exit code 2, and leaves no file behind.

mod arguments;
mod builtin;
mod progress;
mod report;
mod stage;
mod subject;

use std::io::Write as _;
use std::process::ExitCode;
use std::time::Instant;

use ropewalk::{Renderer, RendererOptions};

use arguments::Arguments;
use progress::Progress;
use report::{FrameEntry, Report};
use subject::Subject;

fn main() -> ExitCode {
    let arguments = match Arguments::from_command_line() {
        Ok(Some(arguments)) => arguments,
        Ok(None) => return ExitCode::SUCCESS,
        Err(message) => return fail(&message),
    };
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => fail(&message),
    }
}

/// An error is one line, whatever a driver or a file name puts into it.
fn fail(message: &str) -> ExitCode {
    eprintln!("error: {}", one_line(message));
    ExitCode::from(2)
}

fn one_line(text: &str) -> String {
    text.lines().map(str::trim).collect::<Vec<_>>().join(" ")
}

fn run(arguments: &Arguments) -> Result<(), String> {
    let start = Instant::now();
    let mut subject = {
        let _progress = Progress::spinner("loading");
        Subject::load(arguments)?
    };
    let load_time = start.elapsed();

    let options = RendererOptions::default().with_device(arguments.device.into());
    let mut renderer = Renderer::new(&options).map_err(|error| error.to_string())?;
    if let Some(reason) = renderer.fallback_reason() {
        eprintln!("rendering on the CPU: {}", one_line(reason));
    }

    let mut report = Report {
        file: arguments.file.clone(),
        import: subject.import.as_ref().map(|import| import.counts),
        not_honoured: subject.import.as_ref().map(|import| import.warnings.clone()).unwrap_or_default(),
        fallback: renderer.fallback_reason().map(str::to_owned),
        load_time,
        nodes: subject.scene.node_count(),
        geometries: subject.scene.geometry_count(),
        size: arguments.size,
        samples: arguments.samples,
        frames: Vec::new(),
    };
    let frames = arguments.frames.unwrap_or(1);
    let progress = if frames == 1 { Progress::spinner("rendering") } else { Progress::steps("rendering", frames) };
    for frame in 0..frames {
        report.frames.push(render(arguments, &mut renderer, &mut subject, frame, frames)?);
        progress.advance();
    }
    drop(progress);
    tell(arguments, &report)
}

/// Renders and writes one image.
fn render(
    arguments: &Arguments,
    renderer: &mut Renderer,
    subject: &mut Subject,
    frame: u32,
    frames: u32,
) -> Result<FrameEntry, String> {
    let output = arguments.output_of(frame + 1);
    let view = subject.view(frame, frames);
    let rendered = renderer.render(&mut subject.scene, &view).map_err(|error| error.to_string())?;

    let read_start = Instant::now();
    let image = rendered.image().map_err(|error| error.to_string())?;
    let read_time = read_start.elapsed();

    let save_start = Instant::now();
    let save = || image.downscaled(arguments.samples)?.save(&output);
    save().map_err(|error| error.to_string())?;
    Ok(FrameEntry { output, report: rendered.report().clone(), read_time, save_time: save_start.elapsed() })
}

/// Says what was done, as the arguments ask.
fn tell(arguments: &Arguments, report: &Report) -> Result<(), String> {
    if arguments.json {
        return say(&report.to_json().map_err(|error| error.to_string())?);
    }
    if arguments.stats {
        say(&report.to_tables())?;
    } else if !report.not_honoured.is_empty() {
        eprintln!("{} features of the file are not honoured (--stats lists them)", report.not_honoured.len());
    }
    match report.frames.as_slice() {
        [first, .., last] => say(&format!("wrote {} to {}", first.output.display(), last.output.display())),
        [only] => say(&format!("wrote {}", only.output.display())),
        [] => Ok(()),
    }
}

/// A line on standard output. `println!` would panic where nobody reads it any more.
fn say(line: &str) -> Result<(), String> {
    writeln!(std::io::stdout(), "{line}").map_err(|error| format!("standard output: {error}"))
}
