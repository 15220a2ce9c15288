//! The fast bottom-up builder: agglomerative clustering along a Morton curve.
//!
//! The boxes are sorted along a Morton curve (`morton`), and the range is halved recursively until a range holds one or
//! two boxes. On the way back each range joins the at most two clusters left by either half and merges the pair with
//! the smallest common box until two are left for the enclosing range (`clustering`). Neighbours in space that the
//! curve separates are so merged at a higher level. At most nine pairs are examined per range.
//!
//! This is the approximate agglomerative clustering of Y. Gu, Y. He, K. Fatahalian, G. Blelloch, *Efficient BVH
//! Construction via Approximate Agglomerative Clustering* (2013), with a cluster count after each range that is always
//! 2 instead of growing with the range: more made the build slower and the hierarchy no better
//! (`docs/benchmarks/log.md`).
//!
//! The bottom level keeps a pair of build nodes of each merge (`build_tree`), the top level a record of its own
//! (`accel::tlas::build`).

mod build_tree;
mod cluster;
mod clustering;
mod morton;
mod radix_sort;

pub(in crate::accel) use self::build_tree::build_tree;
pub(in crate::accel) use self::cluster::{ChildCluster, ClusterKind};
pub(in crate::accel) use self::clustering::{MAX_CLUSTER_DEPTH, MergeRecord, TASK_MINIMUM, build};
pub(in crate::accel) use self::morton::MortonOrder;
