//! Memory. Below: a million random edits; it stays bounded, and all that follows the scene agrees with it. `memory`:
//! imports of files that are made to exhaust it.

#![expect(clippy::unwrap_used, clippy::panic, reason = "a panic in a test is a failure")]

mod memory;

use std::sync::{Mutex, MutexGuard, PoisonError};

use glam::DVec3;
use peak_alloc::PeakAlloc;
use proptest::strategy::{Strategy, ValueTree};
use proptest::test_runner::TestRunner;
use ropewalk::Scene;
use ropewalk::compile::Compiler;
use ropewalk::graph::ChangeCursor;
use ropewalk_testkit::canonical::Canonical;
use ropewalk_testkit::world::{World, edit_with_geometries};

/// Counts the bytes that are allocated.
#[global_allocator]
static HEAP: PeakAlloc = PeakAlloc;

/// Held by each test while it runs: they count the allocations of the whole program.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

const EDITS: usize = 1_000_000;
/// From this many nodes on, subtrees are removed until half of them are left.
const MOST_NODES: usize = 400;
const EYE: DVec3 = DVec3::new(0.0, 0.0, 10.0);

/// A scene with undo; a compiler and a mirror that read its change log at different intervals; and a cursor that lags
/// far behind.
#[test]
fn a_million_edits_leave_nothing_behind() {
    let _alone = alone();
    let mut runner = TestRunner::default();
    let edits = edit_with_geometries();
    let start = HEAP.current_usage();
    let mut world = World::new();
    world.populate();
    world.scene.enable_undo();
    world.scene.set_undo_limit(20);
    let (mut compiler, mut mirror) = (Compiler::new(), Scene::new());
    let (mut of_mirror, mut lagging) = (ChangeCursor::default(), ChangeCursor::default());
    // The greatest number of allocated bytes in each tenth of the edits, from the first tenth in which the scene has
    // reached its full size.
    let (mut peaks, mut compared) = (Vec::new(), 0);

    for i in 1..=EDITS {
        world.apply(&edits.new_tree(&mut runner).unwrap().current());
        if world.scene.node_count() > MOST_NODES {
            thin_out(&mut world);
        }
        if i % 7 == 0 {
            world.scene.end_undo_group("");
        }
        if i % 100 == 0 {
            for _ in 0..i / 100 % 4 {
                world.scene.undo().unwrap();
            }
            world.forget_stale_keys();
            if i % 300 == 0 {
                world.scene.redo().unwrap();
            }
            compiler.compile(&mut world.scene, EYE).unwrap();
        }
        if i % 1000 == 0 {
            mirror.apply(&world.scene.delta_since(&mut of_mirror)).unwrap();
        }
        if i % (EDITS / 100) == 0 {
            compared += check(&mut world, &mut compiler, &mut mirror, &mut of_mirror);
        }
        if i % (EDITS / 10) == 0 {
            let _ = world.scene.changes_since(&mut lagging);
            peaks.push(HEAP.current_usage() - start);
        }
    }

    let (first, last) = (peaks[0], peaks[9]);
    assert!(compared > 100, "only {compared} instances were compared");
    println!("{first} bytes after a tenth of the edits, {last} after all");
    assert!(last < 2 * first, "memory grows: {peaks:?}");

    // Without nodes no other object is left, and nothing on the device.
    world.scene.disable_undo();
    for child in world.scene.children(world.scene.root()).unwrap().collect::<Vec<_>>() {
        world.scene.remove(child).unwrap();
    }
    world.scene.remove_unused();
    compiler.compile(&mut world.scene, EYE).unwrap();
    mirror.apply(&world.scene.delta_since(&mut of_mirror)).unwrap();
    for scene in [&world.scene, &mirror] {
        let counts = [scene.geometry_count(), scene.material_count(), scene.texture_count()];
        assert_eq!((scene.node_count(), scene.core_count(), counts), (1, 1, [0; 3]));
    }
    assert_eq!(compiler.arrays().byte_count(), 0);
}

/// Checks that mirror and compiler agree with the scene, and that the device arrays are not much larger than those of a
/// new compiler. Returns the number of instances.
fn check(world: &mut World, compiler: &mut Compiler, mirror: &mut Scene, of_mirror: &mut ChangeCursor) -> usize {
    world.scene.validate().unwrap();
    compiler.compile(&mut world.scene, EYE).unwrap();
    let mut fresh = Compiler::new();
    fresh.compile(&mut world.scene, EYE).unwrap();
    let canonical = Canonical::of(compiler.arrays());
    assert_eq!(canonical.difference(&Canonical::of(fresh.arrays())), None);
    let (found, least) = (compiler.arrays().byte_count(), fresh.arrays().byte_count());
    assert!(found < 20 * least + 1_000_000, "{found} bytes on the device, where {least} would do");

    mirror.apply(&world.scene.delta_since(of_mirror)).unwrap();
    mirror.validate().unwrap();
    let (one, other) = (world.scene.snapshot(), mirror.snapshot());
    assert!(one.objects().eq(other.objects()), "the mirror differs");
    canonical.instance_count()
}

/// Removes subtrees until half of the nodes are left.
fn thin_out(world: &mut World) {
    while world.scene.node_count() > MOST_NODES / 2 {
        let top = world.scene.children(world.scene.root()).unwrap().next().unwrap();
        world.scene.remove(top).unwrap();
    }
    world.forget_stale_keys();
}
