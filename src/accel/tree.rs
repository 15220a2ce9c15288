//! The output of every builder: a binary tree over primitive boxes, before it is written as device nodes.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4, Vec4Swizzles};

use crate::math::Aabb;

/// The depth down to which the top-down builder searches for splits. Deeper nodes are split at the median.
pub(super) const MAX_SAH_DEPTH: u32 = 64;

/// The most levels of a bottom-level hierarchy: below level 64 nodes are split at the median, and 2^28 primitives can
/// be halved 28 times.
pub const MAX_BLAS_DEPTH: usize = (MAX_SAH_DEPTH + 29) as usize;

/// Constants of the cost model of the surface area heuristic (SAH).
#[derive(Clone, Copy)]
pub(super) struct SahParams {
    /// The most primitives in a leaf.
    pub(super) max_leaf_size: usize,
    /// Cost of a primitive test, in units of one node fetch and box test.
    pub(super) primitive_cost: f32,
}

/// A binary tree over primitives.
///
/// Builders that fill subtrees in parallel reserve the worst case for each: `2 n - 2` elements of `nodes` below the
/// root of a subtree of at most `n` leaves, and `n` elements of `primitive_indices`. Both arrays therefore have unused
/// gaps; pages of them that are never written take no memory.
#[derive(Default)]
pub(super) struct BuildTree {
    /// The root is at index 0; empty for a tree without primitives. The two children of a node are adjacent.
    pub(super) nodes: Vec<BuildNode>,
    /// Primitive indices; each leaf refers to a range of them.
    pub(super) primitive_indices: Vec<u32>,
    /// Whether a primitive may be in several leaves (spatial splits). No leaf holds the same primitive twice.
    pub(super) has_duplicates: bool,
}

impl BuildTree {
    /// Appends the primitives below `node`, without duplicates, to the first `count` elements of `target`. Returns the
    /// new count, or `None` if `target` is too short. Recursion is as deep as the tree.
    pub(super) fn collect_primitives(&self, node: usize, target: &mut [u32], mut count: usize) -> Option<usize> {
        match self.nodes[node].contents() {
            // A leaf: append its primitives, except those collected before.
            BuildNodeContent::Primitives(range) => {
                for &primitive in &self.primitive_indices[range] {
                    if !(self.has_duplicates && target[..count].contains(&primitive)) {
                        *target.get_mut(count)? = primitive;
                        count += 1;
                    }
                }
                Some(count)
            }
            // An inner node: collect both children.
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
    /// For an inner node the index of its first child; for a leaf the index of its first element in
    /// `primitive_indices`.
    first_child_or_primitive: u32,
    pub(super) max: Vec3,
    /// 0 for an inner node.
    primitive_count: u32,
}

/// The children of an inner node or the primitives of a leaf.
pub(super) enum BuildNodeContent {
    /// The index of the first child; the second child follows it.
    Children(usize),
    /// A range of `primitive_indices`.
    Primitives(std::ops::Range<usize>),
}

impl BuildNode {
    /// An inner node; `first_child` is an index into the tree's nodes.
    pub(super) fn inner(bounds: &SimdAabb, first_child: usize) -> Self {
        Self {
            min: bounds.min.xyz(),
            first_child_or_primitive: first_child as u32,
            max: bounds.max.xyz(),
            primitive_count: 0,
        }
    }

    /// A leaf of `count` primitives, at least one; `first` is an index into the tree's `primitive_indices`.
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

/// The most nodes that a binary subtree of `leaf_count` leaves has below its root.
pub(super) fn max_node_count_below(leaf_count: usize) -> usize {
    2 * leaf_count.max(1) - 2
}

/// Subtrees of fewer primitives are built by one thread; their nodes are written without gaps.
pub(super) const PARALLEL_SUBTREE_THRESHOLD: usize = 1 << 10;

/// A box as two 4-lane vectors. The fourth lanes are padding and may hold anything.
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

    /// The common part of two boxes; if they do not overlap, `min > max` on some axis.
    pub(super) fn intersection(self, other: Self) -> Self {
        Self { min: self.min.max(other.min), max: self.max.min(other.max) }
    }

    #[inline]
    pub(super) fn extended_to(self, point: Vec4) -> Self {
        Self { min: self.min.min(point), max: self.max.max(point) }
    }

    /// Half the surface area after all lengths are multiplied by `scale`, in scaled units squared.
    #[inline]
    pub(super) fn half_area(self, scale: f32) -> f32 {
        let d = (self.max - self.min) * scale;
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}

/// The power of two by which the longest side of a box comes to lie in [1, 2), so that scaled areas neither overflow
/// nor underflow. Infinite for a box whose sides are all zero or subnormal, and zero for one with an infinite side.
pub(super) fn normalizing_scale(bounds: &SimdAabb) -> f32 {
    let side = bounds.max - bounds.min;
    let longest = side.x.max(side.y).max(side.z);
    1.0 / f32::from_bits(longest.to_bits() & f32::INFINITY.to_bits())
}

/// A reference to a primitive as builders partition it: a box and a primitive index (Embree's `PrimRef`). 32 bytes.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct PrimitiveReference {
    /// Lanes x, y, z: the least corner of the box. Lane w: the primitive index, tagged with [`NORMAL_FLOAT_BIT`].
    min: Vec4,
    max: Vec4,
}

/// An exponent bit that is set in an index stored in a float lane, so that every index below 2^29 reads as a normal
/// float: a subnormal operand slows SIMD arithmetic on all lanes a hundredfold.
pub(super) const NORMAL_FLOAT_BIT: u32 = 0x4000_0000;

impl PrimitiveReference {
    pub(super) fn new(bounds: &Aabb, primitive: u32) -> Self {
        Self { min: bounds.min.extend(f32::from_bits(NORMAL_FLOAT_BIT | primitive)), max: bounds.max.extend(1.0) }
    }

    /// The same primitive with its box clipped to `bounds`: one part of a spatial split.
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

    /// Twice the centre of the box, which saves a multiplication: builders only compare centres with each other.
    /// Infinite if the sum overflows.
    #[inline]
    pub(super) fn doubled_center(&self) -> Vec4 {
        self.min + self.max
    }
}

/// The box around a set of references, and the box around their centres. The top-down builder stores doubled centres,
/// the Morton order of `agglomerative` halved ones.
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

    /// Whether all centres coincide.
    pub(super) fn has_one_center(&self) -> bool {
        self.centers.min.truncate() == self.centers.max.truncate()
    }

    pub(super) fn from_references(references: &[PrimitiveReference]) -> Self {
        references.iter().fold(Self::EMPTY, Self::extended_by)
    }
}
