//! `--allow-folder`: the folders below which a glTF file may name buffers and images.

use std::path::{Path, PathBuf};

use ropewalk::gltf::FilePolicy;

/// The policy for a file: its own folder, and those that were allowed.
pub(crate) fn file_policy(file: &Path, allowed: &[PathBuf]) -> FilePolicy {
    let own = match file.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    FilePolicy::below(std::iter::once(own).chain(allowed.iter().map(PathBuf::as_path)))
}

/// Rejects a folder that does not exist: nothing would be below it.
pub(crate) fn check_folders(allowed: &[PathBuf]) -> Result<(), String> {
    match allowed.iter().find(|folder| !folder.is_dir()) {
        None => Ok(()),
        Some(folder) => Err(format!("--allow-folder: there is no folder {}", folder.display())),
    }
}
