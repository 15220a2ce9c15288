//! Near children first: the top level's nodes of two children, then the bottom levels' of eight. Twin of
//! `shaders/shared/wide.wgsl`.
//!
//! **Top level.** The depth-first array holds the binary tree: the left child of node i is i + 1, the right one is where the left one's
//! escape index leads. Both boxes are tested, the nearer one is visited, the other waits on a short stack. Where that is full the
//! subtree is walked along its escape indices instead, so the depth is unlimited. Rays that look for any hit do so from the
//! start: order gains them nothing.
//!
//! **Bottom levels.** The boxes of eight children are tested at once. Those that are met wait in the order of their slots for the
//! ray's octant (H. Ylitie, T. Karras, S. Laine, *Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs*, 2017);
//! while one is visited, the others are one entry of a stack: the node, a bit for each, and where the first of them begins. The
//! builder bounds the depth, so the stack always suffices. Both levels share it, as they do the loop: an instance is left when no more waits
//! than did when it was entered.
//!
//! **Boxes.** A box whose planes are multiples of a step from the node's origin is met where the exact one is: `accel::wide` proves it for
//! the expression here. The comparison allows [`BOX_ENTRY_SCALE`] as that of the exact boxes does, and "where the first begins" is
//! rounded down.

use glam::Vec3;

use super::KernelScene;
use super::intersect::{BOX_ENTRY_SCALE, SlabRay, intersects_box, max_component, shear_ray};
use super::math::{max, min};
use super::query::VisitOrder;
use super::traversal_state::{LeafTraversal, TraversalCounter, TraversalRay, tlas_root};
use crate::accel::MAX_WIDE_DEPTH;
use crate::device::layout::{NONE, Node, PrimitiveRange, RayRecord, WideNode};

/// Nodes of the top level that can wait.
pub(super) const TLAS_STACK_SIZE: u32 = 16;
/// Tells an instance from an inner node of the top level.
pub(super) const TLAS_LEAF_BIT: u32 = 1 << 31;
/// Wide nodes some of whose children can wait: all above the deepest.
pub(super) const BLAS_STACK_SIZE: u32 = MAX_WIDE_DEPTH as u32;
/// The lower bits of a stack entry's second word are the children that wait, the others those of a number.
pub(super) const PENDING_CHILDREN_MASK: u32 = 255;
/// What is never where a box begins.
pub(super) const NO_ENTRY: f32 = -1.0;

pub(super) struct WideTraversal<C> {
    place: TraversalRay,
    /// What comes next in the top level: the index of an inner node that is met, or its instance and [`TLAS_LEAF_BIT`]; along escape indices, the
    /// index of the next node; [`NONE`] where the stack says.
    tlas_next: u32,
    /// Where the walk along escape indices ends; 0 where there is none.
    tlas_rope_end: u32,
    /// How many of the top level wait.
    tlas_stack_size: u32,

    /// Which way the ray goes along x, y and z.
    octant: u32,
    first_node: u32,
    /// The wide node whose children are visited, relative to the first; a bit for each that waits, in order; where the first begins.
    wide_node_index: u32,
    pending_children: u32,
    nearest_pending_t: f32,
    /// How many wait, of both levels.
    stack_size: u32,
    /// First those of the top level, as `tlas_next` has them, and where they begin. Then the wide nodes above: where the first of their children begins and
    /// who waits share a word.
    stack: [(u32, u32); (TLAS_STACK_SIZE + BLAS_STACK_SIZE) as usize],
    pub(super) counter: C,
}

impl<C: TraversalCounter> WideTraversal<C> {
    pub(super) fn new(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32, order: VisitOrder) -> Self {
        let mut walk = Self {
            place: TraversalRay::new(ray, ray_mask),
            tlas_next: tlas_root(scene.tlas_nodes),
            tlas_rope_end: 0,
            tlas_stack_size: 0,
            octant: 0,
            first_node: 0,
            wide_node_index: 0,
            pending_children: 0,
            nearest_pending_t: 0.0,
            stack_size: 0,
            stack: [(0, 0); (TLAS_STACK_SIZE + BLAS_STACK_SIZE) as usize],
            counter: C::default(),
        };
        if walk.tlas_next != NONE {
            if order == VisitOrder::NearFirst {
                let root = walk.read_tlas_node(scene, 0);
                walk.tlas_next = if walk.tlas_entry_distance(root, ray.t_max) == NO_ENTRY {
                    NONE
                } else {
                    encode_tlas_entry(0, root)
                };
            } else {
                walk.tlas_rope_end = NONE;
            }
        }
        walk
    }

    /// One step in the top level; false at its end.
    fn step_tlas(&mut self, scene: &KernelScene<'_>, t_max: f32) -> bool {
        if self.tlas_rope_end != 0 {
            self.step_tlas_rope(scene, t_max);
        } else if self.tlas_next != NONE {
            self.visit_tlas_entry(scene, t_max);
        } else if self.stack_size > 0 {
            self.stack_size -= 1;
            let (top, near) = self.stack[self.stack_size as usize];
            if f32::from_bits(near) <= t_max {
                self.tlas_next = top;
            }
        } else {
            return false;
        }
        true
    }

    /// Visits the next node along the escape indices.
    fn step_tlas_rope(&mut self, scene: &KernelScene<'_>, t_max: f32) {
        if self.tlas_next == self.tlas_rope_end {
            self.tlas_rope_end = 0;
            self.tlas_next = NONE;
            return;
        }
        let node = self.read_tlas_node(scene, self.tlas_next);
        self.counter.boxes(1);
        if !intersects_box(&self.place.level_ray, self.place.t_min, t_max, node) {
            self.tlas_next = node.escape_index;
        } else if !node.is_leaf() {
            self.tlas_next += 1;
        } else {
            self.tlas_next = node.escape_index;
            self.enter_instance(scene, node.primitives.first_primitive(), t_max);
        }
    }

    /// Visits what is met.
    fn visit_tlas_entry(&mut self, scene: &KernelScene<'_>, t_max: f32) {
        if self.tlas_next & TLAS_LEAF_BIT != 0 {
            let instance = self.tlas_next & !TLAS_LEAF_BIT;
            self.tlas_next = NONE;
            self.enter_instance(scene, instance, t_max);
            return;
        }
        let left = self.tlas_next + 1;
        if self.stack_size == TLAS_STACK_SIZE {
            self.tlas_rope_end = self.read_tlas_node(scene, self.tlas_next).escape_index;
            self.tlas_next = left;
            return;
        }
        let left_node = self.read_tlas_node(scene, left);
        let right = left_node.escape_index;
        let right_node = self.read_tlas_node(scene, right);
        let (left_near, right_near) =
            (self.tlas_entry_distance(left_node, t_max), self.tlas_entry_distance(right_node, t_max));
        let (left_top, right_top) = (encode_tlas_entry(left, left_node), encode_tlas_entry(right, right_node));
        let right_first = left_near == NO_ENTRY || (right_near != NO_ENTRY && right_near < left_near);
        if left_near != NO_ENTRY && right_near != NO_ENTRY {
            let far = if right_first { (left_top, left_near.to_bits()) } else { (right_top, right_near.to_bits()) };
            self.stack[self.stack_size as usize] = far;
            self.stack_size += 1;
        }
        self.tlas_next = if right_first { right_top } else { left_top };
        if left_near == NO_ENTRY && right_near == NO_ENTRY {
            self.tlas_next = NONE;
        }
    }

    fn read_tlas_node<'a>(&mut self, scene: &KernelScene<'a>, index: u32) -> &'a Node {
        let node = &scene.tlas_nodes[index as usize];
        self.counter.node();
        self.counter.read(node);
        node
    }

    /// Where the ray enters a node's box, rounded down; [`NO_ENTRY`] if it does not, or there is nothing in it.
    fn tlas_entry_distance(&mut self, node: &Node, t_max: f32) -> f32 {
        self.counter.boxes(1);
        let SlabRay { origin, reciprocal_direction: reciprocal } = self.place.level_ray;
        let a = (Vec3::from_array(node.min) - origin) * reciprocal;
        let b = (Vec3::from_array(node.max) - origin) * reciprocal;
        let near = Vec3::new(min(a.x, b.x), min(a.y, b.y), min(a.z, b.z));
        let far = Vec3::new(max(a.x, b.x), max(a.y, b.y), max(a.z, b.z));
        let t_near = max(max(near.x, near.y), max(near.z, self.place.t_min)) * BOX_ENTRY_SCALE;
        let t_far = min(min(far.x, far.y), min(far.z, t_max));
        if t_near <= t_far && !node.is_empty() { t_near } else { NO_ENTRY }
    }

    fn enter_instance(&mut self, scene: &KernelScene<'_>, index: u32, t_max: f32) {
        let Some((instance, origin, direction)) = self.place.enter_instance(scene, index) else { return };
        self.counter.instance();
        self.counter.read(instance);
        self.first_node = scene.geometries[instance.geometry as usize].first_wide_node;
        let reciprocal = self.place.level_ray.reciprocal_direction;
        self.octant =
            u32::from(reciprocal.x < 0.0) | u32::from(reciprocal.y < 0.0) << 1 | u32::from(reciprocal.z < 0.0) << 2;
        self.tlas_stack_size = self.stack_size;
        let root = self.visit_wide_node(scene, 0, t_max);
        self.place.local_shear = shear_ray(origin, direction, max(grid_extent(root), max_component(origin.abs())));
    }

    /// Visits a wide node: finds out which of its children are met.
    fn visit_wide_node<'a>(&mut self, scene: &KernelScene<'a>, index: u32, t_max: f32) -> &'a WideNode {
        let node = &scene.wide_nodes[(self.first_node + index) as usize];
        self.counter.node();
        self.counter.read(node);
        self.counter.boxes(node.child_mask().count_ones());
        let offset = Vec3::from_array(node.origin) - self.place.level_ray.origin;
        let nears = child_entry_distances(
            node,
            grid_step(node),
            offset,
            self.place.level_ray.reciprocal_direction,
            self.place.t_min,
            t_max,
        );
        let mut met = 0;
        let mut near = f32::MAX;
        for (slot, begins) in nears.into_iter().enumerate() {
            if begins != NO_ENTRY && node.child_mask() >> slot & 1 != 0 {
                met |= 1 << slot;
                near = min(near, begins);
            }
        }
        self.wide_node_index = index;
        self.pending_children = slots_in_visit_order(met, self.octant);
        self.nearest_pending_t = near;
        node
    }

    /// The next leaf below the wide nodes that wait, if there is one.
    fn step_blas(&mut self, scene: &KernelScene<'_>, t_max: f32) -> Option<PrimitiveRange> {
        if self.pending_children == 0 {
            if self.stack_size == self.tlas_stack_size {
                self.place.leave_instance();
                return None;
            }
            self.stack_size -= 1;
            let (node, word) = self.stack[self.stack_size as usize];
            self.nearest_pending_t = f32::from_bits(word & !PENDING_CHILDREN_MASK);
            if self.nearest_pending_t <= t_max {
                self.wide_node_index = node;
                self.pending_children = word & PENDING_CHILDREN_MASK;
            }
            return None;
        }
        let slot = self.pending_children.trailing_zeros() ^ self.octant;
        self.pending_children &= self.pending_children - 1;
        let child = scene.wide_nodes[(self.first_node + self.wide_node_index) as usize].children[slot as usize];
        if child.is_leaf() {
            return Some(child.triangles());
        }
        if self.pending_children != 0 {
            self.stack[self.stack_size as usize] = (
                self.wide_node_index,
                self.nearest_pending_t.to_bits() & !PENDING_CHILDREN_MASK | self.pending_children,
            );
            self.stack_size += 1;
        }
        self.visit_wide_node(scene, child.node_index(), t_max);
        None
    }
}

impl<C: TraversalCounter> LeafTraversal for WideTraversal<C> {
    #[inline]
    fn next_leaf(&mut self, scene: &KernelScene<'_>, t_max: f32) -> Option<PrimitiveRange> {
        loop {
            if self.place.instance == NONE {
                if !self.step_tlas(scene, t_max) {
                    return None;
                }
            } else if let Some(leaf) = self.step_blas(scene, t_max) {
                return Some(leaf);
            }
        }
    }

    fn ray(&self) -> &TraversalRay {
        &self.place
    }

    fn count_triangles(&mut self, count: u32) {
        self.counter.triangles(count);
    }
}

/// A node of the top level as [`WideTraversal::tlas_next`] has those that are met.
fn encode_tlas_entry(index: u32, node: &Node) -> u32 {
    if node.is_leaf() { node.primitives.first_primitive() | TLAS_LEAF_BIT } else { index }
}

/// The largest coordinate in a node's grid.
pub(crate) fn grid_extent(node: &WideNode) -> f32 {
    let least = Vec3::from_array(node.origin);
    let greatest = least + grid_step(node) * 255.0;
    max(max_component(least.abs()), max_component(greatest.abs()))
}

/// The lengths of a node's steps.
fn grid_step(node: &WideNode) -> Vec3 {
    Vec3::from_array(node.grid_step())
}

/// Where the ray enters each child's box, rounded down; [`NO_ENTRY`] where it does not.
fn child_entry_distances(
    node: &WideNode,
    steps: Vec3,
    offset: Vec3,
    reciprocal: Vec3,
    t_min: f32,
    t_max: f32,
) -> [f32; 8] {
    std::array::from_fn(|slot| {
        let along = |axis: usize, side: usize| {
            let side = if reciprocal[axis] < 0.0 { 1 - side } else { side };
            (f32::from(node.planes[axis][side][slot]) * steps[axis] + offset[axis]) * reciprocal[axis]
        };
        let t_near = max(max(along(0, 0), along(1, 0)), max(along(2, 0), t_min)) * BOX_ENTRY_SCALE;
        let t_far = min(min(along(0, 1), along(1, 1)), min(along(2, 1), t_max));
        if t_near <= t_far { t_near } else { NO_ENTRY }
    })
}

/// Bits by slot to bits by order: bit i is that of slot `i ^ octant`.
fn slots_in_visit_order(bits: u32, octant: u32) -> u32 {
    let mut bits = bits;
    if octant & 1 != 0 {
        bits = (bits & 0x55) << 1 | bits >> 1 & 0x55;
    }
    if octant & 2 != 0 {
        bits = (bits & 0x33) << 2 | bits >> 2 & 0x33;
    }
    if octant & 4 != 0 {
        bits = (bits & 0x0f) << 4 | bits >> 4;
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slot_of_the_rays_octant_comes_first() {
        for octant in 0..8 {
            for bits in 0..256 {
                let ordered = slots_in_visit_order(bits, octant);
                assert!((0..8).all(|i| ordered >> i & 1 == bits >> (i ^ octant) & 1), "{bits:08b} {octant}");
            }
        }
    }
}
