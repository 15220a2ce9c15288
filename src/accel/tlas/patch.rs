//! Patches of the top level: single leaves, and those of their ancestors whose box changes.

use super::node::{around_children, instance_leaf, with_box_around};
use super::{RebuildReason, Tlas};
use crate::accel::build::agglomerative::clamp_to_f32;
use crate::accel::stats::half_area;
use crate::device::DeviceBuffer;
use crate::device::layout::{NONE, Node, PrimitiveRange};
use crate::math::Aabb;

impl Tlas {
    /// Gives a slot a leaf if it needs one, takes it away if it does not, and writes its box, which a refit would do anyway.
    /// Whether anything changed, as far as is known.
    pub(super) fn patch_leaf(
        &mut self,
        nodes: &mut DeviceBuffer<Node>,
        boxes: &[Aabb],
        slot: u32,
        refits: bool,
    ) -> Result<bool, RebuildReason> {
        let bounds = boxes.get(slot as usize).and_then(clamp_to_f32);
        let leaf = match (self.leaves.leaf(slot), bounds) {
            (None, None) => return Ok(false),
            (Some(_), Some(_)) if refits => return Ok(true),
            (Some(leaf), Some(_)) => leaf,
            (Some(leaf), None) => {
                self.leaves.release(slot, leaf);
                leaf
            }
            (None, Some(bounds)) => {
                let growth = |leaf, most| area_growth(nodes, &self.parents, leaf, &bounds, most);
                self.leaves.allocate(slot, growth).ok_or(RebuildReason::NoUnusedLeaf)?
            }
        };
        let escape_index = nodes[leaf as usize].escape_index;
        let node = bounds.map_or(Node::unused_leaf(escape_index), |b| instance_leaf(slot, &b, escape_index));
        Ok(self.write(nodes, leaf, node))
    }

    /// Writes a node, and has its parent looked at. Whether it changed.
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

    /// Brings the boxes of stale nodes up to date, children before parents: a parent has a lower index. Returns how many
    /// changed.
    pub(super) fn patch_ancestors(&mut self, nodes: &mut DeviceBuffer<Node>) -> usize {
        let mut written = 0;
        while let Some(index) = self.stale_ancestors.pop() {
            if self.stale_ancestors.peek() != Some(&index) {
                let node = around_children(nodes, index as usize);
                written += usize::from(self.write(nodes, index, node));
            }
        }
        written
    }

    /// Moves an instance to the last leaf if that is unused: the nearest in the array. O(log n). Returns how many nodes changed.
    pub(super) fn fill_last_leaf(&mut self, nodes: &mut DeviceBuffer<Node>) -> usize {
        let last = nodes.len() as u32 - 1;
        if !nodes[last as usize].is_empty() {
            return 0;
        }
        let from = last_used_leaf(nodes, &self.parents);
        let source = nodes[from as usize];
        self.leaves.relocate(source.primitives.first_primitive(), from, last);
        self.write(nodes, last, Node { escape_index: NONE, ..source });
        self.write(nodes, from, Node::unused_leaf(source.escape_index));
        2 + self.patch_ancestors(nodes)
    }
}

/// By how much the areas of a leaf's ancestors grow if the leaf gets this box; stops counting at `most`.
fn area_growth(nodes: &[Node], parents: &[u32], leaf: u32, bounds: &Aabb, most: f64) -> f64 {
    let leaf_node = instance_leaf(0, bounds, NONE);
    let (mut index, mut growth) = (parents[leaf as usize], 0.0);
    while index != NONE && growth < most {
        let node = &nodes[index as usize];
        growth += half_area(&with_box_around(node, node, &leaf_node)) - half_area(node);
        index = parents[index as usize];
    }
    growth
}

/// The leaf in use with the greatest index; there must be one, and not the last.
fn last_used_leaf(nodes: &[Node], parents: &[u32]) -> u32 {
    // 1. Up, to the first ancestor with something in its first child: the second is that which was come from.
    let mut index = nodes.len() as u32 - 1;
    loop {
        let parent = parents[index as usize];
        index = parent;
        if !nodes[parent as usize + 1].is_empty() {
            break;
        }
    }
    // 2. Down again.
    index += 1;
    while nodes[index as usize].primitives == PrimitiveRange::INNER {
        let second = nodes[index as usize + 1].escape_index;
        index = if nodes[second as usize].is_empty() { index + 1 } else { second };
    }
    index
}
