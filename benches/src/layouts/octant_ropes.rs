//! Depth-first arrays with escape indices as in the paper, but eight of them: one for each octant of ray directions.

use glam::Vec3;

use super::tree::Content;
use super::{Counts, SlabRay, Tree, VisitLeaf, Walk};

/// 32 bytes on a device.
#[derive(Clone, Copy)]
struct Node {
    aabb: [Vec3; 2],
    escape_index: u32,
    first: u32,
    /// 0 for an inner node.
    count: u32,
}

const NODE_BYTES: usize = 32;

/// An array for each octant of directions.
pub(super) struct OctantRopes([Vec<Node>; 8]);

impl OctantRopes {
    pub(super) fn new(tree: &Tree, is_pruned: bool) -> Self {
        let kept = kept(tree, is_pruned);
        Self(std::array::from_fn(|octant| {
            let signs = Vec3::from_array(std::array::from_fn(|axis| if octant >> axis & 1 == 1 { -1.0 } else { 1.0 }));
            let along = |node: u32| {
                let [min, max] = tree.0[node as usize].aabb;
                signs.dot(min + max)
            };
            flatten(tree, &kept, |[a, b]| if along(b) < along(a) { [b, a] } else { [a, b] })
        }))
    }
}

impl Walk for OctantRopes {
    fn node_bytes(&self) -> usize {
        self.0.iter().map(Vec::len).sum::<usize>() * NODE_BYTES
    }

    fn walk(&self, ray: &SlabRay, t_max: f32, counts: &mut Counts, leaf: &mut VisitLeaf<'_>) -> f32 {
        let octant = (0..3).map(|axis| usize::from(ray.reciprocal[axis] < 0.0) << axis).sum::<usize>();
        walk(&self.0[octant], ray, t_max, counts, leaf)
    }
}

fn walk(nodes: &[Node], ray: &SlabRay, mut t_max: f32, counts: &mut Counts, leaf: &mut VisitLeaf<'_>) -> f32 {
    let mut index = 0;
    while let Some(node) = nodes.get(index) {
        counts.fetch(NODE_BYTES, 1);
        index = if ray.enter(node.aabb, t_max).is_none() {
            node.escape_index as usize
        } else if node.count == 0 {
            index + 1
        } else {
            t_max = leaf(node.first, node.count, t_max, counts);
            if t_max < 0.0 {
                break;
            }
            node.escape_index as usize
        };
    }
    t_max
}

/// Which nodes to keep: all, or only those inner nodes that save more box tests than they cost. With A the half area of
/// a box, k the number of kept children of node n, and a its nearest kept ancestor: testing n costs A(a) box tests and
/// saves k (A(a) - A(n)).
fn kept(tree: &Tree, is_pruned: bool) -> Vec<bool> {
    /// Whether a node is kept depends on which of its ancestors and descendants are, so the decision is repeated.
    const PASSES: usize = 4;
    let nodes = &tree.0;
    let mut kept = vec![true; nodes.len()];
    for _ in 0..if is_pruned { PASSES } else { 0 } {
        let mut ancestor_area = vec![f32::INFINITY; nodes.len()];
        for (index, node) in nodes.iter().enumerate() {
            if let Content::Inner(children) = node.content {
                let area = if kept[index] { node.half_area() } else { ancestor_area[index] };
                for child in children {
                    ancestor_area[child as usize] = area;
                }
            }
        }
        let mut kept_below = vec![1; nodes.len()];
        for (index, node) in nodes.iter().enumerate().rev() {
            let Content::Inner(children) = node.content else { continue };
            let below: u32 = children.iter().map(|&child| kept_below[child as usize]).sum();
            let ancestor = ancestor_area[index];
            kept[index] = index == 0 || below as f32 * (ancestor - node.half_area()) >= ancestor;
            kept_below[index] = if kept[index] { 1 } else { below };
        }
    }
    kept
}

fn flatten(tree: &Tree, kept: &[bool], order: impl Fn([u32; 2]) -> [u32; 2]) -> Vec<Node> {
    enum Step {
        Enter(u32),
        /// The subtree of the array's node is complete.
        Leave(usize),
    }
    let mut nodes: Vec<Node> = Vec::with_capacity(tree.0.len());
    let mut steps = vec![Step::Enter(0)];
    while let Some(step) = steps.pop() {
        match step {
            Step::Leave(index) => nodes[index].escape_index = nodes.len() as u32,
            Step::Enter(index) => {
                let node = &tree.0[index as usize];
                let place = nodes.len();
                let (first, count) = match node.content {
                    Content::Leaf { first, count } => (first, count),
                    Content::Inner(_) => (0, 0),
                };
                if kept[index as usize] {
                    nodes.push(Node { aabb: node.aabb, escape_index: place as u32 + 1, first, count });
                }
                if let Content::Inner(children) = node.content {
                    if kept[index as usize] {
                        steps.push(Step::Leave(place));
                    }
                    let [near, far] = order(children);
                    steps.extend([Step::Enter(far), Step::Enter(near)]);
                }
            }
        }
    }
    nodes
}
