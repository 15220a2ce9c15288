//! The sample scenes, in the folder that the variable `ROPEWALK_SCENES` names.

use std::path::{Path, PathBuf};

/// The folder; `None`, with a message on standard error, if the variable is not set.
pub fn scenes(test: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("ROPEWALK_SCENES").map(PathBuf::from);
    if folder.is_none() {
        eprintln!("{test}: skipped, because ROPEWALK_SCENES is not set");
    }
    folder
}

/// Every glTF file below a folder, sorted.
pub fn gltf_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut pending = vec![folder.to_owned()];
    while let Some(folder) = pending.pop() {
        for entry in std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display())) {
            let path = entry.unwrap().path();
            if path.is_dir() {
                pending.push(path);
            } else if path.extension().is_some_and(|e| e == "gltf" || e == "glb") {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}
