//! Refits the top level: recomputes all boxes bottom up in an unchanged hierarchy.

use std::ops::Range;

use rayon::prelude::*;

use super::cost::AreaSums;
use super::node::{around_children, instance_leaf, with_box_around};
use crate::accel::stats::half_area;
use crate::device::DeviceBuffer;
use crate::device::layout::Node;
use crate::math::Aabb;

/// Subtrees of fewer nodes are refitted by one thread.
const TASK_MINIMUM: usize = 1 << 13;
/// Hierarchies of fewer nodes are refitted by one thread: waking others would take longer.
const PARALLEL_MINIMUM: usize = 1 << 16;

/// Recomputes all boxes, those of the leaves from `boxes`, and marks as dirty the range from the first to the last
/// changed node of each task. Returns the area sums and whether any node changed. O(n) on all threads of the current
/// rayon pool.
pub(super) fn refit(nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb]) -> (AreaSums, bool) {
    // 1. Divide the array between subtrees, and refit these, in parallel if there are many nodes.
    let (upper_nodes, tasks) = tasks(nodes);
    let is_parallel = nodes.len() >= PARALLEL_MINIMUM;
    let mut rest = nodes.as_mut_slice_without_marking();
    let mut rest_start = 0;
    let mut slices = Vec::with_capacity(tasks.len());
    for task in tasks {
        rest = &mut rest[task.start - rest_start..];
        rest_start = task.end;
        let Some(slice) = rest.split_off_mut(..task.len()) else { break };
        slices.push((task.start, slice));
    }
    let refit = |(start, slice)| refit_subtree(slice, start, boxes);
    let refitted: Vec<RefittedRange> =
        if is_parallel { slices.into_par_iter().map(refit).collect() } else { slices.into_iter().map(refit).collect() };
    let (mut areas, mut has_changed) = (AreaSums::default(), false);
    for subtree in refitted {
        areas.add(subtree.areas);
        if !subtree.changed.is_empty() {
            nodes.mark_dirty(subtree.changed);
            has_changed = true;
        }
    }
    // 2. Refit the inner nodes above the subtrees, children before parents.
    for index in upper_nodes.into_iter().rev() {
        let node = around_children(nodes, index);
        nodes.set(index, node);
        if index > 0 {
            areas.add_node(&node);
        }
    }
    (areas, has_changed)
}

/// Splits a hierarchy into subtrees of fewer than [`TASK_MINIMUM`] nodes and the inner nodes above them. Returns those
/// nodes and the ranges of the subtrees; both ascending.
fn tasks(nodes: &[Node]) -> (Vec<usize>, Vec<Range<usize>>) {
    let (mut upper_nodes, mut tasks, mut index) = (Vec::new(), Vec::new(), 0);
    while index < nodes.len() {
        let end = nodes[index].subtree_end(nodes.len());
        if end - index >= TASK_MINIMUM {
            upper_nodes.push(index);
            index += 1;
        } else {
            tasks.push(index..end);
            index = end;
        }
    }
    (upper_nodes, tasks)
}

/// The result of refitting one subtree.
struct RefittedRange {
    areas: AreaSums,
    /// From the first change to the last, as indices of the whole array.
    changed: Range<usize>,
}

/// Refits a subtree, whose root is at index `start` of the whole array.
fn refit_subtree(nodes: &mut [Node], start: usize, boxes: &[Aabb]) -> RefittedRange {
    let mut refitted = RefittedRange { areas: AreaSums::default(), changed: nodes.len()..0 };
    // 1. List the leaves and the inner nodes.
    let mut fetched = vec![(0, Aabb::EMPTY); nodes.len().div_ceil(2) + 1];
    let mut inner = vec![0; nodes.len() / 2 + 1];
    let (mut leaf_count, mut inner_count) = (0, 0);
    for (index, node) in nodes.iter().enumerate() {
        // Branch-free: whether a node is a leaf is unpredictable.
        let is_leaf = node.is_leaf();
        // The last node is a leaf with escape index `NONE`, so it is recognised by its index.
        let is_unused_leaf = node.escape_index as usize == start + index + 1 || index + 1 == nodes.len();
        fetched[leaf_count].0 = index;
        inner[inner_count] = index;
        leaf_count += usize::from(is_leaf);
        inner_count += usize::from(!(is_leaf | is_unused_leaf));
    }
    // 2. Fetch the boxes of the leaves. They are scattered in memory: in a loop of their own many cache misses are in
    // flight at once.
    for (index, bounds) in &mut fetched[..leaf_count] {
        if let Some(current) = boxes.get(nodes[*index].primitives.first_primitive() as usize) {
            *bounds = *current;
        }
    }
    // 3. Write the leaves.
    for (index, bounds) in &fetched[..leaf_count] {
        let old = nodes[*index];
        let node = bounds
            .clamped_to_finite()
            .map_or(old, |b| instance_leaf(old.primitives.first_primitive(), &b, old.escape_index));
        refitted.areas.leaves += half_area(&node);
        refitted.write(nodes, *index, &node);
    }
    // 4. Write the inner nodes, children before parents.
    for &index in inner[..inner_count].iter().rev() {
        let second = Node::right_child(nodes, index) - start;
        let node = with_box_around(&nodes[index], &nodes[index + 1], &nodes[second]);
        if start + index > 0 {
            refitted.areas.inner += half_area(&node);
        }
        refitted.write(nodes, index, &node);
    }
    refitted.changed = start + refitted.changed.start..start + refitted.changed.end;
    refitted
}

impl RefittedRange {
    /// Writes a node of the subtree, and notes it if it changed.
    #[inline]
    fn write(&mut self, nodes: &mut [Node], index: usize, node: &Node) {
        if bytemuck::cast::<_, [u64; 4]>(nodes[index]) != bytemuck::cast::<_, [u64; 4]>(*node) {
            nodes[index] = *node;
            self.changed = self.changed.start.min(index)..self.changed.end.max(index + 1);
        }
    }
}
