//! What becomes of a bottom-level structure whose geometry changed: the choices, and nothing else.

use std::sync::Arc;

use serde::Serialize;

use crate::graph::{Geometry, Quality, Structure};

/// How much dearer a refitted structure may get than it was when it was built, by its SAH cost, before it is built anew.
/// `docs/BENCHMARKS.md` has what rays cost at other limits.
pub(super) const MAX_DECAY: f64 = 1.25;

/// Two changes with at most so many compiles from one to the next are in a row.
const RECENT: u64 = 8;

/// A geometry that changed so many times in a row goes on doing so.
const MANY: u32 = 3;

/// How often a geometry changes, counted in compiles.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct History {
    changed_at: u64,
    changes_in_a_row: u32,
}

impl History {
    /// Of a geometry that is new at this compile.
    pub(super) fn new(now: u64) -> Self {
        Self { changed_at: now, changes_in_a_row: 0 }
    }

    /// The geometry changed again.
    pub(super) fn change(&mut self, now: u64) {
        let is_recent = now - self.changed_at <= RECENT;
        self.changes_in_a_row = if is_recent { self.changes_in_a_row.saturating_add(1) } else { 1 };
        self.changed_at = now;
    }

    /// The structure to build for a geometry: the one that it asks for, else one that suits how often it changes.
    pub(super) fn structure(&self, geometry: &Geometry) -> Structure {
        let quality = if self.changes_in_a_row < MANY { Quality::default() } else { Quality::Fast };
        geometry.structure.unwrap_or(Structure::Bvh(quality))
    }
}

/// What it takes to follow a geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// The structure stays as it is.
    Keep,
    /// Its boxes follow the triangles.
    Refit,
    Build(BuildReason),
}

/// Why a structure is built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BuildReason {
    New,
    Triangles,
    Decay,
    Choice,
}

/// What to do about a `structure` that was built for `old`, where there is `new` now.
pub(super) fn step(structure: Structure, old: &Geometry, new: &Geometry) -> Step {
    // At once where they are shared.
    if !Arc::ptr_eq(&old.indices, &new.indices) && old.indices != new.indices {
        return Step::Build(BuildReason::Triangles);
    }
    if new.structure.is_some_and(|chosen| chosen != structure) {
        return Step::Build(BuildReason::Choice);
    }
    // Bit by bit: the signs of zeros are told apart.
    let [old_bits, new_bits] = [old, new].map(|geometry| bytemuck::cast_slice::<_, u32>(&geometry.positions));
    if Arc::ptr_eq(&old.positions, &new.positions) || old_bits == new_bits {
        return Step::Keep;
    }
    match structure {
        Structure::Bvh(Quality::Fast | Quality::Balanced) => Step::Refit,
        // Their leaves hold parts of triangles: whole ones would make them worse than a new structure.
        Structure::Bvh(Quality::Best) | Structure::KdTree => Step::Build(BuildReason::Choice),
    }
}

/// Why bottom-level structures were built: how many for each reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct BlasBuilds {
    /// Their geometry was not visible before.
    pub new: usize,
    /// Their geometry got other triangles, or some triangles got or lost two equal corners.
    pub other_triangles: usize,
    /// Their geometry had deformed so far that refitting made them a quarter dearer than they were when built.
    pub decayed: usize,
    /// Their geometry asked for another structure, or deformed and asks for one that is not refitted.
    pub chosen: usize,
}

impl BlasBuilds {
    pub(super) fn count(&mut self, reason: BuildReason) {
        *match reason {
            BuildReason::New => &mut self.new,
            BuildReason::Triangles => &mut self.other_triangles,
            BuildReason::Decay => &mut self.decayed,
            BuildReason::Choice => &mut self.chosen,
        } += 1;
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    const FAST: Structure = Structure::Bvh(Quality::Fast);
    const BALANCED: Structure = Structure::Bvh(Quality::Balanced);

    /// What would be built after changes at these compiles.
    fn built_after(compiles: &[u64]) -> Structure {
        let mut history = History::new(0);
        compiles.iter().for_each(|&now| history.change(now));
        history.structure(&Geometry::default())
    }

    #[test]
    fn what_changes_frame_after_frame_is_built_fast() {
        assert_eq!(built_after(&[]), BALANCED);
        assert_eq!(built_after(&[1, 2]), BALANCED);
        assert_eq!(built_after(&[1, 2, 3]), FAST);
        assert_eq!(built_after(&[8, 16, 24]), FAST, "every eighth compile");
        assert_eq!(built_after(&[9, 18, 27, 36]), BALANCED, "now and then");
        assert_eq!(built_after(&[1, 2, 3, 4, 100]), BALANCED, "it had come to rest");
    }

    #[test]
    fn an_explicit_choice_wins() {
        let mut history = History::new(0);
        let geometry = Geometry::default().with_structure(Structure::KdTree);
        assert_eq!(history.structure(&geometry), Structure::KdTree);
        (1..10).for_each(|now| history.change(now));
        assert_eq!(history.structure(&geometry), Structure::KdTree);
    }

    #[test]
    fn each_change_takes_no_more_than_it_must() {
        let old = Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 2]]);
        let copy = Geometry::new(old.positions.to_vec(), old.indices.to_vec());
        let moved = Geometry { positions: [Vec3::ZERO, Vec3::X, Vec3::Z].into(), ..old.clone() };
        let turned = Geometry { indices: [[0, 2, 1]].into(), ..old.clone() };
        let signed = Geometry { positions: [-Vec3::ZERO, Vec3::X, Vec3::Y].into(), ..old.clone() };
        for structure in [FAST, BALANCED] {
            assert_eq!(step(structure, &old, &old), Step::Keep);
            assert_eq!(step(structure, &old, &copy), Step::Keep);
            assert_eq!(step(structure, &old, &moved), Step::Refit);
            assert_eq!(step(structure, &old, &signed), Step::Refit, "bit by bit");
            assert_eq!(step(structure, &copy, &moved), Step::Refit, "triangles equal, not shared");
            assert_eq!(step(structure, &old, &turned), Step::Build(BuildReason::Triangles));
            assert_eq!(step(structure, &old, &old.clone().with_structure(structure)), Step::Keep);
        }
        for structure in [Structure::KdTree, Structure::Bvh(Quality::Best)] {
            assert_eq!(step(structure, &old, &old), Step::Keep, "nothing is chosen any more: what is there will do");
            assert_eq!(step(structure, &old, &moved), Step::Build(BuildReason::Choice));
            assert_eq!(step(FAST, &old, &old.clone().with_structure(structure)), Step::Build(BuildReason::Choice));
        }
    }
}
