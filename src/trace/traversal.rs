//! Which arrays the kernel walks, and what that costs.

use std::ops::AddAssign;

use serde::Serialize;

use crate::device::DeviceArrays;

/// The hierarchies that the GPU's kernel, and its twin in `emulated`, walk. All give the same hits, bit for bit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Traversal {
    /// Both levels in one fixed order along escape indices, without a stack: the paper's. Also taken for arrays without wide nodes.
    Rope,
    /// Near children first: the top level's of two, the bottom levels' of eight with quantised boxes, with one short stack. A top level too
    /// deep for it goes on as above, as do rays that look for any hit there.
    #[default]
    Wide,
}

impl Traversal {
    /// The one to walk these arrays by: arrays made by hand may have no wide nodes.
    pub(crate) fn supported_by(self, arrays: &DeviceArrays) -> Self {
        if arrays.wide_nodes.is_empty() { Self::Rope } else { self }
    }
}

/// What rays cost, whatever the machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct TraversalCounts {
    /// Nodes read, of both levels.
    pub nodes: u64,
    /// Boxes tested.
    pub boxes: u64,
    /// Triangles tested.
    pub triangles: u64,
    /// Instances entered.
    pub instances: u64,
    /// Bytes of all these.
    pub bytes: u64,
}

/// What a frame traces, and what that costs, whatever the machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FrameCounts {
    /// Rays that look for what they hit first: those through the pixels, mirrored and refracted ones.
    pub radiance_rays: u64,
    /// Of those through the pixels, the ones that hit something.
    pub primary_hits: u64,
    /// Rays from surfaces to lights.
    pub shadow_rays: u64,
    /// What all of them cost.
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
