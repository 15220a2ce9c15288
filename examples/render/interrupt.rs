//! Ctrl+C: the first ends the program in order, and the second at once.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::exit;
use std::thread;
use std::time::Duration;

use ropewalk::Cancel;

/// The exit code of a program that Ctrl+C has ended, as shells have it: 128 and the number of the signal.
pub(crate) const INTERRUPTED: u8 = 130;

/// How long after the first Ctrl+C the program may take to end by itself. What cannot be stopped in between, such as
/// the encoding of a large image, is then left.
const PATIENCE: Duration = Duration::from_millis(600);

/// Installs the handler of Ctrl+C, which cancels the token that is returned. `output` is the image to be written.
pub(crate) fn cancel_on_interrupt(output: &Path) -> Result<Cancel, String> {
    let cancel = Cancel::new();
    let (token, folder) = (cancel.clone(), output.parent().unwrap_or(Path::new("")).to_owned());
    let interrupt = move || {
        if token.is_cancelled() {
            exit_now(&folder);
        }
        token.cancel();
        eprintln!("interrupted");
        let folder = folder.clone();
        thread::spawn(move || {
            thread::sleep(PATIENCE);
            exit_now(&folder);
        });
    };
    ctrlc::set_handler(interrupt).map_err(|error| format!("Ctrl+C cannot be handled: {error}"))?;
    Ok(cancel)
}

/// Ends the program, and removes the file that it may be writing: images are written under another name first.
fn exit_now(folder: &Path) -> ! {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let prefix = format!(".ropewalk-{}-", std::process::id());
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let is_own = |path: &PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(&prefix));
    for path in entries.map(|entry| entry.path()).filter(is_own) {
        // Nothing can be done if that fails.
        let _ = fs::remove_file(path);
    }
    exit(INTERRUPTED.into())
}
