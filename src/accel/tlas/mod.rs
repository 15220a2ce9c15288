//! The top level: a hierarchy over instances, in device world space, built once and then kept up with what changes.
//!
//! [`Tlas`] knows where each instance's leaf is and how good the hierarchy still is, and picks the least update:
//!
//! - A few boxes changed: their leaves are patched, and of their ancestors those whose box changes (`bottom_up`).
//! - Many changed: one pass over all nodes, children before parents (`bottom_up`).
//! - The hierarchy has become bad, or has no room: a new one (`accel::cluster`, `flatten`).
//!
//! Instances come and go without a rebuild: a leaf that loses its instance stays as an [unused](Node::unused_leaf) one, and takes
//! the next that comes (`leaves`). In a scene where that has happened, a rebuild leaves some room.

mod build;
mod cost;
mod leaf_table;
mod node;
mod patch;
mod policy;
mod refit;

use std::collections::BinaryHeap;
use std::fmt;

use serde::Serialize;

use self::cost::CostTracker;
use self::leaf_table::LeafTable;
pub use self::policy::RebuildReason;
use self::policy::Step;
use super::stats::BvhStats;
use super::validate::{BvhError, validate_nodes};
use crate::accel::build::agglomerative::{self, MortonOrder, clamp_to_f32};
use crate::device::DeviceBuffer;
use crate::device::layout::{Node, PrimitiveRange};
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
/// use ropewalk::accel::{Tlas, TlasUpdate};
/// use ropewalk::device::DeviceBuffer;
/// use ropewalk::glam::Vec3;
/// use ropewalk::math::Aabb;
///
/// let cube = |x: f32| Aabb { min: Vec3::new(x, 0.0, 0.0), max: Vec3::new(x + 1.0, 1.0, 1.0) };
/// let mut boxes: Vec<Aabb> = (0..100).map(|i| cube(2.0 * i as f32)).collect();
/// let (mut tlas, mut nodes) = (Tlas::default(), DeviceBuffer::default());
/// tlas.build(&mut nodes, &boxes);
/// assert_eq!(tlas.instance_count(), 100);
///
/// boxes[7].max.y += 0.5;
/// let update = tlas.update(&mut nodes, &boxes, &[7]);
/// assert!(matches!(update, TlasUpdate::Patched { instances: 1, .. }));
/// ```
#[derive(Debug, Default)]
pub struct Tlas {
    leaves: LeafTable,
    /// The parent of each node; `NONE` for the root.
    parents: Vec<u32>,
    cost: CostTracker,
    /// Inner nodes whose box may have changed. Empty between calls.
    stale_ancestors: BinaryHeap<u32>,
    /// Whether instances have come that found no unused leaf: a rebuild then leaves some.
    has_run_out: bool,
}

/// What became of the hierarchy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum TlasUpdate {
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
    Rebuilt(RebuildReason),
}

impl fmt::Display for TlasUpdate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kept => f.write_str("kept"),
            Self::Patched { instances, nodes } => write!(f, "patched (instances: {instances}, nodes: {nodes})"),
            Self::Refitted { instances } => write!(f, "refitted (instances: {instances})"),
            Self::Rebuilt(RebuildReason::Empty) => f.write_str("built"),
            Self::Rebuilt(RebuildReason::NoUnusedLeaf) => f.write_str("rebuilt (no room for new instances)"),
            Self::Rebuilt(RebuildReason::Sparse) => f.write_str("rebuilt (half empty)"),
            Self::Rebuilt(RebuildReason::Decayed) => f.write_str("rebuilt (decayed)"),
        }
    }
}

impl Tlas {
    /// How much dearer a hierarchy may get than it was when built, before it is built anew. Measured as the sum of the areas of
    /// all inner nodes below the root, and as the [cost](Self::sah_cost), whichever grew more.
    pub const MAX_DECAY: f64 = policy::MAX_DECAY;

    /// No hierarchy has more levels than this.
    pub const MAX_DEPTH: usize = agglomerative::MAX_CLUSTER_DEPTH + 1;

    /// Builds the hierarchy anew, on all threads of the current rayon pool where there are many instances; the result does not
    /// depend on the number of threads. O(n).
    ///
    /// # Panics
    /// In debug builds, if there are 2^28 slots or more (34 GB of instances).
    pub fn build(&mut self, nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb]) {
        if boxes.len() < agglomerative::TASK_MINIMUM {
            self.build_here(nodes, boxes);
        } else {
            // One entry into the pool, not one for each parallel loop.
            rayon::scope(|_| self.build_here(nodes, boxes));
        }
        debug_assert_eq!(self.validate(nodes, boxes), Ok(()));
    }

    fn build_here(&mut self, nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb]) {
        // 1. Instances that are near each other in space become near each other in an array.
        let order = MortonOrder::new(boxes);
        // 2. Neighbours merge, until one cluster is left.
        let tree = build::ClusterTree::new(order);
        // 3. Device nodes.
        let spare = policy::spare_leaves(tree.leaf_count(), self.has_run_out);
        let len = build::node_count(&tree, spare);
        self.parents = bytemuck::zeroed_vec(len);
        self.leaves.reset(boxes.len(), tree.leaf_count());
        let sums = build::flatten(&tree, spare, nodes.resize_for_overwrite(len), &mut self.parents, &mut self.leaves);
        self.cost = CostTracker::new(sums, nodes);
        self.stale_ancestors.clear();
    }

    /// Brings the hierarchy up to date with `boxes`, of which those of the slots in `changed` may differ from the last call's:
    /// in any order, also more than once, also ones that did not change.
    ///
    /// O(c log n) for c changes where they are few, else O(n).
    pub fn update(&mut self, nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb], changed: &[u32]) -> TlasUpdate {
        let reason = match self.try_update(nodes, boxes, changed) {
            Ok(update) => return update,
            Err(reason) => reason,
        };
        self.has_run_out |= reason == RebuildReason::NoUnusedLeaf;
        let was_empty = nodes.is_empty();
        self.build(nodes, boxes);
        if was_empty && nodes.is_empty() { TlasUpdate::Kept } else { TlasUpdate::Rebuilt(reason) }
    }

    /// Patches or refits the hierarchy, as `policy` decides; the reason where it must be built anew.
    fn try_update(
        &mut self,
        nodes: &mut DeviceBuffer<Node>,
        boxes: &[Aabb],
        changed: &[u32],
    ) -> Result<TlasUpdate, RebuildReason> {
        self.leaves.resize(boxes.len());
        let refits = match policy::step(self.leaves.used_count(), self.leaves.unused_count(), changed.len()) {
            Step::Patch => false,
            Step::Refit => true,
            Step::Rebuild(reason) => return Err(reason),
        };
        // 1. Leaves: instances come and go, and boxes change.
        let mut instances = 0;
        for &slot in changed {
            instances += usize::from(self.patch_leaf(nodes, boxes, slot, refits)?);
        }
        if instances == 0 {
            return Ok(TlasUpdate::Kept);
        }
        policy::check_sparse(self.leaves.used_count(), self.leaves.unused_count())?;
        // 2. Inner nodes.
        let mut written = instances;
        if refits {
            let some_came_or_went = !self.stale_ancestors.is_empty();
            self.stale_ancestors.clear();
            let (areas, has_moved) = refit::refit(nodes, boxes);
            self.cost.reset_sums(areas);
            if !(some_came_or_went || has_moved) {
                return Ok(TlasUpdate::Kept);
            }
        } else {
            written += self.patch_ancestors(nodes);
        }
        // 3. The last node must be in use: traversal ends at it.
        written += self.fill_last_leaf(nodes);
        self.cost.settle(nodes);
        policy::check_decay(self.cost.decay(nodes))?;
        Ok(match refits {
            true => TlasUpdate::Refitted { instances },
            false => TlasUpdate::Patched { instances, nodes: written },
        })
    }

    /// How many instances there are in the leaves.
    pub fn instance_count(&self) -> usize {
        self.leaves.used_count()
    }

    /// The [cost](BvhStats::sah_cost) of the hierarchy in `nodes`, kept up with every update. O(1).
    pub fn sah_cost(&self, nodes: &[Node]) -> f64 {
        self.cost.sah_cost(nodes)
    }

    /// Sizes and quality of `nodes`, measured. O(n).
    pub fn stats(&self, nodes: &[Node]) -> BvhStats {
        BvhStats { bytes: size_of_val(nodes), ..BvhStats::of(nodes, 1.0) }
    }

    /// Checks what traversal and the next update rely on: escape order, containment, every slot with a box in exactly one
    /// leaf, and that leaf known. `boxes` as they were at the last call. O(n).
    ///
    /// # Errors
    /// The first [`BvhError`] found.
    pub fn validate(&self, nodes: &[Node], boxes: &[Aabb]) -> Result<(), BvhError> {
        let mut found = vec![false; boxes.len()];
        validate_nodes(nodes, |range| {
            let bounds = boxes.get(range.first_primitive() as usize).and_then(clamp_to_f32)?;
            let is_new =
                range.primitive_count() == 1 && !std::mem::replace(&mut found[range.first_primitive() as usize], true);
            is_new.then_some(bounds)
        })?;
        for ((slot, found), bounds) in (0..).zip(found).zip(boxes) {
            let leaf = self.leaves.leaf(slot);
            let is_known = leaf.is_some_and(|leaf| nodes[leaf as usize].primitives == PrimitiveRange::leaf(slot, 1));
            let expected = clamp_to_f32(bounds).is_some();
            if found != expected || is_known != expected {
                return Err(BvhError::Missing { primitive: slot });
            }
        }
        Ok(())
    }
}
