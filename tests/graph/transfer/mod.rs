//! State transfer: mirrors, undo, transactions, threads and files, under random edits and against the naive model.
#![expect(clippy::unwrap_used, clippy::panic, clippy::expect_used, reason = "a panic in a test is a failure")]

mod deltas;
mod files;
mod history;
mod queue;
mod recordings;
mod replica;
mod session;

use ropewalk::Scene;
use ropewalk::graph::{ObjectKey, ObjectState};

use super::random_edits::{model, random};

/// The whole content of a scene, except which keys removed objects had.
fn content(scene: &Scene) -> Vec<(ObjectKey, Option<ObjectState>)> {
    scene.snapshot().objects().map(|(object, state)| (object, state.cloned())).collect()
}

/// A scene with every kind of object, some of them shared; others have been removed.
fn sample() -> Scene {
    use proptest::strategy::{Strategy as _, ValueTree as _};

    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let edits = proptest::collection::vec(random::raw_edit(), 400).new_tree(&mut runner).unwrap().current();
    let mut scene = Scene::new();
    let mut model = model::Model::new(&scene);
    let mut issued = random::Issued::new(&scene);
    for raw in edits.iter().filter(|raw| raw.kind % 32 != 6) {
        issued.resolve(raw, &model).run(&mut scene, &mut model, &mut issued);
    }
    let counts = [scene.node_count(), scene.core_count(), scene.geometry_count(), scene.material_count()];
    assert!(counts.iter().all(|&count| count > 4) && scene.texture_count() > 1, "{counts:?}");
    scene
}
