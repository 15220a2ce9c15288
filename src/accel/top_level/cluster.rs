//! The builder: agglomerative clustering along a space-filling curve.
//!
//! A range of instances in the order of the curve is halved until one is left. On the way back, each range takes the two
//! clusters that either half has left over, and merges the pair with the smallest common box, twice: again two are left for
//! the next larger range. What the curve has cut apart thus meets again, and no more than nine pairs are ever looked at.
//!
//! That is Y. Gu, Y. He, K. Fatahalian, G. Blelloch, *Efficient BVH Construction via Approximate Agglomerative Clustering*
//! (2013), with the number of clusters that a range leaves over, which there grows with the range, always 2: measured, more of
//! them made the build slower and the hierarchy no better (docs/BENCHMARKS.md).

use glam::Vec4Swizzles;

use super::morton::Order;
use crate::accel::tree::{Extent, LaneBox};
use crate::math::Aabb;

/// Ranges of fewer instances are built by one thread.
pub(super) const TASK_MINIMUM: usize = 1 << 11;

/// No tree has more levels: the keys of the order have 64 bits, so that no more than 64 ranges contain each other. Each adds two
/// levels at most, the last merge one, and instances are the lowest.
pub(super) const MAX_DEPTH: usize = 2 * 64 + 2;

/// A box and two numbers, which travel in the fourth lanes, see [`TAG`]. 32 bytes.
#[derive(Clone, Copy, bytemuck::Zeroable)]
pub(super) struct Cluster {
    bounds: LaneBox,
}

/// Set in the bits of a number in a float lane, so that every number below 2^30 is a normal float: subnormal operands would
/// slow the arithmetic on the other lanes a hundredfold.
const TAG: u32 = 0x4000_0000;

impl Cluster {
    fn new(bounds: LaneBox, numbers: [u32; 2]) -> Self {
        let [min, max] = numbers.map(|number| f32::from_bits(TAG | number));
        Self { bounds: LaneBox { min: bounds.min.with_w(min), max: bounds.max.with_w(max) } }
    }

    /// An instance, with its slot.
    pub(super) fn instance(bounds: &Aabb, slot: u32) -> Self {
        Self::new(LaneBox { min: bounds.min.extend(0.0), max: bounds.max.extend(0.0) }, [slot, 0])
    }

    fn slot(&self) -> u32 {
        self.bounds.min.w.to_bits() ^ TAG
    }

    /// Of an instance its place in the order; of others the number of instances and that of the [`Link`] added.
    fn number(&self) -> u32 {
        self.bounds.min.w.to_bits() ^ TAG
    }

    /// A place for a link among those of the range: each cluster has one, since it takes two to need one.
    fn free_link(&self) -> u32 {
        self.bounds.max.w.to_bits() ^ TAG
    }
}

/// What was merged into what.
pub(super) struct Tree {
    /// Along the curve.
    instances: Vec<Cluster>,
    links: Vec<Link>,
    root: Option<u32>,
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
        self.instances.len()
    }

    /// The cluster of all; `None` if there is nothing.
    pub(super) fn root(&self) -> Option<u32> {
        self.root
    }

    /// How a cluster was merged; `None` for an instance.
    pub(super) fn link(&self, cluster: u32) -> Option<&Link> {
        self.links.get((cluster as usize).checked_sub(self.instances.len())?)
    }

    /// Slot and box of an instance.
    pub(super) fn instance(&self, cluster: u32) -> (u32, Aabb) {
        let instance = &self.instances[cluster as usize];
        (instance.slot(), Aabb { min: instance.bounds.min.xyz(), max: instance.bounds.max.xyz() })
    }

    pub(super) fn leaves_below(&self, cluster: u32) -> u32 {
        self.link(cluster).map_or(1, |link| link.leaf_count)
    }
}

/// Merges all instances. O(n log n), of which the logarithm is that of a search in a sorted range.
pub(super) fn build(order: Order) -> Tree {
    let mut links: Vec<Link> = bytemuck::zeroed_vec(order.len());
    let builder = Builder { order: &order, scale: scale(order.extent()) };
    let root = match order.len() {
        0 => None,
        count => match builder.run(0, count, &mut links) {
            Few { clusters: [all, _], count: 1 } => Some(all.number()),
            Few { clusters: [a, b], .. } => Some(builder.merge(&a, &b, 0, &mut links).number()),
        },
    };
    Tree { instances: order.into_instances(), links, root }
}

/// Makes the scene about one unit long, so that areas neither overflow nor vanish. It goes by the centres: one box without end
/// must not make all others vanish, and its own area may well be infinite.
fn scale(extent: &Extent) -> f32 {
    let longest = |b: &LaneBox| (b.max - b.min).truncate().max_element();
    let length = longest(&extent.centers);
    1.0 / if length > 0.0 { length } else { longest(&extent.bounds) }
}

/// What the threads share.
struct Builder<'a> {
    order: &'a Order,
    scale: f32,
}

/// One or two clusters.
#[derive(Clone, Copy)]
struct Few {
    clusters: [Cluster; 2],
    count: usize,
}

impl Builder<'_> {
    /// Merges the instances from `first` to `end` until one or two clusters are left. `links` are the links of the range.
    /// Recursion is at most 64 deep.
    fn run(&self, first: usize, end: usize, links: &mut [Link]) -> Few {
        let instance = |place: usize| Cluster::new(self.order.instances()[place].bounds, [place as u32; 2]);
        match end - first {
            1 => Few { clusters: [instance(first); 2], count: 1 },
            2 => Few { clusters: [instance(first), instance(first + 1)], count: 2 },
            count => {
                let middle = self.order.split(first, end);
                let (left_links, right_links) = links.split_at_mut(middle - first);
                let mut left = || self.run(first, middle, left_links);
                let mut right = || self.run(middle, end, right_links);
                let (left, right) = if count < TASK_MINIMUM { (left(), right()) } else { rayon::join(left, right) };
                self.combine(&left, &right, first, links)
            }
        }
    }

    /// Merges clusters until two are left.
    ///
    /// Merged ones go to the end, and of equal boxes the first are taken: where there is nothing to choose between, as many
    /// instances come to lie on either side.
    #[inline]
    fn combine(&self, left: &Few, right: &Few, first: usize, links: &mut [Link]) -> Few {
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
            let merged = self.merge(&clusters[pair[0]], &clusters[pair[1]], first, links);
            clusters.copy_within(pair[1] + 1..count, pair[1]);
            clusters.copy_within(pair[0] + 1..count - 1, pair[0]);
            count -= 1;
            clusters[count - 1] = merged;
        }
        Few { clusters: [clusters[0], clusters[1]], count }
    }

    #[inline]
    fn merge(&self, a: &Cluster, b: &Cluster, first: usize, links: &mut [Link]) -> Cluster {
        let count = self.order.len();
        let leaves_below = |cluster: &Cluster| {
            let link = (cluster.number() as usize).checked_sub(count);
            link.map_or(1, |link| links[link - first].leaf_count)
        };
        let leaf_count = leaves_below(a) + leaves_below(b);
        let mut children = [a.number(), b.number()];
        if b.bounds.half_area(self.scale) > a.bounds.half_area(self.scale) {
            children.swap(0, 1);
        }
        let link = a.free_link();
        links[link as usize - first] = Link { children, leaf_count };
        Cluster::new(a.bounds.union(b.bounds), [count as u32 + link, b.free_link()])
    }
}
