//! Makes a tree better: takes subtrees out and puts them where they enlarge the boxes above least.
//!
//! D. Meister, J. Bittner, *Parallel Reinsertion for Bounding Volume Hierarchy Optimization* (2018). All the places are searched
//! for in parallel, in a tree that stays as it is; then the moves are made one by one, those that gain most first, but not
//! those that touch what another has changed. So the result does not depend on the number of threads.

use rayon::prelude::*;

use super::MAX_BLAS_DEPTH;
use crate::accel::tree::{BuildNode, BuildNodeContent, BuildTree, SimdAabb, normalizing_scale};

/// How much is done.
#[derive(Clone, Copy)]
pub(super) struct ReinsertionParams {
    /// How often all of it is done.
    pub(super) rounds: u32,
    /// Which part of the nodes is tried in each round, those with the largest surfaces: 0 to 1.
    pub(super) share: f32,
}

/// Moves subtrees. Leaves stay as they are, but for where they hang.
pub(super) fn reinsert(tree: &mut BuildTree, effort: ReinsertionParams) {
    let Some(root) = tree.nodes.first() else { return };
    let scale = normalizing_scale(&root.bounds());
    let (parents, heights) = parents_and_heights(&tree.nodes);
    let mut inserter = Reinserter { nodes: &mut tree.nodes, parents, heights, scale };
    for _ in 0..effort.rounds {
        let candidates = inserter.candidates(effort.share);
        let mut moves: Vec<Reinsertion> =
            candidates.into_par_iter().filter_map(|node| inserter.find_best_position(node)).collect();
        moves.par_sort_unstable_by(|a, b| b.area_saved.total_cmp(&a.area_saved).then(a.node.cmp(&b.node)));
        inserter.apply(&moves);
    }
}

/// The parent of each pair of siblings, see [`pair_index`], and the levels below each node. Builders put children after their parent.
fn parents_and_heights(nodes: &[BuildNode]) -> (Vec<u32>, Vec<u8>) {
    let (mut parents, mut heights) = (vec![0; nodes.len() / 2], vec![0; nodes.len()]);
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

/// Siblings stand at odd indices and those after them.
fn pair_index(index: usize) -> usize {
    (index - 1) / 2
}

fn sibling(index: usize) -> usize {
    ((index - 1) ^ 1) + 1
}

/// A subtree, and the node that it is to become the sibling of.
struct Reinsertion {
    node: usize,
    target: usize,
    /// By how much the inner nodes' surfaces shrink.
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

    /// The nodes with the largest surfaces, but for the root and its children.
    fn candidates(&self, share: f32) -> Vec<usize> {
        let key = |(index, node): (usize, &BuildNode)| {
            let area = self.area(node.bounds());
            let can_move = index > 2 && area > 0.0 && self.parent(index) > 0;
            can_move.then(|| u64::from(area.to_bits()) << 32 | index as u64)
        };
        let mut keys: Vec<u64> = self.nodes.par_iter().enumerate().with_min_len(1 << 12).filter_map(key).collect();
        let count = (keys.len() as f32 * share) as usize;
        keys.par_sort_unstable_by(|a, b| b.cmp(a));
        keys.truncate(count);
        keys.into_iter().map(|key| key as u32 as usize).collect()
    }

    /// The best place for a subtree: branch and bound, first below its sibling, then further and further up. `None` if it is
    /// where it is.
    fn find_best_position(&self, node: usize) -> Option<Reinsertion> {
        let bounds = self.nodes[node].bounds();
        let area = self.area(bounds);
        let parent = self.parent(node);
        let (mut best, mut target) = (0.0, 0);
        // What is gained without the subtree, up to here; and the box that is left of `pivot` then.
        let mut gain = self.area(self.nodes[parent].bounds());
        let mut rest = self.nodes[sibling(node)].bounds();
        let (mut pivot, mut other) = (parent, sibling(node));
        let mut stack = Vec::with_capacity(64);
        loop {
            stack.push((gain, other));
            while let Some((gain, index)) = stack.pop() {
                if gain - area <= best {
                    continue;
                }
                let there = &self.nodes[index];
                let gain_here = gain - self.area(there.bounds().union(bounds));
                if gain_here > best {
                    (best, target) = (gain_here, index);
                }
                if let BuildNodeContent::Children(child) = there.contents() {
                    let gain_below = gain_here + self.area(there.bounds());
                    if gain_below - area > best {
                        stack.extend([(gain_below, child), (gain_below, child + 1)]);
                    }
                }
            }
            if pivot != parent {
                rest = rest.union(self.nodes[other].bounds());
                gain += self.area(self.nodes[pivot].bounds()) - self.area(rest);
            }
            if pivot == 0 {
                break;
            }
            (other, pivot) = (sibling(pivot), self.parent(pivot));
        }
        let moves = target != 0 && target != sibling(node) && target != parent;
        moves.then_some(Reinsertion { node, target, area_saved: best })
    }

    /// Makes all moves that do not get in the way of one made before.
    fn apply(&mut self, moves: &[Reinsertion]) {
        let mut touched = vec![false; self.nodes.len()];
        for &Reinsertion { node, target, .. } in moves {
            let parent = self.parent(node);
            let involved = [node, sibling(node), parent, self.parent(parent.max(1)), target, self.parent(target)];
            if involved.iter().any(|&index| touched[index]) || !self.is_valid(node, target) {
                continue;
            }
            involved.iter().for_each(|&index| touched[index] = true);
            self.reinsert_subtree(node, target);
        }
    }

    /// Whether the target has not come to lie below the subtree, and the tree would not become too deep.
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

    /// The parent's slot takes the sibling; the sibling's slot takes the target, so that both are a pair again; and the target's
    /// slot takes the node above that pair.
    fn reinsert_subtree(&mut self, node: usize, target: usize) {
        let (parent, sibling) = (self.parent(node), sibling(node));
        self.move_subtree(parent, sibling);
        self.move_subtree(sibling, target);
        self.parents[pair_index(node)] = target as u32;
        self.refit_ancestors(node);
        self.refit_ancestors(parent);
    }

    /// Moves what is in a slot, with all that is below, to another.
    fn move_subtree(&mut self, to: usize, from: usize) {
        self.nodes[to] = self.nodes[from];
        self.heights[to] = self.heights[from];
        if let BuildNodeContent::Children(child) = self.nodes[to].contents() {
            self.parents[pair_index(child)] = to as u32;
        }
    }

    /// Brings all that is above a node up to date.
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
