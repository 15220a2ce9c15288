//! Sorts boxes along a Morton curve (G. Morton, 1966), on which boxes that are near each other are mostly near in
//! space.

use glam::{UVec4, Vec4};
use rayon::prelude::*;

use super::cluster::Cluster;
use super::radix_sort;
use crate::accel::tree::{ReferenceBounds, SimdAabb};
use crate::math::Aabb;

/// Non-empty boxes sorted by Morton code, ties by their index in the input.
pub(in crate::accel) struct MortonOrder {
    /// Ascending; the Morton code in the upper bits and the input index in the lower ones.
    keys: Vec<u64>,
    /// The box of each key, as a cluster of one.
    leaf_clusters: Vec<Cluster>,
    extent: ReferenceBounds,
    /// The bits of a key that hold the input index.
    index_bits: u32,
}

impl MortonOrder {
    /// Sorts the boxes that are not empty. O(n).
    pub(in crate::accel) fn new(boxes: &[Aabb]) -> Self {
        // 1. Divide the bits of a key between the input index and the three axes.
        let index_bits = usize::BITS - boxes.len().leading_zeros();
        let axis_bits = ((u64::BITS - index_bits) / 3).min(21);
        // 2. Fit the grid of the curve to the centres.
        let extent = reference_bounds(boxes);
        let grid = MortonGrid::new(&extent.centers, axis_bits);
        // 3. Compute the keys in parallel.
        let key = |(index, bounds): (usize, &Aabb)| match bounds.is_empty() {
            true => EMPTY_KEY,
            false => grid.morton_code(half_center(bounds)) << index_bits | index as u64,
        };
        let mut keys: Vec<u64> = boxes.par_iter().enumerate().with_min_len(CHUNK).map(key).collect();
        // 4. Sort them, and drop those of empty boxes.
        radix_sort::sort(&mut keys, index_bits);
        keys.retain(|&key| key != EMPTY_KEY);
        // 5. Gather the boxes in that order.
        let index_mask = (1 << index_bits) - 1;
        let leaf = |key: &u64| {
            let index = (key & index_mask) as u32;
            Cluster::leaf(&boxes[index as usize].clamped_to_finite().unwrap_or(Aabb::EMPTY), index)
        };
        let leaf_clusters = keys.par_iter().with_min_len(CHUNK).map(leaf).collect();
        Self { keys, leaf_clusters, extent, index_bits }
    }

    pub(in crate::accel) fn len(&self) -> usize {
        self.keys.len()
    }

    /// The boxes as clusters of one, in Morton order.
    pub(in crate::accel) fn leaf_clusters(&self) -> &[Cluster] {
        &self.leaf_clusters
    }

    /// The runs of at least two boxes of the same Morton code.
    pub(super) fn equal_codes(&self) -> impl Iterator<Item = &[Cluster]> {
        let mut first = 0;
        let runs = self.keys.chunk_by(|a, b| a >> self.index_bits == b >> self.index_bits).map(move |run| {
            first += run.len();
            &self.leaf_clusters[first - run.len()..first]
        });
        runs.filter(|run| run.len() > 1)
    }

    /// Where the range from `first` to `end` (at least two boxes) is halved: at the first key that has the highest
    /// differing bit set (T. Karras, 2012), that is, where the curve passes from one half of a cell into the other.
    pub(in crate::accel) fn highest_bit_split(&self, first: usize, end: usize) -> usize {
        let keys = &self.keys[first..end];
        // The highest bit in which the first and the last key differ.
        let highest = (keys[0] ^ keys[keys.len() - 1]).ilog2();
        // Binary search for the first key with that bit set.
        first + keys.partition_point(|key| (key ^ keys[0]) >> highest == 0)
    }

    /// The box around all boxes, and the box around all centres times 0.5, so that no difference of two overflows.
    pub(in crate::accel) fn extent(&self) -> &ReferenceBounds {
        &self.extent
    }
}

/// The key of an empty box. No box in use has it, since no input index has all of its bits set.
const EMPTY_KEY: u64 = u64::MAX;

/// Boxes per parallel chunk.
const CHUNK: usize = 1 << 12;

/// Half of the centre (a quarter of the sum of the corners), so that neither it nor a difference of two overflows. The
/// fourth lane is 0.
fn half_center(bounds: &Aabb) -> Vec4 {
    let farthest = Vec4::splat(f32::MAX);
    let [min, max] = [bounds.min, bounds.max].map(|corner| corner.extend(0.0).clamp(-farthest, farthest));
    min * 0.25 + max * 0.25
}

/// The box around all boxes, and the box around all halved centres, see [`MortonOrder::extent`].
fn reference_bounds(boxes: &[Aabb]) -> ReferenceBounds {
    let of_chunk = |boxes: &[Aabb]| {
        boxes.iter().filter(|b| !b.is_empty()).fold(ReferenceBounds::EMPTY, |sum, b| {
            let bounds = SimdAabb { min: b.min.extend(0.0), max: b.max.extend(0.0) };
            sum.union(ReferenceBounds { bounds, centers: SimdAabb { min: half_center(b), max: half_center(b) } })
        })
    };
    boxes.par_chunks(CHUNK).map(of_chunk).reduce(|| ReferenceBounds::EMPTY, ReferenceBounds::union)
}

/// A Morton curve over the cells of a grid on the box of the centres.
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

    /// The Morton code of a centre's cell: the bits of its three coordinates, interleaved.
    fn morton_code(&self, center: Vec4) -> u64 {
        let cell: UVec4 = ((center - self.origin) * self.scale).as_uvec4();
        spread_bits(cell.x) | spread_bits(cell.y) << 1 | spread_bits(cell.z) << 2
    }
}

/// Inserts two zero bits before each of the lower 21 bits.
fn spread_bits(bits: u32) -> u64 {
    let mut x = u64::from(bits);
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}
