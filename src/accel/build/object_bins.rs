//! Object splits by the surface area heuristic, evaluated at bins of primitive centres (I. Wald, *On fast Construction
//! of SAH-based Bounding Volume Hierarchies*, 2007).

use glam::{IVec4, Mat4, Vec4};
use rayon::prelude::*;

use crate::accel::tree::{PrimitiveReference, ReferenceBounds, SimdAabb};

/// The most bins along an axis.
const MAX_BINS: usize = 32;

/// Nodes of at least this many references are binned and partitioned in parallel, in chunks of [`CHUNK_SIZE`]
/// references.
pub(super) const PARALLEL_BINNING_THRESHOLD: usize = 1 << 16;
/// References per parallel chunk; fixed, so that the result does not depend on the number of threads.
pub(super) const CHUNK_SIZE: usize = 1 << 13;

/// Maps a reference to its bin along each axis.
#[derive(Clone, Copy)]
pub(super) struct BinMapping {
    origin: Vec4,
    /// Bins per unit of doubled centre; 0 on an axis along which all centres coincide.
    scale: Vec4,
    bin_count: usize,
}

/// 2^23. Adding it to a float in [0, 2^23) rounds to the nearest integer and leaves that integer in the lowest bits of
/// the mantissa.
const ROUNDING_OFFSET: f32 = 8_388_608.0;

impl BinMapping {
    /// The mapping of a node's centres to bins, or `None` if all centres coincide.
    pub(super) fn new(extent: &ReferenceBounds, primitive_count: usize) -> Option<Self> {
        // 1. Choose the number of bins: more for larger nodes, at most 32.
        let bin_count = (4 + primitive_count / 8).min(MAX_BINS);
        let width = extent.centers.max - extent.centers.min;
        // 2. Map the outermost centres to the centres of the outermost bins, so that neither of these bins is empty.
        let axis_scale = |width: f32| {
            let scale = (bin_count - 1) as f32 / width;
            if width > 0.0 && width.is_finite() && scale.is_finite() { scale } else { 0.0 }
        };
        let scale = Vec4::new(axis_scale(width.x), axis_scale(width.y), axis_scale(width.z), 0.0);
        // 3. If all centres coincide along every axis, there is no split.
        (scale != Vec4::ZERO).then_some(Self { origin: extent.centers.min, scale, bin_count })
    }

    /// The bin index along each axis plus [`ROUNDING_OFFSET`].
    #[inline]
    fn bin_position(&self, doubled_center: Vec4) -> Vec4 {
        (doubled_center - self.origin) * self.scale + Vec4::splat(ROUNDING_OFFSET)
    }

    #[inline]
    fn bin_indices(&self, reference: &PrimitiveReference) -> [usize; 3] {
        let bits: [u32; 4] = bytemuck::cast(self.bin_position(reference.doubled_center()));
        [bits[0], bits[1], bits[2]].map(|b| b as usize % MAX_BINS)
    }
}

/// For each bin and axis, the box around the references whose centres fall into it, and their count.
#[derive(Clone)]
pub(super) struct ObjectBins {
    boxes: [[SimdAabb; 3]; MAX_BINS],
    counts: [[i32; 4]; MAX_BINS],
}

impl ObjectBins {
    pub(super) const EMPTY: Self = Self { boxes: [[SimdAabb::EMPTY; 3]; MAX_BINS], counts: [[0; 4]; MAX_BINS] };

    /// Clears the bins and accumulates all references.
    pub(super) fn fill(&mut self, references: &[PrimitiveReference], binning: &BinMapping) {
        // 1. Clear the bins in use.
        self.boxes[..binning.bin_count].fill([SimdAabb::EMPTY; 3]);
        self.counts[..binning.bin_count].fill([0; 4]);
        // 2. Add each reference's box and count to its bin along every axis.
        for reference in references {
            let bounds = reference.bounds();
            for (axis, bin) in binning.bin_indices(reference).into_iter().enumerate() {
                let target = &mut self.boxes[bin][axis];
                *target = target.union(bounds);
                self.counts[bin][axis] += 1;
            }
        }
    }

    /// [`fill`](Self::fill) in parallel. Returns the bins of each chunk, whose counts give the write offsets of
    /// parallel partitioning.
    pub(super) fn fill_parallel(&mut self, references: &[PrimitiveReference], binning: &BinMapping) -> Vec<Self> {
        // 1. Bin each chunk in parallel.
        let fill = |chunk| {
            let mut bins = Self::EMPTY;
            bins.fill(chunk, binning);
            bins
        };
        let chunks: Vec<Self> = references.par_chunks(CHUNK_SIZE).map(fill).collect();
        // 2. Merge the bins of the chunks, in order.
        *self = chunks.iter().fold(Self::EMPTY, |mut sum, chunk| {
            sum.merge(chunk);
            sum
        });
        chunks
    }

    fn merge(&mut self, other: &Self) {
        for bin in 0..MAX_BINS {
            for axis in 0..3 {
                self.boxes[bin][axis] = self.boxes[bin][axis].union(other.boxes[bin][axis]);
                self.counts[bin][axis] += other.counts[bin][axis];
            }
        }
    }

    /// How many of the binned references are left of the split.
    pub(super) fn left_count(&self, split: &ObjectSplit) -> usize {
        self.counts[..split.first_right_bin].iter().map(|counts| counts[split.axis] as usize).sum()
    }

    /// The object split of least SAH cost over all bins and axes. `scale` brings the node to about unit size, so that
    /// no area overflows.
    ///
    /// The three axes are swept together, one per SIMD lane. On an axis that can be split, the outermost bins hold the
    /// outermost centres, so both sides of every split are non-empty. On an axis where all centres coincide the right
    /// side is empty and its cost NaN, which never compares as less.
    pub(super) fn best_split(&self, binning: &BinMapping, scale: f32) -> Option<ObjectSplit> {
        // 1. Sweep from the right: the cost of the right side of each plane between two bins.
        let mut right_costs = [Vec4::ZERO; MAX_BINS];
        let right_costs = &mut right_costs[..binning.bin_count - 1];
        let mut side = SideAccumulator::EMPTY;
        for (plane, cost) in right_costs.iter_mut().enumerate().rev() {
            side.add(&self.boxes[plane + 1], &self.counts[plane + 1]);
            *cost = side.costs(scale);
        }
        // 2. Sweep from the left: add the cost of the left side, and keep the least total per axis.
        let mut best_costs = Vec4::INFINITY;
        let mut best_bins = Vec4::ZERO;
        let mut side = SideAccumulator::EMPTY;
        for (plane, &right_cost) in right_costs.iter().enumerate() {
            side.add(&self.boxes[plane], &self.counts[plane]);
            let costs = side.costs(scale) + right_cost;
            let is_better = costs.cmplt(best_costs);
            best_costs = Vec4::select(is_better, costs, best_costs);
            best_bins = Vec4::select(is_better, Vec4::splat((plane + 1) as f32), best_bins);
        }
        // 3. Choose the axis of least cost; ties go to the lowest axis.
        let axis = if best_costs.x <= best_costs.y && best_costs.x <= best_costs.z {
            0
        } else if best_costs.y <= best_costs.z {
            1
        } else {
            2
        };
        // 4. Collect the boxes and the left count of that split.
        (best_costs[axis] < f32::INFINITY)
            .then(|| self.object_split_at(axis, best_bins[axis] as usize, best_costs[axis], binning))
    }

    fn object_split_at(&self, axis: usize, bin: usize, cost: f32, binning: &BinMapping) -> ObjectSplit {
        let boxes = &self.boxes[..binning.bin_count];
        let union = |boxes: &[[SimdAabb; 3]]| boxes.iter().fold(SimdAabb::EMPTY, |a, b| a.union(b[axis]));
        let (left, right) = (union(&boxes[..bin]), union(&boxes[bin..]));
        let mut split = ObjectSplit {
            axis,
            first_right_bin: bin,
            binning: *binning,
            cost,
            left_count: 0,
            left_bounds: left,
            right_bounds: right,
        };
        split.left_count = self.left_count(&split);
        split
    }
}

/// The union box and reference count of the bins swept so far, for each axis.
struct SideAccumulator {
    boxes: [SimdAabb; 3],
    counts: [i32; 4],
}

impl SideAccumulator {
    const EMPTY: Self = Self { boxes: [SimdAabb::EMPTY; 3], counts: [0; 4] };

    #[inline]
    fn add(&mut self, boxes: &[SimdAabb; 3], counts: &[i32; 4]) {
        for (sum, &bounds) in self.boxes.iter_mut().zip(boxes) {
            *sum = sum.union(bounds);
        }
        for (sum, count) in self.counts.iter_mut().zip(counts) {
            *sum += count;
        }
    }

    /// Reference count times scaled half area, one axis per lane.
    #[inline]
    fn costs(&self, scale: f32) -> Vec4 {
        let [x, y, z] = &self.boxes;
        let [x, y, z] = [(x.max - x.min) * scale, (y.max - y.min) * scale, (z.max - z.min) * scale];
        let sides = Mat4::from_cols(x, y, z, Vec4::ZERO).transpose();
        let (x, y, z) = (sides.x_axis, sides.y_axis, sides.z_axis);
        (x * y + y * z + z * x) * IVec4::from_array(self.counts).as_vec4()
    }
}

/// An object split: a plane between two bins of centres along one axis.
#[derive(Clone)]
pub(super) struct ObjectSplit {
    axis: usize,
    /// The first bin right of the plane.
    first_right_bin: usize,
    binning: BinMapping,
    /// SAH cost without constants: reference count times scaled half area, summed over both sides.
    pub(super) cost: f32,
    pub(super) left_count: usize,
    pub(super) left_bounds: SimdAabb,
    pub(super) right_bounds: SimdAabb,
}

impl ObjectSplit {
    /// Whether a reference with this doubled centre belongs to the right side.
    #[inline]
    pub(super) fn is_right(&self, doubled_center: Vec4) -> bool {
        let threshold = Vec4::splat(ROUNDING_OFFSET + self.first_right_bin as f32);
        let right = self.binning.bin_position(doubled_center).cmpge(threshold).bitmask();
        right >> self.axis & 1 != 0
    }
}
