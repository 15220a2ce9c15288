//! The top-down builder: binned SAH, parallel over subtrees and, near the root, within a node.
//!
//! At each node it takes the cheaper of the best object split and, if [`SpatialSplits`] are given, the best spatial
//! split. The result depends on the input alone, not on the number of threads: unions of boxes are exact in any order,
//! partitioning is stable, and the duplicate budget of a node is divided between its children before they are built.

use super::coincident::CoincidentTriangles;
use super::object_bins::{BinMapping, ObjectBins, ObjectSplit, PARALLEL_BINNING_THRESHOLD};
use super::partition::{partition, partition_parallel};
use super::spatial_split::{self, SpatialSplit, SpatialSplits, widen_references};
use crate::Cancel;
use crate::accel::tree::{
    BuildNode, BuildTree, MAX_SAH_DEPTH, PARALLEL_SUBTREE_THRESHOLD, PrimitiveReference, ReferenceBounds, SahParams,
    max_node_count_below, normalizing_scale,
};

/// Builds a tree over `references`, whose bounds are `extent`. O(n log n). Once cancelled, it makes leaves of what is
/// left.
pub(super) fn build(
    mut references: Vec<PrimitiveReference>,
    extent: &ReferenceBounds,
    params: &SahParams,
    splits: Option<SpatialSplits<'_>>,
    coincident: &CoincidentTriangles<'_>,
    cancel: &Cancel,
) -> BuildTree {
    let count = references.len();
    if count == 0 {
        return BuildTree::default();
    }
    // 1. Reserve room for the references that spatial splits add, and widen those that may be divided.
    let extent = &splits.map_or(*extent, |_| widen_references(&mut references));
    let capacity = count + splits.map_or(0, |splits| splits.duplicate_budget);
    references.resize(capacity, bytemuck::Zeroable::zeroed());
    // 2. Allocate node and index arrays for the worst case; pages that are never written take no memory.
    let mut nodes: Vec<BuildNode> = bytemuck::zeroed_vec(1 + max_node_count_below(capacity));
    let mut primitive_indices: Vec<u32> = bytemuck::zeroed_vec(capacity);
    let mut scratch: Vec<PrimitiveReference> = bytemuck::zeroed_vec(capacity);
    // 3. Collect the constants of the build.
    let root_scale = normalizing_scale(&extent.bounds);
    let min_overlap_area = MIN_OVERLAP * extent.bounds.half_area(root_scale);
    let context = BuildContext { params, spatial_splits: splits, min_overlap_area, root_scale, coincident, cancel };
    // 4. Build from the root.
    let root = BuildRecord {
        references: &mut references,
        scratch: &mut scratch,
        primitive_indices: &mut primitive_indices,
        count,
        extent,
        slots: SubtreeSlots { first_node: 1, first_primitive: 0, depth: 0 },
        is_merged: false,
    };
    let (root_node, below) = nodes.split_at_mut(1);
    root_node[0] = root.build_subtree(below, &mut WorkerScratch::new(&context)).0;
    BuildTree { nodes, primitive_indices, has_duplicates: splits.is_some() }
}

/// Spatial splits are tried only where the boxes of the best object split overlap by at least this fraction of the
/// root's surface area (alpha in Stich et al., section 4.1, there 1e-5: that doubles the build time without measurably
/// better hierarchies).
const MIN_OVERLAP: f32 = 1e-3;

/// Read-only state shared by all subtrees of a build.
struct BuildContext<'a> {
    params: &'a SahParams,
    spatial_splits: Option<SpatialSplits<'a>>,
    /// The overlap from which spatial splits are tried, a half area in units of `root_scale`.
    min_overlap_area: f32,
    /// The [`normalizing_scale`] of the root, in whose units `min_overlap_area` is measured.
    root_scale: f32,
    coincident: &'a CoincidentTriangles<'a>,
    cancel: &'a Cancel,
}

/// One subtree to build (Embree's `BuildRecord`).
struct BuildRecord<'a> {
    /// The first `count` are in use; the rest, and the same number of elements of `primitive_indices`, is this
    /// subtree's share of the duplicate budget.
    references: &'a mut [PrimitiveReference],
    /// Scratch space as long as `references`: partitioning writes to it, and the children swap the two.
    scratch: &'a mut [PrimitiveReference],
    primitive_indices: &'a mut [u32],
    count: usize,
    extent: &'a ReferenceBounds,
    slots: SubtreeSlots,
    /// Whether no two of its triangles coincide, since they were merged above.
    is_merged: bool,
}

/// Where the subtree's nodes and primitive indices go in the tree's arrays.
#[derive(Clone, Copy)]
struct SubtreeSlots {
    /// Index in [`BuildTree::nodes`] of the first node reserved below the subtree's root.
    first_node: usize,
    /// Index of the subtree's first element in [`BuildTree::primitive_indices`].
    first_primitive: usize,
    /// Levels above the subtree's root.
    depth: u32,
}

/// Scratch memory of one thread.
struct WorkerScratch<'a> {
    context: &'a BuildContext<'a>,
    /// Boxed (3.5 kB), because recursion is deep and the stacks of worker threads are small.
    bins: Box<ObjectBins>,
}

impl<'a> WorkerScratch<'a> {
    fn new(context: &'a BuildContext<'a>) -> Self {
        Self { context, bins: Box::new(ObjectBins::EMPTY) }
    }
}

/// The root of a built subtree, and how many of the nodes reserved below it were used, counting gaps before the last
/// one.
type BuiltSubtree = (BuildNode, usize);

impl BuildRecord<'_> {
    /// Builds the subtree; `below` are the nodes reserved below its root. Recursion is at most
    /// [`MAX_BLAS_DEPTH`](crate::accel::MAX_BLAS_DEPTH) deep.
    fn build_subtree(self, below: &mut [BuildNode], worker: &mut WorkerScratch) -> BuiltSubtree {
        let params = worker.context.params;
        // 1. Triangles that coincide are the same one. One or two references need no search.
        if self.count > 1 && self.extent.has_one_center() && !self.is_merged {
            return self.merge_coincident(worker.context).build_subtree(below, worker);
        }
        if self.count == 1 {
            return self.make_leaf();
        }
        if self.count == 2 {
            return self.build_pair(below, params);
        }
        // 2. Find the best object split, unless the build was cancelled.
        if self.count >= PARALLEL_SUBTREE_THRESHOLD && worker.context.cancel.should_stop() {
            return self.make_leaf();
        }
        let can_be_leaf = self.count <= params.max_leaf_size;
        let scale = normalizing_scale(&self.extent.bounds);
        let object_split = self.find_object_split(scale, worker);
        // 3. Take the best spatial split instead if it costs less.
        let best_object_split = object_split.as_ref().map(|(split, _)| split);
        if let Some(split) = self.find_spatial_split(best_object_split, scale, worker.context) {
            return match can_be_leaf && self.is_leaf_cheaper(split.cost, scale, params) {
                true => self.make_leaf_of_different(worker.context),
                false => self.apply_spatial_split(&split, scale, below, worker),
            };
        }
        // 4. Otherwise make a leaf where that is cheaper, apply the object split, or, without one, make a leaf or split
        // at the median.
        match object_split {
            Some((split, _)) if can_be_leaf && self.is_leaf_cheaper(split.cost, scale, params) => {
                self.make_leaf_of_different(worker.context)
            }
            Some((split, chunks)) => self.apply_object_split(&split, &chunks, below, worker),
            None if can_be_leaf => self.make_leaf_of_different(worker.context),
            None => self.split_at_median(below, worker),
        }
    }

    fn active_references(&self) -> &[PrimitiveReference] {
        &self.references[..self.count]
    }

    /// Two references: one leaf or two, without binning. This is the most frequent node size.
    fn build_pair(self, below: &mut [BuildNode], params: &SahParams) -> BuiltSubtree {
        let scale = normalizing_scale(&self.extent.bounds);
        let boxes = [0, 1].map(|i| self.references[i].bounds());
        let split_cost = boxes[0].half_area(scale) + boxes[1].half_area(scale);
        if params.max_leaf_size >= 2 && self.is_leaf_cheaper(split_cost, scale, params) {
            return self.make_leaf();
        }
        for (i, bounds) in boxes.iter().enumerate() {
            below[i] = BuildNode::leaf(bounds, self.slots.first_primitive + i, 1);
            self.primitive_indices[i] = self.references[i].primitive();
        }
        (BuildNode::inner(&self.extent.bounds, self.slots.first_node), 2)
    }

    /// The best object split, with the bins of each chunk for a node that is partitioned in parallel. `None` if all
    /// centres coincide, no area is finite, or the node is at the depth limit of the heuristic.
    fn find_object_split(&self, scale: f32, worker: &mut WorkerScratch) -> Option<(ObjectSplit, Vec<ObjectBins>)> {
        // 1. Below the depth limit only median splits remain.
        if self.slots.depth >= MAX_SAH_DEPTH {
            return None;
        }
        // 2. Bin the references by their centres, in parallel for a large node.
        let binning = BinMapping::new(self.extent, self.count)?;
        let chunks = if self.count < PARALLEL_BINNING_THRESHOLD {
            worker.bins.fill(self.active_references(), &binning);
            Vec::new()
        } else {
            worker.bins.fill_parallel(self.active_references(), &binning)
        };
        // 3. Evaluate the SAH at every boundary between bins.
        Some((worker.bins.best_split(&binning, scale)?, chunks))
    }

    /// The best spatial split, if its cost is below that of the best object split and the duplicate budget allows it.
    fn find_spatial_split(
        &self,
        object_split: Option<&ObjectSplit>,
        scale: f32,
        context: &BuildContext,
    ) -> Option<SpatialSplit> {
        // 1. No budget is left, or the node is at the depth limit.
        let splits = context.spatial_splits?;
        if self.references.len() == self.count || self.slots.depth >= MAX_SAH_DEPTH {
            return None;
        }
        // 2. The children of the object split hardly overlap, so that clipping would gain nothing.
        let overlaps = |split: &ObjectSplit| {
            split.left_bounds.intersection(split.right_bounds).half_area(context.root_scale) > context.min_overlap_area
        };
        if !splits.spatial_only && object_split.is_some_and(|split| !overlaps(split)) {
            return None;
        }
        // 3. Search, and accept only what costs less than the object split; anything for a kd-tree.
        let max_cost = object_split.map_or(f32::INFINITY, |split| split.cost);
        let capacity = self.references.len();
        let split = spatial_split::find_spatial_split(
            splits.geometry,
            self.active_references(),
            &self.extent.bounds,
            capacity,
            scale,
        )?;
        (splits.spatial_only || split.cost < max_cost).then_some(split)
    }

    /// Whether a leaf costs no more than an inner node whose split has this cost (reference count times scaled half
    /// area, summed over both sides). An inner node is charged two node fetches, since a ray that meets it fetches both
    /// children, also those that it then misses.
    fn is_leaf_cheaper(&self, split_cost: f32, scale: f32, params: &SahParams) -> bool {
        let inner_cost = 2.0 + params.primitive_cost * split_cost / self.extent.bounds.half_area(scale);
        params.primitive_cost * self.count as f32 <= inner_cost
    }

    fn apply_object_split(
        self,
        split: &ObjectSplit,
        chunks: &[ObjectBins],
        below: &mut [BuildNode],
        worker: &mut WorkerScratch,
    ) -> BuiltSubtree {
        // 1. Partition into the scratch space.
        let source = &self.references[..self.count];
        let [left_centers, right_centers] = if chunks.is_empty() {
            partition(source, self.scratch, split)
        } else {
            partition_parallel(source, self.scratch, split, chunks)
        };
        // 2. Describe both children.
        let left = (ReferenceBounds { bounds: split.left_bounds, centers: left_centers }, split.left_count);
        let right =
            (ReferenceBounds { bounds: split.right_bounds, centers: right_centers }, self.count - split.left_count);
        // 3. Swap the buffers and build the children.
        let partitioned = Self { references: self.scratch, scratch: self.references, ..self };
        partitioned.build_children(&[left, right], split.left_count, below, worker)
    }

    fn apply_spatial_split(
        self,
        split: &SpatialSplit,
        scale: f32,
        below: &mut [BuildNode],
        worker: &mut WorkerScratch,
    ) -> BuiltSubtree {
        let Some(splits) = worker.context.spatial_splits else { return self.split_at_median(below, worker) };
        // 1. Clip and partition into the scratch space.
        let source = &self.references[..self.count];
        let allow_unsplitting = !splits.spatial_only;
        let sides = split.partition(splits.geometry, source, self.scratch, scale, allow_unsplitting);
        let [(_, left_count), (_, right_count)] = sides;
        // 2. If rounding or unsplitting has left a side empty, fall back on the median.
        if left_count == 0 || right_count == 0 {
            return self.split_at_median(below, worker);
        }
        // 3. Swap the buffers and build the children.
        let right_start = self.scratch.len() - right_count;
        let partitioned = Self { references: self.scratch, scratch: self.references, ..self };
        partitioned.build_children(&sides, right_start, below, worker)
    }

    /// Object median split: two halves of equal count along the axis of largest centre extent.
    fn split_at_median(self, below: &mut [BuildNode], worker: &mut WorkerScratch) -> BuiltSubtree {
        // Coincident triangles must not be separated.
        if !self.is_merged {
            return self.merge_coincident(worker.context).build_subtree(below, worker);
        }
        // 1. Choose the axis of largest centre extent.
        let width = self.extent.centers.max - self.extent.centers.min;
        let axis = if width.x >= width.y && width.x >= width.z { 0 } else { 1 + usize::from(width.z > width.y) };
        // 2. Select the median, ties by primitive index, so that the result is deterministic. Where all centres
        // coincide, any two halves will do, as long as they are always the same.
        let (references, middle) = (&mut self.references[..self.count], self.count / 2);
        if width[axis] != 0.0 {
            references.select_nth_unstable_by(middle, |a, b| {
                let key = |r: &PrimitiveReference| r.doubled_center()[axis];
                key(a).total_cmp(&key(b)).then(a.primitive().cmp(&b.primitive()))
            });
        }
        // 3. Bound both sides, and build the children.
        let (left, right) = references.split_at(middle);
        let sides = [left, right].map(|side| (ReferenceBounds::from_references(side), side.len()));
        self.build_children(&sides, middle, below, worker)
    }

    /// Builds both children from their bounds and counts. The left child's references are at the front, the right
    /// child's from `right_start` on.
    fn build_children(
        self,
        sides: &[(ReferenceBounds, usize); 2],
        right_start: usize,
        below: &mut [BuildNode],
        worker: &mut WorkerScratch,
    ) -> BuiltSubtree {
        let [(left_extent, left_count), (right_extent, right_count)] = sides;
        let count = left_count + right_count;
        // 1. Make the inner node.
        let node = BuildNode::inner(&self.extent.bounds, self.slots.first_node);
        // 2. Divide the remaining duplicate budget in proportion to the counts, and close the gap between the two
        // sides.
        let budget = (self.references.len() - count) as u64;
        let left_capacity = left_count + (budget * *left_count as u64 / count as u64) as usize;
        self.references.copy_within(right_start..right_start + right_count, left_capacity);
        let is_small = self.references.len() < PARALLEL_SUBTREE_THRESHOLD;
        // 3. Split all arrays between the children.
        let (left_indices, right_indices) = self.primitive_indices.split_at_mut(left_capacity);
        let (left_references, right_references) = self.references.split_at_mut(left_capacity);
        let (left_scratch, right_scratch) = self.scratch.split_at_mut(left_capacity);
        let slots = SubtreeSlots { first_node: self.slots.first_node + 2, depth: self.slots.depth + 1, ..self.slots };
        let left = BuildRecord {
            references: left_references,
            scratch: left_scratch,
            primitive_indices: left_indices,
            count: *left_count,
            extent: left_extent,
            slots,
            is_merged: self.is_merged,
        };
        let mut right = BuildRecord {
            references: right_references,
            scratch: right_scratch,
            primitive_indices: right_indices,
            count: *right_count,
            extent: right_extent,
            slots: SubtreeSlots { first_primitive: slots.first_primitive + left_capacity, ..slots },
            is_merged: self.is_merged,
        };
        // 4. Build the children: a small subtree on this thread and without gaps, a large one in parallel in reserved
        // ranges.
        let (children, below) = below.split_at_mut(2);
        let mut used = below.len();
        if is_small {
            let (left_used, right_used);
            (children[0], left_used) = left.build_subtree(below, worker);
            right.slots.first_node += left_used;
            (children[1], right_used) = right.build_subtree(&mut below[left_used..], worker);
            used = left_used + right_used;
        } else {
            let (left_below, right_below) = below.split_at_mut(max_node_count_below(left_capacity));
            right.slots.first_node += left_below.len();
            let context = worker.context;
            (children[0], children[1]) = rayon::join(
                || left.build_subtree(left_below, worker).0,
                || right.build_subtree(right_below, &mut WorkerScratch::new(context)).0,
            );
        }
        (node, 2 + used)
    }

    /// Merges the triangles that coincide. All boxes stay, since those of coincident triangles are equal.
    fn merge_coincident(self, context: &BuildContext) -> Self {
        let count = context.coincident.merge(&mut self.references[..self.count]);
        Self { count, is_merged: true, ..self }
    }

    /// A leaf of a few references, in which triangles with equal centres may coincide.
    fn make_leaf_of_different(self, context: &BuildContext) -> BuiltSubtree {
        let centers = || self.active_references().iter().map(|reference| reference.doubled_center().truncate());
        let may_coincide = || centers().enumerate().any(|(i, center)| centers().take(i).any(|other| other == center));
        if !self.is_merged && may_coincide() { self.merge_coincident(context).make_leaf() } else { self.make_leaf() }
    }

    fn make_leaf(self) -> BuiltSubtree {
        for (index, reference) in self.primitive_indices.iter_mut().zip(self.references[..self.count].iter()) {
            *index = reference.primitive();
        }
        (BuildNode::leaf(&self.extent.bounds, self.slots.first_primitive, self.count), 0)
    }
}
