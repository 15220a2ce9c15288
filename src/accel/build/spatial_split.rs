//! Spatial splits: a plane that cuts through primitives, whose parts go to both sides (M. Stich, H. Friedrich, A.
//! Dietrich, *Spatial Splits in Bounding Volume Hierarchies*, 2009).

use glam::{Vec4, Vec4Swizzles};
use rayon::prelude::*;

use super::object_bins::{CHUNK_SIZE, PARALLEL_BINNING_THRESHOLD};
use super::triangle_clip::{ClippedBounds, TriangleClipper, can_clip};
use crate::accel::padding::SIDE_MARGIN;
use crate::accel::tree::{PrimitiveReference, ReferenceBounds, SimdAabb};
use crate::device::layout::PrimitiveRange;
use crate::graph::Geometry;

/// Settings for spatial splits in the top-down builder.
#[derive(Clone, Copy)]
pub(super) struct SpatialSplits<'a> {
    /// The geometry whose triangles the references stand for; spatial splits clip them.
    pub(super) geometry: &'a Geometry,
    /// How many references spatial splits may add in all: a triangle on both sides of a plane becomes two references.
    pub(super) duplicate_budget: usize,
    /// Whether a node falls back on object splits only where no spatial split is possible. The tree is then a kd-tree.
    pub(super) spatial_only: bool,
}

impl<'a> SpatialSplits<'a> {
    /// Settings for a tree of object and spatial splits, whichever cost less. `share` is the duplicate budget as a
    /// fraction of the number of references, `count`. `None` for a geometry too large or too small for clipping in f32
    /// (see [`can_clip`]).
    pub(super) fn new(geometry: &'a Geometry, extent: &ReferenceBounds, count: usize, share: f32) -> Option<Self> {
        let max_budget = PrimitiveRange::MAX_FIRST as usize - count;
        let duplicate_budget = ((count as f32 * share) as usize).min(max_budget);
        can_clip(&extent.aabb()).then_some(Self { geometry, duplicate_budget, spatial_only: false })
    }
}

/// Widens the boxes of references to whole triangles by what the triangle test requires of the boxes around them
/// ([`SIDE_MARGIN`]): once a triangle has been divided, the boxes of its parts do not tell its size. Returns their new
/// bounds. O(n).
pub(super) fn widen_references(references: &mut [PrimitiveReference]) -> ReferenceBounds {
    let widen = |references: &mut [PrimitiveReference]| {
        references.iter_mut().fold(ReferenceBounds::EMPTY, |extent, reference| {
            let SimdAabb { min, max } = reference.bounds();
            let margin = Vec4::splat((max - min).xyz().max_element() * SIDE_MARGIN);
            *reference = reference.clipped_to(&SimdAabb { min: min - margin, max: max + margin });
            extent.extended_by(reference)
        })
    };
    references.par_chunks_mut(CHUNK_SIZE).map(widen).reduce(|| ReferenceBounds::EMPTY, ReferenceBounds::union)
}

/// The most spatial bins along an axis.
const MAX_SPATIAL_BINS: usize = 32;

/// Spatial bins: equal slabs of a node's box along each axis.
#[derive(Clone, Copy)]
struct SpatialBins {
    origin: Vec4,
    width: Vec4,
    /// 1 over `width`; 0 on an axis along which the box cannot be divided.
    scale: Vec4,
    count: usize,
}

impl SpatialBins {
    fn new(bounds: &SimdAabb, primitive_count: usize) -> Self {
        let count = (4 + primitive_count / 8).min(MAX_SPATIAL_BINS);
        let width = (bounds.max - bounds.min) / count as f32;
        let invert = |width: f32| {
            let scale = 1.0 / width;
            if width > 0.0 && scale.is_finite() { scale } else { 0.0 }
        };
        let [x, y, z, _] = width.to_array().map(invert);
        Self { origin: bounds.min, width, scale: Vec4::new(x, y, z, 0.0), count }
    }

    /// The bin that a point is in, along each axis.
    #[inline]
    fn bin_indices(&self, point: Vec4) -> [usize; 3] {
        let [x, y, z, _] = ((point - self.origin) * self.scale).to_array();
        [x, y, z].map(|position| (position as usize).min(self.count - 1))
    }

    /// The coordinate of the plane at the lower end of a bin.
    fn plane(&self, axis: usize, bin: usize) -> f32 {
        self.width[axis].mul_add(bin as f32, self.origin[axis])
    }
}

/// The spatial split of least SAH cost that leaves fewer than all references on either side, at least one on each, and
/// at most `capacity` in all, duplicates included. `scale` brings the node to about unit size.
pub(super) fn find_spatial_split(
    geometry: &Geometry,
    references: &[PrimitiveReference],
    bounds: &SimdAabb,
    capacity: usize,
    scale: f32,
) -> Option<SpatialSplit> {
    // 1. Count how many references begin and end in each bin. This is cheap, and often no plane qualifies.
    let spatial_bins = SpatialBins::new(bounds, references.len());
    let counts = reduce_references(references, |chunk| EntryExitCounts::of(chunk, &spatial_bins), EntryExitCounts::add);
    let is_valid_split = |[left, right]: [usize; 2]| {
        left.min(right) > 0 && left.max(right) < references.len() && left + right <= capacity
    };
    let axes = [0, 1, 2].map(|axis| {
        spatial_bins.scale[axis] > 0.0 && counts.side_counts(axis, spatial_bins.count).any(|(_, n)| is_valid_split(n))
    });
    if axes == [false; 3] {
        return None;
    }
    // 2. Clip the references to the bins, and take the box of each bin.
    let boxes = reduce_references(
        references,
        |chunk| SpatialBinBounds::of(geometry, chunk, &spatial_bins, axes),
        SpatialBinBounds::union,
    );
    // 3. Sweep the planes for the least cost.
    let mut best: Option<SpatialSplit> = None;
    for axis in (0..3).filter(|&axis| axes[axis]) {
        let rights = boxes.right_bounds(axis, spatial_bins.count);
        let mut left = SimdAabb::EMPTY;
        for (bin, counts) in counts.side_counts(axis, spatial_bins.count) {
            left = left.union(boxes.0[axis][bin - 1]);
            let bounds = [left, rights[bin]];
            let cost = (0..2).map(|side| bounds[side].half_area(scale) * counts[side] as f32).sum();
            if is_valid_split(counts) && best.as_ref().is_none_or(|best| cost < best.cost) {
                best = Some(SpatialSplit { axis, first_right_bin: bin, bins: spatial_bins, cost, counts, bounds });
            }
        }
    }
    best
}

/// Accumulates over all references, in parallel chunks where there are many.
fn reduce_references<T: Send>(
    references: &[PrimitiveReference],
    of_chunk: impl Fn(&[PrimitiveReference]) -> T + Sync,
    add: impl Fn(T, T) -> T + Sync,
) -> T {
    if references.len() < PARALLEL_BINNING_THRESHOLD {
        return of_chunk(references);
    }
    references.par_chunks(CHUNK_SIZE).map(&of_chunk).reduce(|| of_chunk(&[]), &add)
}

/// For each axis and bin, how many references begin (entries) and end (exits) in it.
struct EntryExitCounts {
    entries: [[u32; MAX_SPATIAL_BINS]; 3],
    exits: [[u32; MAX_SPATIAL_BINS]; 3],
}

impl EntryExitCounts {
    fn of(references: &[PrimitiveReference], spatial_bins: &SpatialBins) -> Self {
        let mut counts = Self { entries: [[0; MAX_SPATIAL_BINS]; 3], exits: [[0; MAX_SPATIAL_BINS]; 3] };
        // Count each reference in the bin where it begins and in the one where it ends.
        for reference in references {
            let bounds = reference.bounds();
            let (first, last) = (spatial_bins.bin_indices(bounds.min), spatial_bins.bin_indices(bounds.max));
            for axis in 0..3 {
                counts.entries[axis][first[axis]] += 1;
                counts.exits[axis][last[axis]] += 1;
            }
        }
        counts
    }

    #[expect(clippy::needless_pass_by_value, reason = "rayon's reduce gives it")]
    fn add(mut self, other: Self) -> Self {
        let pairs = [(&mut self.entries, &other.entries), (&mut self.exits, &other.exits)];
        for (sums, counts) in pairs {
            sums.as_flattened_mut().iter_mut().zip(counts.as_flattened()).for_each(|(sum, count)| *sum += count);
        }
        self
    }

    /// For each plane between two bins: the first bin right of it, and the reference counts of both sides; a reference
    /// across the plane counts on both.
    fn side_counts(&self, axis: usize, bin_count: usize) -> impl Iterator<Item = (usize, [usize; 2])> {
        // Start left of the first plane, with every reference on the right side.
        let mut right: usize = self.exits[axis].iter().map(|&count| count as usize).sum();
        let mut left = 0;
        // Step over one bin after the other: its entries join the left side, its exits leave the right side.
        (1..bin_count).map(move |bin| {
            left += self.entries[axis][bin - 1] as usize;
            right -= self.exits[axis][bin - 1] as usize;
            (bin, [left, right])
        })
    }
}

/// For each axis and bin, the box around the parts of references inside it.
struct SpatialBinBounds([[SimdAabb; MAX_SPATIAL_BINS]; 3]);

impl SpatialBinBounds {
    /// The boxes of all bins along the axes for which `axes` is true.
    fn of(geometry: &Geometry, references: &[PrimitiveReference], spatial_bins: &SpatialBins, axes: [bool; 3]) -> Self {
        let mut boxes = Self([[SimdAabb::EMPTY; MAX_SPATIAL_BINS]; 3]);
        for reference in references {
            let mut triangle = None;
            let bounds = reference.bounds();
            let (first, last) = (spatial_bins.bin_indices(bounds.min), spatial_bins.bin_indices(bounds.max));
            for axis in (0..3).filter(|&axis| axes[axis]) {
                let boxes = &mut boxes.0[axis];
                let mut rest = bounds;
                // Clip off the part in each bin but the last.
                #[expect(clippy::needless_range_loop, reason = "the bin's index also gives the plane")]
                for bin in first[axis]..last[axis] {
                    let triangle =
                        triangle.get_or_insert_with(|| TriangleClipper::new(geometry, reference.primitive()));
                    let ClippedBounds { left, right } =
                        triangle.split_bounds(&rest, axis, spatial_bins.plane(axis, bin + 1));
                    boxes[bin] = boxes[bin].union(left);
                    rest = right;
                }
                // Add what remains to the last bin.
                boxes[last[axis]] = boxes[last[axis]].union(rest);
            }
        }
        boxes
    }

    #[expect(clippy::needless_pass_by_value, reason = "rayon's reduce gives it")]
    fn union(mut self, other: Self) -> Self {
        let pairs = self.0.as_flattened_mut().iter_mut().zip(other.0.as_flattened());
        pairs.for_each(|(sum, bounds)| *sum = sum.union(*bounds));
        self
    }

    /// For each bin but the first, the union of its box and all boxes right of it.
    fn right_bounds(&self, axis: usize, bin_count: usize) -> [SimdAabb; MAX_SPATIAL_BINS] {
        let mut rights = self.0[axis];
        for bin in (1..bin_count - 1).rev() {
            rights[bin] = rights[bin].union(rights[bin + 1]);
        }
        rights
    }
}

/// A spatial split: its plane, and the counts and boxes of both sides.
pub(super) struct SpatialSplit {
    axis: usize,
    /// The first bin right of the plane.
    first_right_bin: usize,
    bins: SpatialBins,
    /// SAH cost without constants: reference count times scaled half area, summed over both sides.
    pub(super) cost: f32,
    /// Reference counts left and right of the plane; a reference across it counts on both sides.
    counts: [usize; 2],
    bounds: [SimdAabb; 2],
}

impl SpatialSplit {
    /// Partitions the references into `target`: the left side from its start, the right side from its end. A reference
    /// across the plane is clipped to both sides; if `allow_unsplitting`, it goes whole to one side where that costs
    /// less than duplicating it (reference unsplitting, section 4.4 of the paper). Returns the bounds and count of both
    /// sides.
    pub(super) fn partition(
        &self,
        geometry: &Geometry,
        source: &[PrimitiveReference],
        target: &mut [PrimitiveReference],
        scale: f32,
        allow_unsplitting: bool,
    ) -> [(ReferenceBounds, usize); 2] {
        // 1. The left side grows from the start of `target`, the right side from its end.
        let plane = self.bins.plane(self.axis, self.first_right_bin);
        let mut sides = [(ReferenceBounds::EMPTY, 0); 2];
        let end = target.len();
        let mut push_reference = |side: usize, reference: &PrimitiveReference| {
            let (extent, count) = &mut sides[side];
            *extent = extent.extended_by(reference);
            target[if side == 0 { *count } else { end - 1 - *count }] = *reference;
            *count += 1;
        };
        // 2. For each reference:
        for reference in source {
            let bounds = reference.bounds();
            if self.bins.bin_indices(bounds.max)[self.axis] < self.first_right_bin {
                // It lies entirely on the left.
                push_reference(0, reference);
            } else if self.bins.bin_indices(bounds.min)[self.axis] >= self.first_right_bin {
                // It lies entirely on the right.
                push_reference(1, reference);
            } else if let Some(side) = self.unsplit_side(&bounds, scale).filter(|_| allow_unsplitting) {
                // It costs less undivided.
                push_reference(side, reference);
            } else {
                // Clip it to both sides, and drop a part that rounding has left empty.
                let halves =
                    TriangleClipper::new(geometry, reference.primitive()).split_bounds(&bounds, self.axis, plane);
                for (side, half) in [halves.left, halves.right].into_iter().enumerate() {
                    if half.min.xyz().cmple(half.max.xyz()).all() {
                        push_reference(side, &reference.clipped_to(&half));
                    }
                }
            }
        }
        sides
    }

    /// Reference unsplitting: the side that should take the whole reference, or `None` if splitting it costs least.
    fn unsplit_side(&self, bounds: &SimdAabb, scale: f32) -> Option<usize> {
        let [left, right] = self.bounds;
        let [left_count, right_count] = self.counts.map(|count| count as f32);
        let [left_area, right_area] = self.bounds.map(|bounds| bounds.half_area(scale));
        // The cost of the node if the reference goes whole to the left, or to the right.
        let left_cost = left.union(*bounds).half_area(scale) * left_count + right_area * (right_count - 1.0);
        let right_cost = left_area * (left_count - 1.0) + right.union(*bounds).half_area(scale) * right_count;
        // Compare with the cost of splitting it.
        if left_cost.min(right_cost) >= self.cost {
            return None;
        }
        Some(usize::from(right_cost < left_cost))
    }
}
