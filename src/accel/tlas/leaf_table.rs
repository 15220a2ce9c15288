//! Which instance is in which leaf, and which leaves are unused.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use super::policy::LeafCounts;
use crate::device::layout::NONE;

/// The leaf (node index) of each instance, and the unused leaves.
#[derive(Debug, Default)]
pub(super) struct LeafTable {
    /// The node index of each instance's leaf. With [`FORMER_BIT`] set it is the leaf that the instance had before it
    /// was removed; if it is still unused when the instance reappears, the instance gets it back, so that toggling
    /// visibility does not degrade the hierarchy. Atomic only because building threads write disjoint elements through
    /// a shared reference.
    leaf_of_instance: Vec<AtomicU32>,
    unused: BTreeSet<u32>,
    used_count: usize,
}

/// Marks a former leaf. Node indices are below 2^29.
const FORMER_BIT: u32 = 1 << 31;

/// How many unused leaves are considered for a new instance from each end of the index order.
const CANDIDATES: usize = 3;

impl LeafTable {
    /// Clears the table for `instance_count` instances, `used_count` of which are then [assigned](Self::assign) leaves.
    pub(super) fn reset(&mut self, instance_count: usize, used_count: usize) {
        self.unused.clear();
        self.used_count = used_count;
        self.leaf_of_instance.clear();
        self.resize(instance_count);
    }

    /// Grows the table to `instance_count` instances; it never shrinks.
    pub(super) fn resize(&mut self, instance_count: usize) {
        if instance_count > self.leaf_of_instance.len() {
            self.leaf_of_instance.resize_with(instance_count, || AtomicU32::new(NONE));
        }
    }

    /// Enters the leaf of an instance. Threads that build call it for different instances.
    pub(super) fn assign(&self, instance_index: u32, leaf: u32) {
        self.leaf_of_instance[instance_index as usize].store(leaf, Relaxed);
    }

    pub(super) fn set_unused(&mut self, leaves: impl IntoIterator<Item = u32>) {
        self.unused = leaves.into_iter().collect();
    }

    /// The leaf of an instance, if it has one.
    pub(super) fn leaf(&self, instance_index: u32) -> Option<u32> {
        let leaf = self.leaf_of_instance.get(instance_index as usize)?.load(Relaxed);
        (leaf & FORMER_BIT == 0).then_some(leaf)
    }

    /// Releases the leaf of an instance that was removed.
    pub(super) fn release(&mut self, instance_index: u32, leaf: u32) {
        self.assign(instance_index, leaf | FORMER_BIT);
        self.unused.insert(leaf);
        self.used_count -= 1;
    }

    /// Allocates an unused leaf for an instance: the leaf it had before, else of up to six candidates the one whose
    /// ancestors' areas grow least. `growth(leaf, bound)` returns that growth, or any value of at least `bound`. `None`
    /// if no leaf is unused.
    pub(super) fn allocate(&mut self, instance_index: u32, growth: impl Fn(u32, f64) -> f64) -> Option<u32> {
        // 1. The leaf that it had before, if that is still unused.
        let former = self.leaf_of_instance[instance_index as usize].load(Relaxed);
        let mut chosen = (former != NONE).then_some(former & !FORMER_BIT).filter(|leaf| self.unused.contains(leaf));
        // 2. Else the best of a few candidates from both ends of the index order.
        if chosen.is_none() {
            let mut min_growth = f64::INFINITY;
            for &leaf in self.unused.iter().take(CANDIDATES).chain(self.unused.iter().rev().take(CANDIDATES)) {
                let growth = growth(leaf, min_growth);
                if growth < min_growth || chosen.is_none() {
                    (chosen, min_growth) = (Some(leaf), growth);
                }
            }
        }
        // 3. Take it.
        let leaf = chosen?;
        self.unused.remove(&leaf);
        self.used_count += 1;
        self.assign(instance_index, leaf);
        Some(leaf)
    }

    /// Moves an instance from one leaf to an unused one.
    pub(super) fn relocate(&mut self, instance_index: u32, from: u32, to: u32) {
        self.assign(instance_index, to);
        self.unused.remove(&to);
        self.unused.insert(from);
    }

    pub(super) fn counts(&self) -> LeafCounts {
        LeafCounts { used: self.used_count, unused: self.unused.len() }
    }
}
