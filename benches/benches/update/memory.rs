//! The memory of a node and of an instance, from the resident memory of the process.

use memory_stats::memory_stats;
use ropewalk::compile::Compiler;

use crate::propagation::Ropewalk;
use crate::ready::{Compiled, EYE};
use crate::shape::{Pose, Shape};

/// What is measured, and how many bytes each takes.
pub fn bytes_each(count: usize) -> ropewalk::Result<Vec<(&'static str, usize)>> {
    let mut random = fastrand::Rng::with_seed(3);
    let parents = Shape::Humanoids.parents(count);
    let poses: Vec<Pose> = parents.iter().map(|_| Pose::random(&mut random)).collect();
    let start = resident();
    let mut tree = Ropewalk::new(&parents, &poses)?;
    let built = resident();
    tree.scene().hierarchy()?;
    let flattened = resident();
    let mut compiled = Compiled::new(Shape::Flat, count / 2, &mut random)?;
    let scene = compiled.scene();
    // A second one, beside the one that was compiled with the scene.
    let before = resident();
    let mut compiler = Compiler::new();
    compiler.compile(scene, EYE)?;
    let after = resident();
    drop((tree, compiler));
    Ok(vec![
        ("memory: node and core", (built - start) / count),
        ("memory: entry of the hierarchy", (flattened - built) / count),
        ("memory: compiled instance", (after - before) / (count / 2)),
    ])
}

fn resident() -> usize {
    memory_stats().map_or(0, |stats| stats.physical_mem)
}
