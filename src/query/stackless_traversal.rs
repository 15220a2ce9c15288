//! Stackless traversal of one level of the acceleration structure by escape indices.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::device::layout::{NONE, Node};

/// A traversal of one hierarchy (the TLAS or a BLAS) that yields its leaves. It needs no stack: the escape index of a
/// node leads to the next one when its box is missed or its subtree is finished.
pub(super) struct StacklessTraversal<'a> {
    nodes: &'a [Node],
    /// The next node, or [`NONE`] at the end.
    index: u32,
    visited: u64,
    /// Receives the number of visited nodes on drop.
    total: &'a AtomicU64,
}

impl<'a> StacklessTraversal<'a> {
    /// A traversal from the first of `nodes`. What lies behind the hierarchy's last node is never read.
    pub(super) fn new(nodes: &'a [Node], total: &'a AtomicU64) -> Self {
        // An empty hierarchy is an empty slice, a zeroed node or an unused root.
        let is_empty = nodes.first().is_none_or(Node::is_empty_root);
        Self { nodes, index: if is_empty { NONE } else { 0 }, visited: 0, total }
    }

    /// The next leaf that passes the test `entered`, together with all nodes above it.
    #[inline]
    pub(super) fn next_leaf(&mut self, mut entered: impl FnMut(&Node) -> bool) -> Option<&'a Node> {
        while self.index != NONE {
            let node = &self.nodes[self.index as usize];
            self.visited += 1;
            // The box is missed: skip the subtree.
            if node.is_empty() || !entered(node) {
                self.index = node.escape_index;
            } else if !node.is_leaf() {
                // An inner node: its first child follows it.
                self.index += 1;
            } else {
                // A leaf: go on after it next time.
                self.index = node.escape_index;
                return Some(node);
            }
        }
        None
    }

    /// Greedy descent: the leaf reached by following the child with the lowest `cost`. `None` if a node on the way has
    /// no child of finite cost.
    pub(super) fn descend_to_nearest_leaf(mut self, cost: impl Fn(&Node) -> f64) -> Option<&'a Node> {
        while self.index != NONE {
            let node = &self.nodes[self.index as usize];
            if node.is_leaf() {
                return Some(node);
            }
            // Visit the children along their escape indices, and keep the one of least cost.
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
