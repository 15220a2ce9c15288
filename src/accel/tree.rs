//! What a builder makes: a binary tree over primitive boxes, not yet in device order.

use bytemuck::Zeroable;
use glam::{Vec3, Vec4, Vec4Swizzles};

use crate::math::Aabb;

/// A binary tree over `order.len()` primitives.
///
/// A subtree of `n` primitives owns `2 n - 1` consecutive slots of `nodes` (as many as it can have nodes) and `n` of
/// `order`: its root comes first, then its left child, then its right child, at [`right_child`]. So threads can fill
/// subtrees side by side, and nothing needs an index.
pub(super) struct BuildTree {
    pub(super) nodes: Vec<BuildNode>,
    /// Primitive numbers, leaf after leaf.
    pub(super) order: Vec<u32>,
}

/// A node of a [`BuildTree`].
#[derive(Clone, Copy, Zeroable)]
pub(super) struct BuildNode {
    pub(super) min: Vec3,
    pub(super) max: Vec3,
    /// Nodes in this subtree, itself included.
    pub(super) node_count: u32,
    /// Primitives below the left child; 0 for a leaf.
    pub(super) left_primitives: u32,
}

impl BuildNode {
    pub(super) fn new(bounds: &LaneBox, node_count: u32, left_primitives: u32) -> Self {
        Self { min: bounds.min.xyz(), max: bounds.max.xyz(), node_count, left_primitives }
    }
}

/// How many slots of [`BuildTree::nodes`] a subtree owns.
pub(super) fn slot_count(primitive_count: usize) -> usize {
    (2 * primitive_count).saturating_sub(1)
}

/// Subtrees of fewer primitives are built by one thread, and their nodes stand without gaps: memory that is never touched
/// costs nothing.
pub(super) const TASK_MINIMUM: usize = 1 << 10;

/// Where the right child of a subtree of `primitive_count` primitives stands, counted from the left child.
pub(super) fn right_child(primitive_count: usize, left_primitives: usize, left_nodes: u32) -> usize {
    if primitive_count < TASK_MINIMUM { left_nodes as usize } else { slot_count(left_primitives) }
}

/// A box in two SIMD registers; what is in the fourth lanes means nothing.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct LaneBox {
    pub(super) min: Vec4,
    pub(super) max: Vec4,
}

impl LaneBox {
    pub(super) const EMPTY: Self = Self { min: Vec4::INFINITY, max: Vec4::NEG_INFINITY };

    #[inline]
    pub(super) fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    #[inline]
    pub(super) fn with_point(self, point: Vec4) -> Self {
        Self { min: self.min.min(point), max: self.max.max(point) }
    }

    /// Half the surface area of the box scaled by `scale`.
    #[inline]
    pub(super) fn half_area(self, scale: f32) -> f32 {
        let d = (self.max - self.min) * scale;
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}

/// A primitive as the builder moves it about: its box and its number. 32 bytes.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct Reference {
    /// The fourth lane holds the number, see [`TAG`].
    min: Vec4,
    max: Vec4,
}

/// Set in the bits of a primitive number that travels in a float lane, so that every number below 2^28 is a normal float:
/// subnormal operands would slow the arithmetic on the other lanes a hundredfold.
const TAG: u32 = 0x4000_0000;

impl Reference {
    pub(super) fn new(bounds: &Aabb, primitive: u32) -> Self {
        Self { min: bounds.min.extend(f32::from_bits(TAG | primitive)), max: bounds.max.extend(1.0) }
    }

    pub(super) fn primitive(&self) -> u32 {
        self.min.w.to_bits() ^ TAG
    }

    #[inline]
    pub(super) fn bounds(&self) -> LaneBox {
        LaneBox { min: self.min, max: self.max }
    }

    /// Twice the centre of the box: the builder only compares centres. Infinite if the sum overflows.
    #[inline]
    pub(super) fn doubled_center(&self) -> Vec4 {
        self.min + self.max
    }
}

/// The boxes of a set of references, and of their (doubled) centres.
#[derive(Clone, Copy)]
pub(super) struct Extent {
    pub(super) bounds: LaneBox,
    pub(super) centers: LaneBox,
}

impl Extent {
    pub(super) const EMPTY: Self = Self { bounds: LaneBox::EMPTY, centers: LaneBox::EMPTY };

    #[inline]
    pub(super) fn with(self, reference: &Reference) -> Self {
        Self {
            bounds: self.bounds.union(reference.bounds()),
            centers: self.centers.with_point(reference.doubled_center()),
        }
    }

    pub(super) fn union(self, other: Self) -> Self {
        Self { bounds: self.bounds.union(other.bounds), centers: self.centers.union(other.centers) }
    }

    pub(super) fn aabb(&self) -> Aabb {
        Aabb { min: self.bounds.min.xyz(), max: self.bounds.max.xyz() }
    }

    pub(super) fn of(references: &[Reference]) -> Self {
        references.iter().fold(Self::EMPTY, Self::with)
    }
}
