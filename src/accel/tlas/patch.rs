//! Patches of the top level: single leaves, and those of their ancestors whose boxes change.

use super::Tlas;
use super::node::{around_children, instance_leaf, with_box_around};
use super::policy::Action;
use crate::accel::stats::half_area;
use crate::device::DeviceBuffer;
use crate::device::layout::{NONE, Node};
use crate::math::Aabb;

impl Tlas {
    /// Updates the leaves of the `changed` instances. Returns how many changed or, in a refit, may have changed; `None`
    /// if an instance found no unused leaf.
    pub(super) fn update_leaves(
        &mut self,
        nodes: &mut DeviceBuffer<Node>,
        boxes: &[Aabb],
        changed: &[u32],
        action: Action,
    ) -> Option<usize> {
        let mut count = 0;
        for &instance_index in changed {
            count += usize::from(self.update_leaf(nodes, boxes, instance_index, action)?);
        }
        Some(count)
    }

    /// Updates the leaf of one instance: allocates one for an instance that appeared, releases that of one that
    /// vanished, and writes the box. In a refit the box is left to the refit. Returns whether the leaf changed; in a
    /// refit, whether it may have. `None` if no leaf is unused.
    fn update_leaf(
        &mut self,
        nodes: &mut DeviceBuffer<Node>,
        boxes: &[Aabb],
        instance_index: u32,
        action: Action,
    ) -> Option<bool> {
        let bounds = boxes.get(instance_index as usize).and_then(Aabb::clamped_to_finite);
        let leaf = match (self.leaves.leaf(instance_index), bounds) {
            // Absent before and after.
            (None, None) => return Some(false),
            // Present before and after: the refit will write its box, or it is written below.
            (Some(_), Some(_)) if action == Action::Refit => return Some(true),
            (Some(leaf), Some(_)) => leaf,
            // Vanished: release its leaf.
            (Some(leaf), None) => {
                self.leaves.release(instance_index, leaf);
                leaf
            }
            // Appeared: allocate a leaf.
            (None, Some(bounds)) => {
                let growth = |leaf, bound| area_growth(nodes, &self.parents, leaf, &bounds, bound);
                self.leaves.allocate(instance_index, growth)?
            }
        };
        let escape_index = nodes[leaf as usize].escape_index;
        let node = bounds.map_or(Node::unused_leaf(escape_index), |b| instance_leaf(instance_index, &b, escape_index));
        Some(self.write(nodes, leaf, node))
    }

    /// Writes a node and, if it changed, queues its parent for an update. Returns whether it changed.
    fn write(&mut self, nodes: &mut DeviceBuffer<Node>, index: u32, node: Node) -> bool {
        let old = nodes[index as usize];
        if old == node {
            return false;
        }
        nodes.set(index as usize, node);
        self.cost.replace_node(index, &old, &node);
        if index > 0 {
            self.stale_ancestors.push(self.parents[index as usize]);
        }
        true
    }

    /// Recomputes the boxes of queued ancestors, children first: the heap yields the highest index, and a parent has a
    /// lower index than its children. Returns how many nodes changed.
    pub(super) fn patch_ancestors(&mut self, nodes: &mut DeviceBuffer<Node>) -> usize {
        let mut changed = 0;
        while let Some(index) = self.stale_ancestors.pop() {
            // Of several entries for one node only the last counts.
            if self.stale_ancestors.peek() != Some(&index) {
                let node = around_children(nodes, index as usize);
                changed += usize::from(self.write(nodes, index, node));
            }
        }
        changed
    }

    /// If the last leaf is unused, moves into it the used leaf with the next lower index. O(log n). Returns how many
    /// nodes changed.
    pub(super) fn fill_last_leaf(&mut self, nodes: &mut DeviceBuffer<Node>) -> usize {
        // 1. If the last leaf is used, there is nothing to do.
        let last = nodes.len() as u32 - 1;
        if !nodes[last as usize].is_empty() {
            return 0;
        }
        // 2. Find the nearest used leaf.
        let from = last_used_leaf(nodes, &self.parents);
        let source = nodes[from as usize];
        // 3. Exchange the two, and update the ancestors of both.
        self.leaves.relocate(source.primitives.first_primitive(), from, last);
        self.write(nodes, last, Node { escape_index: NONE, ..source });
        self.write(nodes, from, Node::unused_leaf(source.escape_index));
        2 + self.patch_ancestors(nodes)
    }
}

/// By how much the summed half area of a leaf's ancestors would grow if the leaf got this box. Stops once the sum
/// reaches `bound`.
fn area_growth(nodes: &[Node], parents: &[u32], leaf: u32, bounds: &Aabb, bound: f64) -> f64 {
    let leaf_node = instance_leaf(0, bounds, NONE);
    let (mut index, mut growth) = (parents[leaf as usize], 0.0);
    while index != NONE && growth < bound {
        let node = &nodes[index as usize];
        growth += half_area(&with_box_around(node, node, &leaf_node)) - half_area(node);
        index = parents[index as usize];
    }
    growth
}

/// The used leaf with the highest index. The last node must be an unused leaf, and some leaf must be in use.
fn last_used_leaf(nodes: &[Node], parents: &[u32]) -> u32 {
    // 1. Go up to the first ancestor whose first child is in use; the second child is the one that we came from.
    let mut index = nodes.len() as u32 - 1;
    loop {
        let parent = parents[index as usize];
        index = parent;
        if !nodes[parent as usize + 1].is_empty() {
            break;
        }
    }
    // 2. Go down that first child, to the right wherever something there is in use.
    index += 1;
    while !nodes[index as usize].is_leaf() {
        let right = Node::right_child(nodes, index as usize);
        index = if nodes[right].is_empty() { index + 1 } else { right as u32 };
    }
    index
}
