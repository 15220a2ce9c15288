//! What depends on who looks: which level of detail is shown, and where billboards turn.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;

use glam::DAffine3;

use super::viewpoint::{Viewpoint, max_axis_scale};
use crate::Result;
use crate::graph::{Core, Hierarchy, LodMetric, Scene};

/// The choices for one observer, by entry of the hierarchy.
#[derive(Debug, Default)]
pub(super) struct ViewDependentState {
    lods: BTreeMap<u32, ChosenLevel>,
    billboards: BTreeSet<u32>,
    /// Children of levels of detail that are not chosen; empty without any.
    hidden_levels: Vec<bool>,
    /// Those, and all below them.
    hidden_entries: Vec<bool>,
    /// The worlds of what is below billboards.
    billboard_worlds: HashMap<u32, DAffine3>,
    /// Whom all this is for.
    observer: Option<Viewpoint>,
}

/// The level that an entry with levels of detail shows.
#[derive(Clone, Copy, Debug, Default)]
struct ChosenLevel {
    chosen: Option<u32>,
    is_applied: bool,
}

impl ViewDependentState {
    /// Nothing in the scene depends on who looks.
    pub(super) fn is_empty(&self) -> bool {
        self.lods.is_empty() && self.billboards.is_empty()
    }

    /// Whether all choices are right for an observer of an unchanged scene.
    pub(super) fn is_current(&self, observer: &Viewpoint) -> bool {
        self.is_empty() || self.observer.as_ref() == Some(observer)
    }

    /// Whether no level of detail above hides the entry.
    pub(super) fn is_shown(&self, entry: usize) -> bool {
        !self.hidden_entries.get(entry).copied().unwrap_or(false)
    }

    /// Where the entry is.
    pub(super) fn world_from_local(&self, hierarchy: &Hierarchy, entry: usize) -> DAffine3 {
        let placed = || hierarchy.resolved()[entry].world_from_local;
        if self.billboard_worlds.is_empty() {
            placed()
        } else {
            self.billboard_worlds.get(&(entry as u32)).copied().unwrap_or_else(placed)
        }
    }

    /// The entry is new, or has another core or other children.
    pub(super) fn classify(&mut self, scene: &Scene, hierarchy: &Hierarchy, entry: usize) {
        let key = entry as u32;
        // A gap has no core.
        let Ok(core) = scene.node_core(hierarchy.nodes()[entry]) else { return };
        match core {
            Core::Lod(_) => self.lods.entry(key).or_default().is_applied = false,
            _ => self.unset_lod(hierarchy, key),
        }
        match core {
            Core::Billboard(_) => drop(self.billboards.insert(key)),
            _ => drop(self.billboards.remove(&key)),
        }
        // What is added below a hidden level is hidden, and a new level is known to what it is a level of.
        let parent = hierarchy.parents()[entry];
        if let Some(level) = self.lods.get_mut(&parent) {
            level.is_applied = false;
        }
        if !self.hidden_levels.is_empty() {
            self.hidden_levels.resize(hierarchy.nodes().len(), false);
            self.hidden_entries.resize(hierarchy.nodes().len(), false);
            self.hidden_entries[entry] =
                self.hidden_levels[entry] || self.hidden_entries.get(parent as usize) == Some(&true);
        }
    }

    /// The entry is gone.
    pub(super) fn remove_entry(&mut self, entry: u32) {
        self.lods.remove(&entry);
        self.billboards.remove(&entry);
    }

    /// All entries are gone; levels that were chosen are forgotten.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Chooses for an observer. Tells the ranges in which something is shown or hidden, and the entries that turned.
    pub(super) fn choose_for(
        &mut self,
        scene: &Scene,
        hierarchy: &Hierarchy,
        observer: &Viewpoint,
    ) -> Result<ViewChanges> {
        let mut choice = ViewChanges::default();
        if self.is_empty() && self.billboard_worlds.is_empty() {
            return Ok(choice);
        }
        self.observer = Some(*observer);
        self.update_billboards(scene, hierarchy, observer, &mut choice)?;
        let entries: Vec<u32> = self.lods.keys().copied().collect();
        for entry in entries {
            self.choose_level(scene, hierarchy, observer, entry, &mut choice)?;
        }
        Ok(choice)
    }

    /// Computes the worlds below all billboards, outermost first. O(entries below them).
    fn update_billboards(
        &mut self,
        scene: &Scene,
        hierarchy: &Hierarchy,
        observer: &Viewpoint,
        choice: &mut ViewChanges,
    ) -> Result<()> {
        let before = std::mem::take(&mut self.billboard_worlds);
        for range in hierarchy.subtrees(self.billboards.iter().map(|&entry| entry as usize)) {
            for entry in range {
                let Ok(core) = scene.node_core(hierarchy.nodes()[entry]) else { continue };
                let parent = hierarchy.parents()[entry];
                let above = self.billboard_worlds.get(&parent).copied();
                let above = above.unwrap_or_else(|| hierarchy.world_from_parent(entry));
                let world = match core {
                    Core::Billboard(billboard) => above * billboard.local(&above, observer.eye, observer.up),
                    Core::Transform(transform) => above * transform.to_affine(),
                    _ => above,
                };
                self.billboard_worlds.insert(entry as u32, world);
            }
        }
        let differs = |entry: &u32| before.get(entry) != self.billboard_worlds.get(entry);
        choice.turned = before.keys().chain(self.billboard_worlds.keys()).copied().filter(differs).collect();
        Ok(())
    }

    fn choose_level(
        &mut self,
        scene: &Scene,
        hierarchy: &Hierarchy,
        observer: &Viewpoint,
        entry: u32,
        choice: &mut ViewChanges,
    ) -> Result<()> {
        let node = hierarchy.nodes()[entry as usize];
        let Core::Lod(lod) = scene.node_core(node)? else { return Ok(()) };
        let world = self.world_from_local(hierarchy, entry as usize);
        let center = world.transform_point3(lod.center);
        let measured = match lod.metric {
            LodMetric::Distance => center.distance(observer.eye),
            LodMetric::ProjectedSize { radius } => observer.projected_size(center, radius * max_axis_scale(&world)),
        };
        let before = self.lods.get(&entry).copied().unwrap_or_default();
        let chosen = lod.select_level(measured, before.chosen);
        self.lods.insert(entry, ChosenLevel { chosen: Some(chosen), is_applied: true });
        if before.is_applied && before.chosen == Some(chosen) {
            return Ok(());
        }
        self.hidden_levels.resize(hierarchy.nodes().len(), false);
        let shown = scene.children(node)?.nth(chosen as usize);
        for below in hierarchy.children(entry as usize) {
            self.hidden_levels[below] = Some(hierarchy.nodes()[below]) != shown;
        }
        self.propagate_hidden(hierarchy, entry, choice);
        Ok(())
    }

    /// An entry that has no levels of detail any more hides nothing.
    fn unset_lod(&mut self, hierarchy: &Hierarchy, entry: u32) {
        if self.lods.remove(&entry).is_some() {
            for below in hierarchy.children(entry as usize) {
                if let Some(hidden) = self.hidden_levels.get_mut(below) {
                    *hidden = false;
                }
            }
        }
    }

    /// Finds out what is hidden below an entry.
    fn propagate_hidden(&mut self, hierarchy: &Hierarchy, entry: u32, choice: &mut ViewChanges) {
        self.hidden_entries.resize(hierarchy.nodes().len(), false);
        for range in hierarchy.subtree(entry as usize) {
            for below in range.clone().filter(|&below| below != entry as usize) {
                self.hidden_entries[below] =
                    self.hidden_levels[below] || self.hidden_entries[hierarchy.parents()[below] as usize];
            }
            choice.visibility_ranges.push(range);
        }
    }
}

/// What [`ViewDependentState::choose_for`] chose otherwise than before.
#[derive(Debug, Default)]
pub(super) struct ViewChanges {
    /// Ranges of entries of which some are now shown or hidden.
    pub(super) visibility_ranges: Vec<Range<usize>>,
    /// Entries that are elsewhere.
    pub(super) turned: Vec<u32>,
}
