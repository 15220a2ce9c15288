//! The interactive viewer: opens a glTF file or a scene made in code, to look around, pick, drag, edit and undo.
//!
//! `cargo run --release -p ropewalk-viewer -- SCENE.glb`; `--help` lists the options.

#[path = "../../render/allowed_folders.rs"]
mod allowed_folders;
mod app;
mod arguments;
#[path = "../../render/builtin/mod.rs"]
mod builtin;
mod camera_control;
#[path = "../../render/cameras_and_lights.rs"]
mod cameras_and_lights;
mod detail;
mod device;
mod drag;
mod drawing;
mod edit;
mod event_loop;
mod inspector;
mod loaded_scene;
mod messages;
mod node_icons;
mod overlay;
mod present;
mod projection;
#[cfg(test)]
mod session_tests;
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
