//! The top level: a BVH over instances in device world space, kept up to date by patching, refitting or rebuilding.
//!
//! [`Tlas`] knows each instance's leaf (`leaf_table`) and the SAH cost relative to the last build (`cost`), and
//! `policy` chooses the cheapest sufficient update:
//!
//! - Few boxes changed: patch their leaves and the ancestors whose boxes change (`patch`).
//! - Many changed: refit all nodes in one bottom-up pass (`refit`).
//! - The cost has grown too much, no unused leaf is left, or most leaves are unused: rebuild (`build`, by
//!   `accel::build::agglomerative`).
//!
//! Adding and removing an instance needs no rebuild: a removed instance leaves an [unused](Node::unused_leaf) leaf,
//! which the next added instance takes. Once leaves have run out, rebuilds reserve some unused ones.

mod build;
mod cost;
mod leaf_table;
mod node;
mod patch;
mod policy;
mod refit;
mod report;

use std::collections::BinaryHeap;

use self::cost::CostTracker;
use self::leaf_table::LeafTable;
use self::policy::Action;
pub use self::report::{RebuildReason, TlasUpdate};
use super::stats::BvhStats;
use super::validate::{BvhError, validate_nodes};
use crate::accel::build::agglomerative::{self, MortonOrder};
use crate::device::DeviceBuffer;
use crate::device::layout::{Node, PrimitiveRange};
use crate::math::Aabb;

/// The top-level acceleration structure: the bookkeeping that keeps an array of nodes up to date. A leaf holds one
/// instance.
///
/// An instance is identified by its index in the device's `instances` array. Every call gets the boxes of all
/// instances, in device world space (relative to the render origin), and the same `nodes`, which nobody else may write.
/// An instance whose box is empty or NaN gets no leaf, as does one beyond the slice. An infinite box is clamped to
/// finite f32. A box must contain the instance including all rounding of its transform; rounding in traversal is
/// covered by padding here.
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
#[derive(Debug)]
pub struct Tlas {
    leaves: LeafTable,
    /// The index of each node's parent; `NONE` for the root.
    parents: Vec<u32>,
    cost: CostTracker,
    /// A max-heap of inner nodes whose boxes may be out of date; children have higher indices than their parents. Empty
    /// between calls.
    stale_ancestors: BinaryHeap<u32>,
    /// Whether rebuilds reserve unused leaves: set once an instance was added and no leaf was unused.
    has_run_out: bool,
    max_cost_ratio: f64,
}

impl Default for Tlas {
    /// An empty hierarchy, which is rebuilt at [`MAX_COST_RATIO`](Self::MAX_COST_RATIO).
    fn default() -> Self {
        Self {
            leaves: LeafTable::default(),
            parents: Vec::new(),
            cost: CostTracker::default(),
            stale_ancestors: BinaryHeap::new(),
            has_run_out: false,
            max_cost_ratio: Self::MAX_COST_RATIO,
        }
    }
}

/// What an update in place did, and what it decided in the end.
struct Updated {
    action: Action,
    /// Leaves that changed or, in a refit, may have changed.
    instances: usize,
    /// Nodes that a patch changed, leaves included.
    nodes: usize,
}

impl Tlas {
    /// A hierarchy is rebuilt when its cost exceeds this multiple of its cost after the last build, unless another
    /// limit is [set](Self::set_max_cost_ratio). The larger of two ratios counts: that of the summed area of all inner
    /// nodes below the root, and that of the [SAH cost](Self::sah_cost) without the share of the leaves.
    pub const MAX_COST_RATIO: f64 = policy::MAX_COST_RATIO;

    /// The most levels of a hierarchy that this type builds.
    pub const MAX_DEPTH: usize = agglomerative::MAX_CLUSTER_DEPTH + 1;

    /// Sets the multiple of the cost after the last build at which an update rebuilds: 1 for whenever it has grown at
    /// all, infinity for never.
    pub fn set_max_cost_ratio(&mut self, max_cost_ratio: f64) {
        self.max_cost_ratio = max_cost_ratio;
    }

    /// Builds a new hierarchy, on all threads of the current rayon pool if there are many instances; the result does
    /// not depend on the number of threads. O(n log n), of which the logarithm is that of binary searches.
    ///
    /// # Panics
    /// In debug builds, if there are 2^28 instances or more: a leaf stores the instance index in 28 bits.
    pub fn build(&mut self, nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb]) {
        if boxes.len() < agglomerative::TASK_MINIMUM {
            self.build_here(nodes, boxes);
        } else {
            // Enter the rayon pool once instead of once per parallel loop.
            rayon::scope(|_| self.build_here(nodes, boxes));
        }
        debug_assert_eq!(self.validate(nodes, boxes), Ok(()));
    }

    fn build_here(&mut self, nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb]) {
        // 1. Sort the instances along a Morton curve.
        let order = MortonOrder::new(boxes);
        // 2. Merge neighbouring clusters until one is left.
        let tree = build::ClusterTree::new(order);
        // 3. Write device nodes in depth-first order, with reserved unused leaves if any.
        let reserved = policy::reserved_leaf_count(tree.leaf_count(), self.has_run_out);
        let len = build::node_count(&tree, reserved);
        self.parents = bytemuck::zeroed_vec(len);
        self.leaves.reset(boxes.len(), tree.leaf_count());
        let sums =
            build::flatten(&tree, reserved, nodes.resize_for_overwrite(len), &mut self.parents, &mut self.leaves);
        self.cost = CostTracker::new(sums, nodes);
        self.stale_ancestors.clear();
    }

    /// Brings the hierarchy up to date with `boxes`. Only boxes of the instances in `changed` may differ from the last
    /// call's; `changed` may be unordered, repeat instances and name instances that did not change.
    ///
    /// O(c log n) for few changes c (a patch), else O(n).
    pub fn update(&mut self, nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb], changed: &[u32]) -> TlasUpdate {
        let was_empty = nodes.is_empty();
        let Updated { action, instances, nodes: changed_nodes } = self.update_in_place(nodes, boxes, changed);
        if let Action::Rebuild(reason) = action {
            self.has_run_out |= reason == RebuildReason::NoUnusedLeaf;
            self.build(nodes, boxes);
        }
        policy::report(action, was_empty && nodes.is_empty(), instances, changed_nodes)
    }

    /// Patches or refits the hierarchy, as `policy` decides. If the action that it returns is a rebuild, the nodes may
    /// be half updated: the caller must build.
    fn update_in_place(&mut self, nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb], changed: &[u32]) -> Updated {
        let mut updated = Updated { action: Action::Keep, instances: 0, nodes: 0 };
        self.leaves.resize(boxes.len());
        // 1. Choose between a patch and a refit.
        updated.action = policy::choose_action(self.leaves.counts(), changed.len());
        if let Action::Rebuild(_) = updated.action {
            return updated;
        }
        // 2. Update the leaves: instances appear and vanish, and boxes change.
        let changed_leaves = self.update_leaves(nodes, boxes, changed, updated.action);
        updated.action = policy::after_leaves(updated.action, self.leaves.counts(), changed_leaves);
        updated.instances = changed_leaves.unwrap_or(0);
        // 3. Update the inner nodes: the ancestors of changed leaves, or all.
        let mut has_changed = true;
        match updated.action {
            Action::Keep | Action::Rebuild(_) => return updated,
            Action::Patch => updated.nodes = updated.instances + self.patch_ancestors(nodes),
            Action::Refit => {
                let leaf_use_has_changed = !self.stale_ancestors.is_empty();
                self.stale_ancestors.clear();
                let (areas, box_has_changed) = refit::refit(nodes, boxes);
                self.cost.reset_sums(areas);
                has_changed = leaf_use_has_changed || box_has_changed;
            }
        }
        // 4. Make the last node a used leaf, since traversal ends at the node whose escape index is `NONE`.
        updated.nodes += self.fill_last_leaf(nodes);
        // 5. Rebuild if the cost has grown too much.
        self.cost.recompute_if_inexact(nodes);
        updated.action =
            policy::after_boxes(updated.action, has_changed, self.cost.cost_ratio(nodes), self.max_cost_ratio);
        updated
    }

    /// How many instances are in the hierarchy.
    pub fn instance_count(&self) -> usize {
        self.leaves.counts().used
    }

    /// The [SAH cost](BvhStats::sah_cost) of the hierarchy in `nodes`, tracked incrementally. O(1).
    pub fn sah_cost(&self, nodes: &[Node]) -> f64 {
        self.cost.sah_cost(nodes)
    }

    /// Measures the size and quality of `nodes`. O(n).
    pub fn stats(&self, nodes: &[Node]) -> BvhStats {
        BvhStats { bytes: size_of_val(nodes), ..BvhStats::of(nodes, 1.0) }
    }

    /// Checks the invariants that traversal and the next update rely on: escape indices, containment, every non-empty
    /// box in exactly one leaf, and the leaf table in agreement. `boxes` must be those of the last call. O(n).
    ///
    /// # Errors
    /// The first [`BvhError`] found.
    pub fn validate(&self, nodes: &[Node], boxes: &[Aabb]) -> Result<(), BvhError> {
        // 1. Check the nodes, and that no instance is in two leaves.
        let mut found = vec![false; boxes.len()];
        validate_nodes(nodes, |range| {
            let bounds = boxes.get(range.first_primitive() as usize).and_then(Aabb::clamped_to_finite)?;
            let is_new =
                range.primitive_count() == 1 && !std::mem::replace(&mut found[range.first_primitive() as usize], true);
            is_new.then_some(bounds)
        })?;
        // 2. Check that every instance with a box is in a leaf, and that the leaf table agrees.
        for ((instance_index, found), bounds) in (0..).zip(found).zip(boxes) {
            let leaf = self.leaves.leaf(instance_index);
            let own_range = PrimitiveRange::leaf(instance_index, 1);
            let is_known = leaf.is_some_and(|leaf| nodes[leaf as usize].primitives == own_range);
            let expected = !bounds.is_empty();
            if found != expected || is_known != expected {
                return Err(BvhError::Missing { primitive: instance_index });
            }
        }
        Ok(())
    }
}
