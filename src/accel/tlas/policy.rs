//! The policy of the top level: whether an update keeps, patches, refits or rebuilds it. Decisions only.
//!
//! | decided by | condition, the first that holds | action |
//! |---|---|---|
//! | [`choose_action`] | no instance is in the hierarchy | rebuild ([`RebuildReason::Empty`]) |
//! | | more than 1 in 16 leaves, plus 16, are listed as changed | refit |
//! | | otherwise | patch |
//! | [`after_leaves`] | an instance was added and no leaf was unused | rebuild ([`RebuildReason::NoUnusedLeaf`]) |
//! | | no leaf changed | keep |
//! | | more leaves are unused than used | rebuild ([`RebuildReason::Sparse`]) |
//! | | otherwise | as chosen |
//! | [`after_boxes`] | no box changed | keep |
//! | | the cost has grown by more than half (or another limit) since the last build | rebuild ([`RebuildReason::CostGrown`]) |
//! | | otherwise | as chosen |
//!
//! [`reserved_leaf_count`] decides how many unused leaves a rebuild reserves for instances that are added later, and
//! [`report`] what the caller is told.

use super::report::{RebuildReason, TlasUpdate};

/// A hierarchy is rebuilt when its cost exceeds this multiple of its cost after the last build
/// (`docs/benchmarks/log.md`).
pub(super) const MAX_COST_RATIO: f64 = 1.5;

/// Patching is chosen if at most one leaf in this many, plus this many, changed: beyond that a refit is faster.
const LEAVES_PER_PATCHED_LEAF: usize = 16;

/// How the hierarchy is brought up to date.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// It is up to date.
    Keep,
    /// Rewrite the changed leaves, and those of their ancestors whose boxes change.
    Patch,
    /// Recompute all boxes, children before parents.
    Refit,
    /// Build a new hierarchy.
    Rebuild(RebuildReason),
}

/// The leaves of a hierarchy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LeafCounts {
    /// Leaves that hold an instance.
    pub(super) used: usize,
    /// Leaves that hold none.
    pub(super) unused: usize,
}

/// Chooses an action before anything is written. `changed` is the length of the list of changed instances: repeated and
/// unchanged ones count too, since they cost little to patch.
pub(super) fn choose_action(leaves: LeafCounts, changed: usize) -> Action {
    if leaves.used == 0 {
        Action::Rebuild(RebuildReason::Empty)
    } else if changed > (leaves.used + leaves.unused) / LEAVES_PER_PATCHED_LEAF + LEAVES_PER_PATCHED_LEAF {
        Action::Refit
    } else {
        Action::Patch
    }
}

/// Decides again after the leaves were updated, `changed_leaves` of which changed or, in a refit, may have changed.
/// `None` if an instance found no unused leaf.
pub(super) fn after_leaves(chosen: Action, leaves: LeafCounts, changed_leaves: Option<usize>) -> Action {
    match changed_leaves {
        None => Action::Rebuild(RebuildReason::NoUnusedLeaf),
        Some(0) => Action::Keep,
        Some(_) if leaves.unused > leaves.used => Action::Rebuild(RebuildReason::Sparse),
        Some(_) => chosen,
    }
}

/// Decides again after all boxes are up to date. `cost_ratio` is the cost relative to that after the last build, and
/// `max_cost_ratio` its limit.
pub(super) fn after_boxes(chosen: Action, has_changed: bool, cost_ratio: f64, max_cost_ratio: f64) -> Action {
    if !has_changed {
        Action::Keep
    } else if cost_ratio > max_cost_ratio {
        Action::Rebuild(RebuildReason::CostGrown)
    } else {
        chosen
    }
}

/// How many unused leaves a rebuild reserves beside `used` ones: 1/64 of them, but 8 (at most a quarter) in small
/// scenes. None in a scene whose leaves have never run out (`has_run_out`): most scenes never get another instance.
pub(super) fn reserved_leaf_count(used: usize, has_run_out: bool) -> usize {
    if has_run_out { (used / 64).max((used / 4).min(8)) } else { 0 }
}

/// The report of an update that changed this many instances and nodes. A rebuild of an empty hierarchy into an
/// empty one (`stays_empty`) changes nothing.
pub(super) fn report(action: Action, stays_empty: bool, instances: usize, nodes: usize) -> TlasUpdate {
    match action {
        Action::Keep => TlasUpdate::Kept,
        Action::Rebuild(_) if stays_empty => TlasUpdate::Kept,
        Action::Patch => TlasUpdate::Patched { instances, nodes },
        Action::Refit => TlasUpdate::Refitted { instances },
        Action::Rebuild(reason) => TlasUpdate::Rebuilt(reason),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EMPTY: Action = Action::Rebuild(RebuildReason::Empty);
    const NO_UNUSED_LEAF: Action = Action::Rebuild(RebuildReason::NoUnusedLeaf);
    const SPARSE: Action = Action::Rebuild(RebuildReason::Sparse);
    const COST_GROWN: Action = Action::Rebuild(RebuildReason::CostGrown);

    #[test]
    fn few_changes_are_patched_many_refitted() {
        let table = [
            // used, unused, changed
            (0, 0, 1, EMPTY),
            (0, 8, 1, EMPTY),
            (0, 0, 0, EMPTY),
            (1, 0, 0, Action::Patch),
            (1, 0, 16, Action::Patch),
            (1, 0, 17, Action::Refit),
            (1_600, 0, 116, Action::Patch),
            (1_600, 0, 117, Action::Refit),
            (800, 800, 116, Action::Patch),
            (800, 800, 117, Action::Refit),
        ];
        for (used, unused, changed, expected) in table {
            let action = choose_action(LeafCounts { used, unused }, changed);
            assert_eq!(action, expected, "{used} used, {unused} unused, {changed} changed");
        }
    }

    #[test]
    fn leaves_decide_whether_the_hierarchy_stays() {
        let table = [
            // used, unused, changed leaves
            (4, 0, None, NO_UNUSED_LEAF),
            (4, 0, Some(0), Action::Keep),
            (4, 5, Some(0), Action::Keep),
            (4, 4, Some(1), Action::Patch),
            (4, 5, Some(1), SPARSE),
            (0, 1, Some(1), SPARSE),
        ];
        for (used, unused, changed, expected) in table {
            let action = after_leaves(Action::Patch, LeafCounts { used, unused }, changed);
            assert_eq!(action, expected, "{used} used, {unused} unused, {changed:?} changed");
        }
        let leaves = LeafCounts { used: 4, unused: 4 };
        assert_eq!(after_leaves(Action::Refit, leaves, Some(1)), Action::Refit);
    }

    #[test]
    fn boxes_decide_whether_the_hierarchy_stays() {
        let table = [
            // has changed, cost ratio
            (false, 9.0, Action::Keep),
            (true, 1.0, Action::Refit),
            (true, MAX_COST_RATIO, Action::Refit),
            (true, MAX_COST_RATIO.next_up(), COST_GROWN),
        ];
        for (has_changed, cost_ratio, expected) in table {
            let action = after_boxes(Action::Refit, has_changed, cost_ratio, MAX_COST_RATIO);
            assert_eq!(action, expected, "{has_changed}, {cost_ratio}");
        }
        assert_eq!(after_boxes(Action::Patch, true, 1.0, MAX_COST_RATIO), Action::Patch);
        assert_eq!(after_boxes(Action::Patch, true, 9.0, 10.0), Action::Patch);
    }

    #[test]
    fn leaves_are_reserved_where_they_have_run_out() {
        let table = [(0, 0), (3, 0), (4, 1), (31, 7), (32, 8), (511, 8), (512, 8), (513, 8), (576, 9), (64_000, 1_000)];
        for (used, reserved) in table {
            assert_eq!(reserved_leaf_count(used, true), reserved, "{used}");
            assert_eq!(reserved_leaf_count(used, false), 0, "{used}");
        }
    }

    #[test]
    fn reports_name_what_was_done() {
        let table = [
            (Action::Keep, false, TlasUpdate::Kept),
            (Action::Patch, false, TlasUpdate::Patched { instances: 2, nodes: 5 }),
            (Action::Refit, false, TlasUpdate::Refitted { instances: 2 }),
            (SPARSE, false, TlasUpdate::Rebuilt(RebuildReason::Sparse)),
            (EMPTY, false, TlasUpdate::Rebuilt(RebuildReason::Empty)),
            (EMPTY, true, TlasUpdate::Kept),
        ];
        for (action, stays_empty, expected) in table {
            assert_eq!(report(action, stays_empty, 2, 5), expected, "{action:?}, {stays_empty}");
        }
    }
}
