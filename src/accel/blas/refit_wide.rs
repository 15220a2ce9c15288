//! Refits wide nodes after their triangles moved: new quantised boxes; children and their slots stay as they are.

use std::ops::Range;

use glam::{Vec3, Vec4Swizzles};
use rayon::prelude::*;

use super::quantize::{WIDE_CHILD_COUNT, quantize_node};
use super::triangle_bounds::triangle_bounds;
use crate::accel::padding::pad_bounds;
use crate::accel::tree::SimdAabb;
use crate::device::layout::{Triangle, WideNode};

/// Nodes per parallel chunk.
const CHUNK: usize = 1 << 8;

/// Recomputes the boxes of all wide nodes, bottom up, and returns the range from the first to the last node that
/// changed. O(n) on all threads of the current rayon pool, except for one sequential pass over the nodes' boxes. Slots
/// are not reassigned, though the front-to-back order may be slightly worse after large motion.
pub(super) fn refit_wide(nodes: &mut [WideNode], triangles: &[Triangle]) -> Option<Range<usize>> {
    let leaf_bounds = |node: &WideNode, slot: usize| {
        let range = node.children[slot].triangles();
        let (first, count) = (range.first_primitive() as usize, range.primitive_count() as usize);
        pad_bounds(triangle_bounds(&triangles[first..first + count]))
    };
    let slots = |node: &WideNode| {
        let used = node.child_mask();
        (0..WIDE_CHILD_COUNT).filter(move |slot| used >> slot & 1 != 0)
    };
    // 1. Bound the leaves of each node in parallel, then propagate the boxes bottom up: children are stored after their
    // parents.
    let around_leaves = |node: &WideNode| {
        let leaves = slots(node).filter(|&slot| node.children[slot].is_leaf());
        leaves.fold(SimdAabb::EMPTY, |bounds, slot| bounds.union(leaf_bounds(node, slot)))
    };
    let mut boxes: Vec<SimdAabb> = nodes.par_iter().with_min_len(CHUNK).map(around_leaves).collect();
    for (index, node) in nodes.iter().enumerate().rev() {
        for slot in slots(node).filter(|&slot| !node.children[slot].is_leaf()) {
            boxes[index] = boxes[index].union(boxes[node.children[slot].node_index() as usize]);
        }
    }
    // 2. Quantise each node again, on the grid of its new box.
    let corners = |bounds: SimdAabb| -> [Vec3; 2] { [bounds.min.xyz(), bounds.max.xyz()] };
    let requantize = |(index, node): (usize, &mut WideNode)| {
        let mut children = [None; WIDE_CHILD_COUNT];
        for slot in slots(node) {
            let child = node.children[slot];
            children[slot] = Some(corners(if child.is_leaf() {
                leaf_bounds(node, slot)
            } else {
                boxes[child.node_index() as usize]
            }));
        }
        let new = WideNode { children: node.children, ..quantize_node(corners(boxes[index]), &children) };
        let has_changed = new != *node;
        *node = new;
        has_changed.then_some(index..index + 1)
    };
    let union_range = |a: Option<Range<usize>>, b: Option<Range<usize>>| match (a, b) {
        (Some(a), Some(b)) => Some(a.start.min(b.start)..a.end.max(b.end)),
        (a, b) => a.or(b),
    };
    nodes.par_iter_mut().enumerate().with_min_len(CHUNK).map(requantize).reduce(|| None, union_range)
}
