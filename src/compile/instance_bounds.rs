//! The world boxes of the instances, and the TLAS over them.

use crate::accel::{Tlas, TlasUpdate};
use crate::device::DeviceBuffer;
use crate::device::layout::Node;
use crate::math::Aabb;

/// The world box of each instance by slot, which of them have changed, and the TLAS that is updated with those.
#[derive(Debug, Default)]
pub(super) struct InstanceBounds {
    /// By slot, relative to the render origin; empty for an unused slot and for an instance that no ray can hit.
    boxes: Vec<Aabb>,
    /// Slots whose boxes have changed since the last update of the TLAS, in the order of the changes.
    changed_slots: Vec<u32>,
    tlas: Tlas,
}

impl InstanceBounds {
    /// Sets the box of a slot. New slots between the last one and this get empty boxes.
    pub(super) fn set(&mut self, slot: u32, bounds: Aabb) {
        let index = slot as usize;
        if index >= self.boxes.len() {
            self.boxes.resize(index + 1, Aabb::EMPTY);
        }
        if self.boxes[index] != bounds {
            self.boxes[index] = bounds;
            self.changed_slots.push(slot);
        }
    }

    /// Removes all boxes and empties the TLAS; both release their memory.
    pub(super) fn clear(&mut self, nodes: &mut DeviceBuffer<Node>) {
        *self = Self::default();
        nodes.truncate(0);
    }

    /// Updates the TLAS (patch, refit or rebuild) with the boxes that have changed.
    pub(super) fn update_tlas(&mut self, nodes: &mut DeviceBuffer<Node>) -> TlasUpdate {
        let changed = std::mem::take(&mut self.changed_slots);
        self.tlas.update(nodes, &self.boxes, &changed)
    }
}
