//! Size and quality of a hierarchy.

use glam::{DVec3, Vec3, Vec4, Vec4Swizzles};
use serde::Serialize;

use crate::device::layout::Node;

/// Size and quality of a hierarchy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BvhStats {
    /// Inner nodes and leaves.
    pub node_count: usize,
    /// Leaves.
    pub leaf_count: usize,
    /// Primitive references in all leaves; a primitive in several leaves counts once for each.
    pub primitive_count: usize,
    /// Primitive references beyond the first of each primitive (from spatial splits).
    pub duplicate_count: usize,
    /// Primitive references in the largest leaf.
    pub max_leaf_size: u32,
    /// Nodes from the root to the deepest leaf, both included.
    pub depth: usize,
    /// Expected cost of a ray that meets the root's box and hits nothing, in node fetches. A node is fetched with the
    /// probability that the ray meets its parent's box, which is the ratio of that box's surface area to the root's; a
    /// primitive test costs what the builder assumed
    /// ([`BlasBuildParams::triangle_cost`](super::BlasBuildParams::triangle_cost)).
    pub sah_cost: f64,
    /// Size on the device, in bytes.
    pub bytes: usize,
}

impl BvhStats {
    /// Measures nodes; `bytes` and `duplicate_count` remain 0. O(n).
    pub(super) fn of(nodes: &[Node], primitive_cost: f32) -> Self {
        let mut stats = Self { node_count: nodes.len(), ..Self::default() };
        let Some(root) = nodes.first() else { return stats };
        let root_area = half_area(root);
        // The enclosing inner nodes of the current node, each with its escape index and its area relative to the
        // root's.
        let mut ancestors: Vec<(u32, f64)> = Vec::new();
        for (index, node) in nodes.iter().enumerate() {
            // 1. Leave the subtrees that end here.
            while ancestors.last().is_some_and(|&(escape_index, _)| escape_index == index as u32) {
                ancestors.pop();
            }
            // 2. The node is fetched as often as its parent's box is met.
            stats.sah_cost += ancestors.last().map_or(1.0, |&(_, area)| area);
            let area = half_area(node) / root_area;
            // 3. An inner node encloses those that follow; a leaf is counted.
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
    // Computed on four lanes; the fourth is set to zero, since it holds an index and not a coordinate.
    let [min, max] = bytemuck::cast::<Node, [Vec4; 2]>(*node).map(|corner| corner.with_w(0.0));
    let side = max - min;
    let area = side.dot(side.yzxw());
    if area.is_normal() { f64::from(area) } else { half_area_in_f64(node) }
}

/// The same in f64, where f32 overflows or underflows; 0 for an unused node.
#[cold]
fn half_area_in_f64(node: &Node) -> f64 {
    if node.is_empty() {
        return 0.0;
    }
    let side = Vec3::from_array(node.max).as_dvec3() - Vec3::from_array(node.min).as_dvec3();
    side.dot(DVec3::new(side.y, side.z, side.x))
}
