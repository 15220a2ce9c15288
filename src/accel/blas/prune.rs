//! Pruning: which nodes of a build tree are kept as device nodes.
//!
//! An inner node n with k children below a node a is left out, so that its children become a's, where that makes fewer fetches.
//! With it, n is fetched as often as a's box is met, and its children as often as n's own box is; without it they are fetched as
//! often as a's box is met. A box is met in proportion to its surface A, so the condition is k A(a) < A(a) + k A(n). It is decided
//! from the leaves up, with a the node directly above. In the same way a subtree becomes a leaf where that is cheaper.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering::Relaxed};

use glam::Vec3;

use super::collapse::MAX_WIDE_LEAF_SIZE;
use crate::accel::MAX_BLAS_DEPTH;
use crate::accel::build::SahParams;
use crate::accel::padding::pad_corners;
use crate::accel::tree::{BuildNode, BuildNodeContent, BuildTree};
use crate::device::layout::PrimitiveRange;

/// No inner node of a [`Blas`](super::Blas) has more children.
pub const MAX_CHILDREN: usize = 8;

/// Trees of fewer nodes are pruned and flattened by one thread, others side by side down to [`PARALLEL_DEPTH`].
const PARALLEL_MINIMUM: usize = 1 << 12;
/// See [`PARALLEL_MINIMUM`].
const PARALLEL_DEPTH: u32 = 12;

/// A build tree that is not empty, with the decision for each of its nodes whether it is kept.
pub(super) struct PrunedTree<'a> {
    tree: &'a BuildTree,
    params: &'a SahParams,
    /// The size of each node's subtree after pruning, packed. Atomic for the threads that prune: each knows which subtree is its own.
    sizes: Vec<AtomicU64>,
    /// See [`height`](Self::wide_leaf_height).
    heights: Vec<AtomicU8>,
    task_depth: u32,
}

/// A node of the build tree and where its primitives begin.
#[derive(Clone, Copy)]
pub(super) struct SubtreeRoot {
    /// Index into the build tree's nodes.
    pub(super) node: usize,
    /// The first of its primitives in the order of leaves.
    pub(super) first_primitive: u32,
}

/// The size of a subtree after pruning.
#[derive(Clone, Copy)]
pub(super) struct SubtreeSize {
    /// Nodes that are kept.
    pub(super) nodes: u32,
    pub(super) primitives: u32,
    /// How many of the kept nodes have no other kept node of the subtree above them: 1 where the root is kept, else as many as the
    /// children that it gives to the node above.
    pub(super) top_node_count: u32,
}

impl SubtreeSize {
    fn pack(self) -> u64 {
        u64::from(self.nodes) << 34 | u64::from(self.primitives) << 4 | u64::from(self.top_node_count)
    }

    fn unpack(packed: u64) -> Self {
        let [nodes, primitives, roots] = [packed >> 34, packed >> 4, packed].map(|bits| bits as u32);
        Self { nodes, primitives: primitives & ((1 << 30) - 1), top_node_count: roots & 15 }
    }
}

/// What a subtree costs with its root kept; its size counts the root's children as `top_node_count`.
#[derive(Clone, Copy)]
struct SubtreePlan {
    size: SubtreeSize,
    /// Half the surface of the root's box.
    area: f64,
    /// Cost of all that is below the root, in fetches times area.
    cost: f64,
    /// See [`PrunedTree::wide_leaf_height`].
    height: u8,
}

impl SubtreePlan {
    /// Adds one of two children, and decides whether it is left out. Returns its size.
    fn add(&mut self, child: SubtreePlan) -> SubtreeSize {
        let children = f64::from(child.size.top_node_count);
        let saved = children * child.area + self.area - children * self.area;
        let left_out = child.size.top_node_count > 0
            && saved > 0.0
            && self.size.top_node_count + child.size.top_node_count <= MAX_CHILDREN as u32 + 1;
        let size = if left_out {
            SubtreeSize { nodes: child.size.nodes - 1, ..child.size }
        } else {
            SubtreeSize { top_node_count: 1, ..child.size }
        };
        self.size.nodes += size.nodes;
        self.size.primitives += size.primitives;
        self.size.top_node_count += size.top_node_count - 1;
        self.cost += child.cost + self.area;
        if left_out {
            self.cost -= saved;
        }
        size
    }
}

impl<'a> PrunedTree<'a> {
    /// Prunes a tree. `None` if the tree has no node, or more than [`MAX_BLAS_DEPTH`] levels. O(n).
    pub(super) fn new(tree: &'a BuildTree, params: &'a SahParams) -> Option<Self> {
        if tree.nodes.is_empty() {
            return None;
        }
        let task_depth = if tree.nodes.len() < PARALLEL_MINIMUM { 0 } else { PARALLEL_DEPTH };
        let (sizes, heights) = (bytemuck::zeroed_vec(tree.nodes.len()), bytemuck::zeroed_vec(tree.nodes.len()));
        let pruned = Self { tree, params, sizes, heights, task_depth };
        // The root is always kept.
        let plan = pruned.prune(0, 0)?;
        pruned.set_size_and_height(0, SubtreeSize { top_node_count: 1, ..plan.size }, plan.height);
        Some(pruned)
    }

    /// Decides for all nodes below one whether they are kept. `None` if the tree is too deep; recursion never is.
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
        // 1. The children's subtrees.
        let plan = |child| self.prune(child, depth + 1);
        let plans = self.join_near_root(depth, || plan(child), || plan(child + 1));
        // 2. Whether each child is kept.
        let mut whole = SubtreePlan {
            size: SubtreeSize { nodes: 1, primitives: 0, top_node_count: 2 },
            area,
            cost: 0.0,
            height: 0,
        };
        for (child, plan) in [child, child + 1].into_iter().zip([plans.0?, plans.1?]) {
            let size = whole.add(plan);
            self.set_size_and_height(child, size, plan.height);
            whole.height = whole.height.max(plan.height + 1);
        }
        if whole.size.primitives <= MAX_WIDE_LEAF_SIZE {
            whole.height = 0;
        }
        // 3. Whether all of it had better be a leaf.
        let leaf = self.leaf_primitive_count(index, &whole).map(leaf);
        leaf.filter(|leaf| leaf.cost <= whole.cost).or(Some(whole))
    }

    /// How many primitives there would be in a leaf instead of a subtree, if they are not too many.
    fn leaf_primitive_count(&self, index: usize, whole: &SubtreePlan) -> Option<u32> {
        let (primitives, most) = (whole.size.primitives as usize, self.params.max_leaf_size);
        if !self.tree.has_duplicates {
            return (primitives <= most).then_some(primitives as u32);
        }
        // Where primitives repeat, a leaf holds each once: it may have fewer than the subtree.
        let mut gathered = [0; PrimitiveRange::MAX_COUNT as usize];
        let is_worth_a_look = primitives <= 2 * most;
        is_worth_a_look.then(|| self.gather(index, &mut gathered[..most])).flatten().map(|count| count as u32)
    }

    /// Writes the primitives below a node to the beginning of `target`, each once. Returns how many there are, or `None` if they
    /// do not fit.
    pub(super) fn gather(&self, node: usize, target: &mut [u32]) -> Option<usize> {
        self.tree.collect_primitives(node, target, 0)
    }

    /// All of the tree.
    pub(super) fn root(&self) -> SubtreeRoot {
        SubtreeRoot { node: 0, first_primitive: 0 }
    }

    /// The size of a node's subtree.
    pub(super) fn size(&self, node: usize) -> SubtreeSize {
        SubtreeSize::unpack(self.sizes[node].load(Relaxed))
    }

    /// The two children of an inner node of the build tree, the one with the larger surface first: it is hit more often, and what
    /// it hides need not be visited. `None` for a leaf.
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
        pad_corners(min, max).into()
    }

    /// Half the surface of a node's box.
    pub(super) fn half_area(&self, node: usize) -> f64 {
        half_area(&self.tree.nodes[node])
    }

    /// Levels of inner nodes below a node, itself included, where a subtree of at most [`MAX_WIDE_LEAF_SIZE`] primitives is a leaf: what
    /// `collapse` has to put into wide nodes.
    pub(super) fn wide_leaf_height(&self, node: usize) -> u8 {
        self.heights[node].load(Relaxed)
    }

    /// Does both, side by side near the root.
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

/// Half the surface of a node's box, in f64, where no box of finite floats has an infinite area.
fn half_area(node: &BuildNode) -> f64 {
    let d = node.max.as_dvec3() - node.min.as_dvec3();
    d.x * d.y + d.y * d.z + d.z * d.x
}
