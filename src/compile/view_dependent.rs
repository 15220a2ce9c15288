//! What depends on the viewpoint: the level of detail of each LOD node, and the orientation of billboards.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;

use glam::DAffine3;

use super::viewpoint::{Viewpoint, max_axis_scale};
use crate::Result;
use crate::graph::{Core, Hierarchy, LodMetric, Scene};

/// The choices for one viewpoint, by hierarchy entry.
#[derive(Debug, Default)]
pub(super) struct ViewDependentState {
    /// The LOD nodes.
    lods: BTreeMap<u32, ChosenLevel>,
    /// The billboards.
    billboards: BTreeSet<u32>,
    /// For each entry, whether it is a level of an LOD node that is not chosen. Empty until an LOD node hides one.
    hidden_levels: Vec<bool>,
    /// For each entry, whether it or an ancestor is such a level. Empty until an LOD node hides one.
    hidden_entries: Vec<bool>,
    /// The `world_from_local` of each billboard and everything below it.
    billboard_worlds: HashMap<u32, DAffine3>,
    /// The viewpoint of the choices above.
    viewpoint: Option<Viewpoint>,
}

/// The chosen level of an LOD node, and whether `hidden_levels` reflects it.
#[derive(Clone, Copy, Debug, Default)]
struct ChosenLevel {
    chosen: Option<u32>,
    is_applied: bool,
}

impl ViewDependentState {
    /// Whether nothing in the scene depends on the viewpoint.
    pub(super) fn is_empty(&self) -> bool {
        self.lods.is_empty() && self.billboards.is_empty()
    }

    /// Whether the choices hold for this viewpoint, given an unchanged scene.
    pub(super) fn is_current(&self, viewpoint: &Viewpoint) -> bool {
        self.is_empty() || self.viewpoint.as_ref() == Some(viewpoint)
    }

    /// Whether the entry is shown: no LOD node above hides it.
    pub(super) fn is_shown(&self, entry: usize) -> bool {
        !self.hidden_entries.get(entry).copied().unwrap_or(false)
    }

    /// The entry's world matrix, with billboards above it turned to the viewpoint.
    pub(super) fn world_from_local(&self, hierarchy: &Hierarchy, entry: usize) -> DAffine3 {
        let resolved = || hierarchy.resolved()[entry].world_from_local;
        if self.billboard_worlds.is_empty() {
            resolved()
        } else {
            self.billboard_worlds.get(&(entry as u32)).copied().unwrap_or_else(resolved)
        }
    }

    /// Records that an entry is new, or that its core or children changed.
    pub(super) fn classify(&mut self, scene: &Scene, hierarchy: &Hierarchy, entry: usize) {
        let key = entry as u32;
        // 1. Note LOD nodes and billboards. A removed entry has no core.
        let Ok(core) = scene.node_core(hierarchy.nodes()[entry]) else { return };
        match core {
            Core::Lod(_) => self.lods.entry(key).or_default().is_applied = false,
            _ => self.unset_lod(hierarchy, key),
        }
        match core {
            Core::Billboard(_) => drop(self.billboards.insert(key)),
            _ => drop(self.billboards.remove(&key)),
        }
        // 2. A new child of an LOD node makes it choose again.
        let parent = hierarchy.parents()[entry];
        if let Some(level) = self.lods.get_mut(&parent) {
            level.is_applied = false;
        }
        // 3. An entry added below a hidden level is hidden.
        if !self.hidden_levels.is_empty() {
            self.hidden_levels.resize(hierarchy.nodes().len(), false);
            self.hidden_entries.resize(hierarchy.nodes().len(), false);
            self.hidden_entries[entry] =
                self.hidden_levels[entry] || self.hidden_entries.get(parent as usize) == Some(&true);
        }
    }

    /// Forgets an entry that was removed.
    pub(super) fn remove_entry(&mut self, entry: u32) {
        self.lods.remove(&entry);
        self.billboards.remove(&entry);
    }

    /// Forgets all entries, and with them the chosen levels: hysteresis starts again.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Chooses for a viewpoint. Returns the ranges of entries whose visibility may have changed, and the entries whose
    /// world matrix did.
    pub(super) fn choose_for(
        &mut self,
        scene: &Scene,
        hierarchy: &Hierarchy,
        viewpoint: &Viewpoint,
    ) -> Result<ViewChanges> {
        let mut changes = ViewChanges::default();
        if self.is_empty() && self.billboard_worlds.is_empty() {
            return Ok(changes);
        }
        self.viewpoint = Some(*viewpoint);
        self.update_billboards(scene, hierarchy, viewpoint, &mut changes)?;
        let entries: Vec<u32> = self.lods.keys().copied().collect();
        for entry in entries {
            self.choose_level(scene, hierarchy, viewpoint, entry, &mut changes)?;
        }
        Ok(changes)
    }

    /// Computes the world matrices of all billboards and of everything below them. O(entries below them).
    fn update_billboards(
        &mut self,
        scene: &Scene,
        hierarchy: &Hierarchy,
        viewpoint: &Viewpoint,
        changes: &mut ViewChanges,
    ) -> Result<()> {
        // 1. Visit the subtrees of billboards, parents first. A billboard turns to the eye; a transform multiplies.
        let before = std::mem::take(&mut self.billboard_worlds);
        for range in hierarchy.subtrees(self.billboards.iter().map(|&entry| entry as usize)) {
            for entry in range {
                let Ok(core) = scene.node_core(hierarchy.nodes()[entry]) else { continue };
                let parent = hierarchy.parents()[entry];
                let above = self.billboard_worlds.get(&parent).copied();
                let above = above.unwrap_or_else(|| hierarchy.world_from_parent(entry));
                let world = match core {
                    Core::Billboard(billboard) => above * billboard.local(&above, viewpoint.eye, viewpoint.up),
                    Core::Transform(transform) => above * transform.to_affine(),
                    _ => above,
                };
                self.billboard_worlds.insert(entry as u32, world);
            }
        }
        // 2. List the entries whose matrix changed.
        let differs = |entry: &u32| before.get(entry) != self.billboard_worlds.get(entry);
        changes.moved_entries = before.keys().chain(self.billboard_worlds.keys()).copied().filter(differs).collect();
        Ok(())
    }

    /// Chooses the level of one LOD node, and hides its other children.
    fn choose_level(
        &mut self,
        scene: &Scene,
        hierarchy: &Hierarchy,
        viewpoint: &Viewpoint,
        entry: u32,
        changes: &mut ViewChanges,
    ) -> Result<()> {
        let node = hierarchy.nodes()[entry as usize];
        let Core::Lod(lod) = scene.node_core(node)? else { return Ok(()) };
        // 1. Measure the distance or the projected size.
        let world = self.world_from_local(hierarchy, entry as usize);
        let center = world.transform_point3(lod.center);
        let measured = match lod.metric {
            LodMetric::Distance => center.distance(viewpoint.eye),
            LodMetric::ProjectedSize { radius } => viewpoint.projected_size(center, radius * max_axis_scale(&world)),
        };
        // 2. Choose a level, with hysteresis. Nothing changes if it is the same and its children are up to date.
        let before = self.lods.get(&entry).copied().unwrap_or_default();
        let chosen = lod.select_level(measured, before.chosen);
        self.lods.insert(entry, ChosenLevel { chosen: Some(chosen), is_applied: true });
        if before.is_applied && before.chosen == Some(chosen) {
            return Ok(());
        }
        // 3. Hide the other children.
        self.hidden_levels.resize(hierarchy.nodes().len(), false);
        let shown = scene.children(node)?.nth(chosen as usize);
        for below in hierarchy.children(entry as usize) {
            self.hidden_levels[below] = Some(hierarchy.nodes()[below]) != shown;
        }
        // 4. Propagate that to everything below.
        self.propagate_hidden(hierarchy, entry, changes);
        Ok(())
    }

    /// An entry that is no longer an LOD node hides none of its children.
    fn unset_lod(&mut self, hierarchy: &Hierarchy, entry: u32) {
        if self.lods.remove(&entry).is_some() {
            for below in hierarchy.children(entry as usize) {
                if let Some(hidden) = self.hidden_levels.get_mut(below) {
                    *hidden = false;
                }
            }
        }
    }

    /// Recomputes which entries below an LOD node are hidden.
    fn propagate_hidden(&mut self, hierarchy: &Hierarchy, entry: u32, changes: &mut ViewChanges) {
        self.hidden_entries.resize(hierarchy.nodes().len(), false);
        for range in hierarchy.subtree(entry as usize) {
            for below in range.clone().filter(|&below| below != entry as usize) {
                self.hidden_entries[below] =
                    self.hidden_levels[below] || self.hidden_entries[hierarchy.parents()[below] as usize];
            }
            changes.visibility_ranges.push(range);
        }
    }
}

/// What changed with the viewpoint.
#[derive(Debug, Default)]
pub(super) struct ViewChanges {
    /// Ranges of entries, some of which were shown or hidden.
    pub(super) visibility_ranges: Vec<Range<usize>>,
    /// Entries whose world matrix changed.
    pub(super) moved_entries: Vec<u32>,
}
