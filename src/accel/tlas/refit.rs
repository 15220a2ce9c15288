//! Boxes from the leaves to the root, in nodes that stay where they are.

use std::ops::Range;

use rayon::prelude::*;

use super::cost::AreaSums;
use super::node::{around_children, instance_leaf, with_box_around};
use crate::accel::build::agglomerative::clamp_to_f32;
use crate::accel::stats::half_area;
use crate::device::DeviceBuffer;
use crate::device::layout::{NONE, Node, PrimitiveRange};
use crate::math::Aabb;

/// Subtrees of fewer nodes are refitted by one thread.
const TASK_MINIMUM: usize = 1 << 13;
/// And all of fewer nodes than this: other threads would come too late.
const PARALLEL_MINIMUM: usize = 1 << 16;

/// Computes all boxes anew, those of the leaves from `boxes`, and marks the nodes between the first and the last change of
/// each task. Returns the areas, and whether any node changed. O(n), on all threads of the current rayon pool.
pub(super) fn refit(nodes: &mut DeviceBuffer<Node>, boxes: &[Aabb]) -> (AreaSums, bool) {
    // 1. Subtrees, side by side.
    let (upper, tasks) = tasks(nodes);
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
struct RefittedRange {
    areas: AreaSums,
    /// From the first change to the last, as indices of the whole array.
    changed: Range<usize>,
}

/// `start` is the index of the subtree's root in the whole array.
fn refit_subtree(nodes: &mut [Node], start: usize, boxes: &[Aabb]) -> RefittedRange {
    let mut refitted = RefittedRange { areas: AreaSums::default(), changed: nodes.len()..0 };
    // 1. Leaves. Their boxes come from all over memory: fetched first, with nothing else in the loop, many are on their way at
    // once.
    let mut fetched = vec![(0, Aabb::EMPTY); nodes.len().div_ceil(2) + 1];
    let mut inner = vec![0; nodes.len() / 2 + 1];
    let (mut leaf_count, mut inner_count) = (0, 0);
    for (index, node) in nodes.iter().enumerate() {
        // Without a branch: which it is is a coin toss.
        let is_leaf = node.primitives != PrimitiveRange::INNER;
        // The last node is a leaf, and need not have an escape index to tell it by.
        let is_unused_leaf = node.escape_index as usize == start + index + 1 || index + 1 == nodes.len();
        fetched[leaf_count].0 = index;
        inner[inner_count] = index;
        leaf_count += usize::from(is_leaf);
        inner_count += usize::from(!(is_leaf | is_unused_leaf));
    }
    for (index, bounds) in &mut fetched[..leaf_count] {
        if let Some(current) = boxes.get(nodes[*index].primitives.first_primitive() as usize) {
            *bounds = *current;
        }
    }
    for (index, bounds) in &fetched[..leaf_count] {
        let old = nodes[*index];
        let node =
            clamp_to_f32(bounds).map_or(old, |b| instance_leaf(old.primitives.first_primitive(), &b, old.escape_index));
        refitted.areas.leaves += half_area(&node);
        refitted.write(nodes, *index, &node);
    }
    // 2. Inner nodes, children before parents.
    for &index in inner[..inner_count].iter().rev() {
        let second = nodes[index + 1].escape_index as usize - start;
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
    #[inline]
    fn write(&mut self, nodes: &mut [Node], index: usize, node: &Node) {
        if bytemuck::cast::<_, [u64; 4]>(nodes[index]) != bytemuck::cast::<_, [u64; 4]>(*node) {
            nodes[index] = *node;
            self.changed = self.changed.start.min(index)..self.changed.end.max(index + 1);
        }
    }
}

/// The index after a node's subtree.
fn end(nodes: &[Node], index: usize) -> usize {
    match nodes[index].escape_index {
        NONE => nodes.len(),
        escape_index => escape_index as usize,
    }
}
