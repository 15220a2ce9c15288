//! Approximate agglomerative clustering of boxes in Morton order.

use super::cluster::{ChildCluster, Cluster};
use super::morton::MortonOrder;
use crate::Cancel;
use crate::accel::tree::{ReferenceBounds, SimdAabb};

/// Ranges of fewer boxes are built by one thread.
pub(in crate::accel) const TASK_MINIMUM: usize = 1 << 11;

/// The most levels of a clustered tree. Keys have 64 bits, so at most 64 ranges are nested; each adds at most two
/// levels, the final merge one, and the leaves one.
pub(in crate::accel) const MAX_CLUSTER_DEPTH: usize = 2 * 64 + 2;

/// The record that a caller keeps of each merge.
pub(in crate::accel) trait MergeRecord: Copy + Send {
    /// The record of merging two clusters, the one with the larger surface area first: it is hit more often, and may
    /// hide the other. `merges` holds the records of this range, the first of which has the index `first`.
    fn new(children: [ChildCluster; 2], merges: &[Self], first: usize) -> Self;
}

/// Merges all boxes into one cluster, writing a record of each merge to `merges`. Returns the root, or `None` without
/// boxes. O(n log n): the logarithm is the binary search for the split of each range. Once cancelled, it leaves boxes
/// out.
pub(in crate::accel) fn build<R: MergeRecord>(
    order: &MortonOrder,
    merges: &mut [R],
    cancel: &Cancel,
) -> Option<ChildCluster> {
    // 1. Scale areas to the size of the scene.
    let builder = ClusterBuilder { order, scale: scene_scale(order.extent()), cancel };
    let root = match order.len() {
        0 => return None,
        // 2. Merge the whole range down to one or two clusters.
        count => match builder.merge_range(0, count, merges) {
            RemainingClusters { clusters: [all, _], count: 1 } => all,
            // 3. Merge the last two.
            RemainingClusters { clusters: [a, b], .. } => builder.merge(&a, &b, 0, merges),
        },
    };
    Some(root.as_child(order.len()))
}

/// The scale that makes the scene about one unit long, so that areas neither overflow nor underflow. It is taken from
/// the box of the centres: one unbounded box must not make all others vanish, and its own area may then be infinite.
fn scene_scale(extent: &ReferenceBounds) -> f32 {
    let longest = |b: &SimdAabb| (b.max - b.min).truncate().max_element();
    let length = longest(&extent.centers);
    1.0 / if length > 0.0 { length } else { longest(&extent.bounds) }
}

/// Read-only state shared by all threads.
struct ClusterBuilder<'a> {
    order: &'a MortonOrder,
    scale: f32,
    cancel: &'a Cancel,
}

/// The one or two clusters that a range leaves unmerged.
#[derive(Clone, Copy)]
struct RemainingClusters {
    clusters: [Cluster; 2],
    count: usize,
}

impl ClusterBuilder<'_> {
    /// Merges the boxes at Morton positions from `first` to `end` down to one or two clusters. `merges` holds the
    /// records of this range. Recursion is at most 64 deep.
    fn merge_range<R: MergeRecord>(&self, first: usize, end: usize, merges: &mut [R]) -> RemainingClusters {
        let single =
            |position: usize| Cluster::new(self.order.leaf_clusters()[position].simd_bounds(), [position as u32; 2]);
        match end - first {
            // One or two boxes: nothing to merge yet.
            1 => RemainingClusters { clusters: [single(first); 2], count: 1 },
            // Cancelled: one box stands for the whole range.
            count if count >= TASK_MINIMUM && self.cancel.should_stop() => {
                RemainingClusters { clusters: [single(first); 2], count: 1 }
            }
            2 => RemainingClusters { clusters: [single(first), single(first + 1)], count: 2 },
            count => {
                // 1. Halve the range where the curve passes into the other half of a cell.
                let middle = self.order.highest_bit_split(first, end);
                // 2. Merge both halves, in parallel while they are large.
                let (left_merges, right_merges) = merges.split_at_mut(middle - first);
                let mut left = || self.merge_range(first, middle, left_merges);
                let mut right = || self.merge_range(middle, end, right_merges);
                let (left, right) = if count < TASK_MINIMUM { (left(), right()) } else { rayon::join(left, right) };
                // 3. Merge what they left down to two.
                self.merge_down_to_two(&left, &right, first, merges)
            }
        }
    }

    /// Merges the pair with the smallest common half area until two clusters are left.
    ///
    /// A merged cluster goes to the end of the list, and ties go to the earliest pair, so that equal boxes give a
    /// balanced tree.
    #[inline]
    fn merge_down_to_two<R: MergeRecord>(
        &self,
        left: &RemainingClusters,
        right: &RemainingClusters,
        first: usize,
        merges: &mut [R],
    ) -> RemainingClusters {
        // Collect the up to four clusters.
        let mut clusters = [left.clusters[0]; 4];
        clusters[..left.count].copy_from_slice(&left.clusters[..left.count]);
        let mut count = left.count + right.count;
        clusters[left.count..count].copy_from_slice(&right.clusters[..right.count]);
        while count > 2 {
            // 1. Find the pair with the smallest common box.
            let (mut min_area, mut pair) = (f32::INFINITY, [0, 1]);
            for i in 0..count {
                for j in i + 1..count {
                    let area = clusters[i].simd_bounds().union(clusters[j].simd_bounds()).half_area(self.scale);
                    if area < min_area {
                        (min_area, pair) = (area, [i, j]);
                    }
                }
            }
            // 2. Merge it.
            let merged = self.merge(&clusters[pair[0]], &clusters[pair[1]], first, merges);
            // 3. Remove both from the list and append the merged cluster.
            clusters.copy_within(pair[1] + 1..count, pair[1]);
            clusters.copy_within(pair[0] + 1..count - 1, pair[0]);
            count -= 1;
            clusters[count - 1] = merged;
        }
        RemainingClusters { clusters: [clusters[0], clusters[1]], count }
    }

    /// Merges two clusters of the range whose merge records are `merges`, the first of which has the index `first`.
    #[inline]
    fn merge<R: MergeRecord>(&self, a: &Cluster, b: &Cluster, first: usize, merges: &mut [R]) -> Cluster {
        // 1. Order the children by area, the larger first.
        let count = self.order.len();
        let (a_bounds, b_bounds) = (a.simd_bounds(), b.simd_bounds());
        let mut children = [a.as_child(count), b.as_child(count)];
        if b_bounds.half_area(self.scale) > a_bounds.half_area(self.scale) {
            children.swap(0, 1);
        }
        // 2. Write the record at the index reserved by `a`; the new cluster inherits the one reserved by `b`.
        let index = a.reserved_merge();
        merges[index as usize - first] = R::new(children, merges, first);
        Cluster::new(a_bounds.union(b_bounds), [count as u32 + index, b.reserved_merge()])
    }
}
