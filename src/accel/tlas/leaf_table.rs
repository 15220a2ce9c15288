//! Which instance is in which leaf, and which leaves are free.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use crate::device::layout::NONE;

/// The leaf of each slot, and the unused leaves, by node index.
#[derive(Debug, Default)]
pub(super) struct LeafTable {
    /// With [`FORMER_BIT`] set: a leaf that the slot had, and gets back if it is still free: what is hidden and shown again does
    /// not make the hierarchy worse. Atomic for the threads that build: they know which leaf is where.
    leaf_of_instance: Vec<AtomicU32>,
    free: BTreeSet<u32>,
    used: usize,
}

/// Node indices are below 2^29.
const FORMER_BIT: u32 = 1 << 31;

/// Free leaves that are looked at for a new instance, from either end.
const CANDIDATES: usize = 3;

impl LeafTable {
    /// Forgets all; `used` of `slot_count` slots are then [`assign`](Self::assign) in leaves.
    pub(super) fn reset(&mut self, slot_count: usize, used: usize) {
        self.free.clear();
        self.used = used;
        self.leaf_of_instance.clear();
        self.resize(slot_count);
    }

    /// Makes room for slots; there is none for fewer than before.
    pub(super) fn resize(&mut self, slot_count: usize) {
        if slot_count > self.leaf_of_instance.len() {
            self.leaf_of_instance.resize_with(slot_count, || AtomicU32::new(NONE));
        }
    }

    /// Puts a slot in a leaf, while threads build.
    pub(super) fn assign(&self, slot: u32, leaf: u32) {
        self.leaf_of_instance[slot as usize].store(leaf, Relaxed);
    }

    pub(super) fn set_free(&mut self, leaves: impl IntoIterator<Item = u32>) {
        self.free = leaves.into_iter().collect();
    }

    /// The leaf that a slot is in.
    pub(super) fn leaf(&self, slot: u32) -> Option<u32> {
        let leaf = self.leaf_of_instance.get(slot as usize)?.load(Relaxed);
        (leaf & FORMER_BIT == 0).then_some(leaf)
    }

    /// Frees the leaf `leaf` of a slot.
    pub(super) fn release(&mut self, slot: u32, leaf: u32) {
        self.assign(slot, leaf | FORMER_BIT);
        self.free.insert(leaf);
        self.used -= 1;
    }

    /// Gives a slot a free leaf: the one it had before, or of some the one with the least growth. `growth` gets a leaf and the
    /// least so far. `None` if no leaf is free.
    pub(super) fn allocate(&mut self, slot: u32, growth: impl Fn(u32, f64) -> f64) -> Option<u32> {
        let former = self.leaf_of_instance[slot as usize].load(Relaxed);
        let mut chosen = (former != NONE).then_some(former & !FORMER_BIT).filter(|leaf| self.free.contains(leaf));
        if chosen.is_none() {
            let mut least = f64::INFINITY;
            for &leaf in self.free.iter().take(CANDIDATES).chain(self.free.iter().rev().take(CANDIDATES)) {
                let growth = growth(leaf, least);
                if growth < least || chosen.is_none() {
                    (chosen, least) = (Some(leaf), growth);
                }
            }
        }
        let leaf = chosen?;
        self.free.remove(&leaf);
        self.used += 1;
        self.assign(slot, leaf);
        Some(leaf)
    }

    /// Moves a slot from one leaf to a free one.
    pub(super) fn relocate(&mut self, slot: u32, from: u32, to: u32) {
        self.assign(slot, to);
        self.free.remove(&to);
        self.free.insert(from);
    }

    pub(super) fn used_count(&self) -> usize {
        self.used
    }

    pub(super) fn unused_count(&self) -> usize {
        self.free.len()
    }
}
