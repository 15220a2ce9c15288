//! Where to cut space: a plane through primitives, of which each side gets a part (M. Stich, H. Friedrich, A. Dietrich, *Spatial
//! Splits in Bounding Volume Hierarchies*, 2009).

use glam::{Vec4, Vec4Swizzles};
use rayon::prelude::*;

use super::object_bins::{CHUNK_SIZE, PARALLEL_BINNING_THRESHOLD};
use super::triangle_clip::{ClippedBounds, TriangleClipper, can_clip};
use crate::accel::tree::{PrimitiveReference, ReferenceBounds, SimdAabb};
use crate::device::layout::PrimitiveRange;
use crate::graph::Geometry;

/// Whether and how the top-down builder takes spatial splits.
#[derive(Clone, Copy)]
pub(super) struct SpatialSplits<'a> {
    /// The geometry whose triangles the references are.
    pub(super) geometry: &'a Geometry,
    /// How many references spatial splits may add in all: a triangle on both sides of a plane gets one more.
    pub(super) duplicate_budget: usize,
    /// Whether a node is divided by primitives only where it cannot be split in space: the tree is then a kd-tree.
    pub(super) spatial_only: bool,
}

impl<'a> SpatialSplits<'a> {
    /// A budget of `share` for each of `count` references, for trees that also divide by primitives. `None` where the rounding
    /// of clipped boxes cannot be bounded: near the limits of f32.
    pub(super) fn new(geometry: &'a Geometry, extent: &ReferenceBounds, count: usize, share: f32) -> Option<Self> {
        let most = PrimitiveRange::MAX_FIRST as usize - count;
        let duplicate_budget = ((count as f32 * share) as usize).min(most);
        can_clip(&extent.aabb()).then_some(Self { geometry, duplicate_budget, spatial_only: false })
    }
}

/// The most slices along an axis.
const MAX_SPATIAL_BINS: usize = 32;

/// Equal slices of a node's box, along each axis.
#[derive(Clone, Copy)]
struct SpatialBins {
    origin: Vec4,
    width: Vec4,
    /// 1 over `width`; 0 on an axis along which the box cannot be cut.
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

    /// The slices of a point, along each axis.
    #[inline]
    fn of(&self, point: Vec4) -> [usize; 3] {
        let [x, y, z, _] = ((point - self.origin) * self.scale).to_array();
        [x, y, z].map(|place| (place as usize).min(self.count - 1))
    }

    /// The plane before a slice.
    fn plane(&self, axis: usize, slice: usize) -> f32 {
        self.width[axis].mul_add(slice as f32, self.origin[axis])
    }
}

/// The plane of least cost that leaves some primitives on either side, where both sides together have no more than `capacity`.
/// `scale` makes the node about one unit long.
pub(super) fn find_spatial_split(
    geometry: &Geometry,
    references: &[PrimitiveReference],
    bounds: &SimdAabb,
    capacity: usize,
    scale: f32,
) -> Option<SpatialSplit> {
    // 1. How many there are on either side of each plane: cheap, and often there is no plane to go on with.
    let slices = SpatialBins::new(bounds, references.len());
    let counts = reduce_references(references, |chunk| EntryExitCounts::of(chunk, &slices), EntryExitCounts::add);
    let fits = |[left, right]: [usize; 2]| {
        left.min(right) > 0 && left.max(right) < references.len() && left + right <= capacity
    };
    let axes =
        [0, 1, 2].map(|axis| slices.scale[axis] > 0.0 && counts.side_counts(axis, slices.count).any(|(_, n)| fits(n)));
    if axes == [false; 3] {
        return None;
    }
    // 2. Their boxes.
    let boxes = reduce_references(
        references,
        |chunk| SpatialBinBounds::of(geometry, chunk, &slices, axes),
        SpatialBinBounds::union,
    );
    // 3. The best plane.
    let mut best: Option<SpatialSplit> = None;
    for axis in (0..3).filter(|&axis| axes[axis]) {
        let rights = boxes.right_bounds(axis, slices.count);
        let mut left = SimdAabb::EMPTY;
        for (slice, counts) in counts.side_counts(axis, slices.count) {
            left = left.union(boxes.0[axis][slice - 1]);
            let bounds = [left, rights[slice]];
            let cost = (0..2).map(|side| bounds[side].half_area(scale) * counts[side] as f32).sum();
            if fits(counts) && best.as_ref().is_none_or(|best| cost < best.cost) {
                best = Some(SpatialSplit { axis, first_right_bin: slice, slices, cost, counts, bounds });
            }
        }
    }
    best
}

/// Of all references, by several threads where they are many.
fn reduce_references<T: Send>(
    references: &[PrimitiveReference],
    of: impl Fn(&[PrimitiveReference]) -> T + Sync,
    add: impl Fn(T, T) -> T + Sync,
) -> T {
    if references.len() < PARALLEL_BINNING_THRESHOLD {
        return of(references);
    }
    references.par_chunks(CHUNK_SIZE).map(&of).reduce(|| of(&[]), &add)
}

/// How many primitives begin and end in each slice, along each axis.
struct EntryExitCounts {
    entries: [[u32; MAX_SPATIAL_BINS]; 3],
    exits: [[u32; MAX_SPATIAL_BINS]; 3],
}

impl EntryExitCounts {
    fn of(references: &[PrimitiveReference], slices: &SpatialBins) -> Self {
        let mut counts = Self { entries: [[0; MAX_SPATIAL_BINS]; 3], exits: [[0; MAX_SPATIAL_BINS]; 3] };
        for reference in references {
            let bounds = reference.bounds();
            let (first, last) = (slices.of(bounds.min), slices.of(bounds.max));
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

    /// For the plane before each slice but the first: the slice, and how many primitives there are left and right of the plane.
    fn side_counts(&self, axis: usize, slice_count: usize) -> impl Iterator<Item = (usize, [usize; 2])> {
        let mut right: usize = self.exits[axis].iter().map(|&count| count as usize).sum();
        let mut left = 0;
        (1..slice_count).map(move |slice| {
            left += self.entries[axis][slice - 1] as usize;
            right -= self.exits[axis][slice - 1] as usize;
            (slice, [left, right])
        })
    }
}

/// Around what is in each slice, along each axis.
struct SpatialBinBounds([[SimdAabb; MAX_SPATIAL_BINS]; 3]);

impl SpatialBinBounds {
    /// Along these `axes` only.
    fn of(geometry: &Geometry, references: &[PrimitiveReference], slices: &SpatialBins, axes: [bool; 3]) -> Self {
        let mut boxes = Self([[SimdAabb::EMPTY; MAX_SPATIAL_BINS]; 3]);
        for reference in references {
            let mut corners = None;
            let bounds = reference.bounds();
            let (first, last) = (slices.of(bounds.min), slices.of(bounds.max));
            for axis in (0..3).filter(|&axis| axes[axis]) {
                let boxes = &mut boxes.0[axis];
                let mut rest = bounds;
                #[expect(clippy::needless_range_loop, reason = "the slice's number is a place, too")]
                for slice in first[axis]..last[axis] {
                    let corners = corners.get_or_insert_with(|| TriangleClipper::new(geometry, reference.primitive()));
                    let ClippedBounds { left, right } =
                        corners.split_bounds(&rest, axis, slices.plane(axis, slice + 1));
                    boxes[slice] = boxes[slice].union(left);
                    rest = right;
                }
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

    /// Around each slice and all that are right of it.
    fn right_bounds(&self, axis: usize, slice_count: usize) -> [SimdAabb; MAX_SPATIAL_BINS] {
        let mut rights = self.0[axis];
        for slice in (1..slice_count - 1).rev() {
            rights[slice] = rights[slice].union(rights[slice + 1]);
        }
        rights
    }
}

/// A plane, and what lies on its sides.
pub(super) struct SpatialSplit {
    axis: usize,
    /// The first slice to the right.
    first_right_bin: usize,
    slices: SpatialBins,
    /// Primitive count times scaled half area, summed over both sides.
    pub(super) cost: f32,
    /// Left and right of the plane, what is on both sides counted twice.
    counts: [usize; 2],
    bounds: [SimdAabb; 2],
}

impl SpatialSplit {
    /// Moves the references to `target`: those on the left to its beginning, those on the right to its end. Both get their part of
    /// what the plane goes through, unless `keeps_whole`, and it is better to enlarge one side than to have the primitive
    /// twice. Returns both sides' extents and counts.
    pub(super) fn partition(
        &self,
        geometry: &Geometry,
        source: &[PrimitiveReference],
        target: &mut [PrimitiveReference],
        scale: f32,
        keeps_whole: bool,
    ) -> [(ReferenceBounds, usize); 2] {
        let plane = self.slices.plane(self.axis, self.first_right_bin);
        let mut sides = [(ReferenceBounds::EMPTY, 0); 2];
        let end = target.len();
        let mut put = |side: usize, reference: &PrimitiveReference| {
            let (extent, count) = &mut sides[side];
            *extent = extent.extended_by(reference);
            target[if side == 0 { *count } else { end - 1 - *count }] = *reference;
            *count += 1;
        };
        for reference in source {
            let bounds = reference.bounds();
            if self.slices.of(bounds.max)[self.axis] < self.first_right_bin {
                put(0, reference);
            } else if self.slices.of(bounds.min)[self.axis] >= self.first_right_bin {
                put(1, reference);
            } else if let Some(side) = self.unsplit_side(&bounds, scale).filter(|_| keeps_whole) {
                put(side, reference);
            } else {
                let halves =
                    TriangleClipper::new(geometry, reference.primitive()).split_bounds(&bounds, self.axis, plane);
                for (side, half) in [halves.left, halves.right].into_iter().enumerate() {
                    if half.min.xyz().cmple(half.max.xyz()).all() {
                        put(side, &reference.clipped_to(&half));
                    }
                }
            }
        }
        sides
    }

    /// The side that had better have all of a primitive, if it is not both.
    fn unsplit_side(&self, bounds: &SimdAabb, scale: f32) -> Option<usize> {
        let [left, right] = self.bounds;
        let [left_count, right_count] = self.counts.map(|count| count as f32);
        let [left_area, right_area] = self.bounds.map(|bounds| bounds.half_area(scale));
        let left_cost = left.union(*bounds).half_area(scale) * left_count + right_area * (right_count - 1.0);
        let right_cost = left_area * (left_count - 1.0) + right.union(*bounds).half_area(scale) * right_count;
        if left_cost.min(right_cost) >= self.cost {
            return None;
        }
        Some(usize::from(right_cost < left_cost))
    }
}
