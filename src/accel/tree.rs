//! What a builder makes: a binary tree over primitive boxes, not yet in device order.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4, Vec4Swizzles};

use crate::math::Aabb;

/// A binary tree over primitives.
///
/// Builders that fill subtrees side by side leave gaps in both arrays: a subtree of up to `n` leaves owns `2 n - 2` slots of
/// `nodes` below its root, as many as it can have nodes there, and `n` of `primitive_indices`. Memory that is never touched costs nothing.
#[derive(Default)]
pub(super) struct BuildTree {
    /// The root first, unless there is nothing at all; the two children of a node stand side by side.
    pub(super) nodes: Vec<BuildNode>,
    /// Primitive numbers, a range for each leaf.
    pub(super) primitive_indices: Vec<u32>,
    /// Whether a primitive may be in several leaves. None is in one leaf twice.
    pub(super) has_duplicates: bool,
}

impl BuildTree {
    /// Adds the primitives below a node to the first `count` of `target`, each once. Returns how many there are then, or `None`
    /// if they do not fit. Recursion is as deep as the tree.
    pub(super) fn collect_primitives(&self, node: usize, target: &mut [u32], mut count: usize) -> Option<usize> {
        match self.nodes[node].contents() {
            BuildNodeContent::Primitives(range) => {
                for &primitive in &self.primitive_indices[range] {
                    if !(self.has_duplicates && target[..count].contains(&primitive)) {
                        *target.get_mut(count)? = primitive;
                        count += 1;
                    }
                }
                Some(count)
            }
            BuildNodeContent::Children(child) => {
                let count = self.collect_primitives(child, target, count)?;
                self.collect_primitives(child + 1, target, count)
            }
        }
    }
}

/// A node of a [`BuildTree`].
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(super) struct BuildNode {
    pub(super) min: Vec3,
    /// Of an inner node its first child, of a leaf its first primitive in `primitive_indices`.
    first_child_or_primitive: u32,
    pub(super) max: Vec3,
    /// 0 for an inner node.
    primitive_count: u32,
}

/// What is below a node.
pub(super) enum BuildNodeContent {
    /// The index of the first child; the second one is next to it.
    Children(usize),
    /// A range of `primitive_indices`.
    Primitives(std::ops::Range<usize>),
}

impl BuildNode {
    /// `first_child` is an index of the tree's nodes.
    pub(super) fn inner(bounds: &SimdAabb, first_child: usize) -> Self {
        Self {
            min: bounds.min.xyz(),
            first_child_or_primitive: first_child as u32,
            max: bounds.max.xyz(),
            primitive_count: 0,
        }
    }

    /// `first` is an index of the tree's order; there is at least one primitive.
    pub(super) fn leaf(bounds: &SimdAabb, first: usize, count: usize) -> Self {
        Self {
            min: bounds.min.xyz(),
            first_child_or_primitive: first as u32,
            max: bounds.max.xyz(),
            primitive_count: count as u32,
        }
    }

    pub(super) fn contents(&self) -> BuildNodeContent {
        let first = self.first_child_or_primitive as usize;
        if self.primitive_count == 0 {
            BuildNodeContent::Children(first)
        } else {
            BuildNodeContent::Primitives(first..first + self.primitive_count as usize)
        }
    }

    #[inline]
    pub(super) fn bounds(&self) -> SimdAabb {
        SimdAabb { min: self.min.extend(0.0), max: self.max.extend(0.0) }
    }
}

/// How many slots a subtree of so many leaves owns below its root.
pub(super) fn max_node_count_below(leaf_count: usize) -> usize {
    2 * leaf_count.max(1) - 2
}

/// Subtrees of fewer primitives are built by one thread, and their nodes stand without gaps.
pub(super) const PARALLEL_SUBTREE_THRESHOLD: usize = 1 << 10;

/// A box in two SIMD registers; what is in the fourth lanes means nothing.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct SimdAabb {
    pub(super) min: Vec4,
    pub(super) max: Vec4,
}

impl SimdAabb {
    pub(super) const EMPTY: Self = Self { min: Vec4::INFINITY, max: Vec4::NEG_INFINITY };

    #[inline]
    pub(super) fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    pub(super) fn aabb(self) -> Aabb {
        Aabb { min: self.min.xyz(), max: self.max.xyz() }
    }

    /// What is in both; a least corner is above the greatest one if nothing is.
    pub(super) fn intersection(self, other: Self) -> Self {
        Self { min: self.min.max(other.min), max: self.max.min(other.max) }
    }

    #[inline]
    pub(super) fn extended_to(self, point: Vec4) -> Self {
        Self { min: self.min.min(point), max: self.max.max(point) }
    }

    /// Half the surface area of the box scaled by `scale`.
    #[inline]
    pub(super) fn half_area(self, scale: f32) -> f32 {
        let d = (self.max - self.min) * scale;
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}

/// The power of two that brings the longest side of a box to between 1 and 2, so that areas neither overflow nor vanish;
/// infinite or zero for a box without a side of normal length.
pub(super) fn normalizing_scale(bounds: &SimdAabb) -> f32 {
    let side = bounds.max - bounds.min;
    let longest = side.x.max(side.y).max(side.z);
    1.0 / f32::from_bits(longest.to_bits() & f32::INFINITY.to_bits())
}

/// A primitive as the builder moves it about: its box and its number. 32 bytes.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct PrimitiveReference {
    /// The fourth lane holds the number, see [`NORMAL_FLOAT_BIT`].
    min: Vec4,
    max: Vec4,
}

/// Set in the bits of a primitive number that travels in a float lane, so that every number below 2^28 is a normal float:
/// subnormal operands would slow the arithmetic on the other lanes a hundredfold.
const NORMAL_FLOAT_BIT: u32 = 0x4000_0000;

impl PrimitiveReference {
    pub(super) fn new(bounds: &Aabb, primitive: u32) -> Self {
        Self { min: bounds.min.extend(f32::from_bits(NORMAL_FLOAT_BIT | primitive)), max: bounds.max.extend(1.0) }
    }

    /// The same primitive, of which only what is in `bounds` counts.
    pub(super) fn clipped_to(&self, bounds: &SimdAabb) -> Self {
        Self { min: bounds.min.with_w(self.min.w), max: bounds.max.with_w(1.0) }
    }

    pub(super) fn primitive(&self) -> u32 {
        self.min.w.to_bits() ^ NORMAL_FLOAT_BIT
    }

    #[inline]
    pub(super) fn bounds(&self) -> SimdAabb {
        SimdAabb { min: self.min, max: self.max }
    }

    /// Twice the centre of the box: the builder only compares centres. Infinite if the sum overflows.
    #[inline]
    pub(super) fn doubled_center(&self) -> Vec4 {
        self.min + self.max
    }
}

/// The boxes of a set of references, and of their (doubled) centres.
#[derive(Clone, Copy)]
pub(super) struct ReferenceBounds {
    pub(super) bounds: SimdAabb,
    pub(super) centers: SimdAabb,
}

impl ReferenceBounds {
    pub(super) const EMPTY: Self = Self { bounds: SimdAabb::EMPTY, centers: SimdAabb::EMPTY };

    #[inline]
    pub(super) fn extended_by(self, reference: &PrimitiveReference) -> Self {
        Self {
            bounds: self.bounds.union(reference.bounds()),
            centers: self.centers.extended_to(reference.doubled_center()),
        }
    }

    pub(super) fn union(self, other: Self) -> Self {
        Self { bounds: self.bounds.union(other.bounds), centers: self.centers.union(other.centers) }
    }

    pub(super) fn aabb(&self) -> Aabb {
        self.bounds.aabb()
    }

    pub(super) fn from_references(references: &[PrimitiveReference]) -> Self {
        references.iter().fold(Self::EMPTY, Self::extended_by)
    }
}
