//! The default builder: top-down, binned SAH, in parallel over subtrees and, near the root, within a node.
//!
//! The result depends on the input alone, not on the number of threads: boxes are unions (exact in any order), and
//! partitioning is stable.

use glam::Vec4;
use rayon::prelude::*;

use super::bins::{Binning, Bins, CHUNK, PARALLEL_MINIMUM, Split};
use super::tree::{BuildNode, BuildTree, Extent, LaneBox, Reference, TASK_MINIMUM, slots_below};

/// No hierarchy has more levels than this: nodes below level 64 are halved by count, and 2^28 primitives can be halved 28
/// times.
pub const MAX_DEPTH: usize = (MAX_SAH_DEPTH + 29) as usize;

const MAX_SAH_DEPTH: u32 = 64;

/// What the heuristic weighs.
#[derive(Clone, Copy)]
pub(super) struct SahParams {
    pub(super) max_leaf_size: usize,
    /// Cost of testing a primitive, in units of fetching a node and testing its box.
    pub(super) primitive_cost: f32,
}

/// Builds a tree over references, `extent` being theirs. O(n log n).
pub(super) fn build(mut references: Vec<Reference>, extent: &Extent, params: &SahParams) -> BuildTree {
    let count = references.len();
    if count == 0 {
        return BuildTree { nodes: Vec::new(), order: Vec::new() };
    }
    let mut nodes: Vec<BuildNode> = bytemuck::zeroed_vec(1 + slots_below(count));
    let mut order: Vec<u32> = bytemuck::zeroed_vec(count);
    let mut spare: Vec<Reference> = bytemuck::zeroed_vec(count);
    let place = Place { slot: 1, primitive: 0, depth: 0 };
    let root = Task { references: &mut references, spare: &mut spare, order: &mut order, extent, place };
    let (root_slot, slots) = nodes.split_at_mut(1);
    root_slot[0] = root.run(slots, &mut Worker::new(params)).0;
    BuildTree { nodes, order }
}

/// A subtree to build.
struct Task<'a> {
    references: &'a mut [Reference],
    /// As long as `references`: they are partitioned into it, and the two change places for the children.
    spare: &'a mut [Reference],
    order: &'a mut [u32],
    extent: &'a Extent,
    place: Place,
}

/// Where a subtree is to go.
#[derive(Clone, Copy)]
struct Place {
    /// Where its slots begin in the tree's nodes.
    slot: usize,
    /// Where its primitives begin in the tree's order.
    primitive: usize,
    depth: u32,
}

/// What a thread has at hand.
struct Worker<'a> {
    params: &'a SahParams,
    /// On the heap: recursion is deep and stacks are small.
    bins: Box<Bins>,
}

impl<'a> Worker<'a> {
    fn new(params: &'a SahParams) -> Self {
        Self { params, bins: Box::new(Bins::EMPTY) }
    }
}

/// The root of a subtree, and how many of the slots below it are in use or before one that is.
type Built = (BuildNode, usize);

impl Task<'_> {
    /// Builds the subtree with `slots` for what is below its root. Recursion is at most [`MAX_DEPTH`] deep.
    fn run(self, slots: &mut [BuildNode], worker: &mut Worker) -> Built {
        let count = self.references.len();
        if count == 1 {
            return self.make_leaf();
        }
        if count == 2 {
            return self.pair(slots, worker.params);
        }
        let can_be_leaf = count <= worker.params.max_leaf_size;
        let scale = unit_scale(&self.extent.bounds);
        let params = worker.params;
        match self.find_split(scale, worker) {
            Some((split, _)) if can_be_leaf && self.is_leaf_cheaper(split.cost, scale, params) => self.make_leaf(),
            Some((split, chunks)) => self.split(&split, &chunks, slots, worker),
            None if can_be_leaf => self.make_leaf(),
            None => self.halve(slots, worker),
        }
    }

    /// One leaf or two, without binning: no other count is as common.
    fn pair(self, slots: &mut [BuildNode], params: &SahParams) -> Built {
        let scale = unit_scale(&self.extent.bounds);
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
    fn find_split(&self, scale: f32, worker: &mut Worker) -> Option<(Split, Vec<Bins>)> {
        if self.place.depth >= MAX_SAH_DEPTH {
            return None;
        }
        let binning = Binning::new(self.extent, self.references.len())?;
        let chunks = if self.references.len() < PARALLEL_MINIMUM {
            worker.bins.fill(self.references, &binning);
            Vec::new()
        } else {
            worker.bins.fill_by_chunks(self.references, &binning)
        };
        Some((worker.bins.best_split(&binning, scale)?, chunks))
    }

    /// `split_cost` is the sum of primitive count times scaled half area over both children. An inner node also costs the
    /// fetch of both children, even of one that the ray then misses.
    fn is_leaf_cheaper(&self, split_cost: f32, scale: f32, params: &SahParams) -> bool {
        let inner_cost = 2.0 + params.primitive_cost * split_cost / self.extent.bounds.half_area(scale);
        params.primitive_cost * self.references.len() as f32 <= inner_cost
    }

    fn split(self, split: &Split, chunks: &[Bins], slots: &mut [BuildNode], worker: &mut Worker) -> Built {
        let [left_centers, right_centers] = if chunks.is_empty() {
            partition(self.references, self.spare, split)
        } else {
            partition_chunks(self.references, self.spare, split, chunks)
        };
        let left = Extent { bounds: split.left, centers: left_centers };
        let right = Extent { bounds: split.right, centers: right_centers };
        let partitioned = Self { references: self.spare, spare: self.references, ..self };
        partitioned.recurse(split.left_count, &left, &right, slots, worker)
    }

    /// Splits into two halves of equal count along the longest axis.
    fn halve(self, slots: &mut [BuildNode], worker: &mut Worker) -> Built {
        let width = self.extent.centers.max - self.extent.centers.min;
        let axis = if width.x >= width.y && width.x >= width.z { 0 } else { 1 + usize::from(width.z > width.y) };
        let middle = self.references.len() / 2;
        self.references.select_nth_unstable_by(middle, |a, b| {
            let key = |r: &Reference| r.doubled_center()[axis];
            key(a).total_cmp(&key(b)).then(a.primitive().cmp(&b.primitive()))
        });
        let (left, right) = self.references.split_at(middle);
        let (left, right) = (Extent::of(left), Extent::of(right));
        self.recurse(middle, &left, &right, slots, worker)
    }

    fn recurse(
        self,
        left_count: usize,
        left: &Extent,
        right: &Extent,
        slots: &mut [BuildNode],
        worker: &mut Worker,
    ) -> Built {
        let count = self.references.len();
        let node = BuildNode::inner(&self.extent.bounds, self.place.slot);
        let (left_order, right_order) = self.order.split_at_mut(left_count);
        let (left_references, right_references) = self.references.split_at_mut(left_count);
        let (left_spare, right_spare) = self.spare.split_at_mut(left_count);
        let place = Place { slot: self.place.slot + 2, depth: self.place.depth + 1, ..self.place };
        let left = Task { references: left_references, spare: left_spare, order: left_order, extent: left, place };
        let right_place = Place { primitive: place.primitive + left_count, ..place };
        let mut right = Task {
            references: right_references,
            spare: right_spare,
            order: right_order,
            extent: right,
            place: right_place,
        };

        let (children, slots) = slots.split_at_mut(2);
        let mut slot_count = slots.len();
        if count < TASK_MINIMUM {
            let (left_slots, right_slots);
            (children[0], left_slots) = left.run(slots, worker);
            right.place.slot += left_slots;
            (children[1], right_slots) = right.run(&mut slots[left_slots..], worker);
            slot_count = left_slots + right_slots;
        } else {
            let (left_slots, right_slots) = slots.split_at_mut(slots_below(left_count));
            right.place.slot += left_slots.len();
            let params = worker.params;
            (children[0], children[1]) =
                rayon::join(|| left.run(left_slots, worker).0, || right.run(right_slots, &mut Worker::new(params)).0);
        }
        (node, 2 + slot_count)
    }

    fn make_leaf(self) -> Built {
        for (slot, reference) in self.order.iter_mut().zip(self.references.iter()) {
            *slot = reference.primitive();
        }
        (BuildNode::leaf(&self.extent.bounds, self.place.primitive, self.references.len()), 0)
    }
}

/// The power of two that brings the longest side of a box to between 1 and 2, so that areas neither overflow nor vanish;
/// infinite or zero for a box without a side of normal length.
fn unit_scale(bounds: &LaneBox) -> f32 {
    let side = bounds.max - bounds.min;
    let longest = side.x.max(side.y).max(side.z);
    1.0 / f32::from_bits(longest.to_bits() & f32::INFINITY.to_bits())
}

/// Moves the references to `target`, those left of the split first, both sides in their old order. Returns the boxes of
/// both sides' centres.
fn partition(source: &[Reference], target: &mut [Reference], split: &Split) -> [LaneBox; 2] {
    let (left, right) = target.split_at_mut(split.left_count);
    scatter(source, left, right, split)
}

/// The same by several threads: the bins of each chunk say how many references it sends to either side.
fn partition_chunks(source: &[Reference], target: &mut [Reference], split: &Split, chunks: &[Bins]) -> [LaneBox; 2] {
    let (mut left, mut right) = target.split_at_mut(split.left_count);
    let mut pieces = Vec::with_capacity(chunks.len());
    for (source, bins) in source.chunks(CHUNK).zip(chunks) {
        let left_count = bins.left_count(split);
        let left_piece = left.split_off_mut(..left_count).unwrap_or_default();
        let right_piece = right.split_off_mut(..source.len() - left_count).unwrap_or_default();
        pieces.push((source, left_piece, right_piece));
    }
    pieces
        .into_par_iter()
        .map(|(source, left, right)| scatter(source, left, right, split))
        .reduce(|| [LaneBox::EMPTY; 2], |a, b| [a[0].union(b[0]), a[1].union(b[1])])
}

/// Without a branch: which side a reference goes to is a coin toss that no processor predicts.
fn scatter(source: &[Reference], left: &mut [Reference], right: &mut [Reference], split: &Split) -> [LaneBox; 2] {
    let [mut left_centers, mut right_centers] = [LaneBox::EMPTY; 2];
    let mut next = [0; 2];
    let targets = [left, right];
    for reference in source {
        let center = reference.doubled_center();
        let side = usize::from(split.is_right(center));
        // Clamped to infinity for the side that the reference does not go to, so that it leaves those bounds as they are.
        let away = Vec4::splat([f32::NEG_INFINITY, f32::INFINITY][side]);
        left_centers.min = left_centers.min.min(center.max(away));
        left_centers.max = left_centers.max.max(center.min(-away));
        right_centers.min = right_centers.min.min(center.max(-away));
        right_centers.max = right_centers.max.max(center.min(away));
        targets[side][next[side]] = *reference;
        next[side] += 1;
    }
    [left_centers, right_centers]
}
