//! Edit batches from eight threads at once: each is applied whole or not at all.

use std::collections::HashMap;
use std::sync::Arc;
use std::thread;

use ropewalk::graph::EditQueue;
use ropewalk::{Core, Error, NodeKey, Scene, Transform};

const THREADS: usize = 8;
const BATCHES: usize = 400;

/// Each thread owns a node whose name is a counter. A batch moves 1 from one counter to another, adds a node below
/// each, and sometimes fails half-way: the counters' sum stays the same, and the number of nodes is that of the batches
/// that succeeded.
#[test]
fn batches_of_eight_threads() {
    let mut scene = Scene::new();
    let tallies: Vec<NodeKey> = (0..THREADS).map(|_| scene.add(scene.root(), Core::Group).unwrap()).collect();
    tallies.iter().for_each(|&node| scene.set_name(node, "0").unwrap());
    let queue = EditQueue::new();
    let tallies = Arc::new(tallies);

    let workers: Vec<_> = (0..THREADS)
        .map(|thread| {
            let (sender, tallies) = (queue.sender(), tallies.clone());
            thread::spawn(move || {
                let mut committed = HashMap::new();
                let mut pending = Vec::new();
                for number in 0..BATCHES {
                    let to = (thread + 1 + number) % THREADS;
                    let (from, to) = (tallies[thread], tallies[to]);
                    let fails = (thread * 7 + number) % 5 == 0;
                    let outcome = sender.send(move |scene| {
                        change_tally(scene, from, -1)?;
                        scene.add(from, Transform::IDENTITY)?;
                        if fails {
                            // Fails as a batch does whose node was removed.
                            scene.remove(NodeKey::default())?;
                        }
                        let added = scene.add(to, Core::Group)?;
                        change_tally(scene, to, 1)?;
                        Ok(added)
                    });
                    pending.push((fails, to, outcome));
                    if number % 16 == 0 {
                        thread::yield_now();
                    }
                }
                for (fails, to, outcome) in pending {
                    match outcome.wait() {
                        Ok(added) => assert!(!fails && committed.insert(added, to).is_none()),
                        Err(error) => assert!(fails && matches!(error, Error::StaleKey { .. }), "{error}"),
                    }
                }
                committed
            })
        })
        .collect();

    let mut applied = 0;
    while applied < THREADS * BATCHES {
        applied += queue.apply(&mut scene);
        let sum: i64 = tallies.iter().map(|&node| tally(&scene, node)).sum();
        assert_eq!(sum, 0, "between batches, what one has lost another has got");
    }
    let mut committed = HashMap::new();
    for worker in workers {
        committed.extend(worker.join().unwrap());
    }
    assert_eq!(committed.len(), THREADS * BATCHES * 4 / 5);
    assert_eq!(scene.node_count(), 1 + THREADS + 2 * committed.len());
    for (&added, &parent) in &committed {
        assert_eq!(scene.parent(added).unwrap(), Some(parent));
    }
    scene.validate().unwrap();
}

fn tally(scene: &Scene, node: NodeKey) -> i64 {
    scene.name(node).unwrap().parse().unwrap()
}

fn change_tally(scene: &mut Scene, node: NodeKey, by: i64) -> ropewalk::Result<()> {
    let tally = tally(scene, node) + by;
    scene.set_name(node, tally.to_string())
}

#[test]
fn a_batch_without_a_queue_is_told_so() {
    let queue = EditQueue::new();
    let sender = queue.sender();
    let waiting = sender.send(|scene| scene.set_mask(scene.root(), 0));
    assert!(waiting.try_outcome().is_none());
    drop(queue);
    assert!(matches!(waiting.wait(), Err(Error::QueueClosed)));
    let late = sender.send(|scene| scene.set_mask(scene.root(), 0));
    assert!(matches!(late.try_outcome(), Some(Err(Error::QueueClosed))));
}
