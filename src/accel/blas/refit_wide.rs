//! Wide nodes whose triangles have moved: new boxes for the same children in the same slots.

use std::ops::Range;

use glam::{Vec3, Vec4, Vec4Swizzles};
use rayon::prelude::*;

use super::collapse::{WIDE_CHILD_COUNT, quantize_node};
use crate::accel::padding::pad_bounds;
use crate::accel::tree::SimdAabb;
use crate::device::layout::{Triangle, WideNode};

/// Nodes that one thread takes at a time.
const CHUNK: usize = 1 << 8;

/// Computes all boxes anew, and tells from where to where nodes changed. O(n), on all threads of the current rayon pool but for a
/// pass over the nodes' boxes. Which child has which slot stays, though another might suit its place better by now.
pub(super) fn refit_wide(nodes: &mut [WideNode], triangles: &[Triangle]) -> Option<Range<usize>> {
    let leaf = |node: &WideNode, slot: usize| {
        let (first, count) =
            (node.children[slot].first_primitive() as usize, node.children[slot].primitive_count() as usize);
        pad_bounds(triangle_bounds(&triangles[first..first + count]))
    };
    let slots = |node: &WideNode| {
        let used = node.exponents[3];
        (0..WIDE_CHILD_COUNT).filter(move |slot| used >> slot & 1 != 0)
    };
    // 1. The boxes around the leaves of each node, then around all that is below it: children come after their parents.
    let around_leaves = |node: &WideNode| {
        let leaves = slots(node).filter(|&slot| node.children[slot].primitive_count() > 0);
        leaves.fold(SimdAabb::EMPTY, |bounds, slot| bounds.union(leaf(node, slot)))
    };
    let mut boxes: Vec<SimdAabb> = nodes.par_iter().with_min_len(CHUNK).map(around_leaves).collect();
    for (index, node) in nodes.iter().enumerate().rev() {
        for slot in slots(node).filter(|&slot| node.children[slot].primitive_count() == 0) {
            boxes[index] = boxes[index].union(boxes[node.children[slot].first_primitive() as usize]);
        }
    }
    // 2. The grids.
    let corners = |bounds: SimdAabb| -> [Vec3; 2] { [bounds.min.xyz(), bounds.max.xyz()] };
    let requantise = |(index, node): (usize, &mut WideNode)| {
        let mut children = [None; WIDE_CHILD_COUNT];
        for slot in slots(node) {
            let child = node.children[slot];
            let is_leaf = child.primitive_count() > 0;
            children[slot] =
                Some(corners(if is_leaf { leaf(node, slot) } else { boxes[child.first_primitive() as usize] }));
        }
        let new = WideNode { children: node.children, ..quantize_node(corners(boxes[index]), &children) };
        let has_changed = new != *node;
        *node = new;
        has_changed.then_some(index..index + 1)
    };
    let either = |a: Option<Range<usize>>, b: Option<Range<usize>>| match (a, b) {
        (Some(a), Some(b)) => Some(a.start.min(b.start)..a.end.max(b.end)),
        (a, b) => a.or(b),
    };
    nodes.par_iter_mut().enumerate().with_min_len(CHUNK).map(requantise).reduce(|| None, either)
}

/// The box around triangles, not padded.
pub(super) fn triangle_bounds(triangles: &[Triangle]) -> SimdAabb {
    let corners = triangles.iter().flat_map(|triangle| bytemuck::cast::<_, [Vec4; 3]>(*triangle));
    corners.fold(SimdAabb::EMPTY, SimdAabb::extended_to)
}
