//! What depends on who looks: which level of detail is shown, and where billboards turn.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;

use glam::DAffine3;

use super::viewpoint::{Observer, longest_axis};
use crate::Result;
use crate::graph::{Core, Hierarchy, LodMeasure, Scene};

/// The choices for one observer, by entry of the hierarchy.
#[derive(Debug, Default)]
pub(super) struct ViewDependent {
    lods: BTreeMap<u32, Level>,
    billboards: BTreeSet<u32>,
    /// Children of levels of detail that are not chosen; empty without any.
    hidden: Vec<bool>,
    /// Those, and all below them.
    culled: Vec<bool>,
    /// The worlds of what is below billboards.
    turned: HashMap<u32, DAffine3>,
    /// Whom all this is for.
    observer: Option<Observer>,
}

/// The level that an entry with levels of detail shows.
#[derive(Clone, Copy, Debug, Default)]
struct Level {
    chosen: Option<u32>,
    is_applied: bool,
}

impl ViewDependent {
    /// Nothing in the scene depends on who looks.
    pub(super) fn is_empty(&self) -> bool {
        self.lods.is_empty() && self.billboards.is_empty()
    }

    /// Whether all choices are right for an observer of an unchanged scene.
    pub(super) fn is_current(&self, observer: &Observer) -> bool {
        self.is_empty() || self.observer.as_ref() == Some(observer)
    }

    /// Whether no level of detail above hides the entry.
    pub(super) fn shows(&self, entry: usize) -> bool {
        !self.culled.get(entry).copied().unwrap_or(false)
    }

    /// Where the entry is.
    pub(super) fn world(&self, hierarchy: &Hierarchy, entry: usize) -> DAffine3 {
        let placed = || hierarchy.placed()[entry].world;
        if self.turned.is_empty() { placed() } else { self.turned.get(&(entry as u32)).copied().unwrap_or_else(placed) }
    }

    /// The entry is new, or has another core or other children.
    pub(super) fn classify(&mut self, scene: &Scene, hierarchy: &Hierarchy, entry: usize) {
        let key = entry as u32;
        // A gap has no core.
        let Ok(core) = scene.core(hierarchy.nodes()[entry]) else { return };
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
        if !self.hidden.is_empty() {
            self.hidden.resize(hierarchy.nodes().len(), false);
            self.culled.resize(hierarchy.nodes().len(), false);
            self.culled[entry] = self.hidden[entry] || self.culled.get(parent as usize) == Some(&true);
        }
    }

    /// The entry is gone.
    pub(super) fn forget(&mut self, entry: u32) {
        self.lods.remove(&entry);
        self.billboards.remove(&entry);
    }

    /// All entries are gone; levels that were chosen are forgotten.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Chooses for an observer. Tells the ranges in which something is shown or hidden, and the entries that turned.
    pub(super) fn choose(&mut self, scene: &Scene, hierarchy: &Hierarchy, observer: &Observer) -> Result<Choice> {
        let mut choice = Choice::default();
        if self.is_empty() && self.turned.is_empty() {
            return Ok(choice);
        }
        self.observer = Some(*observer);
        self.turn(scene, hierarchy, observer, &mut choice)?;
        let entries: Vec<u32> = self.lods.keys().copied().collect();
        for entry in entries {
            self.choose_level(scene, hierarchy, observer, entry, &mut choice)?;
        }
        Ok(choice)
    }

    /// Computes the worlds below all billboards, outermost first. O(entries below them).
    fn turn(&mut self, scene: &Scene, hierarchy: &Hierarchy, observer: &Observer, choice: &mut Choice) -> Result<()> {
        let before = std::mem::take(&mut self.turned);
        for range in hierarchy.subtrees(self.billboards.iter().map(|&entry| entry as usize)) {
            for entry in range {
                let Ok(core) = scene.core(hierarchy.nodes()[entry]) else { continue };
                let parent = hierarchy.parents()[entry];
                let above = self.turned.get(&parent).copied();
                let above = above.unwrap_or_else(|| hierarchy.inherited_world(entry));
                let world = match core {
                    Core::Billboard(billboard) => above * billboard.local(&above, observer.eye, observer.up),
                    Core::Transform(transform) => above * transform.to_affine(),
                    _ => above,
                };
                self.turned.insert(entry as u32, world);
            }
        }
        let differs = |entry: &u32| before.get(entry) != self.turned.get(entry);
        choice.turned = before.keys().chain(self.turned.keys()).copied().filter(differs).collect();
        Ok(())
    }

    fn choose_level(
        &mut self,
        scene: &Scene,
        hierarchy: &Hierarchy,
        observer: &Observer,
        entry: u32,
        choice: &mut Choice,
    ) -> Result<()> {
        let node = hierarchy.nodes()[entry as usize];
        let Core::Lod(lod) = scene.core(node)? else { return Ok(()) };
        let world = self.world(hierarchy, entry as usize);
        let center = world.transform_point3(lod.center);
        let measured = match lod.measure {
            LodMeasure::Distance => center.distance(observer.eye),
            LodMeasure::ProjectedSize { radius } => observer.projected_size(center, radius * longest_axis(&world)),
        };
        let before = self.lods.get(&entry).copied().unwrap_or_default();
        let chosen = lod.level(measured, before.chosen);
        self.lods.insert(entry, Level { chosen: Some(chosen), is_applied: true });
        if before.is_applied && before.chosen == Some(chosen) {
            return Ok(());
        }
        self.hidden.resize(hierarchy.nodes().len(), false);
        let shown = scene.children(node)?.nth(chosen as usize);
        for below in hierarchy.children(entry as usize) {
            self.hidden[below] = Some(hierarchy.nodes()[below]) != shown;
        }
        self.cull(hierarchy, entry, choice);
        Ok(())
    }

    /// An entry that has no levels of detail any more hides nothing.
    fn unset_lod(&mut self, hierarchy: &Hierarchy, entry: u32) {
        if self.lods.remove(&entry).is_some() {
            for below in hierarchy.children(entry as usize) {
                if let Some(hidden) = self.hidden.get_mut(below) {
                    *hidden = false;
                }
            }
        }
    }

    /// Finds out what is hidden below an entry.
    fn cull(&mut self, hierarchy: &Hierarchy, entry: u32, choice: &mut Choice) {
        self.culled.resize(hierarchy.nodes().len(), false);
        for range in hierarchy.subtree(entry as usize) {
            for below in range.clone().filter(|&below| below != entry as usize) {
                self.culled[below] = self.hidden[below] || self.culled[hierarchy.parents()[below] as usize];
            }
            choice.shown.push(range);
        }
    }
}

/// What [`ViewDependent::choose`] chose otherwise than before.
#[derive(Debug, Default)]
pub(super) struct Choice {
    /// Ranges of entries of which some are now shown or hidden.
    pub(super) shown: Vec<Range<usize>>,
    /// Entries that are elsewhere.
    pub(super) turned: Vec<u32>,
}
