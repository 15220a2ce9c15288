//! What the kernel's own traversals read.

use rayon::prelude::*;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{NONE, RayRecord};
use ropewalk::trace::{Emulated, Traversal, TraversalCounts};

use crate::rays::RayKind;

/// What the kernel reads and tests for some rays.
#[derive(Clone, Copy, Debug)]
pub struct KernelCounts {
    /// Sums over all rays.
    pub counts: TraversalCounts,
    /// Rays are traced in groups of 32 that step together, a step being a node or a triangle: the share of the lanes'
    /// steps in which the lane's ray is not yet done.
    pub lockstep_efficiency: f64,
}

/// Threads of a GPU that step together.
const LANES: usize = 32;

impl KernelCounts {
    /// Traces rays of one kind by [`Emulated`], ray by ray, and counts.
    pub fn of(arrays: &DeviceArrays, rays: &[RayRecord], kind: RayKind, traversal: Traversal) -> Self {
        let kernel = Emulated::default().with_traversal(traversal);
        let count = |ray: &RayRecord| {
            let ray = std::slice::from_ref(ray);
            if kind.is_any_hit() {
                kernel.count_any_hits(arrays, ray, NONE)
            } else {
                kernel.count_closest_hits(arrays, ray, NONE)
            }
        };
        let counts: Vec<TraversalCounts> = rays.par_iter().map(count).collect();
        let steps = |counts: &TraversalCounts| counts.nodes + counts.triangles;
        let slowest = |group: &[TraversalCounts]| group.iter().map(steps).max().unwrap_or(0);
        let lane_steps = LANES as u64 * counts.chunks(LANES).map(slowest).sum::<u64>();
        let mut sum = TraversalCounts::default();
        counts.into_iter().for_each(|counts| sum += counts);
        Self { counts: sum, lockstep_efficiency: steps(&sum) as f64 / lane_steps.max(1) as f64 }
    }
}
