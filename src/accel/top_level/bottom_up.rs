//! Boxes from the leaves to the root, in nodes that stay where they are.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::cost::Areas;
use super::{flatten, leaves};
use crate::accel::stats::half_area;
use crate::device::DeviceBuffer;
use crate::device::layout::{NONE, Node, PrimitiveRange};
use crate::math::Aabb;

/// Subtrees of fewer nodes are refitted by one thread.
const TASK_MINIMUM: usize = 1 << 13;

/// Computes all boxes anew, those of the leaves from `boxes`, and marks the nodes between the first and the last change of
/// each task. Returns the areas, and whether any node changed. O(n), on all threads of the current rayon pool.
pub(super) fn refit(nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb]) -> (Areas, bool) {
    // 1. Subtrees, side by side.
    let (upper, tasks) = tasks(nodes);
    let mut rest = nodes.unmarked_mut();
    let mut rest_start = 0;
    let mut slices = Vec::with_capacity(tasks.len());
    for task in tasks {
        rest = &mut rest[task.start - rest_start..];
        rest_start = task.end;
        let Some(slice) = rest.split_off_mut(..task.len()) else { break };
        slices.push((task.start, slice));
    }
    let refitted: Vec<Refitted> =
        slices.into_par_iter().map(|(start, slice)| refit_subtree(slice, start, boxes)).collect();
    let (mut areas, mut has_changed) = (Areas::default(), false);
    for subtree in refitted {
        areas.add(subtree.areas);
        if !subtree.changed.is_empty() {
            nodes.mark(subtree.changed);
            has_changed = true;
        }
    }
    // 2. What is above them.
    for index in upper.into_iter().rev() {
        let node = around_children(nodes, index);
        nodes.set(index, node);
        if index > 0 {
            areas.add_node(&node);
        }
    }
    (areas, has_changed)
}

/// Splits a hierarchy into subtrees of some size, and the inner nodes above them; both ascending.
fn tasks(nodes: &[Node]) -> (Vec<usize>, Vec<Range<usize>>) {
    let (mut upper, mut tasks, mut index) = (Vec::new(), Vec::new(), 0);
    while index < nodes.len() {
        let end = end(nodes, index);
        if end - index >= TASK_MINIMUM {
            upper.push(index);
            index += 1;
        } else {
            tasks.push(index..end);
            index = end;
        }
    }
    (upper, tasks)
}

/// What became of a subtree.
struct Refitted {
    areas: Areas,
    /// From the first change to the last, as indices of the whole array.
    changed: Range<usize>,
}

/// `start` is the index of the subtree's root in the whole array.
fn refit_subtree(nodes: &mut [Node], start: usize, boxes: &[Aabb]) -> Refitted {
    let mut refitted = Refitted { areas: Areas::default(), changed: nodes.len()..0 };
    // 1. Leaves, listed first: boxes come from all over memory, and without a branch between them many are on their way at once.
    let mut listed = [0; TASK_MINIMUM];
    let mut leaf_count = 0;
    for (index, node) in nodes.iter().enumerate() {
        listed[leaf_count] = index as u32;
        leaf_count += usize::from(node.primitives != PrimitiveRange::INNER);
    }
    for &index in &listed[..leaf_count] {
        let old = nodes[index as usize];
        let slot = old.primitives.first();
        let bounds = leaves::finite(boxes, slot);
        let node = bounds.map_or(old, |bounds| flatten::leaf(slot, &bounds, old.escape_index));
        refitted.areas.add_node(&node);
        refitted.write(nodes, index as usize, &node);
    }
    // 2. Inner nodes, children before parents.
    for index in (0..nodes.len()).rev() {
        let old = nodes[index];
        // An unused leaf is the last of its subtree, which an inner node never is.
        let is_unused = old.escape_index as usize == start + index + 1 || index + 1 == nodes.len();
        if old.primitives != PrimitiveRange::INNER || is_unused {
            continue;
        }
        let second = nodes[index + 1].escape_index as usize - start;
        let node = around(&old, &nodes[index + 1], &nodes[second]);
        if start + index > 0 {
            refitted.areas.add_node(&node);
        }
        refitted.write(nodes, index, &node);
    }
    refitted.changed = start + refitted.changed.start..start + refitted.changed.end;
    refitted
}

impl Refitted {
    #[inline]
    fn write(&mut self, nodes: &mut [Node], index: usize, node: &Node) {
        if nodes[index] != *node {
            nodes[index] = *node;
            self.changed = self.changed.start.min(index)..self.changed.end.max(index + 1);
        }
    }
}

/// An inner node with the box around its children.
pub(super) fn around_children(nodes: &[Node], index: usize) -> Node {
    let second = nodes[index + 1].escape_index as usize;
    around(&nodes[index], &nodes[index + 1], &nodes[second])
}

/// `node` with the box around two others. Those boxes are padded: so is this.
#[inline]
pub(super) fn around(node: &Node, a: &Node, b: &Node) -> Node {
    let (a, b) = if a.is_unused() {
        (b, b)
    } else if b.is_unused() {
        (a, a)
    } else {
        (a, b)
    };
    Node {
        min: Vec3::from_array(a.min).min(Vec3::from_array(b.min)).to_array(),
        max: Vec3::from_array(a.max).max(Vec3::from_array(b.max)).to_array(),
        ..*node
    }
}

/// By how much the areas of a leaf's ancestors grow if the leaf gets this box; stops counting at `most`.
pub(super) fn growth(nodes: &[Node], parents: &[u32], leaf: u32, bounds: &Aabb, most: f64) -> f64 {
    let leaf_node = flatten::leaf(0, bounds, NONE);
    let (mut index, mut growth) = (parents[leaf as usize], 0.0);
    while index != NONE && growth < most {
        let node = &nodes[index as usize];
        growth += half_area(&around(node, node, &leaf_node)) - half_area(node);
        index = parents[index as usize];
    }
    growth
}

/// The leaf in use with the greatest index; there must be one, and not the last.
pub(super) fn last_used_leaf(nodes: &[Node], parents: &[u32]) -> u32 {
    // 1. Up, to the first ancestor with something in its first child: the second is that which was come from.
    let mut index = nodes.len() as u32 - 1;
    loop {
        let parent = parents[index as usize];
        index = parent;
        if !nodes[parent as usize + 1].is_unused() {
            break;
        }
    }
    // 2. Down again.
    index += 1;
    while nodes[index as usize].primitives == PrimitiveRange::INNER {
        let second = nodes[index as usize + 1].escape_index;
        index = if nodes[second as usize].is_unused() { index + 1 } else { second };
    }
    index
}

/// The index after a node's subtree.
fn end(nodes: &[Node], index: usize) -> usize {
    match nodes[index].escape_index {
        NONE => nodes.len(),
        escape_index => escape_index as usize,
    }
}
