//! The world boxes of the instances, and the TLAS over them.

use super::coincident_instances::{CoincidentInstances, Promoted};
use crate::accel::{Tlas, TlasUpdate};
use crate::device::DeviceBuffer;
use crate::device::layout::{InstanceRecord, Node};
use crate::math::Aabb;

/// The world box of each instance by slot, which of them have changed, and the TLAS that is updated with those.
#[derive(Debug, Default)]
pub(super) struct InstanceBounds {
    /// By slot, relative to the render origin; empty for an unused slot, for an instance that no ray can hit, and for
    /// one that another stands for.
    boxes: Vec<Aabb>,
    /// By slot: a hash of the matrix in f64, which tells instances apart whose records f32 rounds to the same.
    placement_hashes: Vec<u64>,
    /// Slots whose boxes have changed since the last update of the TLAS, in the order of the changes.
    changed_slots: Vec<u32>,
    coincident: CoincidentInstances,
    tlas: Tlas,
}

impl InstanceBounds {
    /// Sets the box and the hash of the matrix of a slot whose record has been written; `record_changed` says whether
    /// that is another one than before. New slots between the last one and this get empty boxes.
    pub(super) fn set(&mut self, slot: u32, bounds: Aabb, placement_hash: u64, record_changed: bool) {
        let index = slot as usize;
        if index >= self.boxes.len() {
            self.boxes.resize(index + 1, Aabb::EMPTY);
            self.placement_hashes.resize(index + 1, 0);
        }
        let record_changed = record_changed || self.placement_hashes[index] != placement_hash;
        self.placement_hashes[index] = placement_hash;
        // 1. An instance that coincides with others no longer does so if it has changed.
        if let Some(group_bounds) = self.coincident.group_bounds(slot) {
            if !record_changed && group_bounds == bounds {
                return;
            }
            if let Some(Promoted { slot, bounds }) = self.coincident.remove(slot) {
                self.set_box(slot, bounds);
            }
        }
        // 2. Set the box.
        self.set_box(slot, bounds);
    }

    fn set_box(&mut self, slot: u32, bounds: Aabb) {
        let index = slot as usize;
        if self.boxes[index] != bounds {
            self.boxes[index] = bounds;
            self.changed_slots.push(slot);
        }
    }

    /// Sets the limit of the TLAS, see [`Tlas::set_max_cost_ratio`].
    pub(super) fn set_max_cost_ratio(&mut self, max_cost_ratio: f64) {
        self.tlas.set_max_cost_ratio(max_cost_ratio);
    }

    /// Removes all boxes and empties the TLAS; both release their memory.
    pub(super) fn clear(&mut self, nodes: &mut DeviceBuffer<Node>) {
        *self = Self::default();
        nodes.truncate(0);
    }

    /// Updates the TLAS (patch, refit or rebuild) with the boxes that have changed. After a rebuild the instances that
    /// coincide are searched; if there are any, it is built once more without those that others stand for.
    pub(super) fn update_tlas(&mut self, nodes: &mut DeviceBuffer<Node>, records: &[InstanceRecord]) -> TlasUpdate {
        let changed = std::mem::take(&mut self.changed_slots);
        let update = self.tlas.update(nodes, &self.boxes, &changed);
        if matches!(update, TlasUpdate::Rebuilt(_))
            && self.coincident.find(&mut self.boxes, records, &self.placement_hashes) > 0
        {
            self.tlas.build(nodes, &self.boxes);
        }
        update
    }

    /// The instances that coincide with one, itself included. Ascending: the first stands for all.
    pub(super) fn coincident_with(&self, slot: u32) -> impl Iterator<Item = u32> {
        self.coincident.group(slot)
    }

    /// How many instances others stand for.
    pub(super) fn coincident_count(&self) -> usize {
        self.coincident.left_out_count()
    }
}
