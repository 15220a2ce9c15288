//! The SAH cost of the top level, tracked incrementally with every node that changes.

use crate::accel::stats::half_area;
use crate::device::layout::Node;

/// Sums of the nodes' half areas, in device world units squared.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct AreaSums {
    /// Over the inner nodes except the root.
    pub(super) inner: f64,
    /// Over the leaves.
    pub(super) leaves: f64,
}

impl AreaSums {
    pub(super) fn add(&mut self, other: Self) {
        self.inner += other.inner;
        self.leaves += other.leaves;
    }

    /// Adds a node. An inner root must not be added.
    pub(super) fn add_node(&mut self, node: &Node) {
        if node.is_leaf() {
            self.leaves += half_area(node);
        } else {
            self.inner += half_area(node);
        }
    }

    /// The sums over all nodes. O(n).
    fn of(nodes: &[Node]) -> Self {
        let mut areas = Self::default();
        let is_inner_root = nodes.len() > 1;
        nodes[usize::from(is_inner_root)..].iter().for_each(|node| areas.add_node(node));
        areas
    }
}

/// The current cost of a hierarchy and its cost after the last build.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CostTracker {
    areas: AreaSums,
    /// An upper bound of the rounding error accumulated in `areas`.
    rounding_error: f64,
    /// After the last build: `areas.inner`, and `areas.inner` divided by the root's half area.
    at_build: [f64; 2],
}

/// The share of the SAH cost that is the same for all hierarchies, in the units of [`CostTracker::cost_ratio`]. The
/// cost is 1 + 2 (1 + share) plus a term for the leaves, where share is the summed area of the inner nodes below the
/// root divided by the root's; half of it without the leaves is 1.5 + share. (Not related to `policy::MAX_COST_RATIO`.)
const FIXED_COST: f64 = 1.5;

impl CostTracker {
    /// The cost of a new hierarchy.
    pub(super) fn new(areas: AreaSums, nodes: &[Node]) -> Self {
        let mut cost = Self { areas, ..Self::default() };
        cost.at_build = cost.inner(nodes);
        cost
    }

    /// Sets the sums after all nodes have changed.
    pub(super) fn reset_sums(&mut self, areas: AreaSums) {
        (self.areas, self.rounding_error) = (areas, 0.0);
    }

    /// Updates the sums after one node changed. An inner root is not part of the sums and is ignored.
    pub(super) fn replace_node(&mut self, index: u32, old: &Node, new: &Node) {
        let is_inner_root = index == 0 && !new.is_leaf();
        if is_inner_root {
            return;
        }
        // 1. The areas before and after.
        let (mut before, mut after) = (AreaSums::default(), AreaSums::default());
        before.add_node(old);
        after.add_node(new);
        // 2. Bound the rounding error of the updated sums.
        let max_sum =
            self.areas.inner.max(self.areas.leaves) + before.inner + before.leaves + after.inner + after.leaves;
        self.rounding_error += max_sum * (4.0 * f64::EPSILON);
        // 3. Update the sums.
        self.areas.inner += after.inner - before.inner;
        self.areas.leaves += after.leaves - before.leaves;
    }

    /// Recomputes the sums if their relative rounding error may exceed 1e-7: after very many updates, or when a box far
    /// larger than all others has gone. O(n) then, else O(1).
    pub(super) fn recompute_if_inexact(&mut self, nodes: &[Node]) {
        const MAX_RELATIVE_ERROR: f64 = 1e-7;
        if self.rounding_error > MAX_RELATIVE_ERROR * self.areas.inner.min(self.areas.leaves) {
            self.reset_sums(AreaSums::of(nodes));
        }
    }

    /// The SAH cost as [`BvhStats::sah_cost`](crate::accel::BvhStats::sah_cost) defines it. O(1).
    pub(super) fn sah_cost(&self, nodes: &[Node]) -> f64 {
        let Some(root) = nodes.first() else { return 0.0 };
        let root_area = half_area(root);
        let inner = if nodes.len() > 1 { root_area + self.areas.inner } else { 0.0 };
        1.0 + (2.0 * inner + self.areas.leaves) / root_area
    }

    /// The cost relative to that after the last build, as the larger of two measures.
    ///
    /// (a) The ratio of the inner nodes' summed areas: one instance that moves far away makes the root so large that a
    /// root-relative cost hides the growth of its other ancestors. (b) The ratio of that sum divided by the root's
    /// area, with [`FIXED_COST`] added to both sides: when a scene contracts all areas shrink, and only the share
    /// relative to the root shows it. The areas of leaves and of the root are left out, since no other hierarchy could
    /// make them smaller.
    pub(super) fn cost_ratio(&self, nodes: &[Node]) -> f64 {
        let [inner, share] = self.inner(nodes);
        let [built_inner, built_share] = self.at_build;
        // (a)
        let area_ratio = if inner > built_inner { inner / built_inner } else { 1.0 };
        // (b)
        area_ratio.max((FIXED_COST + share) / (FIXED_COST + built_share))
    }

    /// The summed half area of the inner nodes below the root, and that divided by the root's half area.
    fn inner(&self, nodes: &[Node]) -> [f64; 2] {
        let root_area = nodes.first().map_or(1.0, half_area);
        [self.areas.inner, self.areas.inner / root_area]
    }
}
