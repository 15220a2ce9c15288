//! The sample scenes, in the folder that the variable `ROPEWALK_SCENES` names. Nothing else in the tests reads it.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// The folder; `None`, with a message on standard error, if the variable is not set or empty. That is the rule of
/// `scripts/test.sh` too. A folder that does not exist is not skipped: the test that reads it fails.
pub fn scenes(test: &str) -> Option<PathBuf> {
    let folder = named_folder(std::env::var_os("ROPEWALK_SCENES"));
    if folder.is_none() {
        eprintln!("{test}: skipped, because ROPEWALK_SCENES names no folder");
    }
    folder
}

fn named_folder(variable: Option<OsString>) -> Option<PathBuf> {
    variable.filter(|folder| !folder.is_empty()).map(PathBuf::from)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_variable_names_no_folder() {
        assert_eq!(named_folder(None), None);
        assert_eq!(named_folder(Some(OsString::new())), None);
        assert_eq!(named_folder(Some("scenes".into())), Some(PathBuf::from("scenes")));
    }
}
