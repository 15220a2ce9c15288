//! The top level: a hierarchy over instances, in device world space, built once and then kept up with what changes.
//!
//! [`TopLevel`] knows where each instance's leaf is and how good the hierarchy still is, and picks the least update:
//!
//! - A few boxes changed: their leaves are patched, and of their ancestors those whose box changes (`bottom_up`).
//! - Many changed: one pass over all nodes, children before parents (`bottom_up`).
//! - The hierarchy has become bad, or has no room: a new one (`accel::cluster`, `flatten`).
//!
//! Instances come and go without a rebuild: a leaf that loses its instance stays as an [unused](Node::unused) one, and takes
//! the next that comes (`leaves`). In a scene where that has happened, a rebuild leaves some room.

mod bottom_up;
mod cost;
mod flatten;
mod leaves;

use std::collections::BinaryHeap;
use std::fmt;

use serde::Serialize;

use self::cost::Cost;
use self::leaves::Leaves;
use super::cluster::{self, Order, finite};
use super::stats::Stats;
use super::validate::{StructureError, check_nodes};
use crate::device::DeviceBuffer;
use crate::device::layout::{NONE, Node, PrimitiveRange};
use crate::math::Aabb;

/// A top-level structure: what it takes to keep an array of nodes up to date. A leaf holds one instance.
///
/// Instances are numbered by *slot*, their index in the `instances` array of the device. Every call gets the boxes of all
/// slots, in device world space, and the same `nodes`, which nobody else writes. A slot whose box is empty (or NaN) is in no
/// leaf; slots beyond the slice are as empty. An infinite box is cut to the range of `f32`. A box must hold the instance with
/// all rounding errors of its transform; rounding in traversal is taken care of here.
///
/// Memory: 64 bytes an instance in `nodes`, 12 here.
///
/// ```
/// use ropewalk::accel::{TopLevel, Update};
/// use ropewalk::device::DeviceBuffer;
/// use ropewalk::glam::Vec3;
/// use ropewalk::math::Aabb;
///
/// let cube = |x: f32| Aabb { min: Vec3::new(x, 0.0, 0.0), max: Vec3::new(x + 1.0, 1.0, 1.0) };
/// let mut boxes: Vec<Aabb> = (0..100).map(|i| cube(2.0 * i as f32)).collect();
/// let (mut top_level, mut nodes) = (TopLevel::default(), DeviceBuffer::default());
/// top_level.build(&mut nodes, &boxes);
/// assert_eq!(top_level.instance_count(), 100);
///
/// boxes[7].max.y += 0.5;
/// let update = top_level.update(&mut nodes, &boxes, &[7]);
/// assert!(matches!(update, Update::Patched { instances: 1, .. }));
/// ```
#[derive(Debug, Default)]
pub struct TopLevel {
    leaves: Leaves,
    /// The parent of each node; [`NONE`] for the root.
    parents: Vec<u32>,
    cost: Cost,
    /// Inner nodes whose box may have changed. Empty between calls.
    stale: BinaryHeap<u32>,
    /// Whether a rebuild is to leave room: instances have come that found none.
    leaves_room: bool,
}

/// What became of the hierarchy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Update {
    /// No box changed.
    #[default]
    Kept,
    /// A few leaves changed, and those of their ancestors whose boxes did.
    Patched {
        /// Leaves that changed.
        instances: usize,
        /// Nodes that changed, leaves included.
        nodes: usize,
    },
    /// All boxes were computed anew; which node lies where stayed.
    Refitted {
        /// Slots given as changed whose leaf changed or may have.
        instances: usize,
    },
    /// The hierarchy was built anew.
    Rebuilt(Rebuild),
}

/// Why the hierarchy was built anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Rebuild {
    /// There was nothing in it before.
    Empty,
    /// More instances came than there were unused leaves.
    NoRoom,
    /// More than half of the leaves were unused.
    Sparse,
    /// Instances have moved so far that the nodes' boxes had grown past [`TopLevel::MAX_DECAY`].
    Decayed,
}

impl fmt::Display for Update {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kept => f.write_str("kept"),
            Self::Patched { instances, nodes } => write!(f, "patched (instances: {instances}, nodes: {nodes})"),
            Self::Refitted { instances } => write!(f, "refitted (instances: {instances})"),
            Self::Rebuilt(Rebuild::Empty) => f.write_str("built"),
            Self::Rebuilt(Rebuild::NoRoom) => f.write_str("rebuilt (no room for new instances)"),
            Self::Rebuilt(Rebuild::Sparse) => f.write_str("rebuilt (half empty)"),
            Self::Rebuilt(Rebuild::Decayed) => f.write_str("rebuilt (decayed)"),
        }
    }
}

impl TopLevel {
    /// How much dearer a hierarchy may get than it was when built, before it is built anew. Measured as the sum of the areas of
    /// all inner nodes below the root, and as the [cost](Self::sah_cost), whichever grew more.
    pub const MAX_DECAY: f64 = 1.5;

    /// No hierarchy has more levels than this.
    pub const MAX_DEPTH: usize = cluster::MAX_DEPTH + 1;

    /// Of `LEAVES_A_PATCH` leaves one may change, for patching to be worth it.
    const LEAVES_A_PATCH: usize = 16;

    /// Builds the hierarchy anew, on all threads of the current rayon pool where there are many instances; the result does not
    /// depend on the number of threads. O(n).
    ///
    /// # Panics
    /// In debug builds, if there are 2^28 slots or more (34 GB of instances).
    pub fn build(&mut self, nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb]) {
        if boxes.len() < cluster::TASK_MINIMUM {
            self.build_here(nodes, boxes);
        } else {
            // One entry into the pool, not one for each parallel loop.
            rayon::scope(|_| self.build_here(nodes, boxes));
        }
        debug_assert_eq!(self.validate(nodes, boxes), Ok(()));
    }

    fn build_here(&mut self, nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb]) {
        // 1. Instances that are near each other in space become near each other in an array.
        let order = Order::new(boxes);
        // 2. Neighbours merge, until one cluster is left.
        let tree = flatten::Tree::new(order);
        // 3. Device nodes.
        let room = if self.leaves_room { leaves::room(tree.leaf_count()) } else { 0 };
        let len = flatten::node_count(&tree, room);
        self.parents = bytemuck::zeroed_vec(len);
        self.leaves.reset(boxes.len(), tree.leaf_count());
        let sums = flatten::flatten(&tree, room, nodes.rewrite(len), &mut self.parents, &mut self.leaves);
        self.cost = Cost::new(sums, nodes);
        self.stale.clear();
    }

    /// Brings the hierarchy up to date with `boxes`, of which those of the slots in `changed` may differ from the last call's:
    /// in any order, also more than once, also ones that did not change.
    ///
    /// O(c log n) for c changes where they are few, else O(n).
    pub fn update(&mut self, nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb], changed: &[u32]) -> Update {
        let reason = if self.instance_count() == 0 {
            Rebuild::Empty
        } else {
            match self.update_in_place(nodes, boxes, changed) {
                Ok(update) => return update,
                Err(reason) => reason,
            }
        };
        self.leaves_room |= reason == Rebuild::NoRoom;
        let was_empty = nodes.is_empty();
        self.build(nodes, boxes);
        if was_empty && nodes.is_empty() { Update::Kept } else { Update::Rebuilt(reason) }
    }

    fn update_in_place(
        &mut self,
        nodes: &mut DeviceBuffer<Node>,
        boxes: &[Aabb],
        changed: &[u32],
    ) -> Result<Update, Rebuild> {
        self.leaves.resize(boxes.len());
        let refits = changed.len() > self.leaves.count() / Self::LEAVES_A_PATCH + Self::LEAVES_A_PATCH;
        // 1. Leaves.
        let mut instances = 0;
        for &slot in changed {
            instances += usize::from(self.update_leaf(nodes, boxes, slot, refits)?);
        }
        if instances == 0 {
            return Ok(Update::Kept);
        }
        if self.leaves.is_sparse() {
            return Err(Rebuild::Sparse);
        }
        // 2. Inner nodes.
        let mut written = instances;
        if refits {
            let some_came_or_went = !self.stale.is_empty();
            self.stale.clear();
            let (areas, has_moved) = bottom_up::refit(nodes, boxes);
            self.cost.set(areas);
            if !(some_came_or_went || has_moved) {
                return Ok(Update::Kept);
            }
        } else {
            written += self.update_ancestors(nodes);
        }
        // 3. Traversal ends at the last node.
        written += self.fill_last(nodes);
        self.cost.settle(nodes);
        if self.cost.decay(nodes) > Self::MAX_DECAY {
            return Err(Rebuild::Decayed);
        }
        Ok(if refits { Update::Refitted { instances } } else { Update::Patched { instances, nodes: written } })
    }

    /// How many instances there are in the leaves.
    pub fn instance_count(&self) -> usize {
        self.leaves.used_count()
    }

    /// The [cost](Stats::sah_cost) of the hierarchy in `nodes`, kept up with every update. O(1).
    pub fn sah_cost(&self, nodes: &[Node]) -> f64 {
        self.cost.sah_cost(nodes)
    }

    /// Sizes and quality of `nodes`, measured. O(n).
    pub fn stats(&self, nodes: &[Node]) -> Stats {
        Stats { bytes: size_of_val(nodes), ..Stats::of(nodes, 1.0) }
    }

    /// Checks what traversal and the next update rely on: escape order, containment, every slot with a box in exactly one
    /// leaf, and that leaf known. `boxes` as they were at the last call. O(n).
    ///
    /// # Errors
    /// The first [`StructureError`] found.
    pub fn validate(&self, nodes: &[Node], boxes: &[Aabb]) -> Result<(), StructureError> {
        let mut found = vec![false; boxes.len()];
        check_nodes(nodes, |range| {
            let bounds = boxes.get(range.first() as usize).and_then(finite)?;
            let is_new = range.count() == 1 && !std::mem::replace(&mut found[range.first() as usize], true);
            is_new.then_some(bounds)
        })?;
        for ((slot, found), bounds) in (0..).zip(found).zip(boxes) {
            let leaf = self.leaves.leaf(slot);
            let is_known = leaf.is_some_and(|leaf| nodes[leaf as usize].primitives == PrimitiveRange::leaf(slot, 1));
            let expected = finite(bounds).is_some();
            if found != expected || is_known != expected {
                return Err(StructureError::Missing { primitive: slot });
            }
        }
        Ok(())
    }

    /// Gives a slot a leaf if it needs one, takes it away if it does not, and writes its box, which a refit would do anyway.
    /// Whether anything changed, as far as is known.
    fn update_leaf(
        &mut self,
        nodes: &mut DeviceBuffer<Node>,
        boxes: &[Aabb],
        slot: u32,
        refits: bool,
    ) -> Result<bool, Rebuild> {
        let bounds = boxes.get(slot as usize).and_then(finite);
        let leaf = match (self.leaves.leaf(slot), bounds) {
            (None, None) => return Ok(false),
            (Some(_), Some(_)) if refits => return Ok(true),
            (Some(leaf), Some(_)) => leaf,
            (Some(leaf), None) => {
                self.leaves.release(slot, leaf);
                leaf
            }
            (None, Some(bounds)) => {
                let growth = |leaf, most| bottom_up::growth(nodes, &self.parents, leaf, &bounds, most);
                self.leaves.take(slot, growth).ok_or(Rebuild::NoRoom)?
            }
        };
        let escape_index = nodes[leaf as usize].escape_index;
        let node = bounds.map_or(Node::unused(escape_index), |b| flatten::leaf(slot, &b, escape_index));
        Ok(self.write(nodes, leaf, node))
    }

    /// Writes a node, and has its parent looked at. Whether it changed.
    fn write(&mut self, nodes: &mut DeviceBuffer<Node>, index: u32, node: Node) -> bool {
        let old = nodes[index as usize];
        if old == node {
            return false;
        }
        nodes.set(index as usize, node);
        self.cost.replace(index, &old, &node);
        if index > 0 {
            self.stale.push(self.parents[index as usize]);
        }
        true
    }

    /// Brings the boxes of stale nodes up to date, children before parents: a parent has a lower index. Returns how many
    /// changed.
    fn update_ancestors(&mut self, nodes: &mut DeviceBuffer<Node>) -> usize {
        let mut written = 0;
        while let Some(index) = self.stale.pop() {
            if self.stale.peek() != Some(&index) {
                let node = bottom_up::around_children(nodes, index as usize);
                written += usize::from(self.write(nodes, index, node));
            }
        }
        written
    }

    /// Moves an instance to the last leaf if that is unused: the nearest in the array. O(log n). Returns how many nodes changed.
    fn fill_last(&mut self, nodes: &mut DeviceBuffer<Node>) -> usize {
        let last = nodes.len() as u32 - 1;
        if !nodes[last as usize].is_unused() {
            return 0;
        }
        let from = bottom_up::last_used_leaf(nodes, &self.parents);
        let source = nodes[from as usize];
        self.leaves.relocate(source.primitives.first(), from, last);
        self.write(nodes, last, Node { escape_index: NONE, ..source });
        self.write(nodes, from, Node::unused(source.escape_index));
        2 + self.update_ancestors(nodes)
    }
}
