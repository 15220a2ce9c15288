//! The default builder: top-down, binned SAH, in parallel over subtrees and, near the root, within a node.
//!
//! The result depends on the input alone, not on the number of threads: boxes are unions (exact in any order), and
//! partitioning is stable.

use glam::Vec4;
use rayon::prelude::*;

use super::bins::{Binning, Bins, CHUNK, PARALLEL_MINIMUM, Split};
use super::tree::{BuildNode, BuildTree, Extent, LaneBox, Reference, slot_count};

/// What the heuristic weighs.
#[derive(Clone, Copy)]
pub(super) struct SahParams {
    pub(super) max_leaf_size: usize,
    /// Cost of testing a primitive, in units of fetching a node and testing its box.
    pub(super) primitive_cost: f32,
}

/// Depth from which on nodes are halved by count, whatever the SAH says: with at most 2^28 primitives no tree is deeper
/// than this plus 28, and recursion over it is safe.
const MAX_SAH_DEPTH: u32 = 64;

/// Subtrees of fewer primitives are built by one thread.
const TASK_MINIMUM: usize = 1 << 10;

/// O(n log n) time, 100 bytes a primitive of temporary memory.
pub(super) fn build(mut references: Vec<Reference>, extent: &Extent, params: SahParams) -> BuildTree {
    let mut nodes = bytemuck::zeroed_vec(slot_count(references.len()));
    let mut order = bytemuck::zeroed_vec(references.len());
    if !references.is_empty() {
        let mut spare = bytemuck::zeroed_vec(references.len());
        let root = Task {
            references: &mut references,
            spare: &mut spare,
            nodes: &mut nodes,
            order: &mut order,
            extent,
            depth: 0,
        };
        root.run(&params, &mut Bins::EMPTY);
    }
    BuildTree { nodes, order }
}

/// A subtree to build.
struct Task<'a> {
    references: &'a mut [Reference],
    /// As long as `references`; they are moved here, partitioned, for the children.
    spare: &'a mut [Reference],
    /// The subtree's slots.
    nodes: &'a mut [BuildNode],
    order: &'a mut [u32],
    extent: &'a Extent,
    depth: u32,
}

/// What a parent needs of a finished subtree.
struct Built {
    node_count: u32,
    /// Expected cost of a ray that hits the subtree's box, in node visits.
    cost: f32,
}

impl Task<'_> {
    fn run(self, params: &SahParams, bins: &mut Bins) -> Built {
        let count = self.references.len();
        if count == 1 {
            return self.make_leaf(params);
        }
        let scale = unit_scale(&self.extent.bounds);
        let area = self.extent.bounds.half_area(scale);
        let leaf_cost = params.primitive_cost * count as f32;
        match self.find_split(scale, bins) {
            Some((split, chunks)) => {
                let split_cost = 2.0 + params.primitive_cost * split.cost / area;
                if count <= params.max_leaf_size && leaf_cost <= split_cost {
                    return self.make_leaf(params);
                }
                self.split(&split, &chunks, params, bins)
            }
            None if count <= params.max_leaf_size => self.make_leaf(params),
            None => self.halve(params, bins),
        }
    }

    /// The best split, and the bins of each chunk where the node is large. `None` where the SAH has nothing to say: all
    /// centres coincide, the box has no area, or the tree is too deep.
    fn find_split(&self, scale: f32, bins: &mut Bins) -> Option<(Split, Vec<Bins>)> {
        if self.depth >= MAX_SAH_DEPTH {
            return None;
        }
        let binning = Binning::new(self.extent, self.references.len())?;
        if self.references.len() < PARALLEL_MINIMUM {
            bins.fill(self.references, &binning);
            Some((bins.best_split(&binning, scale)?, Vec::new()))
        } else {
            let chunks = bins.fill_by_chunks(self.references, &binning);
            Some((bins.best_split(&binning, scale)?, chunks))
        }
    }

    fn split(self, split: &Split, chunks: &[Bins], params: &SahParams, bins: &mut Bins) -> Built {
        let [left, right] = if chunks.is_empty() {
            partition(self.references, self.spare, split)
        } else {
            partition_chunks(self.references, self.spare, split, chunks)
        };
        let left = Extent { bounds: split.left, centers: left };
        let right = Extent { bounds: split.right, centers: right };
        Task { references: self.spare, spare: self.references, ..self }.recurse(
            split.left_count,
            &left,
            &right,
            params,
            bins,
        )
    }

    /// Two halves of equal count along the longest axis.
    fn halve(self, params: &SahParams, bins: &mut Bins) -> Built {
        let width = self.extent.centers.max - self.extent.centers.min;
        let axis = if width.x >= width.y && width.x >= width.z {
            0
        } else if width.y >= width.z {
            1
        } else {
            2
        };
        let middle = self.references.len() / 2;
        self.references.select_nth_unstable_by(middle, |a, b| {
            let key = |r: &Reference| r.doubled_center()[axis];
            key(a).total_cmp(&key(b)).then(a.primitive().cmp(&b.primitive()))
        });
        let (left, right) = self.references.split_at(middle);
        let (left, right) = (Extent::of(left), Extent::of(right));
        self.recurse(middle, &left, &right, params, bins)
    }

    fn recurse(self, left_count: usize, left: &Extent, right: &Extent, params: &SahParams, bins: &mut Bins) -> Built {
        let count = self.references.len();
        let (root, slots) = self.nodes.split_at_mut(1);
        let (left_nodes, right_nodes) = slots.split_at_mut(slot_count(left_count));
        let (left_order, right_order) = self.order.split_at_mut(left_count);
        let (left_references, right_references) = self.references.split_at_mut(left_count);
        let (left_spare, right_spare) = self.spare.split_at_mut(left_count);
        let depth = self.depth + 1;
        let left_task = Task {
            references: left_references,
            spare: left_spare,
            nodes: left_nodes,
            order: left_order,
            extent: left,
            depth,
        };
        let right_task = Task {
            references: right_references,
            spare: right_spare,
            nodes: right_nodes,
            order: right_order,
            extent: right,
            depth,
        };
        let (left_built, right_built) = if count >= TASK_MINIMUM {
            rayon::join(|| left_task.run(params, bins), || right_task.run(params, &mut Bins::EMPTY))
        } else {
            (left_task.run(params, bins), right_task.run(params, bins))
        };
        let node_count = 1 + left_built.node_count + right_built.node_count;
        root[0] = BuildNode::new(&self.extent.bounds, node_count, left_count as u32);
        Built { node_count, cost: 0.0 }
    }

    fn make_leaf(self, params: &SahParams) -> Built {
        self.nodes[0] = BuildNode::new(&self.extent.bounds, 1, 0);
        for (slot, reference) in self.order.iter_mut().zip(self.references.iter()) {
            *slot = reference.primitive();
        }
        Built { node_count: 1, cost: params.primitive_cost * self.order.len() as f32 }
    }
}

/// The power of two that brings the longest side of a box to between 1 and 2, or something useless for a box without a
/// side of normal length.
fn unit_scale(bounds: &LaneBox) -> f32 {
    let side = bounds.max - bounds.min;
    let longest = side.x.max(side.y).max(side.z);
    1.0 / f32::from_bits(longest.to_bits() & 0x7f80_0000)
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
        // Infinitely far out on the side that the reference does not go to, so that it leaves those bounds as they are.
        let out = Vec4::splat([f32::NEG_INFINITY, f32::INFINITY][side]);
        left_centers.min = left_centers.min.min(center.max(out));
        left_centers.max = left_centers.max.max(center.min(-out));
        right_centers.min = right_centers.min.min(center.max(-out));
        right_centers.max = right_centers.max.max(center.min(out));
        targets[side][next[side]] = *reference;
        next[side] += 1;
    }
    [left_centers, right_centers]
}
