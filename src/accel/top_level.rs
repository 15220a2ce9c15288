//! Stand-in for the maintained top level.

use std::fmt;

use serde::Serialize;

use super::Tlas;
use crate::device::DeviceBuffer;
use crate::device::layout::Node;
use crate::math::Aabb;

/// A top level that is kept up with its instances.
#[derive(Debug, Default)]
pub struct TopLevel {
    count: usize,
}

/// What became of the hierarchy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Update {
    /// No box changed.
    #[default]
    Kept,
    /// A few leaves changed.
    Patched {
        /// Leaves that changed.
        instances: usize,
        /// Nodes that changed.
        nodes: usize,
    },
    /// All boxes were computed anew.
    Refitted {
        /// Leaves that changed.
        instances: usize,
    },
    /// Built anew.
    Rebuilt(Rebuild),
}

/// Why the hierarchy was built anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Rebuild {
    /// There was nothing in it before.
    Empty,
    /// No room.
    NoRoom,
    /// Sparse.
    Sparse,
    /// Decayed.
    Decayed,
}

impl fmt::Display for Update {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self:?}")
    }
}

impl TopLevel {
    /// Brings it up to date.
    pub fn update(&mut self, nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb], changed: &[u32]) -> Update {
        if changed.is_empty() {
            return Update::Kept;
        }
        let slots: Vec<u32> = (0..boxes.len() as u32).collect();
        nodes.replace(&Tlas::build(boxes, &slots).nodes);
        let was = std::mem::replace(&mut self.count, nodes.len());
        if was == 0 { Update::Rebuilt(Rebuild::Empty) } else { Update::Rebuilt(Rebuild::Decayed) }
    }
}
