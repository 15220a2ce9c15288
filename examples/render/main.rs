//! Renders a glTF file, or a scene made in code, to an image.
//!
//! `cargo run --release --example render` writes `out.png`; `-- --help` lists the options. Uses a GPU if there is one.
//! A failure prints one line to standard error, ends with exit code 2, and leaves no file behind. So does Ctrl+C, with
//! exit code 130; the images that are complete stay.

mod allowed_folders;
mod arguments;
mod builtin;
mod cameras_and_lights;
mod interrupt;
mod loaded_scene;
mod progress;
mod report;

use std::io::Write as _;
use std::process::ExitCode;
use std::time::Instant;

use ropewalk::{Cancel, Renderer, RendererOptions};

use arguments::Arguments;
use loaded_scene::LoadedScene;
use progress::Progress;
use report::{FrameEntry, Report};

fn main() -> ExitCode {
    let arguments = match Arguments::from_command_line() {
        Ok(Some(arguments)) => arguments,
        Ok(None) => return ExitCode::SUCCESS,
        Err(message) => return fail(&message),
    };
    let cancel = match interrupt::cancel_on_interrupt(&arguments.output) {
        Ok(cancel) => cancel,
        Err(message) => return fail(&message),
    };
    match run(&arguments, &cancel) {
        Ok(()) => ExitCode::SUCCESS,
        Err(_) if cancel.is_cancelled() => ExitCode::from(interrupt::INTERRUPTED),
        Err(message) => fail(&message),
    }
}

/// Prints an error on one line.
fn fail(message: &str) -> ExitCode {
    eprintln!("error: {}", one_line(message));
    ExitCode::from(2)
}

/// The text on one line: line breaks become spaces, and other control characters, which a file could have put into a
/// name, are escaped.
fn one_line(text: &str) -> String {
    let line = text.lines().map(str::trim).collect::<Vec<_>>().join(" ");
    let escaped = |c: char| if c.is_control() { c.escape_default().to_string() } else { c.to_string() };
    line.chars().map(escaped).collect()
}

fn run(arguments: &Arguments, cancel: &Cancel) -> Result<(), String> {
    // 1. Load the scene.
    let start = Instant::now();
    let mut loaded = {
        let _progress = Progress::spinner("loading");
        LoadedScene::load(arguments, cancel)?
    };
    let load_time = start.elapsed();
    // Tell of the file; as JSON, the report has it.
    if let (Some(import), Some(file), false) = (&loaded.import, &arguments.file, arguments.json) {
        report::warning_lines(file, &import.warnings, &import.unlisted_warnings)
            .iter()
            .for_each(|line| eprintln!("{line}"));
    }

    // 2. Open the renderer.
    let options = RendererOptions::default().with_device(arguments.device.into());
    let mut renderer = Renderer::new(&options).map_err(|error| error.to_string())?;
    renderer.set_cancel(cancel.clone());
    if let Some(reason) = renderer.fallback_reason() {
        eprintln!("rendering on the CPU: {}", one_line(reason));
    }

    // 3. Render and save each frame, and report.
    let mut report = Report {
        file: arguments.file.clone(),
        import: loaded.import.as_ref().map(|import| import.counts),
        warnings: loaded.import.as_ref().map(|import| import.warnings.clone()).unwrap_or_default(),
        unlisted_warnings: loaded.import.as_ref().map(|import| import.unlisted_warnings.clone()).unwrap_or_default(),
        fallback: renderer.fallback_reason().map(str::to_owned),
        load_time,
        nodes: loaded.scene.node_count(),
        geometries: loaded.scene.geometry_count(),
        size: arguments.size,
        samples: arguments.samples,
        frames: Vec::new(),
    };
    let frames = arguments.frames.unwrap_or(1);
    let progress = if frames == 1 { Progress::spinner("rendering") } else { Progress::steps("rendering", frames) };
    for frame in 0..frames {
        report.frames.push(render(arguments, &mut renderer, &mut loaded, frame, frames)?);
        progress.advance();
    }
    drop(progress);
    print_report(arguments, &report)
}

/// Renders and writes one image.
fn render(
    arguments: &Arguments,
    renderer: &mut Renderer,
    loaded: &mut LoadedScene,
    frame: u32,
    frames: u32,
) -> Result<FrameEntry, String> {
    let output = arguments.output_of(frame + 1);
    let view = loaded.view(frame, frames);
    let rendered = renderer.render(&mut loaded.scene, &view).map_err(|error| error.to_string())?;

    let read_start = Instant::now();
    let image = rendered.image().map_err(|error| error.to_string())?.with_tone_mapping(arguments.tone_map.into());
    let limited_pixels = rendered.limited_pixels().map_err(|error| error.to_string())?;
    let read_time = read_start.elapsed();

    let save_start = Instant::now();
    let save = || image.downscaled(arguments.samples)?.save(&output);
    save().map_err(|error| error.to_string())?;
    let (report, save_time) = (rendered.report().clone(), save_start.elapsed());
    Ok(FrameEntry { output, report, limited_pixels, read_time, save_time })
}

/// Prints the report in the requested form.
fn print_report(arguments: &Arguments, report: &Report) -> Result<(), String> {
    if arguments.json {
        return print_line(&report.to_json().map_err(|error| error.to_string())?);
    }
    if arguments.stats {
        print_line(&report.to_tables())?;
    }
    match report.frames.as_slice() {
        [first, .., last] => print_line(&format!("wrote {} to {}", first.output.display(), last.output.display())),
        [only] => print_line(&format!("wrote {}", only.output.display())),
        [] => Ok(()),
    }
}

/// Prints a line to standard output. `println!` would panic if the reader of a pipe has closed it.
fn print_line(line: &str) -> Result<(), String> {
    writeln!(std::io::stdout(), "{line}").map_err(|error| format!("standard output: {error}"))
}
