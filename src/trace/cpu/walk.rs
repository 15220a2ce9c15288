//! The way through a bottom-level structure, for one ray and for several that go together: children nearest first, with a stack.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f32x16};

use crate::accel::MAX_WIDE_DEPTH;
use crate::device::layout::{PrimitiveRange, WideNode};
use crate::trace::kernel::BOX_SLACK;

/// What goes through a structure.
pub(super) trait Walker<S: Simd> {
    /// The slots of a node's children that are met, and where at the earliest. `depth` is less than [`DEPTH`].
    fn meet(&mut self, node: &WideNode, depth: usize) -> (u32, f32x8<S>);

    /// Asked before it goes down to a child, the node of that index, in that slot of a node, the last one that was met at that depth:
    /// `None` to do so, or that the child is done with, and whether [`t_max`](Self::t_max) has changed.
    fn inner(&mut self, node: &WideNode, depth: usize, slot: usize, child: u32) -> Option<bool>;

    /// Tests the triangles of a leaf in that slot of a node, the last one that was met at that depth; says whether
    /// [`t_max`](Self::t_max) has changed.
    fn leaf(&mut self, node: &WideNode, depth: usize, slot: usize, triangles: PrimitiveRange) -> bool;

    /// What lies farther does not matter.
    fn t_max(&self) -> f32x8<S>;
}

/// Nodes that are visited at a time.
pub(super) const DEPTH: usize = MAX_WIDE_DEPTH + 1;

/// The nodes that are being visited. Kept from ray to ray, so that nothing clears it.
pub(super) struct Stack([Level; DEPTH]);

/// A node some of whose children are still to be visited.
#[derive(Clone, Copy)]
struct Level {
    enters: [f32; 8],
    node: u32,
    /// A bit for each of those children.
    waiting: u32,
}

impl Default for Stack {
    fn default() -> Self {
        Self([Level { enters: [0.0; 8], node: 0, waiting: 0 }; DEPTH])
    }
}

/// Visits leaves from the node of index `root` on. `octant` has a bit for each axis that the rays go down.
#[inline(always)]
pub(super) fn walk<S: Simd>(
    simd: S,
    nodes: &[WideNode],
    root: u32,
    octant: usize,
    stack: &mut Stack,
    walker: &mut impl Walker<S>,
) {
    let levels = &mut stack.0;
    let first_of = &FIRST[octant & 7];
    let mut t_max = walker.t_max();
    let mut depth = 0;
    let mut index = root;
    loop {
        let mut node = &nodes[index as usize];
        let (mut waiting, mut enters) = walker.meet(node, depth);
        // The next inner node, through the leaves on the way.
        index = loop {
            while waiting == 0 {
                if depth == 0 {
                    return;
                }
                depth -= 1;
                let level = &levels[depth];
                enters = level.enters.simd_into(simd);
                waiting = level.waiting & enters.simd_le(t_max).to_bitmask() as u32;
                index = level.node;
                node = &nodes[index as usize];
            }
            let slot = usize::from(first_of[waiting as usize & 255]) & 7;
            waiting &= !(1 << slot);
            let child = node.children[slot];
            let is_nearer = if child.count() > 0 {
                walker.leaf(node, depth, slot, child)
            } else if let Some(is_nearer) = walker.inner(node, depth, slot, child.first()) {
                is_nearer
            } else {
                if waiting != 0 {
                    levels[depth] = Level { enters: enters.into(), node: index, waiting };
                    depth += 1;
                }
                break child.first();
            };
            if is_nearer {
                t_max = walker.t_max();
                waiting &= enters.simd_le(t_max).to_bitmask() as u32;
            }
        };
    }
}

/// For each octant of a ray's direction and each set of children the slot of the first to be visited: the least `slot ^ octant`.
static FIRST: [[u8; 256]; 8] = {
    let mut first = [[0; 256]; 8];
    let mut octant = 0;
    while octant < 8 {
        let mut set = 1;
        while set < 256 {
            let mut rank = 0;
            while set >> (rank ^ octant) & 1 == 0 {
                rank += 1;
            }
            first[octant][set] = (rank ^ octant) as u8;
            set += 1;
        }
        octant += 1;
    }
    first
};

/// What boxes must reach of a ray: its start in the lower lanes, its end, negated, in the upper ones. The greatest of these and of
/// where the ray enters and, negated, leaves the slabs of a box says whether it is met.
#[inline(always)]
pub(super) fn range<S: Simd>(t_min: f32x8<S>, t_max: f32x8<S>) -> f32x16<S> {
    (t_min * BOX_SLACK).combine(-t_max)
}

/// The slots whose boxes are met, and where, by the greatest of all slabs and the [`range`].
#[inline(always)]
pub(super) fn met<S: Simd>(simd: S, node: &WideNode, slabs: f32x16<S>) -> (u32, f32x8<S>) {
    let (enters, leaves) = slabs.split();
    let met = (enters + leaves).simd_le(f32x8::splat(simd, 0.0)).to_bitmask() as u32;
    (met & super::lanes::children(node), enters)
}
