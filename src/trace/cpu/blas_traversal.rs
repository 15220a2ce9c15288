//! The way through a bottom-level structure, for one ray and for several that go together: children nearest first, with a stack.

use crate::accel::MAX_WIDE_DEPTH;
use crate::device::layout::{PrimitiveRange, WideNode};

/// What goes through a structure.
pub(super) trait NodeVisitor {
    /// The slots of a node's children that are met. `depth` is less than [`MAX_NODE_DEPTH`].
    fn intersect_children(&mut self, node: &WideNode, depth: usize) -> u32;

    /// Those of these children that are still met: they are of the node that was met last at that depth.
    fn cull_beyond_t_max(&self, slots: u32, depth: usize) -> u32;

    /// Asked before it goes down to a child, the node of that index, in that slot of the node that was met last at that depth:
    /// `None` to do so, or that the child is done with, and whether there may be fewer that are still met.
    fn inner(&mut self, node: &WideNode, depth: usize, slot: usize, child: u32) -> Option<bool>;

    /// Tests the triangles of a leaf in that slot of the node that was met last at that depth; says whether there may be fewer that are still
    /// met.
    fn visit_leaf(&mut self, node: &WideNode, depth: usize, slot: usize, triangles: PrimitiveRange) -> bool;
}

/// Nodes that are visited at a time.
pub(super) const MAX_NODE_DEPTH: usize = MAX_WIDE_DEPTH + 1;

/// The nodes above, and a bit for each of their children that are still to be visited. Kept from ray to ray, so that nothing clears it.
pub(super) type Stack = [(u32, u32); MAX_NODE_DEPTH];

/// Visits leaves from the node of index `root` on. `octant` has a bit for each axis that the rays go down.
#[inline(always)]
pub(super) fn traverse_blas(
    nodes: &[WideNode],
    root: u32,
    octant: usize,
    stack: &mut Stack,
    walker: &mut impl NodeVisitor,
) {
    let first_of = &NEAREST_SLOT[octant & 7];
    let mut depth = 0;
    let mut index = root;
    loop {
        let mut node = &nodes[index as usize];
        let mut waiting = walker.intersect_children(node, depth);
        // The next inner node, through the leaves on the way.
        index = loop {
            while waiting == 0 {
                if depth == 0 {
                    return;
                }
                depth -= 1;
                (index, waiting) = stack[depth];
                waiting = walker.cull_beyond_t_max(waiting, depth);
                node = &nodes[index as usize];
            }
            let slot = usize::from(first_of[waiting as usize & 255]) & 7;
            waiting &= !(1 << slot);
            let child = node.children[slot];
            let may_be_fewer = if child.is_leaf() {
                walker.visit_leaf(node, depth, slot, child.triangles())
            } else if let Some(may_be_fewer) = walker.inner(node, depth, slot, child.node_index()) {
                may_be_fewer
            } else {
                if waiting != 0 {
                    stack[depth] = (index, waiting);
                    depth += 1;
                }
                break child.node_index();
            };
            if may_be_fewer {
                waiting = walker.cull_beyond_t_max(waiting, depth);
            }
        };
    }
}

/// For each octant of a ray's direction and each set of children the slot of the first to be visited: the least `slot ^ octant`.
static NEAREST_SLOT: [[u8; 256]; 8] = {
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
