//! The cost of the surface area heuristic, by one function for every tree.

use glam::Vec3;
use ropewalk::device::layout::Node;

/// A node, as the cost sees it.
pub struct CostNode {
    /// Half the surface of its box.
    pub area: f64,
    /// How many primitives it holds; 0 for an inner node.
    pub primitives: u32,
}

/// Expected box and primitive tests, each of cost 1, of a ray that meets the root's box and hits nothing. `children`
/// adds those of an inner node to a list.
pub fn sah_cost(node: impl Fn(usize) -> CostNode, children: impl Fn(usize, &mut Vec<usize>)) -> f64 {
    let (root_area, mut cost) = (node(0).area, 0.0);
    let mut stack = vec![0];
    while let Some(index) = stack.pop() {
        let CostNode { area, primitives } = node(index);
        if primitives > 0 {
            cost += area * f64::from(primitives);
        } else {
            let first = stack.len();
            children(index, &mut stack);
            cost += area * (stack.len() - first) as f64;
        }
    }
    1.0 + cost / root_area
}

/// Of our nodes, of which inner ones have any number of children.
pub fn of_ours(nodes: &[Node]) -> f64 {
    let next = |index: usize| (nodes[index].escape_index as usize).min(nodes.len());
    let node = |index: usize| CostNode {
        area: half_area(nodes[index].min.into(), nodes[index].max.into()),
        primitives: nodes[index].primitives.primitive_count(),
    };
    sah_cost(node, |index, list| {
        let mut child = index + 1;
        while child < next(index) {
            list.push(child);
            child = next(child);
        }
    })
}

/// Half the surface of a box.
pub fn half_area(min: Vec3, max: Vec3) -> f64 {
    let d = max.as_dvec3() - min.as_dvec3();
    d.x * d.y + d.y * d.z + d.z * d.x
}
