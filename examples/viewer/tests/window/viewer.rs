//! The viewer as a process, and the events that it logs.

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::time::Duration;

use serde_json::Value;

use crate::display::Display;

/// Longer than any step takes on a slow, busy machine.
const PATIENCE: Duration = Duration::from_secs(900);

/// A running viewer.
pub(crate) struct Viewer {
    process: Child,
    events: Receiver<Value>,
}

impl Viewer {
    /// Starts it on a display.
    pub(crate) fn start(display: &Display, arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ropewalk-viewer"));
        command.arg("--log").args(arguments).env("DISPLAY", &display.name).env_remove("WAYLAND_DISPLAY");
        let mut process = command.stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(process.stdout.take().unwrap()).lines();
        let (sender, events) = mpsc::channel();
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let event = serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}"));
                if sender.send(event).is_err() {
                    break;
                }
            }
        });
        Self { process, events }
    }

    /// Waits for an event of this name; an error that it did not ask for is a failure.
    #[track_caller]
    pub(crate) fn wait(&self, name: &str) -> Value {
        loop {
            let event = self.events.recv_timeout(PATIENCE).unwrap_or_else(|error| panic!("no {name:?}: {error}"));
            if event["event"] == name {
                return event;
            }
            assert_ne!(event["event"], "error", "{event}");
        }
    }

    /// Waits until the picture is final, and returns its rectangle in the window (left, top, width, height).
    #[track_caller]
    pub(crate) fn wait_for_rest(&self, display: &Display) -> [u16; 4] {
        loop {
            let event = self.wait("at rest");
            if event["block"] == 1 {
                return serde_json::from_value(event["viewport"].clone()).unwrap();
            }
            // The machine is slow: ask the viewer to trace all rays however long that takes.
            display.keys(&[u32::from('r')]);
        }
    }

    /// Whether it still runs.
    pub(crate) fn is_alive(&mut self) -> bool {
        self.process.try_wait().unwrap().is_none()
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
