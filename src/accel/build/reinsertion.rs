//! Lowers a tree's SAH cost by reinsertion: subtrees are removed and inserted where they enlarge the boxes of their new
//! ancestors least (D. Meister, J. Bittner, *Parallel Reinsertion for Bounding Volume Hierarchy Optimization*, 2018).
//!
//! In each iteration the best positions are searched in parallel on an unchanged tree; the moves are then applied one
//! by one in order of area saved, skipping those that touch a node changed by an earlier one. The result does not
//! depend on the number of threads.

use rayon::prelude::*;

use crate::Cancel;
use crate::accel::tree::{BuildNode, BuildNodeContent, BuildTree, MAX_BLAS_DEPTH, SimdAabb, normalizing_scale};

/// How much work reinsertion does.
#[derive(Clone, Copy)]
pub(super) struct ReinsertionParams {
    /// Number of iterations.
    pub(super) iterations: u32,
    /// Fraction of the nodes, those with the largest surface area, that are candidates in each iteration: 0 to 1.
    pub(super) candidate_fraction: f32,
}

/// Optimises the tree in place, until it is cancelled. Leaves keep their primitives; only the position of subtrees
/// changes.
pub(super) fn reinsert(tree: &mut BuildTree, params: ReinsertionParams, cancel: &Cancel) {
    let Some(root) = tree.nodes.first().filter(|_| !cancel.should_stop()) else { return };
    let scale = normalizing_scale(&root.bounds());
    // 1. Find the parents and heights of all nodes.
    let (parents, heights) = parents_and_heights(&tree.nodes);
    let mut inserter = Reinserter { nodes: &mut tree.nodes, parents, heights, scale };
    for _ in 0..params.iterations {
        // 2. Choose the largest nodes.
        let candidates = inserter.candidates(params.candidate_fraction);
        // 3. Search their best positions in parallel.
        let find_best_position = |node| if cancel.should_stop() { None } else { inserter.find_best_position(node) };
        let mut moves: Vec<Reinsertion> = candidates.into_par_iter().filter_map(find_best_position).collect();
        // 4. Sort by area saved, ties by node index.
        moves.par_sort_unstable_by(|a, b| b.area_saved.total_cmp(&a.area_saved).then(a.node.cmp(&b.node)));
        // 5. Apply the moves that do not conflict.
        inserter.apply(&moves);
    }
}

/// The parent of each sibling pair (see [`pair_index`]) and the height of each node. Builders store children after
/// their parent.
fn parents_and_heights(nodes: &[BuildNode]) -> (Vec<u32>, Vec<u8>) {
    let (mut parents, mut heights) = (vec![0; nodes.len() / 2], vec![0; nodes.len()]);
    // Children before parents, so that the heights of children are known.
    for (index, node) in nodes.iter().enumerate().rev() {
        if let BuildNodeContent::Children(child) = node.contents()
            && child > index
        {
            parents[pair_index(child)] = index as u32;
            heights[index] = 1 + heights[child].max(heights[child + 1]);
        }
    }
    (parents, heights)
}

/// The index of the sibling pair that a node belongs to: siblings are at indices 2 k + 1 and 2 k + 2.
fn pair_index(index: usize) -> usize {
    (index - 1) / 2
}

/// The index of a node's sibling.
fn sibling(index: usize) -> usize {
    ((index - 1) ^ 1) + 1
}

/// A move: a subtree, and the node that becomes its new sibling.
struct Reinsertion {
    node: usize,
    target: usize,
    /// By how much the summed half area of all inner nodes decreases, in units of the tree's scale.
    area_saved: f32,
}

struct Reinserter<'a> {
    nodes: &'a mut [BuildNode],
    parents: Vec<u32>,
    heights: Vec<u8>,
    scale: f32,
}

impl Reinserter<'_> {
    fn parent(&self, index: usize) -> usize {
        self.parents[pair_index(index)] as usize
    }

    fn area(&self, bounds: SimdAabb) -> f32 {
        bounds.half_area(self.scale)
    }

    /// The `fraction` of the nodes with the largest surface area, except the root and its children.
    fn candidates(&self, fraction: f32) -> Vec<usize> {
        // The key of a node: its area in the upper bits and its index in the lower ones, for a deterministic order.
        let key = |(index, node): (usize, &BuildNode)| {
            let area = self.area(node.bounds());
            let can_move = index > 2 && area > 0.0 && self.parent(index) > 0;
            can_move.then(|| u64::from(area.to_bits()) << 32 | index as u64)
        };
        let mut keys: Vec<u64> = self.nodes.par_iter().enumerate().with_min_len(1 << 12).filter_map(key).collect();
        // Keep those of the largest keys.
        let count = (keys.len() as f32 * fraction) as usize;
        keys.par_sort_unstable_by(|a, b| b.cmp(a));
        keys.truncate(count);
        keys.into_iter().map(|key| key as u32 as usize).collect()
    }

    /// Finds the best position for a subtree by branch and bound: first below its sibling, then below the siblings of
    /// its ancestors, towards the root. `None` if the current position is the best.
    fn find_best_position(&self, node: usize) -> Option<Reinsertion> {
        let bounds = self.nodes[node].bounds();
        let area = self.area(bounds);
        let parent = self.parent(node);
        let (mut best, mut target) = (0.0, 0);
        // The area saved so far by removing the subtree, and the box of `pivot` without it.
        let mut gain = self.area(self.nodes[parent].bounds());
        let mut bounds_without_subtree = self.nodes[sibling(node)].bounds();
        let (mut pivot, mut other) = (parent, sibling(node));
        let mut stack = Vec::with_capacity(64);
        // For each ancestor (pivot), upward:
        loop {
            // 1. Search the subtree of its other child, and prune where no larger saving is possible.
            stack.push((gain, other));
            while let Some((gain, index)) = stack.pop() {
                if gain - area <= best {
                    continue;
                }
                let sibling_candidate = &self.nodes[index];
                let gain_here = gain - self.area(sibling_candidate.bounds().union(bounds));
                if gain_here > best {
                    (best, target) = (gain_here, index);
                }
                if let BuildNodeContent::Children(child) = sibling_candidate.contents() {
                    let gain_below = gain_here + self.area(sibling_candidate.bounds());
                    if gain_below - area > best {
                        stack.extend([(gain_below, child), (gain_below, child + 1)]);
                    }
                }
            }
            // 2. Take the subtree out of the pivot's box.
            if pivot != parent {
                bounds_without_subtree = bounds_without_subtree.union(self.nodes[other].bounds());
                gain += self.area(self.nodes[pivot].bounds()) - self.area(bounds_without_subtree);
            }
            // 3. Go up to the next ancestor.
            if pivot == 0 {
                break;
            }
            (other, pivot) = (sibling(pivot), self.parent(pivot));
        }
        let moves = target != 0 && target != sibling(node) && target != parent;
        moves.then_some(Reinsertion { node, target, area_saved: best })
    }

    /// Applies the moves in order, skipping those that touch a node changed before.
    fn apply(&mut self, moves: &[Reinsertion]) {
        let mut locked = vec![false; self.nodes.len()];
        for &Reinsertion { node, target, .. } in moves {
            let parent = self.parent(node);
            let involved = [node, sibling(node), parent, self.parent(parent.max(1)), target, self.parent(target)];
            if involved.iter().any(|&index| locked[index]) || !self.is_valid(node, target) {
                continue;
            }
            involved.iter().for_each(|&index| locked[index] = true);
            self.reinsert_subtree(node, target);
        }
    }

    /// Whether the move is still valid: the target is not below the subtree by now, and the depth limit holds.
    fn is_valid(&self, node: usize, target: usize) -> bool {
        let (mut above, mut depth) = (target, 0);
        while above != 0 {
            if above == node {
                return false;
            }
            above = self.parent(above);
            depth += 1;
        }
        depth + 2 + usize::from(self.heights[node].max(self.heights[target])) <= MAX_BLAS_DEPTH
    }

    /// Moves three nodes: the sibling replaces the parent, the target takes the sibling's old place so that subtree and
    /// target are a pair again, and a new inner node above that pair takes the target's old place.
    fn reinsert_subtree(&mut self, node: usize, target: usize) {
        let (parent, sibling) = (self.parent(node), sibling(node));
        // 1. The sibling replaces the parent.
        self.move_subtree(parent, sibling);
        // 2. The target becomes the subtree's sibling.
        self.move_subtree(sibling, target);
        self.parents[pair_index(node)] = target as u32;
        // 3. Refit both paths to the root.
        self.refit_ancestors(node);
        self.refit_ancestors(parent);
    }

    /// Copies a node, and so the subtree below it, from index `from` to index `to`.
    fn move_subtree(&mut self, to: usize, from: usize) {
        self.nodes[to] = self.nodes[from];
        self.heights[to] = self.heights[from];
        if let BuildNodeContent::Children(child) = self.nodes[to].contents() {
            self.parents[pair_index(child)] = to as u32;
        }
    }

    /// Recomputes the boxes and heights of all ancestors of a node.
    fn refit_ancestors(&mut self, mut index: usize) {
        while index != 0 {
            let child = index - (index - 1) % 2;
            index = self.parent(index);
            let bounds = self.nodes[child].bounds().union(self.nodes[child + 1].bounds());
            self.nodes[index] = BuildNode::inner(&bounds, child);
            self.heights[index] = 1 + self.heights[child].max(self.heights[child + 1]);
        }
    }
}
