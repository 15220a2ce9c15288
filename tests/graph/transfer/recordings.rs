//! Recordings: each frame is read back as it was, up to where the file is intact.

use std::fs;

use ropewalk::graph::{Recorder, Replay, SceneFileError};
use ropewalk::{Error, Scene};

use super::content;
use crate::graph::random_edits::model::Model;
use crate::graph::random_edits::random::{Issued, raw_edit};

/// A recorded session of random edits, and what the scene was after each frame.
fn record(path: &std::path::Path) -> Vec<Vec<(ropewalk::graph::ObjectKey, Option<ropewalk::graph::ObjectState>)>> {
    use proptest::strategy::{Strategy as _, ValueTree as _};

    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let edits = proptest::collection::vec(raw_edit(), 600).new_tree(&mut runner).unwrap().current();
    let mut scene = Scene::new();
    let mut model = Model::new(&scene);
    let mut issued = Issued::new(&scene);
    let mut recorder = Recorder::new(path, &mut scene).unwrap();
    let mut frames = vec![content(&scene)];
    for (number, raw) in edits.iter().enumerate() {
        issued.resolve(raw, &model).run(&mut scene, &mut model, &mut issued);
        if number % 7 == 0 {
            recorder.record(&mut scene).unwrap();
            frames.push(content(&scene));
        }
    }
    frames
}

#[test]
fn every_frame_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session.ropewalk");
    let frames = record(&path);
    assert!(frames.len() > 50);

    let (mut replay, mut scene) = (Replay::open(&path).unwrap(), Scene::new());
    for frame in &frames {
        assert!(replay.apply_next(&mut scene).unwrap());
        assert_eq!(content(&scene), *frame);
        scene.validate().unwrap();
    }
    assert!(!replay.apply_next(&mut scene).unwrap());
    assert_eq!(replay.frame(), frames.len());
    // The whole recording loads as the scene after its last frame.
    assert_eq!(content(&Scene::load(&path).unwrap()), *frames.last().unwrap());
}

#[test]
fn a_cut_recording_ends_where_it_is_cut() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session.ropewalk");
    let frames = record(&path);
    let bytes = fs::read(&path).unwrap();
    let mut whole_frames = 0;
    for length in (12..bytes.len()).step_by(101) {
        fs::write(&path, &bytes[..length]).unwrap();
        let (mut replay, mut scene) = (Replay::open(&path).unwrap(), Scene::new());
        let mut count = 0;
        let ending = loop {
            match replay.apply_next(&mut scene) {
                Ok(true) => {
                    assert_eq!(content(&scene), frames[count]);
                    count += 1;
                }
                ending => break ending,
            }
        };
        match ending {
            // The file cut off between two frames.
            Ok(_) => assert_eq!(replay.frame(), count),
            Err(Error::SceneFile { path: named, frame, source: SceneFileError::Truncated }) => {
                assert_eq!((named.as_path(), frame), (path.as_path(), count));
            }
            Err(error) => panic!("{error}"),
        }
        whole_frames += count;
    }
    assert!(whole_frames > 100);
}

#[test]
fn a_recording_that_cannot_be_written_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("no such folder").join("session.ropewalk");
    assert!(matches!(Recorder::new(&path, &mut Scene::new()), Err(Error::Io { path: named, .. }) if named == path));
}
