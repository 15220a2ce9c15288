//! Clusters of boxes, as clustering merges them and as the records of merges see them.

use crate::accel::tree::{NORMAL_FLOAT_BIT, SimdAabb};
use crate::math::Aabb;

/// A box with two indices in the fourth lanes, each tagged with [`NORMAL_FLOAT_BIT`]. 32 bytes.
#[derive(Clone, Copy, bytemuck::Zeroable)]
pub(in crate::accel) struct Cluster {
    bounds: SimdAabb,
}

impl Cluster {
    /// A cluster with its [`tagged_index`](Self::tagged_index) and its [`reserved_merge`](Self::reserved_merge).
    pub(super) fn new(bounds: SimdAabb, indices: [u32; 2]) -> Self {
        let [min, max] = indices.map(|index| f32::from_bits(NORMAL_FLOAT_BIT | index));
        Self { bounds: SimdAabb { min: bounds.min.with_w(min), max: bounds.max.with_w(max) } }
    }

    /// A cluster of one box, with the index of that box in the input.
    pub(super) fn leaf(bounds: &Aabb, box_index: u32) -> Self {
        Self::new(SimdAabb { min: bounds.min.extend(0.0), max: bounds.max.extend(0.0) }, [box_index, 0])
    }

    pub(in crate::accel) fn bounds(&self) -> Aabb {
        self.bounds.aabb()
    }

    pub(super) fn simd_bounds(&self) -> SimdAabb {
        self.bounds
    }

    /// For a [leaf](Self::leaf): the index of its box in the input.
    pub(in crate::accel) fn box_index(&self) -> u32 {
        self.bounds.min.w.to_bits() ^ NORMAL_FLOAT_BIT
    }

    /// For a cluster of one box its position in Morton order; for a merged one the number of boxes plus the index of
    /// its merge record.
    fn tagged_index(&self) -> u32 {
        self.bounds.min.w.to_bits() ^ NORMAL_FLOAT_BIT
    }

    /// The index of an unused merge record that belongs to this cluster's range. Each cluster brings one, and a merge
    /// of two clusters uses one, so there are always enough.
    pub(super) fn reserved_merge(&self) -> u32 {
        self.bounds.max.w.to_bits() ^ NORMAL_FLOAT_BIT
    }

    /// The cluster as the record of a merge sees it; `box_count` is the number of all boxes.
    pub(super) fn as_child(&self, box_count: usize) -> ChildCluster {
        let index = self.tagged_index() as usize;
        let kind = if index < box_count { ClusterKind::Single(index) } else { ClusterKind::Merged(index - box_count) };
        ChildCluster { bounds: self.bounds, kind }
    }
}

/// A cluster as the record of its merge with another sees it.
#[derive(Clone, Copy)]
pub(in crate::accel) struct ChildCluster {
    /// The fourth lanes are padding and may hold anything.
    pub(in crate::accel) bounds: SimdAabb,
    pub(in crate::accel) kind: ClusterKind,
}

/// Whether a cluster is a single box or the result of a merge.
#[derive(Clone, Copy)]
pub(in crate::accel) enum ClusterKind {
    /// One box, by its position in Morton order.
    Single(usize),
    /// A merge of two clusters, by the index of its record.
    Merged(usize),
}
