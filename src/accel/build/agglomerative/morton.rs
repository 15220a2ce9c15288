//! Boxes in the order of a space-filling curve (G. Morton, 1966): what is near in the order is mostly near in space.

use glam::{UVec4, Vec3, Vec4};
use rayon::prelude::*;

use super::{Cluster, radix_sort};
use crate::accel::tree::{ReferenceBounds, SimdAabb};
use crate::math::Aabb;

/// Boxes along the curve; those at the same place of it by slot, their index in the slice that they come from.
pub(in crate::accel) struct MortonOrder {
    /// The place on the curve in the upper bits, and the slot in the lower ones. Ascending.
    keys: Vec<u64>,
    boxes: Vec<Cluster>,
    extent: ReferenceBounds,
}

impl MortonOrder {
    /// Of the boxes that are not empty. O(n).
    pub(in crate::accel) fn new(boxes: &[Aabb]) -> Self {
        let slot_bits = usize::BITS - boxes.len().leading_zeros();
        let axis_bits = ((u64::BITS - slot_bits) / 3).min(21);
        let extent = reference_bounds(boxes);
        let curve = MortonGrid::new(&extent.centers, axis_bits);
        let key = |(slot, bounds): (usize, &Aabb)| match bounds.is_empty() {
            true => EMPTY_KEY,
            false => curve.morton_code(half_center(bounds)) << slot_bits | slot as u64,
        };
        let mut keys: Vec<u64> = boxes.par_iter().enumerate().with_min_len(CHUNK).map(key).collect();
        radix_sort::sort(&mut keys, slot_bits);
        keys.retain(|&key| key != EMPTY_KEY);
        let slot_mask = (1 << slot_bits) - 1;
        let single = |key: &u64| {
            let slot = (key & slot_mask) as u32;
            Cluster::leaf(&clamp_to_f32(&boxes[slot as usize]).unwrap_or(Aabb::EMPTY), slot)
        };
        let boxes = keys.par_iter().with_min_len(CHUNK).map(single).collect();
        Self { keys, boxes, extent }
    }

    pub(in crate::accel) fn len(&self) -> usize {
        self.keys.len()
    }

    /// Clusters of one, along the curve.
    pub(in crate::accel) fn leaf_clusters(&self) -> &[Cluster] {
        &self.boxes
    }

    /// Where the range from `first` to `end`, of two boxes or more, is halved: the curve goes from one half of a box to the
    /// other.
    pub(in crate::accel) fn highest_bit_split(&self, first: usize, end: usize) -> usize {
        let keys = &self.keys[first..end];
        let highest = (keys[0] ^ keys[keys.len() - 1]).ilog2();
        first + keys.partition_point(|key| (key ^ keys[0]) >> highest == 0)
    }

    /// The boxes around all boxes and around all centres, the latter halved.
    pub(in crate::accel) fn extent(&self) -> &ReferenceBounds {
        &self.extent
    }
}

/// Of a slot without a box. No other key is the same: no slot has all of its bits set.
const EMPTY_KEY: u64 = u64::MAX;

/// Boxes that one thread takes at a time.
const CHUNK: usize = 1 << 12;

/// A quarter of the sum of the corners: nothing overflows, not even the difference of two. The fourth lane is 0.
fn half_center(bounds: &Aabb) -> Vec4 {
    let farthest = Vec4::splat(f32::MAX);
    let [min, max] = [bounds.min, bounds.max].map(|corner| corner.extend(0.0).clamp(-farthest, farthest));
    min * 0.25 + max * 0.25
}

/// The boxes around all boxes and around all centres.
fn reference_bounds(boxes: &[Aabb]) -> ReferenceBounds {
    let of_chunk = |boxes: &[Aabb]| {
        boxes.iter().filter(|b| !b.is_empty()).fold(ReferenceBounds::EMPTY, |sum, b| {
            let bounds = SimdAabb { min: b.min.extend(0.0), max: b.max.extend(0.0) };
            sum.union(ReferenceBounds { bounds, centers: SimdAabb { min: half_center(b), max: half_center(b) } })
        })
    };
    boxes.par_chunks(CHUNK).map(of_chunk).reduce(|| ReferenceBounds::EMPTY, ReferenceBounds::union)
}

/// A curve through a box.
struct MortonGrid {
    origin: Vec4,
    /// Cells per unit; 0 on an axis along which all centres coincide.
    scale: Vec4,
}

impl MortonGrid {
    fn new(centers: &SimdAabb, axis_bits: u32) -> Self {
        let axis_scale = |width: f32| {
            let scale = ((1_u32 << axis_bits) - 1) as f32 / width;
            if scale.is_finite() { scale.max(0.0) } else { 0.0 }
        };
        let width = centers.max - centers.min;
        Self { origin: centers.min, scale: Vec4::from_array(width.to_array().map(axis_scale)) }
    }

    /// The cell of a centre, as the number that the curve gives it: the bits of the three coordinates, interleaved.
    fn morton_code(&self, center: Vec4) -> u64 {
        let cell: UVec4 = ((center - self.origin) * self.scale).as_uvec4();
        spread_bits(cell.x) | spread_bits(cell.y) << 1 | spread_bits(cell.z) << 2
    }
}

/// Two zeros before each of the lower 21 bits.
fn spread_bits(bits: u32) -> u64 {
    let mut x = u64::from(bits);
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// A box cut to the range of `f32`, if there is something in it.
#[inline]
pub(in crate::accel) fn clamp_to_f32(bounds: &Aabb) -> Option<Aabb> {
    let farthest = Vec3::splat(f32::MAX);
    let cut =
        |bounds: &Aabb| Aabb { min: bounds.min.clamp(-farthest, farthest), max: bounds.max.clamp(-farthest, farthest) };
    (!bounds.is_empty()).then(|| cut(bounds))
}
