//! Collapses a build tree into 8-wide nodes with quantised boxes. Its leaves are those that pruning made; inner nodes
//! count whether pruning keeps them or not.
//!
//! A wide node starts as one binary node, and the inner child with the largest surface area is replaced by its two
//! children until there are eight (I. Wald, C. Benthin, S. Boulos, *Getting Rid of Packets*, 2008). Where the result
//! would otherwise exceed [`MAX_WIDE_DEPTH`] levels, the tallest child is opened instead, so that traversal stacks have
//! a fixed size.
//!
//! A child is assigned the slot whose octant it lies in (bit k of the slot index: the positive side along axis k), so
//! that ascending `slot ^ ray_octant` visits children roughly front to back (H. Ylitie, T. Karras, S. Laine, *Efficient
//! Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs*, 2017).

use glam::Vec3;
use rayon::prelude::*;

use super::prune::{PrunedTree, SubtreeRoot};
use super::quantize::{WIDE_CHILD_COUNT, quantize_node};
use crate::accel::tree::MAX_BLAS_DEPTH;
use crate::device::layout::{WideChild, WideNode};

/// The most levels of wide nodes. One wide node covers up to three binary levels, of which there are at most
/// [`MAX_BLAS_DEPTH`].
pub const MAX_WIDE_DEPTH: usize = MAX_BLAS_DEPTH.div_ceil(3);

/// Subtrees with fewer binary nodes than this are collapsed by one thread.
const TASK_MINIMUM: usize = 1 << 12;

/// The wide nodes of a tree in depth-first order. O(n).
pub(super) fn collapse(tree: &PrunedTree<'_>) -> Vec<WideNode> {
    WideCollapse { tree }.write_subtree_parallel(tree.root(), MAX_WIDE_DEPTH)
}

/// Read-only state shared by all threads.
struct WideCollapse<'a> {
    tree: &'a PrunedTree<'a>,
}

/// The node with the indices of its inner children increased by `by`, for appending a subtree to an array.
fn with_child_indices_shifted(mut node: WideNode, by: u32) -> WideNode {
    for child in node.children.iter_mut().filter(|child| !child.is_leaf() && !child.is_unused()) {
        *child = WideChild::node(child.node_index() + by);
    }
    node
}

impl WideCollapse<'_> {
    /// Collapses a subtree into at most `levels` levels of wide nodes, large children in parallel. Recursion is at most
    /// [`MAX_WIDE_DEPTH`] deep.
    fn write_subtree_parallel(&self, subtree: SubtreeRoot, levels: usize) -> Vec<WideNode> {
        let size = self.tree.size(subtree.node).nodes as usize;
        // 1. A small subtree is collapsed by this thread.
        let mut wide = Vec::with_capacity(size / 4 + 1);
        if size < TASK_MINIMUM {
            self.append_subtree(subtree, levels, &mut wide);
            return wide;
        }
        // 2. Make the node of a large one, and collapse its inner children in parallel.
        let (node, inner) = self.collapse_node(subtree, levels);
        let below = |child: &Option<SubtreeRoot>| child.map(|child| self.write_subtree_parallel(child, levels - 1));
        let below: Vec<Option<Vec<WideNode>>> = inner.par_iter().map(below).collect();
        // 3. Append their nodes, with child indices shifted to their new positions.
        wide.push(node);
        for (slot, below) in below.into_iter().enumerate().filter_map(|(slot, below)| Some((slot, below?))) {
            let first = wide.len() as u32;
            wide[0].children[slot] = WideChild::node(first);
            wide.extend(below.into_iter().map(|node| with_child_indices_shifted(node, first)));
        }
        wide
    }

    /// [`write_subtree_parallel`](Self::write_subtree_parallel) on one thread, appended to `wide`. Returns the index of
    /// the subtree's root.
    fn append_subtree(&self, subtree: SubtreeRoot, levels: usize, wide: &mut Vec<WideNode>) -> u32 {
        let (node, inner) = self.collapse_node(subtree, levels);
        let own = wide.len();
        wide.push(node);
        for (slot, child) in inner.into_iter().enumerate().filter_map(|(slot, child)| Some((slot, child?))) {
            wide[own].children[slot] = WideChild::node(self.append_subtree(child, levels - 1, wide));
        }
        own as u32
    }

    /// One wide node whose inner children are not linked yet, and for each slot the subtree from which its inner child
    /// will be collapsed.
    fn collapse_node(
        &self,
        subtree: SubtreeRoot,
        levels: usize,
    ) -> (WideNode, [Option<SubtreeRoot>; WIDE_CHILD_COUNT]) {
        // 1. Choose up to eight subtrees.
        let mut child_subtrees = [subtree; WIDE_CHILD_COUNT];
        let count = self.open_children(subtree, levels, &mut child_subtrees);
        // 2. Assign them to slots by position.
        let boxes = child_subtrees.map(|child| self.tree.padded_corners(child.node));
        let slots = assign_slots(&boxes[..count]);
        // 3. Quantise their boxes.
        let mut node =
            quantize_node(self.tree.padded_corners(subtree.node), &slots.map(|child| child.map(|child| boxes[child])));
        // 4. Link the leaves; the caller links the inner children.
        let slots = slots.map(|child| child.map(|child| child_subtrees[child]));
        for (slot, child) in slots.iter().enumerate() {
            if let Some(leaf) = child.filter(|child| self.tree.wide_leaf_height(child.node) == 0) {
                node.children[slot] = WideChild::leaf(leaf.first_primitive, self.tree.size(leaf.node).primitives);
            }
        }
        (node, slots.map(|child| child.filter(|child| self.tree.wide_leaf_height(child.node) > 0)))
    }

    /// Chooses the up to eight subtrees that become children of one wide node, and returns their number. A subtree that
    /// is a leaf becomes the only child.
    fn open_children(
        &self,
        subtree: SubtreeRoot,
        levels: usize,
        child_subtrees: &mut [SubtreeRoot; WIDE_CHILD_COUNT],
    ) -> usize {
        let height_and_area = |subtree: SubtreeRoot| {
            (usize::from(self.tree.wide_leaf_height(subtree.node)), self.tree.half_area(subtree.node))
        };
        let mut heights_and_areas = [height_and_area(subtree); WIDE_CHILD_COUNT];
        let mut count = 1;
        while count < WIDE_CHILD_COUNT {
            // 1. Choose an inner child: the tallest if it is too high for the remaining levels, of which each covers
            // three binary ones, else the largest.
            let inner = || (0..count).filter(|&child| heights_and_areas[child].0 > 0);
            let Some(tallest) = inner().max_by_key(|&child| heights_and_areas[child].0) else { break };
            let largest = || inner().max_by(|&a, &b| heights_and_areas[a].1.total_cmp(&heights_and_areas[b].1));
            let is_too_high = heights_and_areas[tallest].0 > 3 * (levels - 1);
            let next = if is_too_high { tallest } else { largest().unwrap_or(tallest) };
            // 2. Replace it by its two children.
            let Some(children) = self.tree.children(child_subtrees[next]) else { break };
            for (index, child) in [next, count].into_iter().zip(children) {
                child_subtrees[index] = child;
                heights_and_areas[index] = height_and_area(child);
            }
            count += 1;
        }
        count
    }
}

/// Greedily assigns each child the free slot whose corner direction best matches the child's position, the best match
/// first (Ylitie et al. solve an assignment problem by auction). Takes the boxes of the children; returns the child of
/// each slot.
fn assign_slots(boxes: &[[Vec3; 2]]) -> [Option<usize>; WIDE_CHILD_COUNT] {
    // 1. The centres of the children, and their mean.
    let mut centers = [Vec3::ZERO; WIDE_CHILD_COUNT];
    let mut mean = Vec3::ZERO;
    for (center, [min, max]) in centers.iter_mut().zip(boxes) {
        *center = *min * 0.5 + *max * 0.5;
        mean += *center / boxes.len() as f32;
    }
    let mut slots = [None; WIDE_CHILD_COUNT];
    let mut free = u8::MAX;
    // 2. For each child, its best free slot and how well that matches.
    let mut best: [(f32, usize); WIDE_CHILD_COUNT] = std::array::from_fn(|i| best_slot(centers[i] - mean, free));
    // 3. Repeatedly give the best match its slot, and choose again for the children that wanted the same slot.
    let mut is_unassigned = [true; WIDE_CHILD_COUNT];
    for _ in 0..boxes.len() {
        let unassigned = (0..boxes.len()).filter(|&i| is_unassigned[i]);
        let Some(i) = unassigned.max_by(|&a, &b| best[a].0.total_cmp(&best[b].0)) else { break };
        let slot = best[i].1;
        slots[slot] = Some(i);
        is_unassigned[i] = false;
        free &= !(1 << slot);
        for j in 0..boxes.len() {
            if is_unassigned[j] && best[j].1 == slot {
                best[j] = best_slot(centers[j] - mean, free);
            }
        }
    }
    slots
}

/// Of the slots whose bit in `free` is set, the one whose corner lies farthest along `direction`, and that distance.
fn best_slot(direction: Vec3, free: u8) -> (f32, usize) {
    let [x, y, z] = direction.to_array();
    let mut best = (f32::NEG_INFINITY, free.trailing_zeros() as usize % WIDE_CHILD_COUNT);
    for slot in (0..WIDE_CHILD_COUNT).filter(|slot| free >> slot & 1 != 0) {
        let along = |axis: usize, d: f32| if slot >> axis & 1 != 0 { d } else { -d };
        let alignment = along(0, x) + along(1, y) + along(2, z);
        if alignment > best.0 {
            best = (alignment, slot);
        }
    }
    best
}
