//! The command line.

use std::path::PathBuf;

use clap::{Parser, ValueEnum};
use ropewalk::DeviceChoice;

/// Shows a glTF file, or without one a scene made in code, in a window.
#[derive(Clone, Debug, Parser)]
#[command(name = "ropewalk-viewer", version, about, args_override_self = true)]
pub(crate) struct Arguments {
    /// A .gltf, .glb or .ropewalk file; without one, a scene made in code is shown
    pub(crate) file: Option<PathBuf>,
    /// Pixels of the window
    #[arg(long, value_name = "WxH", default_value = "1280x800", value_parser = parse_size)]
    pub(crate) size: (u32, u32),
    /// What traces the rays; auto is a GPU if there is one, else the CPU
    #[arg(long, value_enum, default_value_t)]
    pub(crate) device: Device,
    /// Reflections and refractions that a ray may have
    #[arg(long, value_name = "N", default_value = "3")]
    pub(crate) depth: u32,
    /// Rays along each side of a pixel, averaged, where nothing moves
    #[arg(long, value_name = "N", default_value = "2", value_parser = clap::value_parser!(u32).range(1..=3))]
    pub(crate) samples: u32,
    /// Where Ctrl+S saves: the picture as .png or .exr, the scene as .ropewalk
    #[arg(long, value_name = "FILE", default_value = "view.png")]
    pub(crate) save: String,
    /// Another folder below which files may name buffers and images, besides their own; can be given several times
    #[arg(long, value_name = "FOLDER", action = clap::ArgAction::Append)]
    pub(crate) allow_folder: Vec<PathBuf>,
    /// Print what happens to standard output, as lines of JSON
    #[arg(long)]
    pub(crate) log: bool,
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

fn parse_size(text: &str) -> Result<(u32, u32), String> {
    const MAX: u32 = 16_384;

    let parsed = text.split_once(['x', 'X']).and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    match parsed {
        Some((width, height)) if (1..=MAX).contains(&width) && (1..=MAX).contains(&height) => Ok((width, height)),
        _ => Err(format!("expected two numbers from 1 to {MAX}, as in 1280x800")),
    }
}
