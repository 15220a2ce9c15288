//! From binary nodes to nodes of eight children with quantised boxes.
//!
//! What is opened: of the children so far the inner one with the largest box, until there are eight (I. Wald, C. Benthin,
//! S. Boulos, *Getting Rid of Packets*, 2008). What lies deep is opened first where the depth of the result would otherwise
//! pass [`MAX_WIDE_DEPTH`], so that a traversal needs no larger stack.
//!
//! Boxes are those of H. Ylitie, T. Karras, S. Laine, *Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide
//! BVHs* (2017): a grid over the node with steps of a power of two a side. Children stand in the slots that suit their place,
//! bit k of the slot's number for the far side along axis k: by ascending `slot ^ octant of the ray` they come near to far.
//!
//! **Rounding.** A child's planes lie outside of its (padded) box by at least [`MARGIN`] of a step. A ray's distance from a
//! plane is computed as `(plane * step + (origin - ray.origin)) * reciprocal`. `plane * step` is exact. With v = 2^-23, the
//! relative error of an operation, the difference is at most v |origin - ray.origin| off. Now |origin - ray.origin| is at most
//! the plane's distance and 255 steps: the first part is relative to the result, as are the roundings of the sum and the product, and
//! [`BOX_SLACK`](crate::trace) allows for them; the second is less than 2^-15 steps, which the margin covers. Packets of rays that go
//! anywhere compute it as `plane * (step * reciprocal) + (origin - ray.origin) * reciprocal`, fused: neither product has more than two
//! roundings, and |plane * step| is at most 255 steps too, so that what is not relative to the result is less than 2^-13 steps.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::stats::half_area;
use crate::device::layout::{Node, PrimitiveRange, WideNode};

/// Wide nodes from the root to the deepest, at most: 3 levels of binary nodes each, see [`MAX_DEPTH`](super::MAX_DEPTH).
pub const MAX_WIDE_DEPTH: usize = super::MAX_DEPTH.div_ceil(3);

/// In steps; see the module's text.
const MARGIN: f64 = 1.0 / (1 << 10) as f64;

/// A subtree of so few triangles is a leaf: as many are tested at once.
const LEAF_SIZE: u8 = 4;

/// Subtrees of fewer binary nodes are collapsed by one thread.
const TASK_MINIMUM: usize = 1 << 12;

/// Children of a wide node.
pub(super) const WIDTH: usize = 8;

/// The wide nodes of a binary hierarchy in depth-first order (the right child of an inner node is where the left one's escape
/// index leads). O(n).
pub(super) fn collapse(nodes: &[Node]) -> Vec<WideNode> {
    if nodes.is_empty() {
        return Vec::new();
    }
    let subtrees = subtrees(nodes);
    Tree { nodes, subtrees: &subtrees }.emit_in_parallel(0, MAX_WIDE_DEPTH)
}

struct Tree<'a> {
    nodes: &'a [Node],
    /// What lies below each node.
    subtrees: &'a [Subtree],
}

#[derive(Clone, Copy, Default)]
struct Subtree {
    /// Levels of inner nodes; 0 for what becomes a leaf.
    height: u8,
    /// Triangles, or as many as a leaf holds and one more.
    triangles: u8,
    first: u32,
}

fn subtrees(nodes: &[Node]) -> Vec<Subtree> {
    let mut subtrees = vec![Subtree::default(); nodes.len()];
    for index in (0..nodes.len()).rev() {
        let primitives = nodes[index].primitives;
        subtrees[index] = if primitives == PrimitiveRange::INNER {
            let [left, right] = children(nodes, index).map(|child| subtrees[child]);
            let triangles = u8::min(left.triangles + right.triangles, LEAF_SIZE + 1);
            let height = if triangles <= LEAF_SIZE { 0 } else { 1 + u8::max(left.height, right.height) };
            Subtree { height, triangles, first: left.first }
        } else {
            Subtree { height: 0, triangles: primitives.count() as u8, first: primitives.first() }
        };
    }
    subtrees
}

/// A node whose inner children stand so many places further on.
fn moved(mut node: WideNode, by: u32) -> WideNode {
    // Nothing is at index 0 but the root: unused slots are zero.
    for child in node.children.iter_mut().filter(|child| child.count() == 0 && child.first() > 0) {
        *child = PrimitiveRange::inner(child.first() + by);
    }
    node
}

fn children(nodes: &[Node], index: usize) -> [usize; 2] {
    [index + 1, nodes[index + 1].escape_index as usize]
}

impl Tree<'_> {
    /// The wide nodes of a subtree that may have `levels` levels of them, those of large children side by side. Recursion is at
    /// most [`MAX_WIDE_DEPTH`] deep.
    fn emit_in_parallel(&self, index: usize, levels: usize) -> Vec<WideNode> {
        let size = (self.nodes[index].escape_index as usize).min(self.nodes.len()) - index;
        let mut wide = Vec::with_capacity(size / 8 + 1);
        if size < TASK_MINIMUM {
            self.emit(index, levels, &mut wide);
            return wide;
        }
        let (node, inner) = self.node(index, levels);
        let below = |child: &Option<usize>| child.map(|child| self.emit_in_parallel(child, levels - 1));
        let below: Vec<Option<Vec<WideNode>>> = inner.par_iter().map(below).collect();
        wide.push(node);
        for (slot, below) in below.into_iter().enumerate().filter_map(|(slot, below)| Some((slot, below?))) {
            let first = wide.len() as u32;
            wide[0].children[slot] = PrimitiveRange::inner(first);
            wide.extend(below.into_iter().map(|node| moved(node, first)));
        }
        wide
    }

    /// The same, appended by one thread. Returns the index of the subtree's root.
    fn emit(&self, index: usize, levels: usize, wide: &mut Vec<WideNode>) -> u32 {
        let (node, inner) = self.node(index, levels);
        let own = wide.len();
        wide.push(node);
        for (slot, child) in inner.into_iter().enumerate().filter_map(|(slot, child)| Some((slot, child?))) {
            wide[own].children[slot] = PrimitiveRange::inner(self.emit(child, levels - 1, wide));
        }
        own as u32
    }

    /// A wide node, but for the indices of its inner children, and what is to become these.
    fn node(&self, index: usize, levels: usize) -> (WideNode, [Option<usize>; WIDTH]) {
        let mut opened = [0; WIDTH];
        let count = self.open(index, levels, &mut opened);
        let slots = assign_slots(self.nodes, &opened[..count]);
        let corners = |node: usize| [self.nodes[node].min, self.nodes[node].max].map(Vec3::from_array);
        let mut node = quantised(corners(index), &slots.map(|child| child.map(corners)));
        for (slot, &child) in slots.iter().enumerate() {
            let Some(Subtree { height: 0, triangles, first }) = child.map(|child| self.subtrees[child]) else {
                continue;
            };
            node.children[slot] = PrimitiveRange::leaf(first, u32::from(triangles));
        }
        (node, slots.map(|child| child.filter(|&child| self.subtrees[child].height > 0)))
    }

    /// The nodes that become children; a leaf on its own becomes its only child.
    fn open(&self, index: usize, levels: usize, opened: &mut [usize; WIDTH]) -> usize {
        opened[0] = index;
        let mut count = 1;
        while count < WIDTH {
            let is_inner = |&&child: &&usize| self.subtrees[child].height > 0;
            let inner = || opened[..count].iter().filter(is_inner);
            // Those too high for the levels below must be opened; three levels of them are eight.
            let tallest = inner().max_by_key(|&&child| self.subtrees[child].height);
            let Some(&tallest) = tallest else { break };
            let next = if usize::from(self.subtrees[tallest].height) > 3 * (levels - 1) {
                tallest
            } else {
                let area = |child: &usize| half_area(&self.nodes[*child]);
                *inner().max_by(|a, b| area(a).total_cmp(&area(b))).unwrap_or(&tallest)
            };
            let [left, right] = children(self.nodes, next);
            let place = opened[..count].iter().position(|&child| child == next).unwrap_or_default();
            opened[place] = left;
            opened[count] = right;
            count += 1;
        }
        count
    }
}

/// Gives each child the slot whose corner it is nearest to, the most decided first.
fn assign_slots(nodes: &[Node], opened: &[usize]) -> [Option<usize>; WIDTH] {
    let centers =
        opened.iter().map(|&child| Vec3::from_array(nodes[child].min) * 0.5 + Vec3::from_array(nodes[child].max) * 0.5);
    let mut places = [Vec3::ZERO; WIDTH];
    let mut mean = Vec3::ZERO;
    for (place, center) in places.iter_mut().zip(centers) {
        *place = center;
        mean += center / opened.len() as f32;
    }
    let mut slots = [None; WIDTH];
    let mut waiting = (1_u32 << opened.len()) - 1;
    while waiting != 0 {
        let mut best = (f32::NEG_INFINITY, 0, 0);
        for i in (0..opened.len()).filter(|i| waiting >> i & 1 != 0) {
            for slot in (0..WIDTH).filter(|&slot| slots[slot].is_none()) {
                let corner = Vec3::from_array([0, 1, 2].map(|axis| if slot >> axis & 1 != 0 { 1.0 } else { -1.0 }));
                let score = (places[i] - mean).dot(corner);
                if score > best.0 || best.0 == f32::NEG_INFINITY {
                    best = (score, i, slot);
                }
            }
        }
        let (_, i, slot) = best;
        slots[slot] = Some(opened[i]);
        waiting &= !(1 << i);
    }
    slots
}

/// A wide node without its children's indices: the least and greatest corner of its box, and of those of its children.
pub(super) fn quantised(own: [Vec3; 2], slots: &[Option<[Vec3; 2]>; WIDTH]) -> WideNode {
    let [min, max] = own.map(Vec3::as_dvec3);
    let grid = Grid::around(min, max);
    let mut wide = WideNode {
        origin: grid.origin.as_vec3().to_array(),
        exponents: [0; 4],
        planes: [[[u8::MAX; WIDTH], [0; WIDTH]]; 3],
        children: [PrimitiveRange::INNER; WIDTH],
    };
    wide.exponents[..3].copy_from_slice(&grid.exponents);
    for (slot, child) in slots.iter().enumerate() {
        let Some(child) = child else { continue };
        wide.exponents[3] |= 1 << slot;
        let [min, max] = child.map(Vec3::as_dvec3);
        for axis in 0..3 {
            // A power of two: nothing is rounded.
            let steps = step(grid.exponents[axis]).recip();
            let from = |plane: f64| (plane - grid.origin[axis]) * steps;
            // Rounded down and up without a call, which it is where the processor need not have an instruction for it.
            let most = from(max[axis]) + MARGIN;
            let below = most as u8;
            wide.planes[axis][0][slot] = (from(min[axis]) - MARGIN) as u8;
            wide.planes[axis][1][slot] = below + u8::from(f64::from(below) < most);
        }
    }
    wide
}

/// Where the planes of a node can lie.
struct Grid {
    origin: DVec3,
    exponents: [u8; 3],
}

impl Grid {
    fn around(min: DVec3, max: DVec3) -> Self {
        let mut grid = Self { origin: DVec3::ZERO, exponents: [0; 3] };
        for axis in 0..3 {
            // From the least step up: the origin moves out with the margin.
            let least = ((max[axis] - min[axis]) / 255.0).max(f64::from(f32::MIN_POSITIVE)) as f32;
            let mut exponent = (least.to_bits() >> 23) as u8;
            loop {
                let step = step(exponent);
                let origin = f64::from(((min[axis] - MARGIN * step) as f32).next_down().max(f32::MIN));
                if (max[axis] - origin) / step + MARGIN <= 255.0 {
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

fn step(exponent: u8) -> f64 {
    f64::from(f32::from_bits(u32::from(exponent) << 23))
}
