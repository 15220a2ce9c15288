//! The builder from the top down: binned SAH, in parallel over subtrees and, near the root, within a node.
//!
//! It divides primitives, or cuts space, or does what of both is better, see [`SpatialSplits`]. The result depends on the input alone, not
//! on the number of threads: boxes are unions (exact in any order), partitioning is stable, and each subtree has its own share of
//! the room for primitives that are cut.

use super::SahParams;
use super::object_bins::{BinMapping, ObjectBins, ObjectSplit, PARALLEL_BINNING_THRESHOLD};
use super::partition::{partition, partition_parallel};
use super::spatial_split::{self, SpatialSplit, SpatialSplits};
use crate::accel::tree::{
    BuildNode, BuildTree, PARALLEL_SUBTREE_THRESHOLD, PrimitiveReference, ReferenceBounds, max_node_count_below,
    normalizing_scale,
};

/// No hierarchy has more levels than this: nodes below level 64 are halved by count, and 2^28 primitives can be halved 28 times.
pub const MAX_BLAS_DEPTH: usize = (MAX_SAH_DEPTH + 29) as usize;

const MAX_SAH_DEPTH: u32 = 64;

/// Builds a tree over references, `extent` being theirs. O(n log n).
pub(super) fn build(
    mut references: Vec<PrimitiveReference>,
    extent: &ReferenceBounds,
    params: &SahParams,
    splits: Option<SpatialSplits<'_>>,
) -> BuildTree {
    let count = references.len();
    if count == 0 {
        return BuildTree::default();
    }
    let capacity = count + splits.map_or(0, |splits| splits.duplicate_budget);
    references.resize(capacity, bytemuck::Zeroable::zeroed());
    let mut nodes: Vec<BuildNode> = bytemuck::zeroed_vec(1 + max_node_count_below(capacity));
    let mut order: Vec<u32> = bytemuck::zeroed_vec(capacity);
    let mut spare: Vec<PrimitiveReference> = bytemuck::zeroed_vec(capacity);
    let root_scale = normalizing_scale(&extent.bounds);
    let least_overlap = MIN_OVERLAP * extent.bounds.half_area(root_scale);
    let job = BuildContext { params, spatial_splits: splits, min_overlap_area: least_overlap, root_scale };
    let place = SubtreeSlots { slot: 1, primitive: 0, depth: 0 };
    let root =
        BuildRecord { references: &mut references, scratch: &mut spare, order: &mut order, count, extent, place };
    let (root_slot, slots) = nodes.split_at_mut(1);
    root_slot[0] = root.build_subtree(slots, &mut WorkerScratch::new(&job)).0;
    BuildTree { nodes, primitive_indices: order, has_duplicates: splits.is_some() }
}

/// Space is not cut where the boxes of the best division share less than this of the root's surface (Stich et al., section 4.1,
/// have 1e-5: that takes twice as long, and the hierarchies measured are not better).
const MIN_OVERLAP: f32 = 1e-3;

/// What is the same for all tasks.
struct BuildContext<'a> {
    params: &'a SahParams,
    spatial_splits: Option<SpatialSplits<'a>>,
    min_overlap_area: f32,
    /// In which `least_overlap` is measured.
    root_scale: f32,
}

/// A subtree to build.
struct BuildRecord<'a> {
    /// The first `count` are in use. The others, and as many elements of `order`, are room for those that cuts add.
    references: &'a mut [PrimitiveReference],
    /// As long as `references`: they are partitioned into it, and the two change places for the children.
    scratch: &'a mut [PrimitiveReference],
    order: &'a mut [u32],
    count: usize,
    extent: &'a ReferenceBounds,
    place: SubtreeSlots,
}

/// Where a subtree is to go.
#[derive(Clone, Copy)]
struct SubtreeSlots {
    /// Where its slots begin in the tree's nodes.
    slot: usize,
    /// Where its primitives begin in the tree's order.
    primitive: usize,
    depth: u32,
}

/// What a thread has at hand.
struct WorkerScratch<'a> {
    job: &'a BuildContext<'a>,
    /// On the heap: recursion is deep and stacks are small.
    bins: Box<ObjectBins>,
}

impl<'a> WorkerScratch<'a> {
    fn new(job: &'a BuildContext<'a>) -> Self {
        Self { job, bins: Box::new(ObjectBins::EMPTY) }
    }
}

/// The root of a subtree, and how many of the slots below it are in use or before one that is.
type BuiltSubtree = (BuildNode, usize);

impl BuildRecord<'_> {
    /// Builds the subtree with `slots` for what is below its root. Recursion is at most [`MAX_BLAS_DEPTH`] deep.
    fn build_subtree(self, slots: &mut [BuildNode], worker: &mut WorkerScratch) -> BuiltSubtree {
        let params = worker.job.params;
        if self.count == 1 {
            return self.make_leaf();
        }
        if self.count == 2 {
            return self.build_pair(slots, params);
        }
        let can_be_leaf = self.count <= params.max_leaf_size;
        let scale = normalizing_scale(&self.extent.bounds);
        let division = self.find_object_split(scale, worker);
        if let Some(cut) = self.find_spatial_split(division.as_ref().map(|(split, _)| split), scale, worker.job) {
            return match can_be_leaf && self.is_leaf_cheaper(cut.cost, scale, params) {
                true => self.make_leaf(),
                false => self.apply_spatial_split(&cut, scale, slots, worker),
            };
        }
        match division {
            Some((split, _)) if can_be_leaf && self.is_leaf_cheaper(split.cost, scale, params) => self.make_leaf(),
            Some((split, chunks)) => self.apply_object_split(&split, &chunks, slots, worker),
            None if can_be_leaf => self.make_leaf(),
            None => self.split_at_median(slots, worker),
        }
    }

    fn active_references(&self) -> &[PrimitiveReference] {
        &self.references[..self.count]
    }

    /// One leaf or two, without binning: no other count is as common.
    fn build_pair(self, slots: &mut [BuildNode], params: &SahParams) -> BuiltSubtree {
        let scale = normalizing_scale(&self.extent.bounds);
        let boxes = [0, 1].map(|i| self.references[i].bounds());
        let split_cost = boxes[0].half_area(scale) + boxes[1].half_area(scale);
        if params.max_leaf_size >= 2 && self.is_leaf_cheaper(split_cost, scale, params) {
            return self.make_leaf();
        }
        for (i, bounds) in boxes.iter().enumerate() {
            slots[i] = BuildNode::leaf(bounds, self.place.primitive + i, 1);
            self.order[i] = self.references[i].primitive();
        }
        (BuildNode::inner(&self.extent.bounds, self.place.slot), 2)
    }

    /// The best split, and the bins of each chunk where the node is large. `None` where the heuristic has nothing to say:
    /// all centres coincide, no area is finite, or the tree is too deep.
    fn find_object_split(&self, scale: f32, worker: &mut WorkerScratch) -> Option<(ObjectSplit, Vec<ObjectBins>)> {
        if self.place.depth >= MAX_SAH_DEPTH {
            return None;
        }
        let binning = BinMapping::new(self.extent, self.count)?;
        let chunks = if self.count < PARALLEL_BINNING_THRESHOLD {
            worker.bins.fill(self.active_references(), &binning);
            Vec::new()
        } else {
            worker.bins.fill_parallel(self.active_references(), &binning)
        };
        Some((worker.bins.best_split(&binning, scale)?, chunks))
    }

    /// The best plane to cut space at, if that is better than the best division and there is room for it.
    fn find_spatial_split(
        &self,
        division: Option<&ObjectSplit>,
        scale: f32,
        job: &BuildContext,
    ) -> Option<SpatialSplit> {
        let splits = job.spatial_splits?;
        if self.references.len() == self.count || self.place.depth >= MAX_SAH_DEPTH {
            return None;
        }
        let overlaps = |split: &ObjectSplit| {
            split.left_bounds.intersection(split.right_bounds).half_area(job.root_scale) > job.min_overlap_area
        };
        if !splits.spatial_only && division.is_some_and(|split| !overlaps(split)) {
            return None;
        }
        let most = division.map_or(f32::INFINITY, |split| split.cost);
        let capacity = self.references.len();
        let cut = spatial_split::find_spatial_split(
            splits.geometry,
            self.active_references(),
            &self.extent.bounds,
            capacity,
            scale,
        )?;
        (splits.spatial_only || cut.cost < most).then_some(cut)
    }

    /// `split_cost` is the sum of primitive count times scaled half area over both children. An inner node also costs the
    /// fetch of both children, even of one that the ray then misses.
    fn is_leaf_cheaper(&self, split_cost: f32, scale: f32, params: &SahParams) -> bool {
        let inner_cost = 2.0 + params.primitive_cost * split_cost / self.extent.bounds.half_area(scale);
        params.primitive_cost * self.count as f32 <= inner_cost
    }

    fn apply_object_split(
        self,
        split: &ObjectSplit,
        chunks: &[ObjectBins],
        slots: &mut [BuildNode],
        worker: &mut WorkerScratch,
    ) -> BuiltSubtree {
        let source = &self.references[..self.count];
        let [left_centers, right_centers] = if chunks.is_empty() {
            partition(source, self.scratch, split)
        } else {
            partition_parallel(source, self.scratch, split, chunks)
        };
        let left = (ReferenceBounds { bounds: split.left_bounds, centers: left_centers }, split.left_count);
        let right =
            (ReferenceBounds { bounds: split.right_bounds, centers: right_centers }, self.count - split.left_count);
        let partitioned = Self { references: self.scratch, scratch: self.references, ..self };
        partitioned.build_children(&[left, right], split.left_count, slots, worker)
    }

    fn apply_spatial_split(
        self,
        cut: &SpatialSplit,
        scale: f32,
        slots: &mut [BuildNode],
        worker: &mut WorkerScratch,
    ) -> BuiltSubtree {
        let Some(splits) = worker.job.spatial_splits else { return self.split_at_median(slots, worker) };
        let source = &self.references[..self.count];
        let sides = cut.partition(splits.geometry, source, self.scratch, scale, !splits.spatial_only);
        let [(_, left_count), (_, right_count)] = sides;
        if left_count == 0 || right_count == 0 {
            return self.split_at_median(slots, worker);
        }
        let right_start = self.scratch.len() - right_count;
        let partitioned = Self { references: self.scratch, scratch: self.references, ..self };
        partitioned.build_children(&sides, right_start, slots, worker)
    }

    /// Splits into two halves of equal count along the longest axis.
    fn split_at_median(self, slots: &mut [BuildNode], worker: &mut WorkerScratch) -> BuiltSubtree {
        let width = self.extent.centers.max - self.extent.centers.min;
        let axis = if width.x >= width.y && width.x >= width.z { 0 } else { 1 + usize::from(width.z > width.y) };
        let (references, middle) = (&mut self.references[..self.count], self.count / 2);
        references.select_nth_unstable_by(middle, |a, b| {
            let key = |r: &PrimitiveReference| r.doubled_center()[axis];
            key(a).total_cmp(&key(b)).then(a.primitive().cmp(&b.primitive()))
        });
        let (left, right) = references.split_at(middle);
        let sides = [left, right].map(|side| (ReferenceBounds::from_references(side), side.len()));
        self.build_children(&sides, middle, slots, worker)
    }

    /// Builds both sides: extents and counts. The references of the left one stand first, those of the right one at
    /// `right_start`.
    fn build_children(
        self,
        sides: &[(ReferenceBounds, usize); 2],
        right_start: usize,
        slots: &mut [BuildNode],
        worker: &mut WorkerScratch,
    ) -> BuiltSubtree {
        let [(left_extent, left_count), (right_extent, right_count)] = sides;
        let count = left_count + right_count;
        let node = BuildNode::inner(&self.extent.bounds, self.place.slot);
        // Each side gets its part of the room that is left.
        let room = (self.references.len() - count) as u64;
        let left_capacity = left_count + (room * *left_count as u64 / count as u64) as usize;
        self.references.copy_within(right_start..right_start + right_count, left_capacity);
        let is_small = self.references.len() < PARALLEL_SUBTREE_THRESHOLD;
        let (left_order, right_order) = self.order.split_at_mut(left_capacity);
        let (left_references, right_references) = self.references.split_at_mut(left_capacity);
        let (left_spare, right_spare) = self.scratch.split_at_mut(left_capacity);
        let place = SubtreeSlots { slot: self.place.slot + 2, depth: self.place.depth + 1, ..self.place };
        let left = BuildRecord {
            references: left_references,
            scratch: left_spare,
            order: left_order,
            count: *left_count,
            extent: left_extent,
            place,
        };
        let mut right = BuildRecord {
            references: right_references,
            scratch: right_spare,
            order: right_order,
            count: *right_count,
            extent: right_extent,
            place: SubtreeSlots { primitive: place.primitive + left_capacity, ..place },
        };

        let (children, slots) = slots.split_at_mut(2);
        let mut slot_count = slots.len();
        if is_small {
            let (left_slots, right_slots);
            (children[0], left_slots) = left.build_subtree(slots, worker);
            right.place.slot += left_slots;
            (children[1], right_slots) = right.build_subtree(&mut slots[left_slots..], worker);
            slot_count = left_slots + right_slots;
        } else {
            let (left_slots, right_slots) = slots.split_at_mut(max_node_count_below(left_capacity));
            right.place.slot += left_slots.len();
            let job = worker.job;
            (children[0], children[1]) = rayon::join(
                || left.build_subtree(left_slots, worker).0,
                || right.build_subtree(right_slots, &mut WorkerScratch::new(job)).0,
            );
        }
        (node, 2 + slot_count)
    }

    fn make_leaf(self) -> BuiltSubtree {
        for (slot, reference) in self.order.iter_mut().zip(self.references[..self.count].iter()) {
            *slot = reference.primitive();
        }
        (BuildNode::leaf(&self.extent.bounds, self.place.primitive, self.count), 0)
    }
}
