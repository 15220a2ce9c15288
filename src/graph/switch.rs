//! Switches: select which children of a node are visible.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

/// Shows some children of a node with everything below them, and hides the others: states of a machine, variants of a
/// product. Children are indexed from 0 in their order; indices without a child are ignored.
///
/// As OpenSG's `Switch`, which has none, one and all but not arbitrary sets.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Switch {
    /// No child.
    None,
    /// This child.
    One(u32),
    /// All children.
    #[default]
    All,
    /// These children.
    Set(BTreeSet<u32>),
}

impl Switch {
    /// Whether the child with this index is shown. O(log n) of the set.
    pub fn shows(&self, child: u32) -> bool {
        match self {
            Self::None => false,
            Self::One(shown) => *shown == child,
            Self::All => true,
            Self::Set(shown) => shown.contains(&child),
        }
    }
}
