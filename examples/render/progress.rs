//! Progress bars on standard error, for work that takes over half a second.

use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread::JoinHandle;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// A bar that appears once the work has taken half a second, and vanishes when dropped. Shown on terminals only.
pub(crate) struct Progress {
    bar: ProgressBar,
    done: Option<mpsc::Sender<()>>,
    watcher: Option<JoinHandle<()>>,
}

impl Progress {
    /// A spinner, for work of unknown length.
    pub(crate) fn spinner(what: &'static str) -> Self {
        Self::new(ProgressBar::no_length(), what, "{spinner} {msg} {elapsed}")
    }

    /// A bar that shows how many of `steps` are done.
    pub(crate) fn steps(what: &'static str, steps: u32) -> Self {
        Self::new(ProgressBar::new(steps.into()), what, "{spinner} {msg} {wide_bar} {pos}/{len} {eta}")
    }

    /// Counts one step as done.
    pub(crate) fn advance(&self) {
        self.bar.inc(1);
    }

    fn new(bar: ProgressBar, what: &'static str, template: &str) -> Self {
        const PATIENCE: Duration = Duration::from_millis(500);

        bar.set_draw_target(ProgressDrawTarget::hidden());
        bar.set_message(what);
        bar.set_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()));
        let (done, is_done) = mpsc::channel();
        let shown = bar.clone();
        let watcher = std::thread::spawn(move || {
            if is_done.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
                shown.set_draw_target(ProgressDrawTarget::stderr());
                shown.enable_steady_tick(Duration::from_millis(100));
            }
        });
        Self { bar, done: Some(done), watcher: Some(watcher) }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        // The watcher wakes up when its channel closes, and may show the bar until it has ended.
        drop(self.done.take());
        if let Some(watcher) = self.watcher.take() {
            let _ = watcher.join();
        }
        self.bar.finish_and_clear();
    }
}
