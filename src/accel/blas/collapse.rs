//! From a binary tree to nodes of eight children with quantised boxes.
//!
//! What is opened: of the children so far the inner one with the largest box, until there are eight (I. Wald, C. Benthin,
//! S. Boulos, *Getting Rid of Packets*, 2008). What lies deep is opened first where the depth of the result would otherwise
//! pass [`MAX_WIDE_DEPTH`], so that a traversal needs no larger stack.
//!
//! Boxes are those of H. Ylitie, T. Karras, S. Laine, *Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide
//! BVHs* (2017): a grid over the node with steps of a power of two a side. Children stand in the slots that suit their place,
//! bit k of the slot's number for the far side along axis k: by ascending `slot ^ octant of the ray` they come near to far.
//!
//! **Rounding.** A child's planes lie outside of its (padded) box by at least [`QUANTIZATION_MARGIN`] of a step. A ray's distance from a
//! plane is computed as `(plane * step + (origin - ray.origin)) * reciprocal`. `plane * step` is exact. With v = 2^-23, the
//! relative error of an operation, the difference is at most v |origin - ray.origin| off. Now |origin - ray.origin| is at most
//! the plane's distance and 255 steps: the first part is relative to the result, as are the roundings of the sum and the product, and
//! [`BOX_ENTRY_SCALE`](crate::trace) allows for them; the second is less than 2^-15 steps, which the margin covers. Packets of rays that go
//! anywhere compute it as `plane * (step * reciprocal) + (origin - ray.origin) * reciprocal`, fused: neither product has more than two
//! roundings, and |plane * step| is at most 255 steps too, so that what is not relative to the result is less than 2^-13 steps.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::prune::{PrunedTree, SubtreeRoot};
use crate::device::layout::{PrimitiveRange, WideNode};

/// Wide nodes from the root to the deepest, at most: 3 levels of binary nodes each, see [`MAX_BLAS_DEPTH`](crate::accel::MAX_BLAS_DEPTH).
pub const MAX_WIDE_DEPTH: usize = crate::accel::MAX_BLAS_DEPTH.div_ceil(3);

/// In steps; see the module's text.
const QUANTIZATION_MARGIN: f64 = 1.0 / (1 << 10) as f64;

/// A subtree of so few triangles is a leaf: as many are tested at once.
pub(super) const MAX_WIDE_LEAF_SIZE: u32 = 4;

/// Subtrees that become fewer nodes with escape indices are collapsed by one thread.
const TASK_MINIMUM: usize = 1 << 12;

/// Children of a wide node.
pub(super) const WIDE_CHILD_COUNT: usize = 8;

/// The wide nodes of a tree in depth-first order. O(n).
pub(super) fn collapse(tree: &PrunedTree<'_>) -> Vec<WideNode> {
    WideCollapse { tree }.write_subtree_parallel(tree.root(), MAX_WIDE_DEPTH)
}

struct WideCollapse<'a> {
    tree: &'a PrunedTree<'a>,
}

/// A node whose inner children stand so many places further on.
fn with_child_indices_shifted(mut node: WideNode, by: u32) -> WideNode {
    // Nothing is at index 0 but the root: unused slots are zero.
    for child in node.children.iter_mut().filter(|child| child.primitive_count() == 0 && child.first_primitive() > 0) {
        *child = PrimitiveRange::inner(child.first_primitive() + by);
    }
    node
}

impl WideCollapse<'_> {
    /// The wide nodes of a subtree that may have `levels` levels of them, those of large children side by side. Recursion is at
    /// most [`MAX_WIDE_DEPTH`] deep.
    fn write_subtree_parallel(&self, subtree: SubtreeRoot, levels: usize) -> Vec<WideNode> {
        let size = self.tree.size(subtree.node).nodes as usize;
        let mut wide = Vec::with_capacity(size / 4 + 1);
        if size < TASK_MINIMUM {
            self.emit(subtree, levels, &mut wide);
            return wide;
        }
        let (node, inner) = self.collapse_node(subtree, levels);
        let below = |child: &Option<SubtreeRoot>| child.map(|child| self.write_subtree_parallel(child, levels - 1));
        let below: Vec<Option<Vec<WideNode>>> = inner.par_iter().map(below).collect();
        wide.push(node);
        for (slot, below) in below.into_iter().enumerate().filter_map(|(slot, below)| Some((slot, below?))) {
            let first = wide.len() as u32;
            wide[0].children[slot] = PrimitiveRange::inner(first);
            wide.extend(below.into_iter().map(|node| with_child_indices_shifted(node, first)));
        }
        wide
    }

    /// The same, appended by one thread. Returns the index of the subtree's root.
    fn emit(&self, subtree: SubtreeRoot, levels: usize, wide: &mut Vec<WideNode>) -> u32 {
        let (node, inner) = self.collapse_node(subtree, levels);
        let own = wide.len();
        wide.push(node);
        for (slot, child) in inner.into_iter().enumerate().filter_map(|(slot, child)| Some((slot, child?))) {
            wide[own].children[slot] = PrimitiveRange::inner(self.emit(child, levels - 1, wide));
        }
        own as u32
    }

    /// A wide node, but for the indices of its inner children, and what is to become these.
    fn collapse_node(
        &self,
        subtree: SubtreeRoot,
        levels: usize,
    ) -> (WideNode, [Option<SubtreeRoot>; WIDE_CHILD_COUNT]) {
        let mut opened = [subtree; WIDE_CHILD_COUNT];
        let count = self.open_children(subtree, levels, &mut opened);
        let boxes = opened.map(|child| self.tree.padded_corners(child.node));
        let slots = assign_slots(&boxes[..count]);
        let mut node =
            quantize_node(self.tree.padded_corners(subtree.node), &slots.map(|child| child.map(|child| boxes[child])));
        let slots = slots.map(|child| child.map(|child| opened[child]));
        for (slot, child) in slots.iter().enumerate() {
            if let Some(leaf) = child.filter(|child| self.tree.wide_leaf_height(child.node) == 0) {
                node.children[slot] = PrimitiveRange::leaf(leaf.first_primitive, self.tree.size(leaf.node).primitives);
            }
        }
        (node, slots.map(|child| child.filter(|child| self.tree.wide_leaf_height(child.node) > 0)))
    }

    /// The subtrees that become children; a leaf on its own becomes its only child.
    fn open_children(
        &self,
        subtree: SubtreeRoot,
        levels: usize,
        opened: &mut [SubtreeRoot; WIDE_CHILD_COUNT],
    ) -> usize {
        let of = |subtree: SubtreeRoot| {
            (usize::from(self.tree.wide_leaf_height(subtree.node)), self.tree.half_area(subtree.node))
        };
        let mut heights_and_areas = [of(subtree); WIDE_CHILD_COUNT];
        let mut count = 1;
        while count < WIDE_CHILD_COUNT {
            let inner = || (0..count).filter(|&place| heights_and_areas[place].0 > 0);
            // Those too high for the levels below must be opened; three levels of them are eight.
            let Some(tallest) = inner().max_by_key(|&place| heights_and_areas[place].0) else { break };
            let largest = || inner().max_by(|&a, &b| heights_and_areas[a].1.total_cmp(&heights_and_areas[b].1));
            let is_too_high = heights_and_areas[tallest].0 > 3 * (levels - 1);
            let next = if is_too_high { tallest } else { largest().unwrap_or(tallest) };
            let Some(children) = self.tree.children(opened[next]) else { break };
            for (place, child) in [next, count].into_iter().zip(children) {
                opened[place] = child;
                heights_and_areas[place] = of(child);
            }
            count += 1;
        }
        count
    }
}

/// For each slot the child, by its box, that is nearest to the slot's corner, the most decided first.
fn assign_slots(boxes: &[[Vec3; 2]]) -> [Option<usize>; WIDE_CHILD_COUNT] {
    let mut places = [Vec3::ZERO; WIDE_CHILD_COUNT];
    let mut mean = Vec3::ZERO;
    for (place, [min, max]) in places.iter_mut().zip(boxes) {
        *place = *min * 0.5 + *max * 0.5;
        mean += *place / boxes.len() as f32;
    }
    let mut slots = [None; WIDE_CHILD_COUNT];
    let mut free = u8::MAX;
    // For each child the free slot that suits it best.
    let mut best: [(f32, usize); WIDE_CHILD_COUNT] = std::array::from_fn(|i| best_slot(places[i] - mean, free));
    let mut is_waiting = [true; WIDE_CHILD_COUNT];
    for _ in 0..boxes.len() {
        let waiting = (0..boxes.len()).filter(|&i| is_waiting[i]);
        let Some(i) = waiting.max_by(|&a, &b| best[a].0.total_cmp(&best[b].0)) else { break };
        let slot = best[i].1;
        slots[slot] = Some(i);
        is_waiting[i] = false;
        free &= !(1 << slot);
        for j in 0..boxes.len() {
            if is_waiting[j] && best[j].1 == slot {
                best[j] = best_slot(places[j] - mean, free);
            }
        }
    }
    slots
}

/// Of the slots whose bits are set the one whose corner is farthest in a direction, and how far.
fn best_slot(direction: Vec3, free: u8) -> (f32, usize) {
    let [x, y, z] = direction.to_array();
    let mut best = (f32::NEG_INFINITY, free.trailing_zeros() as usize % WIDE_CHILD_COUNT);
    for slot in (0..WIDE_CHILD_COUNT).filter(|slot| free >> slot & 1 != 0) {
        let along = |axis: usize, d: f32| if slot >> axis & 1 != 0 { d } else { -d };
        let score = along(0, x) + along(1, y) + along(2, z);
        if score > best.0 {
            best = (score, slot);
        }
    }
    best
}

/// A wide node without its children's indices: the least and greatest corner of its box, and of those of its children.
pub(super) fn quantize_node(own: [Vec3; 2], slots: &[Option<[Vec3; 2]>; WIDE_CHILD_COUNT]) -> WideNode {
    let [min, max] = own.map(Vec3::as_dvec3);
    let grid = QuantizationGrid::around(min, max);
    let mut wide = WideNode {
        origin: grid.origin.as_vec3().to_array(),
        exponents: [0; 4],
        planes: [[[u8::MAX; WIDE_CHILD_COUNT], [0; WIDE_CHILD_COUNT]]; 3],
        children: [PrimitiveRange::INNER; WIDE_CHILD_COUNT],
    };
    wide.exponents[..3].copy_from_slice(&grid.exponents);
    for (slot, child) in slots.iter().enumerate() {
        let Some(child) = child else { continue };
        wide.exponents[3] |= 1 << slot;
        let [min, max] = child.map(Vec3::as_dvec3);
        for axis in 0..3 {
            // A power of two: nothing is rounded.
            let steps = step_length(grid.exponents[axis]).recip();
            let from = |plane: f64| (plane - grid.origin[axis]) * steps;
            // Rounded down and up without a call, which it is where the processor need not have an instruction for it.
            let most = from(max[axis]) + QUANTIZATION_MARGIN;
            let below = most as u8;
            wide.planes[axis][0][slot] = (from(min[axis]) - QUANTIZATION_MARGIN) as u8;
            wide.planes[axis][1][slot] = below + u8::from(f64::from(below) < most);
        }
    }
    wide
}

/// Where the planes of a node can lie.
struct QuantizationGrid {
    origin: DVec3,
    exponents: [u8; 3],
}

impl QuantizationGrid {
    fn around(min: DVec3, max: DVec3) -> Self {
        let mut grid = Self { origin: DVec3::ZERO, exponents: [0; 3] };
        for axis in 0..3 {
            // From the least step up: the origin moves out with the margin.
            let least = ((max[axis] - min[axis]) / 255.0).max(f64::from(f32::MIN_POSITIVE)) as f32;
            let mut exponent = (least.to_bits() >> 23) as u8;
            loop {
                let step = step_length(exponent);
                let origin = f64::from(((min[axis] - QUANTIZATION_MARGIN * step) as f32).next_down().max(f32::MIN));
                if (max[axis] - origin) / step + QUANTIZATION_MARGIN <= 255.0 {
                    grid.origin[axis] = origin;
                    grid.exponents[axis] = exponent;
                    break;
                }
                exponent += 1;
            }
        }
        grid
    }
}

fn step_length(exponent: u8) -> f64 {
    f64::from(f32::from_bits(u32::from(exponent) << 23))
}
