//! What becomes of the top level when boxes have changed: the choices, and nothing else.
//!
//! | what is so | what is done |
//! |---|---|
//! | there is no instance yet | a build ([`RebuildReason::Empty`]) |
//! | few boxes changed | a patch of their leaves and of those leaves' ancestors |
//! | more than 1 in 16 changed | a refit of all nodes |
//! | an instance came and no leaf is unused | a rebuild ([`RebuildReason::NoUnusedLeaf`]), and from then on with spare leaves |
//! | more leaves are unused than used | a rebuild ([`RebuildReason::Sparse`]) |
//! | after the patch or refit the boxes have grown too much | a rebuild ([`RebuildReason::Decayed`]) |
//! | no box turned out to differ | nothing |

use serde::Serialize;

/// How much the hierarchy's cost may grow, relative to when it was built, before it is built anew.
pub(super) const MAX_DECAY: f64 = 1.5;

/// One change in so many leaves is worth a patch; where more change, a refit of all nodes takes less time.
const LEAVES_PER_PATCH: usize = 16;

/// How changed boxes are brought into the hierarchy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// Each changed leaf, and of its ancestors those whose box changes.
    Patch,
    /// All nodes, children before parents.
    Refit,
    Rebuild(RebuildReason),
}

/// Why the hierarchy was built anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum RebuildReason {
    /// There was nothing in it before.
    Empty,
    /// More instances came than there were unused leaves.
    NoUnusedLeaf,
    /// More than half of the leaves were unused.
    Sparse,
    /// Instances have moved so far that the nodes' boxes had grown past [`Tlas::MAX_DECAY`](super::Tlas::MAX_DECAY).
    Decayed,
}

/// How to take in `changed` boxes, where so many leaves are used and unused.
pub(super) fn step(used_leaves: usize, unused_leaves: usize, changed: usize) -> Step {
    if used_leaves == 0 {
        Step::Rebuild(RebuildReason::Empty)
    } else if changed > (used_leaves + unused_leaves) / LEAVES_PER_PATCH + LEAVES_PER_PATCH {
        Step::Refit
    } else {
        Step::Patch
    }
}

/// Whether a hierarchy whose leaves are up to date is too sparse to be kept.
pub(super) fn check_sparse(used_leaves: usize, unused_leaves: usize) -> Result<(), RebuildReason> {
    if unused_leaves > used_leaves { Err(RebuildReason::Sparse) } else { Ok(()) }
}

/// Whether a hierarchy that is up to date costs too much to be kept; `decay` is its cost relative to when it was built.
pub(super) fn check_decay(decay: f64) -> Result<(), RebuildReason> {
    if decay > MAX_DECAY { Err(RebuildReason::Decayed) } else { Ok(()) }
}

/// How many unused leaves to build beside those of `instance_count` instances, in a scene where instances have come that found
/// no leaf (`has_run_out`). None in other scenes: most never get another instance.
pub(super) fn spare_leaves(instance_count: usize, has_run_out: bool) -> usize {
    if has_run_out { (instance_count / 64).max((instance_count / 4).min(8)) } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_changes_are_patched_many_refitted() {
        let table = [
            // used, unused, changed
            (0, 0, 1, Step::Rebuild(RebuildReason::Empty)),
            (0, 8, 1, Step::Rebuild(RebuildReason::Empty)),
            (1, 0, 0, Step::Patch),
            (1, 0, 16, Step::Patch),
            (1, 0, 17, Step::Refit),
            (1_600, 0, 116, Step::Patch),
            (1_600, 0, 117, Step::Refit),
            (800, 800, 116, Step::Patch),
            (800, 800, 117, Step::Refit),
        ];
        for (used, unused, changed, expected) in table {
            assert_eq!(step(used, unused, changed), expected, "{used} used, {unused} unused, {changed} changed");
        }
    }

    #[test]
    fn what_is_half_empty_or_has_decayed_is_rebuilt() {
        assert_eq!(check_sparse(4, 4), Ok(()));
        assert_eq!(check_sparse(4, 5), Err(RebuildReason::Sparse));
        assert_eq!(check_decay(MAX_DECAY), Ok(()));
        assert_eq!(check_decay(MAX_DECAY.next_up()), Err(RebuildReason::Decayed));
    }

    #[test]
    fn leaves_are_spared_where_they_have_run_out() {
        let table = [(0, 0), (3, 0), (4, 1), (31, 7), (32, 8), (512, 8), (576, 9), (64_000, 1_000)];
        for (instances, spare) in table {
            assert_eq!(spare_leaves(instances, true), spare, "{instances}");
            assert_eq!(spare_leaves(instances, false), 0, "{instances}");
        }
    }
}
