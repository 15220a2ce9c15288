//! The builder: parallel locally-ordered clustering (D. Meister, J. Bittner, *Parallel Locally-Ordered Clustering for Bounding
//! Volume Hierarchy Construction*, 2018).
//!
//! Clusters stand in the order of a space-filling curve, at first one an instance. In each round every cluster looks for the
//! neighbour within some places with which its box would be the smallest; two that chose each other merge. That goes on until
//! one is left.
//!
//! Differences: the radius of the search grows as clusters get fewer, and a round in which fewer than a fifth merge, for the
//! boxes have nothing to choose between or form a chain, merges every cluster with the next. That bounds both the work, to 5 n,
//! and the depth.

use glam::Vec4Swizzles;
use rayon::prelude::*;

use crate::accel::tree::LaneBox;
use crate::math::Aabb;

/// Clusters that one thread takes at a time.
pub(super) const CHUNK: usize = 1 << 12;

/// A box and two numbers, which travel in the fourth lanes, see [`TAG`]. 32 bytes.
#[derive(Clone, Copy, bytemuck::Zeroable)]
pub(super) struct Cluster {
    bounds: LaneBox,
}

/// Set in the bits of a number in a float lane, so that every number below 2^30 is a normal float: subnormal operands would
/// slow the arithmetic on the other lanes a hundredfold.
const TAG: u32 = 0x4000_0000;

impl Cluster {
    /// Of one instance, at `place` in the order.
    pub(super) fn leaf(bounds: &Aabb, slot: u32, place: u32) -> Self {
        let (place, slot) = (f32::from_bits(TAG | place), f32::from_bits(TAG | slot));
        Self { bounds: LaneBox { min: bounds.min.extend(place), max: bounds.max.extend(slot) } }
    }

    fn merged(bounds: LaneBox, number: u32) -> Self {
        let min = bounds.min.with_w(f32::from_bits(TAG | number));
        Self { bounds: LaneBox { min, max: bounds.max.with_w(1.0) } }
    }

    /// Of a leaf its place; of others the number of leaves and that of the [`Link`] added.
    fn number(&self) -> u32 {
        self.bounds.min.w.to_bits() ^ TAG
    }

    fn slot(&self) -> u32 {
        self.bounds.max.w.to_bits() ^ TAG
    }
}

/// What was merged into what.
pub(super) struct Tree {
    leaves: Vec<Cluster>,
    links: Vec<Link>,
}

/// A merged cluster.
#[derive(Clone, Copy, bytemuck::Zeroable)]
pub(super) struct Link {
    /// The one with the larger surface first: it is hit more often, and what it hides need not be visited.
    pub(super) children: [u32; 2],
    pub(super) leaf_count: u32,
}

impl Tree {
    pub(super) fn leaf_count(&self) -> usize {
        self.leaves.len()
    }

    /// The cluster of all; `None` if there is nothing.
    pub(super) fn root(&self) -> Option<u32> {
        (self.leaves.len() + self.links.len()).checked_sub(1).map(|root| root as u32)
    }

    /// How a cluster was merged; `None` for a leaf.
    pub(super) fn link(&self, cluster: u32) -> Option<&Link> {
        self.links.get((cluster as usize).checked_sub(self.leaves.len())?)
    }

    /// Slot and box of a leaf.
    pub(super) fn leaf(&self, cluster: u32) -> (u32, Aabb) {
        let leaf = &self.leaves[cluster as usize];
        (leaf.slot(), Aabb { min: leaf.bounds.min.xyz(), max: leaf.bounds.max.xyz() })
    }

    pub(super) fn leaves_below(&self, cluster: u32) -> u32 {
        self.link(cluster).map_or(1, |link| link.leaf_count)
    }
}

/// Merges clusters until one is left. O(n).
pub(super) fn build(leaves: Vec<Cluster>) -> Tree {
    let count = leaves.len();
    let links: Vec<Link> = bytemuck::zeroed_vec(count.saturating_sub(1));
    let mut tree = Tree { leaves, links };
    if count < 2 {
        return tree;
    }
    let bounds = tree.leaves.par_chunks(CHUNK).map(union).reduce(|| LaneBox::EMPTY, LaneBox::union);
    let mut round = Round { scale: unit_scale(&bounds), leaf_count: count as u32, link_count: 0 };
    let mut nearest: Vec<u32> = bytemuck::zeroed_vec(count);
    let mut clusters: Vec<Cluster> = bytemuck::zeroed_vec(count);
    let mut left = round.merge(&tree.leaves, &mut nearest, &mut tree.links, &mut clusters);
    let mut merged: Vec<Cluster> = bytemuck::zeroed_vec(left);
    while left > 1 {
        left = round.merge(&clusters[..left], &mut nearest, &mut tree.links, &mut merged);
        std::mem::swap(&mut clusters, &mut merged);
    }
    tree
}

fn union(clusters: &[Cluster]) -> LaneBox {
    clusters.iter().fold(LaneBox::EMPTY, |sum, cluster| sum.union(cluster.bounds))
}

/// The power of two that brings the longest side of a box to between 1 and 2; 0 where no area is finite anyway.
fn unit_scale(bounds: &LaneBox) -> f32 {
    let side = bounds.max - bounds.min;
    let longest = side.x.max(side.y).max(side.z);
    1.0 / f32::from_bits(longest.to_bits() & f32::INFINITY.to_bits())
}

/// How many places on either side are searched, among so many clusters: few where that is most of the work.
fn radius(count: usize) -> usize {
    if count > 1 << 16 { 4 } else { MAX_RADIUS }
}

const MAX_RADIUS: usize = 16;

/// What the rounds have in common.
struct Round {
    /// Makes the scene about one unit long, so that no area overflows.
    scale: f32,
    leaf_count: u32,
    /// Links written so far.
    link_count: usize,
}

impl Round {
    /// Merges some of `clusters` and writes what is left of them to the start of `target`. Returns how many that are.
    fn merge(
        &mut self,
        clusters: &[Cluster],
        nearest: &mut [u32],
        links: &mut [Link],
        target: &mut [Cluster],
    ) -> usize {
        // 1. Search.
        let nearest = &mut nearest[..clusters.len()];
        let radius = radius(clusters.len());
        nearest
            .par_chunks_mut(CHUNK)
            .enumerate()
            .for_each(|(chunk, nearest)| self.find_nearest(clusters, chunk * CHUNK, radius, nearest));
        let mut counts = count(nearest);
        if counts.iter().map(|c| c.links).sum::<usize>() < clusters.len() / 5 {
            nearest.iter_mut().enumerate().for_each(|(i, nearest)| *nearest = partner(i, clusters.len()) as u32);
            counts = count(nearest);
        }
        // 2. Merge.
        let (done, mut links) = links.split_at_mut(self.link_count);
        let (mut target, mut link_count, mut left) = (target, self.link_count, 0);
        let mut pieces = Vec::with_capacity(counts.len());
        for (chunk, count) in counts.into_iter().enumerate() {
            let piece = Piece {
                start: chunk * CHUNK,
                first_number: self.leaf_count + link_count as u32,
                links: links.split_off_mut(..count.links).unwrap_or_default(),
                target: target.split_off_mut(..count.clusters).unwrap_or_default(),
            };
            link_count += count.links;
            left += count.clusters;
            pieces.push(piece);
        }
        let (nearest, done) = (&*nearest, &*done);
        pieces.into_par_iter().for_each(|piece| self.merge_chunk(clusters, nearest, done, piece));
        self.link_count = link_count;
        left
    }

    /// For each cluster from `start` on, the one within `radius` places with which it has the least surface. Of several, its
    /// [`partner`], or else the one of the pair that comes first: that order of pairs makes sure that two choose each other.
    fn find_nearest(&self, clusters: &[Cluster], start: usize, radius: usize, nearest: &mut [u32]) {
        let first = start.saturating_sub(radius) & !1;
        let end = start + nearest.len();
        let cost = |a: usize, b: usize| clusters[a].bounds.union(clusters[b].bounds).half_area(self.scale);
        // Costs and choices from `first` to as far as the last cluster looks.
        let mut least = [f32::INFINITY; CHUNK + 2 * MAX_RADIUS + 2];
        let mut choice = [0; CHUNK + 2 * MAX_RADIUS + 2];
        let window_end = (end + radius).min(clusters.len());
        for i in (first..window_end).step_by(2) {
            let partner = partner(i, clusters.len());
            choice[i - first] = partner as u32;
            if partner > i {
                // An area that is not a number is none.
                let cost = cost(i, partner).min(f32::INFINITY);
                choice[partner - first] = i as u32;
                (least[i - first], least[partner - first]) = (cost, cost);
            }
        }
        for i in first..end {
            let bounds = clusters[i].bounds;
            let (mut own_least, mut own_choice) = (least[i - first], choice[i - first]);
            let row_end = (i + 1 + radius).min(clusters.len());
            for (j, other) in (i + 1..row_end).zip(&clusters[i + 1..row_end]) {
                let cost = bounds.union(other.bounds).half_area(self.scale);
                if cost < own_least {
                    (own_least, own_choice) = (cost, j as u32);
                }
                if cost < least[j - first] {
                    (least[j - first], choice[j - first]) = (cost, i as u32);
                }
            }
            (least[i - first], choice[i - first]) = (own_least, own_choice);
        }
        nearest.copy_from_slice(&choice[start - first..end - first]);
    }

    fn merge_chunk(&self, clusters: &[Cluster], nearest: &[u32], done: &[Link], piece: Piece<'_>) {
        let leaves_below = |number: u32| {
            let link = (number as usize).checked_sub(self.leaf_count as usize);
            link.map_or(1, |link| done[link].leaf_count)
        };
        let mut links = piece.links.iter_mut();
        let mut target = piece.target.iter_mut();
        let mut number = piece.first_number;
        let end = (piece.start + CHUNK).min(clusters.len());
        for i in piece.start..end {
            let other = nearest[i] as usize;
            let merges = nearest[other] as usize == i;
            if merges && other < i {
                continue;
            }
            let Some(target) = target.next() else { return };
            *target = clusters[i];
            if merges {
                let Some(link) = links.next() else { return };
                let (a, b) = (&clusters[i], &clusters[other]);
                let mut children = [a.number(), b.number()];
                if b.bounds.half_area(self.scale) > a.bounds.half_area(self.scale) {
                    children.swap(0, 1);
                }
                *link = Link { children, leaf_count: children.map(leaves_below).iter().sum() };
                *target = Cluster::merged(a.bounds.union(b.bounds), number);
                number += 1;
            }
        }
    }
}

/// Whom a cluster merges with where nothing speaks for another.
fn partner(index: usize, count: usize) -> usize {
    if index ^ 1 < count { index ^ 1 } else { index - 1 }
}

/// What a chunk of clusters makes.
struct Count {
    links: usize,
    clusters: usize,
}

fn count(nearest: &[u32]) -> Vec<Count> {
    let of_chunk = |(chunk, choices): (usize, &[u32])| {
        let mut count = Count { links: 0, clusters: choices.len() };
        for (i, &other) in (chunk * CHUNK..).zip(choices) {
            let merges = nearest[other as usize] as usize == i;
            count.links += usize::from(merges && i < other as usize);
            count.clusters -= usize::from(merges && i > other as usize);
        }
        count
    };
    nearest.par_chunks(CHUNK).enumerate().map(of_chunk).collect()
}

/// Where a chunk of clusters goes.
struct Piece<'a> {
    start: usize,
    /// Of the first cluster that it makes.
    first_number: u32,
    links: &'a mut [Link],
    target: &'a mut [Cluster],
}
