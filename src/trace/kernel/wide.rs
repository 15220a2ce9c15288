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
//! the expression here. The comparison allows [`BOX_SLACK`] as that of the exact boxes does, and "where the first begins" is
//! rounded down.

use glam::Vec3;

use super::KernelScene;
use super::intersect::{BOX_SLACK, SlabRay, max_component, meets_box, shear_ray};
use super::math::{max, min};
use super::walk::{Counter, Place, Walk, first_of};
use crate::accel::MAX_WIDE_DEPTH;
use crate::device::layout::{NONE, Node, PrimitiveRange, Ray, WideNode};

/// Nodes of the top level that can wait.
pub(super) const TOP_STACK: u32 = 16;
/// Tells an instance from an inner node of the top level.
pub(super) const TOP_LEAF: u32 = 1 << 31;
/// Wide nodes some of whose children can wait: all above the deepest.
pub(super) const WIDE_STACK: u32 = MAX_WIDE_DEPTH as u32;
/// The lower bits of a stack entry's second word are the children that wait, the others those of a number.
pub(super) const WAITING_BITS: u32 = 255;
/// What is never where a box begins.
pub(super) const MISSED: f32 = -1.0;

pub(super) struct Wide<C> {
    place: Place,
    /// What comes next in the top level: the index of an inner node that is met, or its instance and [`TOP_LEAF`]; along escape indices, the
    /// index of the next node; [`NONE`] where the stack says.
    top: u32,
    /// Where the walk along escape indices ends; 0 where there is none.
    rope_end: u32,
    /// How many of the top level wait.
    top_count: u32,

    /// Which way the ray goes along x, y and z.
    octant: u32,
    first_node: u32,
    /// The wide node whose children are visited, relative to the first; a bit for each that waits, in order; where the first begins.
    node: u32,
    waiting: u32,
    near: f32,
    /// How many wait, of both levels.
    count: u32,
    /// First those of the top level, as `top` has them, and where they begin. Then the wide nodes above: where the first of their children begins and
    /// who waits share a word.
    stack: [(u32, u32); (TOP_STACK + WIDE_STACK) as usize],
    pub(super) counter: C,
}

impl<C: Counter> Wide<C> {
    pub(super) fn new(scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32, near_first: bool) -> Self {
        let mut walk = Self {
            place: Place::new(ray, ray_mask),
            top: first_of(scene.tlas_nodes),
            rope_end: 0,
            top_count: 0,
            octant: 0,
            first_node: 0,
            node: 0,
            waiting: 0,
            near: 0.0,
            count: 0,
            stack: [(0, 0); (TOP_STACK + WIDE_STACK) as usize],
            counter: C::default(),
        };
        if walk.top != NONE {
            if near_first {
                let root = walk.read_top(scene, 0);
                walk.top = if walk.meet_top(root, ray.t_max) == MISSED { NONE } else { top_of(0, root) };
            } else {
                walk.rope_end = NONE;
            }
        }
        walk
    }

    /// One step in the top level; false at its end.
    fn step_top(&mut self, scene: &KernelScene<'_>, t_max: f32) -> bool {
        if self.rope_end != 0 {
            self.step_rope(scene, t_max);
        } else if self.top != NONE {
            self.open_top(scene, t_max);
        } else if self.count > 0 {
            self.count -= 1;
            let (top, near) = self.stack[self.count as usize];
            if f32::from_bits(near) <= t_max {
                self.top = top;
            }
        } else {
            return false;
        }
        true
    }

    /// Visits the next node along the escape indices.
    fn step_rope(&mut self, scene: &KernelScene<'_>, t_max: f32) {
        if self.top == self.rope_end {
            self.rope_end = 0;
            self.top = NONE;
            return;
        }
        let node = self.read_top(scene, self.top);
        self.counter.boxes(1);
        if !meets_box(&self.place.level, self.place.t_min, t_max, node) {
            self.top = node.escape_index;
        } else if node.primitives == PrimitiveRange::INNER {
            self.top += 1;
        } else {
            self.top = node.escape_index;
            self.enter_instance(scene, node.primitives.first(), t_max);
        }
    }

    /// Visits what is met.
    fn open_top(&mut self, scene: &KernelScene<'_>, t_max: f32) {
        if self.top & TOP_LEAF != 0 {
            let instance = self.top & !TOP_LEAF;
            self.top = NONE;
            self.enter_instance(scene, instance, t_max);
            return;
        }
        let left = self.top + 1;
        if self.count == TOP_STACK {
            self.rope_end = self.read_top(scene, self.top).escape_index;
            self.top = left;
            return;
        }
        let left_node = self.read_top(scene, left);
        let right = left_node.escape_index;
        let right_node = self.read_top(scene, right);
        let (left_near, right_near) = (self.meet_top(left_node, t_max), self.meet_top(right_node, t_max));
        let (left_top, right_top) = (top_of(left, left_node), top_of(right, right_node));
        let right_first = left_near == MISSED || (right_near != MISSED && right_near < left_near);
        if left_near != MISSED && right_near != MISSED {
            let far = if right_first { (left_top, left_near.to_bits()) } else { (right_top, right_near.to_bits()) };
            self.stack[self.count as usize] = far;
            self.count += 1;
        }
        self.top = if right_first { right_top } else { left_top };
        if left_near == MISSED && right_near == MISSED {
            self.top = NONE;
        }
    }

    fn read_top<'a>(&mut self, scene: &KernelScene<'a>, index: u32) -> &'a Node {
        let node = &scene.tlas_nodes[index as usize];
        self.counter.node();
        self.counter.read(node);
        node
    }

    /// Where the ray enters a node's box, rounded down; [`MISSED`] if it does not, or there is nothing in it.
    fn meet_top(&mut self, node: &Node, t_max: f32) -> f32 {
        self.counter.boxes(1);
        let SlabRay { origin, reciprocal } = self.place.level;
        let a = (Vec3::from_array(node.min) - origin) * reciprocal;
        let b = (Vec3::from_array(node.max) - origin) * reciprocal;
        let near = Vec3::new(min(a.x, b.x), min(a.y, b.y), min(a.z, b.z));
        let far = Vec3::new(max(a.x, b.x), max(a.y, b.y), max(a.z, b.z));
        let t_near = max(max(near.x, near.y), max(near.z, self.place.t_min)) * BOX_SLACK;
        let t_far = min(min(far.x, far.y), min(far.z, t_max));
        if t_near <= t_far && !node.is_unused() { t_near } else { MISSED }
    }

    fn enter_instance(&mut self, scene: &KernelScene<'_>, index: u32, t_max: f32) {
        let Some((instance, origin, direction)) = self.place.enter(scene, index) else { return };
        self.counter.instance();
        self.counter.read(instance);
        self.first_node = scene.geometries[instance.geometry as usize].first_wide_node;
        let reciprocal = self.place.level.reciprocal;
        self.octant =
            u32::from(reciprocal.x < 0.0) | u32::from(reciprocal.y < 0.0) << 1 | u32::from(reciprocal.z < 0.0) << 2;
        self.top_count = self.count;
        let root = self.open_wide(scene, 0, t_max);
        self.place.shear = shear_ray(origin, direction, max(extent(root), max_component(origin.abs())));
    }

    /// Visits a wide node: finds out which of its children are met.
    fn open_wide<'a>(&mut self, scene: &KernelScene<'a>, index: u32, t_max: f32) -> &'a WideNode {
        let node = &scene.wide_nodes[(self.first_node + index) as usize];
        self.counter.node();
        self.counter.read(node);
        self.counter.boxes(u32::from(node.exponents[3]).count_ones());
        let offset = Vec3::from_array(node.origin) - self.place.level.origin;
        let nears = meet_children(node, steps(node), offset, self.place.level.reciprocal, self.place.t_min, t_max);
        let mut met = 0;
        let mut near = f32::MAX;
        for (slot, begins) in nears.into_iter().enumerate() {
            if begins != MISSED && node.exponents[3] >> slot & 1 != 0 {
                met |= 1 << slot;
                near = min(near, begins);
            }
        }
        self.node = index;
        self.waiting = in_order(met, self.octant);
        self.near = near;
        node
    }

    /// The next leaf below the wide nodes that wait, if there is one.
    fn step_wide(&mut self, scene: &KernelScene<'_>, t_max: f32) -> Option<PrimitiveRange> {
        if self.waiting == 0 {
            if self.count == self.top_count {
                self.place.leave();
                return None;
            }
            self.count -= 1;
            let (node, word) = self.stack[self.count as usize];
            self.near = f32::from_bits(word & !WAITING_BITS);
            if self.near <= t_max {
                self.node = node;
                self.waiting = word & WAITING_BITS;
            }
            return None;
        }
        let slot = self.waiting.trailing_zeros() ^ self.octant;
        self.waiting &= self.waiting - 1;
        let child = scene.wide_nodes[(self.first_node + self.node) as usize].children[slot as usize];
        if child.count() > 0 {
            return Some(child);
        }
        if self.waiting != 0 {
            self.stack[self.count as usize] = (self.node, self.near.to_bits() & !WAITING_BITS | self.waiting);
            self.count += 1;
        }
        self.open_wide(scene, child.first(), t_max);
        None
    }
}

impl<C: Counter> Walk for Wide<C> {
    #[inline]
    fn next_leaf(&mut self, scene: &KernelScene<'_>, t_max: f32) -> Option<PrimitiveRange> {
        loop {
            if self.place.instance == NONE {
                if !self.step_top(scene, t_max) {
                    return None;
                }
            } else if let Some(leaf) = self.step_wide(scene, t_max) {
                return Some(leaf);
            }
        }
    }

    fn place(&self) -> &Place {
        &self.place
    }

    fn count_triangles(&mut self, count: u32) {
        self.counter.triangles(count);
    }
}

/// A node of the top level as [`Wide::top`] has those that are met.
fn top_of(index: u32, node: &Node) -> u32 {
    if node.primitives == PrimitiveRange::INNER { index } else { node.primitives.first() | TOP_LEAF }
}

/// The largest coordinate in a node's grid.
pub(crate) fn extent(node: &WideNode) -> f32 {
    let least = Vec3::from_array(node.origin);
    let greatest = least + steps(node) * 255.0;
    max(max_component(least.abs()), max_component(greatest.abs()))
}

/// The lengths of a node's steps.
fn steps(node: &WideNode) -> Vec3 {
    let [x, y, z, _] = node.exponents.map(|exponent| f32::from_bits(u32::from(exponent) << 23));
    Vec3::new(x, y, z)
}

/// Where the ray enters each child's box, rounded down; [`MISSED`] where it does not.
fn meet_children(node: &WideNode, steps: Vec3, offset: Vec3, reciprocal: Vec3, t_min: f32, t_max: f32) -> [f32; 8] {
    std::array::from_fn(|slot| {
        let along = |axis: usize, side: usize| {
            let side = if reciprocal[axis] < 0.0 { 1 - side } else { side };
            (f32::from(node.planes[axis][side][slot]) * steps[axis] + offset[axis]) * reciprocal[axis]
        };
        let t_near = max(max(along(0, 0), along(1, 0)), max(along(2, 0), t_min)) * BOX_SLACK;
        let t_far = min(min(along(0, 1), along(1, 1)), min(along(2, 1), t_max));
        if t_near <= t_far { t_near } else { MISSED }
    })
}

/// Bits by slot to bits by order: bit i is that of slot `i ^ octant`.
fn in_order(bits: u32, octant: u32) -> u32 {
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
                let ordered = in_order(bits, octant);
                assert!((0..8).all(|i| ordered >> i & 1 == bits >> (i ^ octant) & 1), "{bits:08b} {octant}");
            }
        }
    }
}
