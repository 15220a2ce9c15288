//! Malformed files, from the tests of the glTF validator. Each import ends soon, with an error or a valid scene.

use std::collections::HashSet;
use std::time::{Duration, Instant};

use ropewalk::gltf::ImportOptions;
use ropewalk::{Error, Scene, gltf};

use ropewalk_testkit::corpus::{gltf_files, scenes};

/// The validator's codes of those faults that an import must not accept: of the node hierarchy, and all that is out of
/// range.
const NEVER_ACCEPTED: &[&str] = &[
    "ACCESSOR_INDEX_OOB",
    "ACCESSOR_JOINTS_INDEX_OOB",
    "ACCESSOR_SPARSE_COUNT_OUT_OF_RANGE",
    "ACCESSOR_TOO_LONG",
    "ASSET_MIN_VERSION_GREATER_THAN_VERSION",
    "BUFFER_BYTE_LENGTH_MISMATCH",
    "BUFFER_VIEW_TOO_LONG",
    "INVALID_MAGIC",
    "NODE_LOOP",
    "NODE_PARENT_OVERRIDE",
    "UNKNOWN_ASSET_MAJOR_VERSION",
    "UNRESOLVED_REFERENCE",
];

/// The codes of faults that have one reading: they are corrected, but not by a strict import.
const CORRECTED: &[&str] = &["SCENE_NON_ROOT_NODE"];

/// Valid, but says that it needs glTF 2.1, which the validator only warns of.
const NEEDS_NEWER_VERSION: &str = "khronos-validator/base/asset/min_version_valid.gltf";

#[test]
fn every_file_of_the_validator() {
    let Some(folder) = scenes("every_file_of_the_validator").map(|folder| folder.join("invalid")) else { return };
    let table = std::fs::read_to_string(folder.join("EXPECT.tsv")).unwrap();
    let mut listed = HashSet::new();
    let mut failures = Vec::new();
    let (mut accepted, mut refused, mut corrected) = (0, 0, 0);
    for line in table.lines().skip(1) {
        let fields: Vec<&str> = line.split('\t').collect();
        let (file, verdict, codes) = (fields[0], fields[1], fields[4]);
        let path = folder.join(file);
        listed.insert(path.clone());

        let mut scene = Scene::new();
        let (root, revision) = (scene.root(), scene.revision());
        let start = Instant::now();
        let result = gltf::import(&path, &mut scene, root);
        if start.elapsed() > Duration::from_secs(2) {
            failures.push(format!("{file}: took {:?}", start.elapsed()));
        }
        scene.validate().unwrap_or_else(|e| panic!("{file}: {e}"));
        match &result {
            Ok(_) => accepted += 1,
            Err(_) => {
                refused += 1;
                assert_eq!((scene.revision(), scene.node_count()), (revision, 1), "{file}: changed by a failed import");
            }
        }
        let must_fail = verdict == "fatal" || codes.split(',').any(|code| NEVER_ACCEPTED.contains(&code));
        let must_fail = must_fail || file == NEEDS_NEWER_VERSION;
        if !must_fail && codes.split(',').any(|code| CORRECTED.contains(&code)) {
            corrected += 1;
            let strict = ImportOptions::default().with_strict(true);
            let mut scene = Scene::new();
            let root = scene.root();
            if gltf::import_with(&path, &strict, &mut scene, root).is_ok() {
                failures.push(format!("{file}: a strict import accepts {codes}"));
            }
            if let Err(error) = &result {
                failures.push(format!("{file}: not corrected: {error}"));
            }
        }
        match (verdict, result) {
            (_, Ok(_)) if must_fail => failures.push(format!("{file}: imports in spite of {codes}")),
            ("warn" | "clean", Err(error)) if !must_fail => failures.push(format!("{file} ({verdict}): {error}")),
            (_, Err(error)) if !matches!(error, Error::Gltf { .. } | Error::UnsupportedExtension { .. }) => {
                failures.push(format!("{file}: unexpected kind of error {error:?}"));
            }
            _ => {}
        }
    }
    assert!(failures.is_empty(), "{} failures:\n{}", failures.len(), failures.join("\n"));
    assert!(accepted > 200 && refused > 90, "{accepted} accepted, {refused} refused: is the table whole?");
    assert!(corrected > 0, "no file has a fault that is corrected");
    let unlisted: Vec<_> = gltf_files(&folder).into_iter().filter(|file| !listed.contains(file)).collect();
    assert!(unlisted.is_empty(), "not in the table: {unlisted:?}");
}
