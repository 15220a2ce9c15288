//! Pruning: which nodes of a build tree are kept as device nodes.
//!
//! An inner node n with k children and parent a is removed, so that its children become a's, if that lowers the
//! expected number of fetches. With n, n is fetched whenever a's box is met, and its children whenever n's is; without
//! it, the children are fetched whenever a's box is met. Boxes are met in proportion to their surface areas A, so n is
//! removed if k A(a) < A(a) + k A(n). This is decided bottom up, where a is the direct parent. In the same way a
//! subtree becomes one leaf if that costs less.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering::Relaxed};

use glam::Vec3;

use crate::accel::padding::pad_corners;
use crate::accel::tree::{BuildNode, BuildNodeContent, BuildTree, MAX_BLAS_DEPTH, SahParams};
use crate::device::layout::PrimitiveRange;

/// The most children of an inner node of a [`Blas`](super::Blas). Pruning removes inner nodes, so a node may have more
/// than two.
pub const MAX_CHILDREN: usize = 8;

/// A subtree of at most this many triangles is one leaf of a wide node: the CPU tests four triangles against a ray at
/// once.
pub(super) const MAX_WIDE_LEAF_SIZE: u32 = 4;

/// Trees of fewer nodes are pruned and flattened by one thread, others in parallel down to [`PARALLEL_DEPTH`].
const PARALLEL_MINIMUM: usize = 1 << 12;
/// Above this level of a large tree, the two children of a node are processed in parallel.
const PARALLEL_DEPTH: u32 = 12;

/// A build tree that is not empty, with the pruning decision for each of its nodes.
pub(super) struct PrunedTree<'a> {
    tree: &'a BuildTree,
    params: &'a SahParams,
    /// The share of its longest side by which a box is padded.
    box_margin: f32,
    /// The [`SubtreeSize`] of each node's subtree after pruning, packed. Atomic only because threads write disjoint
    /// subtrees through a shared reference.
    sizes: Vec<AtomicU64>,
    /// See [`wide_leaf_height`](Self::wide_leaf_height).
    heights: Vec<AtomicU8>,
    task_depth: u32,
}

/// A subtree of the build tree, with the position of its first primitive in leaf order.
#[derive(Clone, Copy)]
pub(super) struct SubtreeRoot {
    /// Index of the subtree's root in the build tree's nodes.
    pub(super) node: usize,
    /// Position of its first primitive in leaf order.
    pub(super) first_primitive: u32,
}

/// How many nodes and primitives a subtree has after pruning.
#[derive(Clone, Copy)]
pub(super) struct SubtreeSize {
    /// Nodes that are kept.
    pub(super) nodes: u32,
    /// Primitive references in its leaves.
    pub(super) primitives: u32,
    /// How many of the kept nodes have no other kept node of the subtree above them: 1 if the subtree's root is kept,
    /// the number of its children if it is removed.
    pub(super) top_node_count: u32,
}

impl SubtreeSize {
    fn pack(self) -> u64 {
        u64::from(self.nodes) << 34 | u64::from(self.primitives) << 4 | u64::from(self.top_node_count)
    }

    fn unpack(packed: u64) -> Self {
        let [nodes, primitives, tops] = [packed >> 34, packed >> 4, packed].map(|bits| bits as u32);
        Self { nodes, primitives: primitives & ((1 << 30) - 1), top_node_count: tops & 15 }
    }
}

/// A subtree with its root kept: its size, area and cost. Here `top_node_count` is the number of the root's children; 0
/// marks a leaf.
#[derive(Clone, Copy)]
struct SubtreePlan {
    size: SubtreeSize,
    /// Half the surface area of the root's box.
    area: f64,
    /// Expected cost of everything below the root: node fetches times half area.
    cost: f64,
    /// See [`PrunedTree::wide_leaf_height`].
    height: u8,
}

impl SubtreePlan {
    /// Adds one of the two children to its parent's plan, and decides whether the child node is removed. Returns the
    /// child's size after that decision.
    fn add(&mut self, child: SubtreePlan) -> SubtreeSize {
        // 1. The expected fetches that removing the child saves.
        let children = f64::from(child.size.top_node_count);
        let cost_saved = children * child.area + self.area - children * self.area;
        // 2. Remove an inner child if that saves any and the parent keeps at most eight children. The parent counts two
        // children from the start, so that this one is counted once too often.
        let is_removed = child.size.top_node_count > 0
            && cost_saved > 0.0
            && self.size.top_node_count + child.size.top_node_count <= MAX_CHILDREN as u32 + 1;
        let size = if is_removed {
            SubtreeSize { nodes: child.size.nodes - 1, ..child.size }
        } else {
            SubtreeSize { top_node_count: 1, ..child.size }
        };
        // 3. Add sizes and cost.
        self.size.nodes += size.nodes;
        self.size.primitives += size.primitives;
        self.size.top_node_count += size.top_node_count - 1;
        self.cost += child.cost + self.area;
        if is_removed {
            self.cost -= cost_saved;
        }
        size
    }
}

impl<'a> PrunedTree<'a> {
    /// Prunes a tree. `None` if the tree has no node, or more than [`MAX_BLAS_DEPTH`] levels. O(n).
    pub(super) fn new(tree: &'a BuildTree, params: &'a SahParams, box_margin: f32) -> Option<Self> {
        if tree.nodes.is_empty() {
            return None;
        }
        let task_depth = if tree.nodes.len() < PARALLEL_MINIMUM { 0 } else { PARALLEL_DEPTH };
        let (sizes, heights) = (bytemuck::zeroed_vec(tree.nodes.len()), bytemuck::zeroed_vec(tree.nodes.len()));
        let pruned = Self { tree, params, box_margin, sizes, heights, task_depth };
        // The root is always kept.
        let plan = pruned.prune(0, 0)?;
        pruned.set_size_and_height(0, SubtreeSize { top_node_count: 1, ..plan.size }, plan.height);
        Some(pruned)
    }

    /// Decides, bottom up, which nodes of a subtree are kept, removed or turned into leaves. `None` if the tree is
    /// deeper than [`MAX_BLAS_DEPTH`], at which recursion stops.
    fn prune(&self, index: usize, depth: u32) -> Option<SubtreePlan> {
        let node = &self.tree.nodes[index];
        let area = half_area(node);
        let leaf = |primitives: u32| SubtreePlan {
            size: SubtreeSize { nodes: 1, primitives, top_node_count: 0 },
            area,
            cost: area * f64::from(primitives) * f64::from(self.params.primitive_cost),
            height: 0,
        };
        let child = match node.contents() {
            BuildNodeContent::Primitives(range) => return Some(leaf(range.len() as u32)),
            BuildNodeContent::Children(child) => child,
        };
        if depth + 1 == MAX_BLAS_DEPTH as u32 {
            return None;
        }
        // 1. Plan both children.
        let plan = |child| self.prune(child, depth + 1);
        let plans = self.join_near_root(depth, || plan(child), || plan(child + 1));
        // 2. Combine them, deciding for each whether it is removed.
        let mut subtree = SubtreePlan {
            size: SubtreeSize { nodes: 1, primitives: 0, top_node_count: 2 },
            area,
            cost: 0.0,
            height: 0,
        };
        for (child, plan) in [child, child + 1].into_iter().zip([plans.0?, plans.1?]) {
            let size = subtree.add(plan);
            self.set_size_and_height(child, size, plan.height);
            subtree.height = subtree.height.max(plan.height + 1);
        }
        if subtree.size.primitives <= MAX_WIDE_LEAF_SIZE {
            subtree.height = 0;
        }
        // 3. Make one leaf of the subtree if that costs no more.
        let leaf = self.leaf_primitive_count(index, &subtree).map(leaf);
        leaf.filter(|leaf| leaf.cost <= subtree.cost).or(Some(subtree))
    }

    /// How many primitives the subtree would have as one leaf, duplicates removed; `None` if more than a leaf may hold.
    fn leaf_primitive_count(&self, index: usize, subtree: &SubtreePlan) -> Option<u32> {
        let (primitives, max_count) = (subtree.size.primitives as usize, self.params.max_leaf_size);
        if !self.tree.has_duplicates {
            return (primitives <= max_count).then_some(primitives as u32);
        }
        // Duplicates of one primitive in the subtree count once in a leaf.
        let mut gathered = [0; PrimitiveRange::MAX_COUNT as usize];
        let may_fit = primitives <= 2 * max_count;
        may_fit.then(|| self.gather(index, &mut gathered[..max_count])).flatten().map(|count| count as u32)
    }

    /// Writes the primitives below a node to the beginning of `target`, without duplicates. Returns how many there are,
    /// or `None` if they do not fit.
    pub(super) fn gather(&self, node: usize, target: &mut [u32]) -> Option<usize> {
        self.tree.collect_primitives(node, target, 0)
    }

    /// The whole tree.
    pub(super) fn root(&self) -> SubtreeRoot {
        SubtreeRoot { node: 0, first_primitive: 0 }
    }

    /// The size of a node's subtree after pruning.
    pub(super) fn size(&self, node: usize) -> SubtreeSize {
        SubtreeSize::unpack(self.sizes[node].load(Relaxed))
    }

    /// The two children of an inner node of the build tree, in the order in which they are written: the one with the
    /// larger surface area first, which is hit more often and may hide the other. `None` for a leaf.
    pub(super) fn children(&self, subtree: SubtreeRoot) -> Option<[SubtreeRoot; 2]> {
        let BuildNodeContent::Children(child) = self.tree.nodes[subtree.node].contents() else { return None };
        let [left, right] = [child, child + 1].map(|index| half_area(&self.tree.nodes[index]));
        let [first, second] = if right > left { [child + 1, child] } else { [child, child + 1] };
        let before_second = subtree.first_primitive + self.size(first).primitives;
        Some([SubtreeRoot { node: first, ..subtree }, SubtreeRoot { node: second, first_primitive: before_second }])
    }

    /// The least and greatest corner of a node's box, padded.
    pub(super) fn padded_corners(&self, node: usize) -> [Vec3; 2] {
        let BuildNode { min, max, .. } = self.tree.nodes[node];
        pad_corners(min, max, self.box_margin).into()
    }

    /// Half the surface area of a node's box.
    pub(super) fn half_area(&self, node: usize) -> f64 {
        half_area(&self.tree.nodes[node])
    }

    /// The height of a subtree in levels of binary inner nodes, where a subtree of at most [`MAX_WIDE_LEAF_SIZE`]
    /// primitives has height 0: what `collapse` has to fit into wide nodes.
    pub(super) fn wide_leaf_height(&self, node: usize) -> u8 {
        self.heights[node].load(Relaxed)
    }

    /// Runs both, in parallel near the root.
    pub(super) fn join_near_root<A: Send, B: Send>(
        &self,
        depth: u32,
        a: impl FnOnce() -> A + Send,
        b: impl FnOnce() -> B + Send,
    ) -> (A, B) {
        if depth < self.task_depth { rayon::join(a, b) } else { (a(), b()) }
    }

    fn set_size_and_height(&self, node: usize, size: SubtreeSize, height: u8) {
        self.sizes[node].store(size.pack(), Relaxed);
        self.heights[node].store(height, Relaxed);
    }
}

/// Half the surface area of a node's box, in f64, so that the area of a finite f32 box is finite.
fn half_area(node: &BuildNode) -> f64 {
    let d = node.max.as_dvec3() - node.min.as_dvec3();
    d.x * d.y + d.y * d.z + d.z * d.x
}
