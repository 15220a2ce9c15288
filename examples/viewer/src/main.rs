//! The interactive viewer: opens a glTF file or a scene made in code, to look around, pick, drag, edit and undo.
//!
//! `cargo run --release -p ropewalk-viewer -- SCENE.glb`; `--help` lists what else can be said.

mod app;
mod arguments;
#[path = "../../render/builtin/mod.rs"]
mod builtin;
mod camera_control;
mod detail;
mod device;
mod drag;
mod drawing;
mod edit;
mod event_loop;
mod inspector;
mod messages;
mod overlay;
mod present;
mod projection;
#[cfg(test)]
mod session_tests;
mod signs;
#[path = "../../render/stage.rs"]
mod stage;
mod subject;
mod theme;
mod tree_panel;
mod ui;
mod viewport;
mod window;

use std::process::ExitCode;

use clap::Parser as _;

use arguments::Arguments;

fn main() -> ExitCode {
    match event_loop::run(Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::from(2)
        }
    }
}
