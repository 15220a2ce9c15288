//! One level of the acceleration structure, walked along its escape indices.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::device::layout::{NONE, Node};

/// A way through one hierarchy, from leaf to leaf. No stack: where a box is not entered, its escape index says how to go on.
pub(super) struct StacklessTraversal<'a> {
    nodes: &'a [Node],
    /// The next node, or [`NONE`] at the end.
    index: u32,
    visited: u64,
    /// Where the nodes visited are added when the walk is over.
    total: &'a AtomicU64,
}

impl<'a> StacklessTraversal<'a> {
    /// `nodes` starts with the hierarchy's first node; what lies behind its last is never read.
    pub(super) fn new(nodes: &'a [Node], total: &'a AtomicU64) -> Self {
        // A hierarchy of nothing is absent, zero or unused.
        let is_empty = nodes.first().is_none_or(Node::is_empty_root);
        Self { nodes, index: if is_empty { NONE } else { 0 }, visited: 0, total }
    }

    /// The next leaf of those that are `entered`, with all that is above them.
    #[inline]
    pub(super) fn next_leaf(&mut self, mut entered: impl FnMut(&Node) -> bool) -> Option<&'a Node> {
        while self.index != NONE {
            let node = &self.nodes[self.index as usize];
            self.visited += 1;
            if node.is_empty() || !entered(node) {
                self.index = node.escape_index;
            } else if !node.is_leaf() {
                self.index += 1;
            } else {
                self.index = node.escape_index;
                return Some(node);
            }
        }
        None
    }

    /// The leaf that is reached from the root by always going on to the child of the least `cost`.
    pub(super) fn descend_to_nearest_leaf(mut self, cost: impl Fn(&Node) -> f64) -> Option<&'a Node> {
        while self.index != NONE {
            let node = &self.nodes[self.index as usize];
            if node.is_leaf() {
                return Some(node);
            }
            let (mut least, mut child) = (f64::INFINITY, self.index + 1);
            self.index = NONE;
            while child != node.escape_index {
                self.visited += 1;
                let child_node = &self.nodes[child as usize];
                let child_cost = if child_node.is_empty() { f64::INFINITY } else { cost(child_node) };
                if child_cost < least {
                    (least, self.index) = (child_cost, child);
                }
                child = child_node.escape_index;
            }
        }
        None
    }
}

impl Drop for StacklessTraversal<'_> {
    fn drop(&mut self) {
        self.total.fetch_add(self.visited, Ordering::Relaxed);
    }
}
