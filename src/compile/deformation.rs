//! The policy for a BLAS whose geometry changed: keep, refit or build, and with which builder. Decisions only.

use std::sync::Arc;

use serde::Serialize;

use crate::accel::Tlas;
use crate::graph::{BlasKind, Geometry, Quality};

/// A refitted structure is rebuilt when its SAH cost exceeds this multiple of its cost after the last build, unless
/// there is [another limit](RebuildLimits). `docs/BENCHMARKS.md` has the cost of rays at other limits.
pub(super) const MAX_BLAS_COST_RATIO: f64 = 1.25;

/// When structures that were refitted or patched are rebuilt: at which multiple of their SAH cost after the last build.
/// 1 is whenever it has grown at all, infinity never.
///
/// Less makes rays faster and updates slower. The defaults suit scenes that are drawn once after each change.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct RebuildLimits {
    /// Of bottom-level structures, whose geometry deforms; 1.25 by default.
    pub max_blas_cost_ratio: f64,
    /// Of the top level; 1.5 by default ([`Tlas::MAX_COST_RATIO`]).
    pub max_tlas_cost_ratio: f64,
}

impl Default for RebuildLimits {
    fn default() -> Self {
        Self { max_blas_cost_ratio: MAX_BLAS_COST_RATIO, max_tlas_cost_ratio: Tlas::MAX_COST_RATIO }
    }
}

impl RebuildLimits {
    /// The same with another limit for bottom-level structures.
    #[must_use]
    pub fn with_max_blas_cost_ratio(self, max_blas_cost_ratio: f64) -> Self {
        Self { max_blas_cost_ratio, ..self }
    }

    /// The same with another limit for the top level.
    #[must_use]
    pub fn with_max_tlas_cost_ratio(self, max_tlas_cost_ratio: f64) -> Self {
        Self { max_tlas_cost_ratio, ..self }
    }
}

/// Two changes at most this many compiles apart count as consecutive.
const RECENT_COMPILES: u64 = 8;

/// A geometry with this many consecutive changes is expected to keep changing, and gets the fast builder.
const FREQUENT_CHANGES: u32 = 3;

/// How often a geometry changes, counted in compiles.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ChangeHistory {
    /// The number of the compile that saw the last change.
    changed_at: u64,
    consecutive_changes: u32,
}

impl ChangeHistory {
    /// The history of a geometry that is new at this compile.
    pub(super) fn new(compile_index: u64) -> Self {
        Self { changed_at: compile_index, consecutive_changes: 0 }
    }

    /// Records that this compile saw a change.
    pub(super) fn record_change(&mut self, compile_index: u64) {
        let is_recent = compile_index - self.changed_at <= RECENT_COMPILES;
        self.consecutive_changes = if is_recent { self.consecutive_changes.saturating_add(1) } else { 1 };
        self.changed_at = compile_index;
    }

    /// The structure to build for a geometry: the one that it requests, else one by how often it changes.
    pub(super) fn structure(&self, geometry: &Geometry) -> BlasKind {
        let quality = if self.consecutive_changes < FREQUENT_CHANGES { Quality::default() } else { Quality::Low };
        geometry.blas_kind.unwrap_or(BlasKind::Bvh(quality))
    }
}

/// What has to be done for a changed geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BlasAction {
    /// Nothing: the structure is still right, only other streams changed.
    Keep,
    /// Recompute the boxes in the unchanged hierarchy.
    Refit,
    /// Build a new structure.
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

/// What to do with a `structure` that was built for the `old` value of a geometry that now has a `new` one.
pub(super) fn choose_action(structure: BlasKind, old: &Geometry, new: &Geometry) -> BlasAction {
    // 1. Another list of triangles needs another hierarchy. The pointer comparison settles shared arrays in O(1).
    if !Arc::ptr_eq(&old.indices, &new.indices) && old.indices != new.indices {
        return BlasAction::Build(BuildReason::TrianglesChanged);
    }
    // 2. The geometry requests a structure that it does not have.
    if new.blas_kind.is_some_and(|chosen| chosen != structure) {
        return BlasAction::Build(BuildReason::StructureChanged);
    }
    // 3. Equal positions, bit by bit: the device holds the signs of zeros, too.
    let [old_bits, new_bits] = [old, new].map(|geometry| bytemuck::cast_slice::<_, u32>(&geometry.positions));
    if Arc::ptr_eq(&old.positions, &new.positions) || old_bits == new_bits {
        return BlasAction::Keep;
    }
    // 4. Vertices have moved: refit what can be refitted.
    match structure {
        BlasKind::Bvh(Quality::Low | Quality::Medium) => BlasAction::Refit,
        // The leaves of these hold clipped triangles; refitting with unclipped ones would give a worse structure than a
        // new build.
        BlasKind::Bvh(Quality::High) | BlasKind::KdTree => BlasAction::Build(BuildReason::StructureChanged),
    }
}

/// How many bottom-level structures were built for which reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct BlasBuildReasons {
    /// The geometry came into use.
    pub new: usize,
    /// The geometry's list of triangles changed, a triangle became or ceased to be degenerate, or one ceased to
    /// coincide with another.
    pub triangles_changed: usize,
    /// Refitting had raised the SAH cost to more than 1.25 times the cost after the last build.
    pub cost_grown: usize,
    /// The geometry requested another structure, or deformed and has one that cannot be refitted.
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

    /// The structure that is built after changes at these compiles.
    fn built_after(compiles: &[u64]) -> BlasKind {
        let mut history = ChangeHistory::new(0);
        compiles.iter().for_each(|&compile_index| history.record_change(compile_index));
        history.structure(&Geometry::default())
    }

    #[test]
    fn what_changes_frame_after_frame_is_built_fast() {
        assert_eq!(built_after(&[]), BALANCED);
        assert_eq!(built_after(&[1, 2]), BALANCED);
        assert_eq!(built_after(&[1, 2, 3]), FAST);
        assert_eq!(built_after(&[8, 16, 24]), FAST, "every eighth compile");
        assert_eq!(built_after(&[9, 18, 27, 36]), BALANCED, "now and then");
        assert_eq!(built_after(&[1, 2, 3, 4, 100]), BALANCED, "it had stopped changing");
    }

    #[test]
    fn an_explicit_choice_wins() {
        let mut history = ChangeHistory::new(0);
        let geometry = Geometry::default().with_blas_kind(BlasKind::KdTree);
        assert_eq!(history.structure(&geometry), BlasKind::KdTree);
        (1..10).for_each(|compile_index| history.record_change(compile_index));
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
                "no structure is requested any more: any will do"
            );
            assert_eq!(choose_action(structure, &old, &moved), BlasAction::Build(BuildReason::StructureChanged));
            assert_eq!(
                choose_action(FAST, &old, &old.clone().with_blas_kind(structure)),
                BlasAction::Build(BuildReason::StructureChanged)
            );
        }
    }
}
