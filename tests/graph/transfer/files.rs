//! Scene files: a saved scene loads as it was, and a damaged file is refused with an error that names it.

use std::cell::Cell;
use std::fs;
use std::path::Path;

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::TestRunner;
use ropewalk::graph::SceneFileError;
use ropewalk::{Core, Error, Scene};

use super::{content, sample};

/// Magic and version, then length, checksum and body of the only frame.
const HEADER: usize = 12;
const FRAME_HEAD: usize = 12;

fn save(scene: &Scene, path: &Path) -> Vec<u8> {
    scene.save(path).unwrap();
    fs::read(path).unwrap()
}

fn fault(error: &Error, path: &Path) -> String {
    assert!(error.to_string().contains(path.to_str().unwrap()), "{error} does not name the file");
    match error {
        Error::SceneFile { frame: 0, source: fault, .. } => {
            format!("{fault:?}").split([' ', '(']).next().unwrap().to_owned()
        }
        other => panic!("{other}"),
    }
}

/// The checksum as the format has it, computed a bit at a time.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 })
    })
}

#[test]
fn saved_loaded_and_saved_again_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ropewalk");
    let mut scene = sample();
    let gone = scene.add(scene.root(), Core::Group).unwrap();
    scene.remove(gone).unwrap();

    let bytes = save(&scene, &path);
    let mut loaded = Scene::load(&path).unwrap();
    loaded.validate().unwrap();
    assert_eq!(loaded.snapshot(), scene.snapshot());
    assert_eq!(save(&loaded, &path), bytes);
    assert_eq!(crc32(&bytes[HEADER + FRAME_HEAD..]).to_le_bytes(), bytes[HEADER + 8..HEADER + FRAME_HEAD]);

    // Keys are valid or stale as before, and new objects get keys that were never issued.
    let keys: Vec<_> = scene.subtree(scene.root()).unwrap().collect();
    assert!(keys.iter().all(|&key| loaded.contains(key)) && !loaded.contains(gone));
    for _ in 0..100 {
        let new = loaded.add(loaded.root(), Core::Group).unwrap();
        assert!(new != gone && !keys.contains(&new));
    }
}

#[test]
fn what_is_no_scene_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ropewalk");
    assert!(matches!(Scene::load(&path), Err(Error::Io { .. })));
    let bytes = save(&sample(), &path);

    let load = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        Scene::load(&path).map(|scene| scene.validate().unwrap())
    };
    let of_version = |version: u32| [&bytes[..8], &version.to_le_bytes(), &bytes[12..]].concat();
    let version = u32::from_le_bytes(bytes[8..12].try_into().unwrap());
    let [newer, older] = [of_version(version + 1), of_version(version - 1)];
    let huge = [&bytes[..HEADER], &u64::MAX.to_le_bytes(), &bytes[HEADER + 8..]].concat();
    let mut damaged = bytes.clone();
    damaged[100] ^= 1;
    let more = [&bytes[..], b"x"].concat();
    for (bytes, expected) in [
        (b"".as_slice(), "NotAScene"),
        (b"{\"asset\": {}, \"x\": 1}", "NotAScene"),
        (&newer, "Newer"),
        (&older, "Older"),
        (&huge, "Truncated"),
        (&damaged, "Checksum"),
    ] {
        assert_eq!(fault(&load(bytes).unwrap_err(), &folder.path().join("scene.ropewalk")), expected);
    }
    assert!(matches!(load(&more), Err(Error::SceneFile { frame: 1, source: SceneFileError::Truncated, .. })));
    // The file cut off after every length.
    for length in 0..bytes.len() {
        let error = load(&bytes[..length]).unwrap_err();
        let expected = if length < 8 { ["NotAScene", "Truncated"] } else { ["Truncated", "Truncated"] };
        assert!(expected.contains(&fault(&error, &folder.path().join("scene.ropewalk")).as_str()), "{error}");
    }
    load(&bytes).unwrap();
}

#[test]
fn the_old_file_stays_where_saving_fails() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("no such folder").join("scene.ropewalk");
    assert!(matches!(Scene::new().save(&path), Err(Error::Io { path: named, .. }) if named == path));
    // There is a folder of the file's name.
    let path = folder.path().join("taken");
    fs::create_dir(&path).unwrap();
    assert!(matches!(Scene::new().save(&path), Err(Error::Io { .. })));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left beside it");
}

/// Bytes changed, inserted or cut out of the body, with the checksum made right again: it loads as a valid scene or is
/// refused with the file's name, and memory is bounded by the size of the file (or this would not end).
#[test]
fn tampered_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ropewalk");
    let bytes = save(&sample(), &path);
    let damage = (any::<Index>(), 0..4_u8, prop_oneof![any::<u8>(), Just(0), Just(1), Just(255)]);
    let (loaded, refused) = (Cell::new(0), Cell::new(0));
    let config = ProptestConfig { cases: 6000, failure_persistence: None, ..ProptestConfig::default() };
    let outcome = TestRunner::new(config).run(&vec(damage, 1..4), |damages| {
        let mut body = bytes[HEADER + FRAME_HEAD..].to_vec();
        for (place, kind, value) in damages {
            let place = place.index(body.len());
            match kind {
                0 | 1 => body[place] = value,
                2 => body.insert(place, value),
                _ => drop(body.remove(place)),
            }
        }
        let length = (body.len() as u64).to_le_bytes();
        let file = [&bytes[..HEADER], &length, &crc32(&body).to_le_bytes(), &body].concat();
        fs::write(&path, file).unwrap();
        match Scene::load(&path) {
            Ok(mut scene) => {
                loaded.set(loaded.get() + 1);
                let _ = scene.hierarchy();
                scene.validate().unwrap();
                // Not in each case, since saving waits for the disk.
                if loaded.get() % 32 == 1 {
                    let again = save(&scene, &path);
                    assert!(content(&Scene::load(&path).unwrap()) == content(&scene));
                    assert_eq!(save(&Scene::load(&path).unwrap(), &path), again);
                }
            }
            Err(error) => {
                refused.set(refused.get() + 1);
                let fault = fault(&error, &path);
                assert!(["Encoding", "Mismatch"].contains(&fault.as_str()), "{error}");
            }
        }
        Ok(())
    });
    outcome.unwrap_or_else(|failure| panic!("{failure}"));
    assert!(loaded.get() > 100 && refused.get() > 100, "{loaded:?} {refused:?}");
}
