//! The two traversals of the device arrays, and counters of their cost.

use std::ops::AddAssign;

use serde::Serialize;

use crate::device::DeviceArrays;

/// How the two BVH levels are traversed. Both traversals return identical hits, bit for bit. `cpu` always uses
/// [`Wide`](Self::Wide) if the arrays have wide nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Traversal {
    /// Stackless traversal along escape indices, both levels in depth-first order (the paper, section 3). The fallback
    /// for arrays without wide nodes.
    Rope,
    /// Ordered traversal with one short stack: the TLAS has two children a node, the BLASes eight with quantised boxes.
    /// A TLAS subtree for which the stack has no room, and the TLAS of every any-hit or transmittance query, is
    /// traversed along escape indices instead.
    #[default]
    Wide,
}

impl Traversal {
    /// The traversal that these arrays support: [`Rope`](Self::Rope) if they have no wide nodes (as hand-made arrays
    /// may), else `self`.
    pub(crate) fn supported_by(self, arrays: &DeviceArrays) -> Self {
        if arrays.wide_nodes.is_empty() { Self::Rope } else { self }
    }
}

/// Machine-independent traversal cost: elements read and tests made, summed over rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct TraversalCounts {
    /// Nodes read, of both levels.
    pub nodes: u64,
    /// Boxes tested.
    pub boxes: u64,
    /// Triangles tested.
    pub triangles: u64,
    /// Instances entered.
    pub instances: u64,
    /// Bytes of nodes, triangles and instances read.
    pub bytes: u64,
}

/// Rays of a frame and their machine-independent traversal cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct FrameCounts {
    /// Closest-hit rays: primary, reflected and refracted rays, and rays that continue behind blended surfaces.
    pub radiance_rays: u64,
    /// Primary rays that hit a surface.
    pub primary_hits: u64,
    /// Rays from surfaces to lights.
    pub shadow_rays: u64,
    /// Traversal cost of all these rays.
    pub cost: TraversalCounts,
}

impl AddAssign for FrameCounts {
    fn add_assign(&mut self, other: Self) {
        self.radiance_rays += other.radiance_rays;
        self.primary_hits += other.primary_hits;
        self.shadow_rays += other.shadow_rays;
        self.cost += other.cost;
    }
}

impl AddAssign for TraversalCounts {
    fn add_assign(&mut self, other: Self) {
        self.nodes += other.nodes;
        self.boxes += other.boxes;
        self.triangles += other.triangles;
        self.instances += other.instances;
        self.bytes += other.bytes;
    }
}
