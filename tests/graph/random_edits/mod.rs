//! Thousands of random edits are applied to a scene and to a naive model: after each, both must read the same.
#![expect(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

pub(super) mod compare;
pub(super) mod edit;
pub(super) mod model;
pub(super) mod random;
mod reader;

use std::cell::RefCell;
use std::collections::BTreeSet;

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use ropewalk::Scene;

use model::Model;
use random::{Issued, RawEdit, raw_edit};
use reader::Reader;

const READERS: usize = 3;

/// Each kind of edit, with the errors that it can end with.
const FAULTS: [(&str, &[&str]); 18] = [
    ("Add", &["Cycle", "OutOfRange", "Stale"]),
    ("AddCore", &["OutOfRange", "Stale"]),
    ("AddGeometry", &["Geometry"]),
    ("AddMaterial", &["OutOfRange", "Stale"]),
    ("AddTexture", &["OutOfRange"]),
    ("SetCore", &["Cycle", "OutOfRange", "Root", "Stale"]),
    ("Remove", &["Root", "Stale"]),
    ("RemoveUnused", &[]),
    ("Reparent", &["Cycle", "Root", "Singular", "Stale", "WrongCore"]),
    ("AssignCore", &["Cycle", "OutOfRange", "Root", "Stale"]),
    ("SetGeometry", &["Geometry", "Stale"]),
    ("SetLocal", &["OutOfRange", "Stale", "WrongCore"]),
    ("SetMask", &["Stale"]),
    ("SetMaterial", &["OutOfRange", "Stale"]),
    ("SetName", &["Stale"]),
    ("SetPositions", &["Geometry", "Stale"]),
    ("SetTexture", &["OutOfRange", "Stale"]),
    ("SetVisible", &["Stale"]),
];

/// One step of a test case. Shrinking removes steps and makes their numbers smaller.
#[derive(Clone, Debug)]
enum Step {
    Edit(RawEdit),
    /// Read the log.
    Read(usize),
    /// Drop the cursor.
    Leave(usize),
    /// Bring the hierarchy up to date.
    Update,
    /// Ask for boxes.
    Measure,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        20 => raw_edit().prop_map(Step::Edit),
        2 => (0..READERS).prop_map(Step::Read),
        1 => (0..READERS * 4).prop_map(|reader| Step::Leave(reader.min(READERS - 1))),
        3 => Just(Step::Update),
        2 => Just(Step::Measure),
    ]
}

#[test]
fn scene_equals_model() {
    let config = ProptestConfig { cases: 800, failure_persistence: None, ..ProptestConfig::default() };
    let endings = RefCell::new(BTreeSet::new());
    let outcome = TestRunner::new(config).run(&vec(step(), 1..120), |steps| {
        run(&steps, &mut endings.borrow_mut());
        Ok(())
    });
    outcome.unwrap_or_else(|failure| panic!("{failure}"));

    // Every kind of edit has succeeded, and has failed in each way in which it can.
    let endings: Vec<String> = endings.into_inner().into_iter().collect();
    let name = |edit: &str, fault: &str| format!("{edit}: {fault}");
    let failures = |(edit, faults): &(&str, &[&str])| faults.iter().map(|fault| name(edit, fault)).collect::<Vec<_>>();
    let successes = FAULTS.iter().map(|(edit, _)| (*edit).to_owned());
    let mut expected: Vec<String> = successes.chain(FAULTS.iter().flat_map(failures)).collect();
    expected.sort();
    assert_eq!(endings, expected);
}

fn run(steps: &[Step], endings: &mut BTreeSet<String>) {
    let mut scene = Scene::new();
    let mut model = Model::new(&scene);
    let mut issued = Issued::new(&scene);
    let mut readers: [Reader; READERS] = std::array::from_fn(|_| Reader::default());
    let mut log = Vec::new();
    for step in steps {
        match step {
            Step::Edit(raw) => {
                let before = model.clone();
                let revision = scene.revision();
                let ending = issued.resolve(raw, &model).run(&mut scene, &mut model, &mut issued);
                endings.insert(ending);
                let changes = before.changes_to(&model);
                assert_eq!(scene.revision() != revision, !changes.is_empty(), "only what changes something counts");
                log.extend(changes);
            }
            Step::Read(reader) => readers[*reader].read(&mut scene, &model, &log),
            Step::Leave(reader) => readers[*reader] = Reader::default(),
            Step::Update => compare::hierarchy(&mut scene, &model),
            Step::Measure => compare::boxes(&mut scene, &model),
        }
        compare::state(&mut scene, &model, &issued);
    }
    for reader in &mut readers {
        reader.read(&mut scene, &model, &log);
    }
}
