//! What an update of the top level reports.

use std::fmt;

use serde::Serialize;

/// How an update changed the hierarchy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum TlasUpdate {
    /// No box changed, or there was no instance before and there is none now.
    #[default]
    Kept,
    /// The leaves of some instances were rewritten, and those of their ancestors whose boxes changed.
    Patched {
        /// Leaves that changed.
        instances: usize,
        /// Nodes that changed, leaves included.
        nodes: usize,
    },
    /// All boxes were recomputed bottom up; the hierarchy stayed as it was.
    Refitted {
        /// How many of the given changed instances have a box now or lost theirs. (The refit may find that some boxes
        /// are equal to before.)
        instances: usize,
    },
    /// The hierarchy was rebuilt.
    Rebuilt(RebuildReason),
}

/// Why the hierarchy was rebuilt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum RebuildReason {
    /// No instance was in the hierarchy before.
    Empty,
    /// An instance was added and no unused leaf was left.
    NoUnusedLeaf,
    /// More than half of the leaves were unused.
    Sparse,
    /// The cost relative to the last build exceeded [`Tlas::MAX_COST_RATIO`](super::Tlas::MAX_COST_RATIO).
    CostGrown,
}

impl fmt::Display for TlasUpdate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kept => f.write_str("kept"),
            Self::Patched { instances, nodes } => write!(f, "patched (instances: {instances}, nodes: {nodes})"),
            Self::Refitted { instances } => write!(f, "refitted (instances: {instances})"),
            Self::Rebuilt(RebuildReason::Empty) => f.write_str("built"),
            Self::Rebuilt(RebuildReason::NoUnusedLeaf) => f.write_str("rebuilt (no unused leaf)"),
            Self::Rebuilt(RebuildReason::Sparse) => f.write_str("rebuilt (sparse)"),
            Self::Rebuilt(RebuildReason::CostGrown) => f.write_str("rebuilt (cost grown)"),
        }
    }
}
