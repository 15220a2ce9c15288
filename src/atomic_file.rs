//! Atomic file writes: the target path always holds the old content or the complete new content.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Writes a temporary file in the same folder, syncs it, and renames it over `path`, so that no reader ever sees a
/// partial file.
pub(crate) fn write_atomically(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let (temporary, mut file) = create_temporary_beside(path)?;
    let written = file.write_all(bytes).and_then(|()| file.sync_all());
    drop(file);
    let result = written.and_then(|()| fs::rename(&temporary, path));
    if result.is_err() {
        // Report the first error, not one of the clean-up.
        let _ = fs::remove_file(&temporary);
    }
    result
}

/// Creates a temporary file with a unique name in the folder of `path`; a rename within one folder is atomic.
fn create_temporary_beside(path: &Path) -> std::io::Result<(PathBuf, fs::File)> {
    static COUNTER: AtomicU32 = AtomicU32::new(0);
    loop {
        let unique = COUNTER.fetch_add(1, Ordering::Relaxed);
        let temporary = path.with_file_name(format!(".ropewalk-{}-{unique}.tmp", std::process::id()));
        match fs::File::create_new(&temporary) {
            // A stale temporary file of a killed process with the same process id: try the next number.
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
            created => return created.map(|file| (temporary, file)),
        }
    }
}
