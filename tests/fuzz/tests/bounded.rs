//! Each target for a fixed number of inputs, as an ordinary test, and the memory of imports.

use std::sync::{Mutex, PoisonError};

use peak_alloc::PeakAlloc;
use ropewalk_fuzz::{TARGETS, Target, Until, fuzz};

/// Counts the bytes that are allocated.
#[global_allocator]
static HEAP: PeakAlloc = PeakAlloc;

/// What a target with a memory limit of 64 MiB may take at most: the limit; as much again twice, while images are
/// decoded; the inputs, and the scene again where it is copied.
const MAX_BYTES: usize = 4 * (64 << 20);

/// Runs a target; its inputs must have had at least so many different outcomes, or they test nothing.
fn run(name: &str, inputs: u64, least_outcomes: usize) {
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);

    let target = TARGETS.iter().find(|target| target.name == name).expect("there is such a target");
    HEAP.reset_peak_usage();
    let start = HEAP.current_usage();
    match fuzz(target, 1, Until::Inputs(inputs)) {
        Ok(summary) => {
            let outcomes = summary.outcomes.len();
            println!("{name}: {outcomes} outcomes, {} bytes", HEAP.peak_usage() - start);
            assert!(outcomes >= least_outcomes, "only {outcomes} outcomes: {:?}", summary.outcomes);
        }
        Err(finding) => panic!("{}: {}", finding.cause, finding.input.escape_ascii()),
    }
    let peak = HEAP.peak_usage() - start;
    assert!(peak < MAX_BYTES, "{peak} bytes");
}

#[test]
fn gltf_and_glb_files() {
    run("import", 3000, 60);
}

#[test]
fn glb_files_of_right_lengths() {
    run("import-glb", 3000, 60);
}

#[test]
fn scene_files() {
    run("scene-file", 2000, 8);
}

#[test]
fn deltas() {
    run("delta", 3000, 8);
}

#[test]
fn edit_queues() {
    run("edit-queue", 500, 50);
}

/// The driver finds a panic that is two mutations away from the seed, and cuts away what has nothing to do with it.
#[test]
fn a_planted_panic_is_found_and_made_small() {
    fn run(bytes: &[u8]) -> String {
        let has = |word: &[u8]| bytes.windows(word.len()).any(|part| part == word);
        assert!(!(has(b"null") && has(b"4294967296")), "planted");
        format!("{} {}", has(b"null"), has(b"4294967296"))
    }
    let target = Target { name: "planted", seeds: || vec![br#"{"a": 10, "b": 20, "c": [30, 40, 50]}"#.to_vec()], run };
    let finding = fuzz(&target, 1, Until::Inputs(100_000)).expect_err("the panic is found");
    assert!(finding.cause.contains("planted"), "{}", finding.cause);
    assert_eq!(finding.input.len(), "null4294967296".len(), "{}", finding.input.escape_ascii());
}
