//! How good the hierarchy is, kept up with every node that changes.

use crate::accel::stats::half_area;
use crate::device::layout::{Node, PrimitiveRange};

/// The areas of a hierarchy's nodes, halved, in units of length squared.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct AreaSums {
    /// Of the inner nodes but the root.
    pub(super) inner: f64,
    /// Of the leaves.
    pub(super) leaves: f64,
}

impl AreaSums {
    pub(super) fn add(&mut self, other: Self) {
        self.inner += other.inner;
        self.leaves += other.leaves;
    }

    /// Adds a node that is not an inner root.
    pub(super) fn add_node(&mut self, node: &Node) {
        if node.primitives == PrimitiveRange::INNER {
            self.inner += half_area(node);
        } else {
            self.leaves += half_area(node);
        }
    }

    fn of(nodes: &[Node]) -> Self {
        let mut areas = Self::default();
        let is_inner_root = nodes.len() > 1;
        nodes[usize::from(is_inner_root)..].iter().for_each(|node| areas.add_node(node));
        areas
    }
}

/// What a hierarchy costs now, and cost when it was built.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CostTracker {
    areas: AreaSums,
    /// No less than what rounding has added to `areas`.
    rounding_error: f64,
    /// When built: `areas.inner`, and that in units of the root's area.
    at_build: [f64; 2],
}

impl CostTracker {
    /// Of a new hierarchy.
    pub(super) fn new(areas: AreaSums, nodes: &[Node]) -> Self {
        let mut cost = Self { areas, ..Self::default() };
        cost.at_build = cost.inner(nodes);
        cost
    }

    /// After all nodes have changed.
    pub(super) fn reset_sums(&mut self, areas: AreaSums) {
        (self.areas, self.rounding_error) = (areas, 0.0);
    }

    /// After the node at `index`, not the root if that is an inner node, has changed.
    pub(super) fn replace_node(&mut self, index: u32, old: &Node, new: &Node) {
        let is_inner_root = index == 0 && new.primitives == PrimitiveRange::INNER;
        if is_inner_root {
            return;
        }
        let (mut before, mut after) = (AreaSums::default(), AreaSums::default());
        before.add_node(old);
        after.add_node(new);
        let most = self.areas.inner.max(self.areas.leaves) + before.inner + before.leaves + after.inner + after.leaves;
        self.rounding_error += most * (4.0 * f64::EPSILON);
        self.areas.inner += after.inner - before.inner;
        self.areas.leaves += after.leaves - before.leaves;
    }

    /// Adds all areas up anew where rounding may show: after very many updates, or when a box far larger than all others is
    /// gone. O(n) then.
    pub(super) fn settle(&mut self, nodes: &[Node]) {
        const MAX_RELATIVE_ERROR: f64 = 1e-7;
        if self.rounding_error > MAX_RELATIVE_ERROR * self.areas.inner.min(self.areas.leaves) {
            self.reset_sums(AreaSums::of(nodes));
        }
    }

    /// As [`BvhStats::sah_cost`](crate::accel::BvhStats::sah_cost).
    pub(super) fn sah_cost(&self, nodes: &[Node]) -> f64 {
        let Some(root) = nodes.first() else { return 0.0 };
        let root_area = half_area(root);
        let inner = if nodes.len() > 1 { root_area + self.areas.inner } else { 0.0 };
        1.0 + (2.0 * inner + self.areas.leaves) / root_area
    }

    /// How many times as dear as when it was built.
    ///
    /// Two measures, the greater counts. One instance far away makes the root so large that all else weighs nothing beside it:
    /// areas alone tell that it has blown up its other ancestors. A scene that contracts shrinks all areas: there it is the
    /// ratio to the root's that tells. What no hierarchy can do better is left out, or the same before and after: leaves and
    /// the root.
    pub(super) fn decay(&self, nodes: &[Node]) -> f64 {
        let [inner, share] = self.inner(nodes);
        let [built_inner, built_share] = self.at_build;
        let grown = if inner > built_inner { inner / built_inner } else { 1.0 };
        grown.max((1.5 + share) / (1.5 + built_share))
    }

    fn inner(&self, nodes: &[Node]) -> [f64; 2] {
        let root_area = nodes.first().map_or(1.0, half_area);
        [self.areas.inner, self.areas.inner / root_area]
    }
}
