//! Image files, written whole or not at all.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use super::{Image, encode};
use crate::{Error, Result};

impl Image {
    /// Writes the image to a file, in the format that the name's ending says:
    /// - `.png`: [`to_rgba8`](Self::to_rgba8), sRGB;
    /// - `.exr`: the linear colour as it is (channels R, G, B, A), and where there are AOVs, Z, N.X, N.Y, N.Z, and as
    ///   unsigned integers `id.node`, `id.node_version` and `id.triangle`; all 32 bit, ZIP compressed without loss.
    ///
    /// The file appears whole or not at all: it is written beside its place under another name and then moved, so that an
    /// older file of that name stays as it was until the new one is complete.
    ///
    /// # Errors
    /// - [`Error::ImageFormat`] for any other ending.
    /// - [`Error::Io`] where the file cannot be written: most often the folder does not exist or may not be written to.
    /// - [`Error::Image`] where the image cannot be encoded: it has no pixels.
    /// - [`Error::OutOfRange`] where an array has not `width * height` elements.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let encode = encode::for_path(path)?;
        self.validate()?;
        let bytes = encode(self).map_err(|source| Error::Image { path: path.to_owned(), source })?;
        write_whole(path, &bytes).map_err(|source| Error::Io { path: path.to_owned(), source })
    }

    /// Whether [`save`](Self::save) knows the format of a file of this name: to be asked before a long render.
    ///
    /// # Errors
    /// [`Error::ImageFormat`] where it does not.
    pub fn check_format(path: impl AsRef<Path>) -> Result<()> {
        encode::for_path(path.as_ref()).map(|_| ())
    }
}

/// Writes a file so that at every moment its name stands for the old content or the new, never for a part.
fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let (temporary, mut file) = create_beside(path)?;
    let written = file.write_all(bytes).and_then(|()| file.sync_all());
    drop(file);
    let result = written.and_then(|()| fs::rename(&temporary, path));
    if result.is_err() {
        // The first error is the one to report.
        let _ = fs::remove_file(&temporary);
    }
    result
}

/// Creates a file with a name of its own in the folder of `path`: a rename within a folder is atomic.
fn create_beside(path: &Path) -> std::io::Result<(PathBuf, fs::File)> {
    static COUNTER: AtomicU32 = AtomicU32::new(0);
    loop {
        let unique = COUNTER.fetch_add(1, Ordering::Relaxed);
        let temporary = path.with_file_name(format!(".ropewalk-{}-{unique}.tmp", std::process::id()));
        match fs::File::create_new(&temporary) {
            // Left by a process that was killed and had the same id.
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
            created => return created.map(|file| (temporary, file)),
        }
    }
}
