//! What becomes of a bottom-level structure whose geometry changed: the choices, and nothing else.

use std::sync::Arc;

use serde::Serialize;

use crate::graph::{BlasKind, Geometry, Quality};

/// How much dearer a refitted structure may get than it was when it was built, by its SAH cost, before it is built anew.
/// `docs/BENCHMARKS.md` has what rays cost at other limits.
pub(super) const MAX_DECAY: f64 = 1.25;

/// Two changes with at most so many compiles from one to the next are in a row.
const RECENT_COMPILES: u64 = 8;

/// A geometry that changed so many times in a row goes on doing so.
const FREQUENT_CHANGES: u32 = 3;

/// How often a geometry changes, counted in compiles.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ChangeHistory {
    changed_at: u64,
    changes_in_a_row: u32,
}

impl ChangeHistory {
    /// Of a geometry that is new at this compile.
    pub(super) fn new(now: u64) -> Self {
        Self { changed_at: now, changes_in_a_row: 0 }
    }

    /// The geometry changed again.
    pub(super) fn change(&mut self, now: u64) {
        let is_recent = now - self.changed_at <= RECENT_COMPILES;
        self.changes_in_a_row = if is_recent { self.changes_in_a_row.saturating_add(1) } else { 1 };
        self.changed_at = now;
    }

    /// The structure to build for a geometry: the one that it asks for, else one that suits how often it changes.
    pub(super) fn structure(&self, geometry: &Geometry) -> BlasKind {
        let quality = if self.changes_in_a_row < FREQUENT_CHANGES { Quality::default() } else { Quality::Low };
        geometry.blas_kind.unwrap_or(BlasKind::Bvh(quality))
    }
}

/// What it takes to follow a geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BlasAction {
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
    TrianglesChanged,
    CostGrown,
    StructureChanged,
}

/// What to do about a `structure` that was built for `old`, where there is `new` now.
pub(super) fn choose_action(structure: BlasKind, old: &Geometry, new: &Geometry) -> BlasAction {
    // At once where they are shared.
    if !Arc::ptr_eq(&old.indices, &new.indices) && old.indices != new.indices {
        return BlasAction::Build(BuildReason::TrianglesChanged);
    }
    if new.blas_kind.is_some_and(|chosen| chosen != structure) {
        return BlasAction::Build(BuildReason::StructureChanged);
    }
    // Bit by bit: the signs of zeros are told apart.
    let [old_bits, new_bits] = [old, new].map(|geometry| bytemuck::cast_slice::<_, u32>(&geometry.positions));
    if Arc::ptr_eq(&old.positions, &new.positions) || old_bits == new_bits {
        return BlasAction::Keep;
    }
    match structure {
        BlasKind::Bvh(Quality::Low | Quality::Medium) => BlasAction::Refit,
        // Their leaves hold parts of triangles: whole ones would make them worse than a new structure.
        BlasKind::Bvh(Quality::High) | BlasKind::KdTree => BlasAction::Build(BuildReason::StructureChanged),
    }
}

/// Why bottom-level structures were built: how many for each reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct BlasBuildReasons {
    /// Their geometry was not visible before.
    pub new: usize,
    /// Their geometry got other triangles, or some triangles got or lost two equal corners.
    pub triangles_changed: usize,
    /// Their geometry had deformed so far that refitting made them a quarter dearer than they were when built.
    pub cost_grown: usize,
    /// Their geometry asked for another structure, or deformed and asks for one that is not refitted.
    pub structure_changed: usize,
}

impl BlasBuildReasons {
    pub(super) fn count(&mut self, reason: BuildReason) {
        *match reason {
            BuildReason::New => &mut self.new,
            BuildReason::TrianglesChanged => &mut self.triangles_changed,
            BuildReason::CostGrown => &mut self.cost_grown,
            BuildReason::StructureChanged => &mut self.structure_changed,
        } += 1;
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    const FAST: BlasKind = BlasKind::Bvh(Quality::Low);
    const BALANCED: BlasKind = BlasKind::Bvh(Quality::Medium);

    /// What would be built after changes at these compiles.
    fn built_after(compiles: &[u64]) -> BlasKind {
        let mut history = ChangeHistory::new(0);
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
        let mut history = ChangeHistory::new(0);
        let geometry = Geometry::default().with_blas_kind(BlasKind::KdTree);
        assert_eq!(history.structure(&geometry), BlasKind::KdTree);
        (1..10).for_each(|now| history.change(now));
        assert_eq!(history.structure(&geometry), BlasKind::KdTree);
    }

    #[test]
    fn each_change_takes_no_more_than_it_must() {
        let old = Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 2]]);
        let copy = Geometry::new(old.positions.to_vec(), old.indices.to_vec());
        let moved = Geometry { positions: [Vec3::ZERO, Vec3::X, Vec3::Z].into(), ..old.clone() };
        let turned = Geometry { indices: [[0, 2, 1]].into(), ..old.clone() };
        let signed = Geometry { positions: [-Vec3::ZERO, Vec3::X, Vec3::Y].into(), ..old.clone() };
        for structure in [FAST, BALANCED] {
            assert_eq!(choose_action(structure, &old, &old), BlasAction::Keep);
            assert_eq!(choose_action(structure, &old, &copy), BlasAction::Keep);
            assert_eq!(choose_action(structure, &old, &moved), BlasAction::Refit);
            assert_eq!(choose_action(structure, &old, &signed), BlasAction::Refit, "bit by bit");
            assert_eq!(choose_action(structure, &copy, &moved), BlasAction::Refit, "triangles equal, not shared");
            assert_eq!(choose_action(structure, &old, &turned), BlasAction::Build(BuildReason::TrianglesChanged));
            assert_eq!(choose_action(structure, &old, &old.clone().with_blas_kind(structure)), BlasAction::Keep);
        }
        for structure in [BlasKind::KdTree, BlasKind::Bvh(Quality::High)] {
            assert_eq!(
                choose_action(structure, &old, &old),
                BlasAction::Keep,
                "nothing is chosen any more: what is there will do"
            );
            assert_eq!(choose_action(structure, &old, &moved), BlasAction::Build(BuildReason::StructureChanged));
            assert_eq!(
                choose_action(FAST, &old, &old.clone().with_blas_kind(structure)),
                BlasAction::Build(BuildReason::StructureChanged)
            );
        }
    }
}
