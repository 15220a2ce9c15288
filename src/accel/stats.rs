//! How large and how good a hierarchy is.

use glam::{DVec3, Vec3, Vec4, Vec4Swizzles};
use serde::Serialize;

use crate::device::layout::Node;

/// Size and quality of a hierarchy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct BvhStats {
    /// Inner nodes and leaves.
    pub node_count: usize,
    /// Leaves.
    pub leaf_count: usize,
    /// Primitives, over all leaves: one that is in several counts as often.
    pub primitive_count: usize,
    /// How many there are more than different ones.
    pub duplicate_count: usize,
    /// Primitives in the fullest leaf.
    pub max_leaf_size: u32,
    /// Nodes from the root to the deepest leaf, both included.
    pub depth: usize,
    /// Expected cost of a ray that meets the root's box and hits nothing, in node fetches: each node is fetched as often as
    /// its parent's box is met (in proportion to its surface), and a primitive costs what the builder assumed.
    pub sah_cost: f64,
    /// Bytes on the device.
    pub bytes: usize,
}

impl BvhStats {
    /// Measures nodes; `bytes` and `duplicate_count` remain 0.
    pub(super) fn of(nodes: &[Node], primitive_cost: f32) -> Self {
        let mut stats = Self { node_count: nodes.len(), ..Self::default() };
        let Some(root) = nodes.first() else { return stats };
        let root_area = half_area(root);
        // Escape index and relative area of the inner nodes around the current one.
        let mut ancestors: Vec<(u32, f64)> = Vec::new();
        for (index, node) in nodes.iter().enumerate() {
            while ancestors.last().is_some_and(|&(escape_index, _)| escape_index == index as u32) {
                ancestors.pop();
            }
            stats.sah_cost += ancestors.last().map_or(1.0, |&(_, area)| area);
            let area = half_area(node) / root_area;
            let count = node.primitives.primitive_count();
            if count == 0 {
                ancestors.push((node.escape_index, area));
            } else {
                stats.leaf_count += 1;
                stats.primitive_count += count as usize;
                stats.max_leaf_size = stats.max_leaf_size.max(count);
                stats.depth = stats.depth.max(ancestors.len() + 1);
                stats.sah_cost += area * f64::from(count) * f64::from(primitive_cost);
            }
        }
        stats
    }

    /// Mean number of primitives in a leaf; 0 without leaves.
    pub fn primitives_per_leaf(&self) -> f64 {
        self.primitive_count as f64 / self.leaf_count.max(1) as f64
    }
}

/// Half the surface area of a node's box; 0 for an unused one.
#[inline]
pub(super) fn half_area(node: &Node) -> f64 {
    // Four lanes at a time, of which the fourth is none of a box.
    let [min, max] = bytemuck::cast::<Node, [Vec4; 2]>(*node).map(|corner| corner.with_w(0.0));
    let side = max - min;
    let area = side.dot(side.yzxw());
    if area.is_normal() { f64::from(area) } else { half_area_in_f64(node) }
}

/// The same where f32 overflows or underflows.
#[cold]
fn half_area_in_f64(node: &Node) -> f64 {
    if node.is_empty() {
        return 0.0;
    }
    let side = Vec3::from_array(node.max).as_dvec3() - Vec3::from_array(node.min).as_dvec3();
    side.dot(DVec3::new(side.y, side.z, side.x))
}
