//! Ordered traversal of a BLAS's wide nodes with a stack, shared by packet and single-ray traversal. Order: by the
//! ray's direction octant.

use crate::accel::MAX_WIDE_DEPTH;
use crate::device::layout::{PrimitiveRange, WideNode};

/// The node and leaf tests of a traversal.
pub(super) trait NodeVisitor {
    /// Intersects the eight children of a node; returns a bit per slot that is hit and keeps the entry distances for
    /// `depth`, which is less than [`MAX_NODE_DEPTH`].
    fn intersect_children(&mut self, node: &WideNode, depth: usize) -> u32;

    /// Of `slots`, children of the last node intersected at `depth`, those whose entry distance is still within
    /// `t_max`.
    fn cull_beyond_t_max(&self, slots: u32, depth: usize) -> u32;

    /// Called before descending into the inner node of index `child`, at `slot` of the last node intersected at
    /// `depth`, which is `node`.
    fn enter_child(&mut self, node: &WideNode, depth: usize, slot: usize, child: u32) -> ChildVisit;

    /// Intersects the triangles of the leaf at `slot` of the last node intersected at `depth`, which is `node`; returns
    /// whether `t_max` may have shrunk.
    fn visit_leaf(&mut self, node: &WideNode, depth: usize, slot: usize, triangles: PrimitiveRange) -> bool;
}

/// What becomes of an inner node that a traversal has reached.
#[derive(Clone, Copy)]
pub(super) enum ChildVisit {
    /// The traversal descends into it.
    Descend,
    /// The visitor has handled its whole subtree.
    Done {
        /// Whether `t_max` may have shrunk.
        t_max_shortened: bool,
    },
}

/// Depth of the per-level arrays: more than the number of nodes on any path from the root.
pub(super) const MAX_NODE_DEPTH: usize = MAX_WIDE_DEPTH + 1;

/// Stack entries: index of an ancestor and a bit for each of its children still to be visited. Reused without clearing;
/// each entry is written before it is read.
pub(super) type Stack = [(u32, u32); MAX_NODE_DEPTH];

/// Visits the leaves below `root` in front-to-back order of `octant` (bit i set: the direction is negative along axis
/// i).
#[inline(always)]
pub(super) fn traverse_blas(
    nodes: &[WideNode],
    root: u32,
    octant: usize,
    stack: &mut Stack,
    visitor: &mut impl NodeVisitor,
) {
    let nearest_slots = &NEAREST_SLOT[octant & 7];
    let mut depth = 0;
    let mut index = root;
    loop {
        // Intersect the children of the current node.
        let mut node = &nodes[index as usize];
        let mut pending_slots = visitor.intersect_children(node, depth);
        // Visit pending children until one must be descended into.
        index = loop {
            // Pop the nearest ancestor with pending children, dropping those beyond t_max.
            while pending_slots == 0 {
                if depth == 0 {
                    return;
                }
                depth -= 1;
                (index, pending_slots) = stack[depth];
                pending_slots = visitor.cull_beyond_t_max(pending_slots, depth);
                node = &nodes[index as usize];
            }
            // Take the pending child nearest in octant order.
            let slot = usize::from(nearest_slots[pending_slots as usize & 255]) & 7;
            pending_slots &= !(1 << slot);
            let child = node.children[slot];
            let t_max_shortened = if child.is_leaf() {
                // Leaf: intersect its triangles.
                visitor.visit_leaf(node, depth, slot, child.triangles())
            } else if let ChildVisit::Done { t_max_shortened } =
                visitor.enter_child(node, depth, slot, child.node_index())
            {
                // Inner node whose subtree the visitor has handled itself, by single rays.
                t_max_shortened
            } else {
                // Otherwise push the siblings and descend.
                if pending_slots != 0 {
                    stack[depth] = (index, pending_slots);
                    depth += 1;
                }
                break child.node_index();
            };
            // t_max may have shrunk: cull pending siblings.
            if t_max_shortened {
                pending_slots = visitor.cull_beyond_t_max(pending_slots, depth);
            }
        };
    }
}

/// `NEAREST_SLOT[octant][slots]`: the slot of the set `slots` with the least `slot ^ octant` (Ylitie et al. 2017,
/// section 3).
static NEAREST_SLOT: [[u8; 256]; 8] = {
    let mut nearest = [[0; 256]; 8];
    let mut octant = 0;
    while octant < 8 {
        let mut slots = 1;
        while slots < 256 {
            let mut rank = 0;
            while slots >> (rank ^ octant) & 1 == 0 {
                rank += 1;
            }
            nearest[octant][slots] = (rank ^ octant) as u8;
            slots += 1;
        }
        octant += 1;
    }
    nearest
};
