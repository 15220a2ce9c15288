//! The command line.

use std::path::{Path, PathBuf};

use clap::error::ErrorKind;
use clap::{Parser, ValueEnum};
use ropewalk::graph::WallKind;
use ropewalk::image::ToneMapping;
use ropewalk::{DeviceChoice, View};

use crate::allowed_folders::check_folders;

/// Renders a glTF file, or without one a scene made in code, to an image.
#[derive(Debug, Parser)]
#[command(name = "render", version, about, args_override_self = true)]
pub(crate) struct Arguments {
    /// A .gltf or .glb file; without one, a scene made in code is rendered
    pub(crate) file: Option<PathBuf>,
    /// The image to write: .png (8 bit, sRGB) or .exr (32 bit float, linear)
    #[arg(short, long, value_name = "FILE", default_value = "out.png", value_parser = parse_output)]
    pub(crate) output: PathBuf,
    /// Pixels of the image
    #[arg(long, value_name = "WxH", default_value = "960x600", value_parser = parse_size)]
    pub(crate) size: (u32, u32),
    /// Rays along each side of a pixel, averaged: 1 is fastest, 2 or more smooths edges
    #[arg(long, value_name = "N", default_value = "2", value_parser = clap::value_parser!(u32).range(1..=16))]
    pub(crate) samples: u32,
    /// What traces the rays; auto is a GPU if there is one, else the CPU
    #[arg(long, value_enum, default_value_t)]
    pub(crate) device: Device,
    /// Reflections and refractions that a ray may have
    #[arg(long, value_name = "N", default_value = "3")]
    pub(crate) depth: u32,
    /// Paths end where they contribute no more than this share of their light to a pixel
    #[arg(long, value_name = "SHARE", default_value_t = View::DEFAULT_MIN_THROUGHPUT, value_parser = parse_share)]
    pub(crate) min_throughput: f32,
    /// The camera sees nothing nearer than this, in world units
    #[arg(long, value_name = "DISTANCE", default_value = "0", value_parser = parse_distance)]
    pub(crate) near: f32,
    /// Rays that a pixel may take; one that needs more shows the nearest opaque surface behind them
    #[arg(long, value_name = "N", default_value = "1024", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) max_rays: u32,
    /// How PNG files show what is brighter than white; unlit colours are always shown as they are
    #[arg(long, value_name = "MAPPING", value_enum, default_value_t)]
    pub(crate) tone_map: ToneMap,
    /// What glass is of which the file does not say it: solid, thin, or as each mesh looks
    #[arg(long, value_name = "KIND", value_enum, default_value_t)]
    pub(crate) wall: Wall,
    /// The camera to look through, by name or number (default: the first; without one, the whole scene is framed)
    #[arg(long, value_name = "NAME|INDEX")]
    pub(crate) camera: Option<String>,
    /// The scene of the file, by name or number (default: the file's own default)
    #[arg(long, value_name = "NAME|INDEX")]
    pub(crate) scene: Option<String>,
    /// Another folder below which the file may name buffers and images, besides its own; can be given several times
    #[arg(long, value_name = "FOLDER", action = clap::ArgAction::Append)]
    pub(crate) allow_folder: Vec<PathBuf>,
    /// The most memory that importing the file may take, in MiB; always limited by what the file's size justifies
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) memory: Option<u32>,
    /// Turntable: write N numbered images from all around
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(crate) frames: Option<u32>,
    /// Print what was done and how long it took
    #[arg(long)]
    pub(crate) stats: bool,
    /// Print the same as JSON, and nothing else, to standard output
    #[arg(long)]
    pub(crate) json: bool,
}

/// `--device`
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(crate) enum Device {
    #[default]
    Auto,
    Gpu,
    Cpu,
    Emulated,
}

impl From<Device> for DeviceChoice {
    fn from(device: Device) -> Self {
        match device {
            Device::Auto => Self::Auto,
            Device::Gpu => Self::Gpu,
            Device::Cpu => Self::Cpu,
            Device::Emulated => Self::Emulated,
        }
    }
}

/// `--tone-map`
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(crate) enum ToneMap {
    #[default]
    Neutral,
    None,
}

impl From<ToneMap> for ToneMapping {
    fn from(tone_map: ToneMap) -> Self {
        match tone_map {
            ToneMap::Neutral => Self::KhronosPbrNeutral,
            ToneMap::None => Self::None,
        }
    }
}

/// `--wall`
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(crate) enum Wall {
    #[default]
    Auto,
    Thin,
    Solid,
}

impl From<Wall> for WallKind {
    fn from(wall: Wall) -> Self {
        match wall {
            Wall::Auto => Self::Auto,
            Wall::Thin => Self::Thin,
            Wall::Solid => Self::Solid,
        }
    }
}

impl Arguments {
    /// Parses the command line; an error is one line. Prints help and version itself, and returns `None` then.
    pub(crate) fn from_command_line() -> Result<Option<Self>, String> {
        let arguments = match Self::try_parse() {
            Ok(arguments) => arguments,
            Err(error) if matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => {
                return error.print().map(|()| None).map_err(|error| format!("standard output: {error}"));
            }
            Err(error) => return Err(one_line(&error)),
        };
        arguments.check()?;
        Ok(Some(arguments))
    }

    /// The traced size in pixels: that of the image times the samples.
    pub(crate) fn traced_size(&self) -> (u32, u32) {
        (self.size.0 * self.samples, self.size.1 * self.samples)
    }

    /// The file of a turntable's frame, counted from 1; `output` itself without a turntable.
    pub(crate) fn output_of(&self, frame: u32) -> PathBuf {
        let Some(frames) = self.frames else { return self.output.clone() };
        let digits = frames.to_string().len();
        let part = |part: Option<&std::ffi::OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
        let (stem, extension) = (part(self.output.file_stem()), part(self.output.extension()));
        self.output.with_file_name(format!("{stem}-{frame:0digits$}.{extension}"))
    }

    /// Checks combinations of arguments, which clap cannot.
    fn check(&self) -> Result<(), String> {
        /// 2 GiB of colours.
        const MAX_SAMPLES: u64 = 1 << 27;

        if self.scene.is_some() && self.file.is_none() {
            return Err("--scene chooses a scene of a file, but no file is given".to_owned());
        }
        check_folders(&self.allow_folder)?;
        let (width, height) = self.traced_size();
        let samples = u64::from(width) * u64::from(height);
        if samples > MAX_SAMPLES {
            let asked = "--size and --samples ask for";
            return Err(format!("{asked} {samples} rays an image, but at most {MAX_SAMPLES} are traced at once"));
        }
        Ok(())
    }
}

/// The message of clap on one line, without the usage.
fn one_line(error: &clap::Error) -> String {
    let text = error.to_string();
    let lines =
        text.lines().map(str::trim).take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For more"));
    let line = lines.filter(|line| !line.is_empty()).collect::<Vec<_>>().join(" ");
    line.trim_start_matches("error: ").to_owned()
}

fn parse_share(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|share| (0.0..=1.0).contains(share)).ok_or_else(|| "must be a number, 0 to 1".to_owned())
}

fn parse_distance(text: &str) -> Result<f32, String> {
    let is_distance = |distance: &f32| distance.is_finite() && *distance >= 0.0;
    text.parse().ok().filter(is_distance).ok_or_else(|| "must be a finite number, at least 0".to_owned())
}

fn parse_size(text: &str) -> Result<(u32, u32), String> {
    /// The largest texture dimension that most GPUs support.
    const MAX: u32 = 16_384;

    let parsed = text.split_once(['x', 'X']).and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    match parsed {
        Some((width, height)) if (1..=MAX).contains(&width) && (1..=MAX).contains(&height) => Ok((width, height)),
        _ => Err(format!("expected two numbers from 1 to {MAX}, as in 960x600")),
    }
}

/// Rejects a file that could not be written, before anything is rendered.
fn parse_output(text: &str) -> Result<PathBuf, String> {
    let path = Path::new(text);
    // The path is in clap's own message already.
    ropewalk::image::Image::check_format(path).map_err(|_| "the name must end in .png or .exr".to_owned())?;
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() && !folder.is_dir() => {
            Err(format!("there is no folder {}", folder.display()))
        }
        _ => Ok(path.to_owned()),
    }
}
