//! A fast builder: agglomerative clustering along a space-filling curve.
//!
//! A range of boxes in the order of the curve is halved until one is left. On the way back, each range takes the two
//! clusters that either half has left over, and merges the pair with the smallest common box, twice: again two are left for
//! the next larger range. What the curve has cut apart thus meets again, and no more than nine pairs are ever looked at.
//!
//! That is Y. Gu, Y. He, K. Fatahalian, G. Blelloch, *Efficient BVH Construction via Approximate Agglomerative Clustering*
//! (2013), with the number of clusters that a range leaves over, which there grows with the range, always 2: measured, more of
//! them made the build slower and the hierarchy no better (docs/BENCHMARKS.md).

mod build_tree;
mod morton;
mod radix_sort;

pub(in crate::accel) use self::build_tree::build_tree;
pub(in crate::accel) use self::morton::{MortonOrder, clamp_to_f32};
use crate::accel::tree::{ReferenceBounds, SimdAabb};
use crate::math::Aabb;

/// Ranges of fewer boxes are built by one thread.
pub(in crate::accel) const TASK_MINIMUM: usize = 1 << 11;

/// No tree has more levels: the keys of the order have 64 bits, so that no more than 64 ranges contain each other. Each adds two
/// levels at most, the last merge one, and single boxes are the lowest.
pub(in crate::accel) const MAX_CLUSTER_DEPTH: usize = 2 * 64 + 2;

/// A box and two numbers, which travel in the fourth lanes, see [`NORMAL_FLOAT_BIT`]. 32 bytes.
#[derive(Clone, Copy, bytemuck::Zeroable)]
pub(in crate::accel) struct Cluster {
    bounds: SimdAabb,
}

/// Set in the bits of a number in a float lane, so that every number below 2^30 is a normal float: subnormal operands would
/// slow the arithmetic on the other lanes a hundredfold.
const NORMAL_FLOAT_BIT: u32 = 0x4000_0000;

impl Cluster {
    fn new(bounds: SimdAabb, numbers: [u32; 2]) -> Self {
        let [min, max] = numbers.map(|number| f32::from_bits(NORMAL_FLOAT_BIT | number));
        Self { bounds: SimdAabb { min: bounds.min.with_w(min), max: bounds.max.with_w(max) } }
    }

    /// Of one box, with its slot.
    fn leaf(bounds: &Aabb, slot: u32) -> Self {
        Self::new(SimdAabb { min: bounds.min.extend(0.0), max: bounds.max.extend(0.0) }, [slot, 0])
    }

    pub(in crate::accel) fn bounds(&self) -> Aabb {
        self.bounds.aabb()
    }

    /// Of one box.
    pub(in crate::accel) fn box_index(&self) -> u32 {
        self.bounds.min.w.to_bits() ^ NORMAL_FLOAT_BIT
    }

    /// Of one box its place in the order; of others the number of boxes and that of the joint added.
    fn tagged_index(&self) -> u32 {
        self.bounds.min.w.to_bits() ^ NORMAL_FLOAT_BIT
    }

    /// A place for a joint among those of the range: each cluster has one, since it takes two to need one.
    fn reserved_merge(&self) -> u32 {
        self.bounds.max.w.to_bits() ^ NORMAL_FLOAT_BIT
    }

    fn as_child(&self, box_count: usize) -> Member {
        let number = self.tagged_index() as usize;
        let kind =
            if number < box_count { ClusterKind::Single(number) } else { ClusterKind::Merged(number - box_count) };
        Member { bounds: self.bounds, kind }
    }
}

/// A cluster as others see it.
#[derive(Clone, Copy)]
pub(in crate::accel) struct Member {
    /// What is in the fourth lanes means nothing.
    pub(in crate::accel) bounds: SimdAabb,
    pub(in crate::accel) kind: ClusterKind,
}

/// How a cluster came about.
#[derive(Clone, Copy)]
pub(in crate::accel) enum ClusterKind {
    /// It is one box, at this place in the order.
    Single(usize),
    /// It was merged: the number of its joint.
    Merged(usize),
}

/// What is kept of a merge.
pub(in crate::accel) trait MergeRecord: Copy + Send {
    /// Of two clusters, the one with the larger surface first: it is hit more often, and what it hides need not be visited.
    /// `joints` has those of both and of what is below, from number `first` on.
    fn new(children: [Member; 2], joints: &[Self], first: usize) -> Self;
}

/// Merges all boxes, with a joint for each in `joints`. Returns the cluster of all; `None` if there is nothing. O(n log n), of
/// which the logarithm is that of a search in a sorted range.
pub(in crate::accel) fn build<J: MergeRecord>(order: &MortonOrder, joints: &mut [J]) -> Option<Member> {
    let builder = ClusterBuilder { order, scale: scene_scale(order.extent()) };
    let root = match order.len() {
        0 => return None,
        count => match builder.merge_range(0, count, joints) {
            RemainingClusters { clusters: [all, _], count: 1 } => all,
            RemainingClusters { clusters: [a, b], .. } => builder.merge(&a, &b, 0, joints),
        },
    };
    Some(root.as_child(order.len()))
}

/// Makes the scene about one unit long, so that areas neither overflow nor vanish. It goes by the centres: one box without end
/// must not make all others vanish, and its own area may well be infinite.
fn scene_scale(extent: &ReferenceBounds) -> f32 {
    let longest = |b: &SimdAabb| (b.max - b.min).truncate().max_element();
    let length = longest(&extent.centers);
    1.0 / if length > 0.0 { length } else { longest(&extent.bounds) }
}

/// What the threads share.
struct ClusterBuilder<'a> {
    order: &'a MortonOrder,
    scale: f32,
}

/// One or two clusters.
#[derive(Clone, Copy)]
struct RemainingClusters {
    clusters: [Cluster; 2],
    count: usize,
}

impl ClusterBuilder<'_> {
    /// Merges the boxes from `first` to `end` until one or two clusters are left. `joints` are those of the range.
    /// Recursion is at most 64 deep.
    fn merge_range<J: MergeRecord>(&self, first: usize, end: usize, joints: &mut [J]) -> RemainingClusters {
        let single = |place: usize| Cluster::new(self.order.leaf_clusters()[place].bounds, [place as u32; 2]);
        match end - first {
            1 => RemainingClusters { clusters: [single(first); 2], count: 1 },
            2 => RemainingClusters { clusters: [single(first), single(first + 1)], count: 2 },
            count => {
                let middle = self.order.highest_bit_split(first, end);
                let (left_joints, right_joints) = joints.split_at_mut(middle - first);
                let mut left = || self.merge_range(first, middle, left_joints);
                let mut right = || self.merge_range(middle, end, right_joints);
                let (left, right) = if count < TASK_MINIMUM { (left(), right()) } else { rayon::join(left, right) };
                self.merge_down_to_two(&left, &right, first, joints)
            }
        }
    }

    /// Merges clusters until two are left.
    ///
    /// Merged ones go to the end, and of equal boxes the first are taken: where there is nothing to choose between, as many
    /// boxes come to lie on either side.
    #[inline]
    fn merge_down_to_two<J: MergeRecord>(
        &self,
        left: &RemainingClusters,
        right: &RemainingClusters,
        first: usize,
        joints: &mut [J],
    ) -> RemainingClusters {
        let mut clusters = [left.clusters[0]; 4];
        clusters[..left.count].copy_from_slice(&left.clusters[..left.count]);
        let mut count = left.count + right.count;
        clusters[left.count..count].copy_from_slice(&right.clusters[..right.count]);
        while count > 2 {
            let (mut least, mut pair) = (f32::INFINITY, [0, 1]);
            for i in 0..count {
                for j in i + 1..count {
                    let cost = clusters[i].bounds.union(clusters[j].bounds).half_area(self.scale);
                    if cost < least {
                        (least, pair) = (cost, [i, j]);
                    }
                }
            }
            let merged = self.merge(&clusters[pair[0]], &clusters[pair[1]], first, joints);
            clusters.copy_within(pair[1] + 1..count, pair[1]);
            clusters.copy_within(pair[0] + 1..count - 1, pair[0]);
            count -= 1;
            clusters[count - 1] = merged;
        }
        RemainingClusters { clusters: [clusters[0], clusters[1]], count }
    }

    #[inline]
    fn merge<J: MergeRecord>(&self, a: &Cluster, b: &Cluster, first: usize, joints: &mut [J]) -> Cluster {
        let count = self.order.len();
        let mut children = [a.as_child(count), b.as_child(count)];
        if b.bounds.half_area(self.scale) > a.bounds.half_area(self.scale) {
            children.swap(0, 1);
        }
        let joint = a.reserved_merge();
        joints[joint as usize - first] = J::new(children, joints, first);
        Cluster::new(a.bounds.union(b.bounds), [count as u32 + joint, b.reserved_merge()])
    }
}
