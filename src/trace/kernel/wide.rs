//! Ordered traversal with a short stack: binary TLAS, eight-wide BLASes. Twin of `shaders/shared/wide.wgsl`.
//!
//! **TLAS.** The depth-first array holds the binary tree: the left child of node i is i + 1, the right one is where the
//! left one's escape index leads. Both boxes are tested, the nearer one is visited, the farther one is pushed on the
//! stack. If the stack is full, the subtree is traversed along its escape indices instead, so the depth is unlimited.
//! Any-hit and transmittance queries traverse the TLAS along escape indices from the start, as order does not help them
//! ([`VisitOrder`]).
//!
//! **BLASes.** The boxes of eight children are tested at once. Hit children are visited in the order of `slot ^ octant`
//! (H. Ylitie, T. Karras, S. Laine, *Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs*, 2017).
//! Pending siblings share one stack entry: node index, child mask, and their least entry distance. The builder bounds
//! the depth, so the stack always suffices. Both levels share the stack and the loop: an instance is finished when the
//! stack is back at its size on entry.
//!
//! **Boxes.** A quantised box is hit wherever the exact box is; `accel::blas::quantize` proves it for the expression
//! used here. The comparison allows [`BOX_ENTRY_SCALE`] as that of the exact boxes does, and the least entry distance
//! on the stack is rounded down.

use glam::Vec3;

use super::KernelScene;
use super::intersect::{BOX_ENTRY_SCALE, SlabRay, intersects_box, max_component, shear_ray};
use super::math::{max, min};
use super::query::VisitOrder;
use super::traversal_state::{LeafTraversal, TraversalCounter, TraversalRay, tlas_root};
use crate::accel::MAX_WIDE_DEPTH;
use crate::device::layout::{NONE, Node, PrimitiveRange, RayRecord, WideNode};

/// Capacity of the TLAS part of the stack.
pub(super) const TLAS_STACK_SIZE: u32 = 16;
/// Flag bit of a TLAS entry that holds an instance index rather than a node index.
pub(super) const TLAS_LEAF_BIT: u32 = 1 << 31;
/// Capacity of the BLAS part of the stack: one entry per level above the deepest.
pub(super) const BLAS_STACK_SIZE: u32 = MAX_WIDE_DEPTH as u32;
/// Low 8 bits of a BLAS stack entry's second word: mask of pending children; the rest: the upper bits of their least
/// entry distance (f32, rounded down).
pub(super) const PENDING_CHILDREN_MASK: u32 = 255;
/// Entry distance of a missed box; real ones are not negative.
pub(super) const NO_ENTRY: f32 = -1.0;

pub(super) struct WideTraversal<C> {
    ray: TraversalRay,
    /// Next TLAS entry: the index of an inner node whose box is hit, or an instance index with [`TLAS_LEAF_BIT`]; along
    /// escape indices, the index of the next node; [`NONE`] to pop from the stack.
    tlas_next: u32,
    /// End (exclusive) of the traversal of a TLAS subtree along escape indices; 0 if there is none.
    tlas_rope_end: u32,
    /// Stack size on entry of the instance.
    tlas_stack_size: u32,

    /// Bit i set: the local direction is negative along axis i.
    octant: u32,
    first_node: u32,
    /// Current wide node relative to the BLAS root; mask of its pending children in visit order; their least entry
    /// distance.
    wide_node_index: u32,
    pending_children: u32,
    nearest_pending_t: f32,
    /// Stack size, both levels.
    stack_size: u32,
    /// Stack entries: first (TLAS entry, entry distance bits), then (wide node, entry distance and pending mask).
    stack: [(u32, u32); (TLAS_STACK_SIZE + BLAS_STACK_SIZE) as usize],
    pub(super) counter: C,
}

impl<C: TraversalCounter> WideTraversal<C> {
    pub(super) fn new(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32, order: VisitOrder) -> Self {
        let mut traversal = Self {
            ray: TraversalRay::new(ray, ray_mask),
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
        if traversal.tlas_next != NONE {
            if order == VisitOrder::NearFirst {
                // Near first: start at the root, if the ray hits its box.
                let root = traversal.read_tlas_node(scene, 0);
                traversal.tlas_next = if traversal.tlas_entry_distance(root, ray.t_max) == NO_ENTRY {
                    NONE
                } else {
                    encode_tlas_entry(0, root)
                };
            } else {
                // Any order: traverse the whole TLAS along escape indices.
                traversal.tlas_rope_end = NONE;
            }
        }
        traversal
    }

    /// Advances the TLAS traversal by one step; false when it is finished.
    fn step_tlas(&mut self, scene: &KernelScene<'_>, t_max: f32) -> bool {
        // In a subtree that is traversed along escape indices.
        if self.tlas_rope_end != 0 {
            self.step_tlas_rope(scene, t_max);
        } else if self.tlas_next != NONE {
            self.visit_tlas_entry(scene, t_max);
        } else if self.stack_size > 0 {
            // Pop an entry; skip it if it lies beyond t_max.
            self.stack_size -= 1;
            let (entry, distance) = self.stack[self.stack_size as usize];
            if f32::from_bits(distance) <= t_max {
                self.tlas_next = entry;
            }
        } else {
            return false;
        }
        true
    }

    /// Visits the next node of a TLAS subtree that is traversed along escape indices.
    fn step_tlas_rope(&mut self, scene: &KernelScene<'_>, t_max: f32) {
        // End of the subtree: continue with the stack.
        if self.tlas_next == self.tlas_rope_end {
            self.tlas_rope_end = 0;
            self.tlas_next = NONE;
            return;
        }
        let node = self.read_tlas_node(scene, self.tlas_next);
        self.counter.boxes(1);
        // Miss: skip the subtree. Inner node: its first child follows. Leaf: enter its instance.
        if !intersects_box(&self.ray.level_ray, self.ray.t_min, t_max, node) {
            self.tlas_next = node.escape_index;
        } else if !node.is_leaf() {
            self.tlas_next += 1;
        } else {
            self.tlas_next = node.escape_index;
            self.enter_instance(scene, node.primitives.first_primitive(), t_max);
        }
    }

    /// Visits the pending TLAS entry: enters an instance, or tests an inner node's two children and pushes the farther.
    fn visit_tlas_entry(&mut self, scene: &KernelScene<'_>, t_max: f32) {
        // Instance entry.
        if self.tlas_next & TLAS_LEAF_BIT != 0 {
            let instance = self.tlas_next & !TLAS_LEAF_BIT;
            self.tlas_next = NONE;
            self.enter_instance(scene, instance, t_max);
            return;
        }
        let left = self.tlas_next + 1;
        // Stack full: traverse the subtree along escape indices.
        if self.stack_size == TLAS_STACK_SIZE {
            self.tlas_rope_end = self.read_tlas_node(scene, self.tlas_next).escape_index;
            self.tlas_next = left;
            return;
        }
        // Test both children.
        let left_node = self.read_tlas_node(scene, left);
        let right = left_node.escape_index;
        let right_node = self.read_tlas_node(scene, right);
        let (left_distance, right_distance) =
            (self.tlas_entry_distance(left_node, t_max), self.tlas_entry_distance(right_node, t_max));
        let (left_entry, right_entry) = (encode_tlas_entry(left, left_node), encode_tlas_entry(right, right_node));
        // Order them by entry distance.
        let right_first = left_distance == NO_ENTRY || (right_distance != NO_ENTRY && right_distance < left_distance);
        // Push the farther.
        if left_distance != NO_ENTRY && right_distance != NO_ENTRY {
            let far = if right_first {
                (left_entry, left_distance.to_bits())
            } else {
                (right_entry, right_distance.to_bits())
            };
            self.stack[self.stack_size as usize] = far;
            self.stack_size += 1;
        }
        // Continue with the nearer.
        self.tlas_next = if right_first { right_entry } else { left_entry };
        if left_distance == NO_ENTRY && right_distance == NO_ENTRY {
            self.tlas_next = NONE;
        }
    }

    fn read_tlas_node<'a>(&mut self, scene: &KernelScene<'a>, index: u32) -> &'a Node {
        let node = &scene.tlas_nodes[index as usize];
        self.counter.node();
        self.counter.read(node);
        node
    }

    /// Distance at which the ray enters a node's box, rounded down; [`NO_ENTRY`] if the box is missed or the node is an
    /// unused leaf, or has no other leaves below it.
    fn tlas_entry_distance(&mut self, node: &Node, t_max: f32) -> f32 {
        self.counter.boxes(1);
        let SlabRay { origin, reciprocal_direction: reciprocal } = self.ray.level_ray;
        // Slab test as in `intersects_box`, but the entry distance is kept.
        let a = (Vec3::from_array(node.min) - origin) * reciprocal;
        let b = (Vec3::from_array(node.max) - origin) * reciprocal;
        let near = Vec3::new(min(a.x, b.x), min(a.y, b.y), min(a.z, b.z));
        let far = Vec3::new(max(a.x, b.x), max(a.y, b.y), max(a.z, b.z));
        let t_near = max(max(near.x, near.y), max(near.z, self.ray.t_min)) * BOX_ENTRY_SCALE;
        let t_far = min(min(far.x, far.y), min(far.z, t_max));
        if t_near <= t_far && !node.is_empty() { t_near } else { NO_ENTRY }
    }

    fn enter_instance(&mut self, scene: &KernelScene<'_>, index: u32, t_max: f32) {
        // Transform the ray, unless the instance is hidden by its mask.
        let Some((instance, origin, direction)) = self.ray.enter_instance(scene, index) else { return };
        self.counter.instance();
        self.counter.read(instance);
        self.first_node = scene.geometries[instance.geometry as usize].first_wide_node;
        // The octant decides the order in which children are visited.
        let reciprocal = self.ray.level_ray.reciprocal_direction;
        self.octant =
            u32::from(reciprocal.x < 0.0) | u32::from(reciprocal.y < 0.0) << 1 | u32::from(reciprocal.z < 0.0) << 2;
        // Start at the BLAS root.
        self.tlas_stack_size = self.stack_size;
        let root = self.visit_wide_node(scene, 0, t_max);
        // Prepare the triangle test.
        self.ray.local_shear =
            shear_ray(&self.ray.level_ray, direction, max(grid_extent(root), max_component(origin.abs())));
    }

    /// Tests the eight children of a wide node and makes the hit ones pending.
    fn visit_wide_node<'a>(&mut self, scene: &KernelScene<'a>, index: u32, t_max: f32) -> &'a WideNode {
        let node = &scene.wide_nodes[(self.first_node + index) as usize];
        self.counter.node();
        self.counter.read(node);
        self.counter.boxes(node.child_mask().count_ones());
        // Decode and test eight boxes.
        let offset = Vec3::from_array(node.origin) - self.ray.level_ray.origin;
        let entry_distances = child_entry_distances(
            node,
            grid_step(node),
            offset,
            self.ray.level_ray.reciprocal_direction,
            self.ray.t_min,
            t_max,
        );
        // Collect the slots in use that are hit, and the least entry distance.
        let mut hit_slots = 0;
        let mut near = f32::MAX;
        for (slot, t_entry) in entry_distances.into_iter().enumerate() {
            if t_entry != NO_ENTRY && node.child_mask() >> slot & 1 != 0 {
                hit_slots |= 1 << slot;
                near = min(near, t_entry);
            }
        }
        // Make them pending, permuted to visit order.
        self.wide_node_index = index;
        self.pending_children = slots_in_visit_order(hit_slots, self.octant);
        self.nearest_pending_t = near;
        node
    }

    /// Advances the BLAS traversal by one step: returns a leaf if one was reached, else `None` after popping,
    /// descending or leaving the instance.
    fn step_blas(&mut self, scene: &KernelScene<'_>, t_max: f32) -> Option<PrimitiveRange> {
        // No pending child: leave the instance, or pop an ancestor with pending children.
        if self.pending_children == 0 {
            if self.stack_size == self.tlas_stack_size {
                self.ray.leave_instance();
                return None;
            }
            self.stack_size -= 1;
            let (node, word) = self.stack[self.stack_size as usize];
            self.nearest_pending_t = f32::from_bits(word & !PENDING_CHILDREN_MASK);
            // Drop an ancestor whose nearest pending child lies beyond t_max.
            if self.nearest_pending_t <= t_max {
                self.wide_node_index = node;
                self.pending_children = word & PENDING_CHILDREN_MASK;
            }
            return None;
        }
        // Take the next child in visit order.
        let slot = self.pending_children.trailing_zeros() ^ self.octant;
        self.pending_children &= self.pending_children - 1;
        let child = scene.wide_nodes[(self.first_node + self.wide_node_index) as usize].children[slot as usize];
        // Leaf.
        if child.is_leaf() {
            return Some(child.triangles());
        }
        // Push the pending siblings, and descend.
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
            if self.ray.instance == NONE {
                if !self.step_tlas(scene, t_max) {
                    return None;
                }
            } else if let Some(leaf) = self.step_blas(scene, t_max) {
                return Some(leaf);
            }
        }
    }

    fn ray(&self) -> &TraversalRay {
        &self.ray
    }

    fn count_triangles(&mut self, count: u32) {
        self.counter.triangles(count);
    }
}

/// Encodes a TLAS node as a traversal entry.
fn encode_tlas_entry(index: u32, node: &Node) -> u32 {
    if node.is_leaf() { node.primitives.first_primitive() | TLAS_LEAF_BIT } else { index }
}

/// Greatest absolute coordinate of a node's grid, local units.
pub(crate) fn grid_extent(node: &WideNode) -> f32 {
    let least = Vec3::from_array(node.origin);
    let greatest = least + grid_step(node) * 255.0;
    max(max_component(least.abs()), max_component(greatest.abs()))
}

/// The grid step along each axis (a power of two, local units).
fn grid_step(node: &WideNode) -> Vec3 {
    Vec3::from_array(node.grid_step())
}

/// Distance at which the ray enters each child's box, rounded down; [`NO_ENTRY`] for a missed box.
fn child_entry_distances(
    node: &WideNode,
    step: Vec3,
    offset: Vec3,
    reciprocal: Vec3,
    t_min: f32,
    t_max: f32,
) -> [f32; 8] {
    std::array::from_fn(|slot| {
        // Distances to the near and far planes per axis; entry is their maximum, exit their minimum.
        let along = |axis: usize, side: usize| {
            let side = if reciprocal[axis] < 0.0 { 1 - side } else { side };
            (f32::from(node.planes[axis][side][slot]) * step[axis] + offset[axis]) * reciprocal[axis]
        };
        let t_near = max(max(along(0, 0), along(1, 0)), max(along(2, 0), t_min)) * BOX_ENTRY_SCALE;
        let t_far = min(min(along(0, 1), along(1, 1)), min(along(2, 1), t_max));
        if t_near <= t_far { t_near } else { NO_ENTRY }
    })
}

/// Permutes a slot mask to visit order: bit i of the result is bit `i ^ octant`.
fn slots_in_visit_order(bits: u32, octant: u32) -> u32 {
    // For each set bit of the octant, swap neighbouring bits, pairs of bits or halves.
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
