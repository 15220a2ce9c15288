//! Where to split: the surface area heuristic, evaluated on bins of primitive centres (Wald 2007, "On fast Construction of
//! SAH-based Bounding Volume Hierarchies").

use glam::{IVec4, Mat4, Vec4};
use rayon::prelude::*;

use crate::accel::tree::{PrimitiveReference, ReferenceBounds, SimdAabb};

/// The most bins along an axis.
const MAX_BINS: usize = 32;

/// From here on a node is binned and partitioned by several threads, in chunks of [`CHUNK_SIZE`] references.
pub(super) const PARALLEL_BINNING_THRESHOLD: usize = 1 << 16;
/// See [`PARALLEL_BINNING_THRESHOLD`].
pub(super) const CHUNK_SIZE: usize = 1 << 13;

/// Maps a reference to its bin along each axis.
#[derive(Clone, Copy)]
pub(super) struct BinMapping {
    origin: Vec4,
    /// Bins per unit of doubled centre; 0 on an axis along which all centres coincide.
    scale: Vec4,
    bin_count: usize,
}

/// 2^23: adding it to a small non-negative float leaves the float, rounded to an integer, in the lowest bits.
const ROUNDING_OFFSET: f32 = 8_388_608.0;

impl BinMapping {
    /// Bins for a node, or `None` if all centres coincide.
    pub(super) fn new(extent: &ReferenceBounds, primitive_count: usize) -> Option<Self> {
        let bin_count = (4 + primitive_count / 8).min(MAX_BINS);
        let width = extent.centers.max - extent.centers.min;
        // The outermost centres are the middles of the outermost bins.
        let axis_scale = |width: f32| {
            let scale = (bin_count - 1) as f32 / width;
            if width > 0.0 && width.is_finite() && scale.is_finite() { scale } else { 0.0 }
        };
        let scale = Vec4::new(axis_scale(width.x), axis_scale(width.y), axis_scale(width.z), 0.0);
        (scale != Vec4::ZERO).then_some(Self { origin: extent.centers.min, scale, bin_count })
    }

    /// The bin along each axis, plus [`ROUNDING_OFFSET`].
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

/// What fell into each bin, for each axis.
#[derive(Clone)]
pub(super) struct ObjectBins {
    boxes: [[SimdAabb; 3]; MAX_BINS],
    counts: [[i32; 4]; MAX_BINS],
}

impl ObjectBins {
    pub(super) const EMPTY: Self = Self { boxes: [[SimdAabb::EMPTY; 3]; MAX_BINS], counts: [[0; 4]; MAX_BINS] };

    /// Forgets what was in the bins and fills them anew.
    pub(super) fn fill(&mut self, references: &[PrimitiveReference], binning: &BinMapping) {
        self.boxes[..binning.bin_count].fill([SimdAabb::EMPTY; 3]);
        self.counts[..binning.bin_count].fill([0; 4]);
        for reference in references {
            let bounds = reference.bounds();
            for (axis, bin) in binning.bin_indices(reference).into_iter().enumerate() {
                let target = &mut self.boxes[bin][axis];
                *target = target.union(bounds);
                self.counts[bin][axis] += 1;
            }
        }
    }

    /// The same by several threads; returns the bins of each chunk, which partitioning needs.
    pub(super) fn fill_parallel(&mut self, references: &[PrimitiveReference], binning: &BinMapping) -> Vec<Self> {
        let fill = |chunk| {
            let mut bins = Self::EMPTY;
            bins.fill(chunk, binning);
            bins
        };
        let chunks: Vec<Self> = references.par_chunks(CHUNK_SIZE).map(fill).collect();
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

    /// How many references lie left of the split.
    pub(super) fn left_count(&self, split: &ObjectSplit) -> usize {
        self.counts[..split.first_right_bin].iter().map(|counts| counts[split.axis] as usize).sum()
    }

    /// The split of least cost. `scale` makes the node about one unit long, so that no area overflows.
    ///
    /// The three axes are swept side by side, a lane each. The outermost bins of a usable axis are never empty (they hold the
    /// outermost centres), so neither is any side of a split; on other axes the cost is NaN and never the least.
    pub(super) fn best_split(&self, binning: &BinMapping, scale: f32) -> Option<ObjectSplit> {
        // The cost of what lies right of each plane, the plane before bin 1 first.
        let mut right_costs = [Vec4::ZERO; MAX_BINS];
        let right_costs = &mut right_costs[..binning.bin_count - 1];
        let mut side = SideAccumulator::EMPTY;
        for (plane, cost) in right_costs.iter_mut().enumerate().rev() {
            side.add(&self.boxes[plane + 1], &self.counts[plane + 1]);
            *cost = side.costs(scale);
        }
        let mut least = Vec4::INFINITY;
        let mut least_bins = Vec4::ZERO;
        let mut side = SideAccumulator::EMPTY;
        for (plane, &right_cost) in right_costs.iter().enumerate() {
            side.add(&self.boxes[plane], &self.counts[plane]);
            let costs = side.costs(scale) + right_cost;
            let less = costs.cmplt(least);
            least = Vec4::select(less, costs, least);
            least_bins = Vec4::select(less, Vec4::splat((plane + 1) as f32), least_bins);
        }
        let axis = if least.x <= least.y && least.x <= least.z {
            0
        } else if least.y <= least.z {
            1
        } else {
            2
        };
        (least[axis] < f32::INFINITY)
            .then(|| self.object_split_at(axis, least_bins[axis] as usize, least[axis], binning))
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

/// What lies on one side of a split, for each axis.
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

    /// Primitive count times half area, a lane an axis.
    #[inline]
    fn costs(&self, scale: f32) -> Vec4 {
        let [x, y, z] = &self.boxes;
        let [x, y, z] = [(x.max - x.min) * scale, (y.max - y.min) * scale, (z.max - z.min) * scale];
        let sides = Mat4::from_cols(x, y, z, Vec4::ZERO).transpose();
        let (x, y, z) = (sides.x_axis, sides.y_axis, sides.z_axis);
        (x * y + y * z + z * x) * IVec4::from_array(self.counts).as_vec4()
    }
}

/// A plane between two bins.
#[derive(Clone)]
pub(super) struct ObjectSplit {
    axis: usize,
    /// The first bin to the right.
    first_right_bin: usize,
    binning: BinMapping,
    /// Primitive count times scaled half area, summed over both sides.
    pub(super) cost: f32,
    pub(super) left_count: usize,
    pub(super) left_bounds: SimdAabb,
    pub(super) right_bounds: SimdAabb,
}

impl ObjectSplit {
    /// Whether a reference with this doubled centre goes to the right.
    #[inline]
    pub(super) fn is_right(&self, doubled_center: Vec4) -> bool {
        let threshold = Vec4::splat(ROUNDING_OFFSET + self.first_right_bin as f32);
        let right = self.binning.bin_position(doubled_center).cmpge(threshold).bitmask();
        right >> self.axis & 1 != 0
    }
}
