//! The visible lights of the compiled scene.

use std::collections::BTreeSet;
use std::ops::Range;

use glam::DVec3;

use super::pack;
use super::view_dependent::ViewDependentState;
use crate::Result;
use crate::device::DeviceBuffer;
use crate::device::layout::LightRecord;
use crate::graph::{Core, Hierarchy, Scene};

/// The hierarchy entries of the visible lights, and whether their records are stale.
#[derive(Debug, Default)]
pub(super) struct LightTable {
    entries: BTreeSet<u32>,
    /// Whether a light was added, removed or marked since the records were written.
    is_stale: bool,
}

impl LightTable {
    /// Adds the light of an entry; its record is stale even if the entry was a light before.
    pub(super) fn insert(&mut self, entry: u32) {
        self.entries.insert(entry);
        self.is_stale = true;
    }

    /// Removes the light of an entry, if it has one.
    pub(super) fn remove(&mut self, entry: u32) {
        self.is_stale |= self.entries.remove(&entry);
    }

    /// Removes all lights.
    pub(super) fn clear(&mut self) {
        self.entries.clear();
        self.is_stale = true;
    }

    /// Marks the lights in a range of entries as stale.
    pub(super) fn mark_range(&mut self, entries: &Range<usize>) {
        let mut lights = self.entries.range(entries.start as u32..entries.end as u32);
        self.is_stale |= lights.next().is_some();
    }

    /// Marks all lights as stale.
    pub(super) fn mark_all(&mut self) {
        self.is_stale = true;
    }

    /// Writes the records of all lights, relative to the render origin, if some are stale. O(lights) then, else O(1).
    pub(super) fn write(
        &mut self,
        scene: &Scene,
        hierarchy: &Hierarchy,
        view: &ViewDependentState,
        origin: DVec3,
        buffer: &mut DeviceBuffer<LightRecord>,
    ) -> Result<()> {
        if !std::mem::take(&mut self.is_stale) {
            return Ok(());
        }
        let mut records = Vec::with_capacity(self.entries.len());
        for &entry in &self.entries {
            let entry = entry as usize;
            if let Core::Light(light) = scene.node_core(hierarchy.nodes()[entry])? {
                records.extend(pack::light_record(light, &view.world_from_local(hierarchy, entry), origin));
            }
        }
        buffer.replace(&records);
        Ok(())
    }
}
