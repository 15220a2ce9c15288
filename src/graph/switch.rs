//! Which children of a node are shown.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

/// Shows some children of a node with everything below them, and hides the others: states of a machine, variants of a
/// product. Children are counted from 0 in their order; a number without a child shows nothing.
///
/// OpenSG's `Switch`, with any set beside none, one and all.
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
    /// Whether the child at this place is shown. O(log n) of the set.
    pub fn shows(&self, child: u32) -> bool {
        match self {
            Self::None => false,
            Self::One(shown) => *shown == child,
            Self::All => true,
            Self::Set(shown) => shown.contains(&child),
        }
    }
}
