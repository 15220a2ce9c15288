//! Nodes that hold the boxes of two children: one fetch tests both, the nearer is visited first, the other waits on a
//! stack.

use super::tree::Content;
use super::{Counts, SlabRay, Tree, VisitLeaf, Walk};

/// Two boxes of 24 bytes, two links of 8.
const NODE_BYTES: usize = 64;

/// The tree itself is the layout.
pub(super) struct Pairs(Tree);

impl Pairs {
    pub(super) fn new(tree: &Tree) -> Self {
        Self(tree.clone())
    }
}

impl Walk for Pairs {
    fn node_bytes(&self) -> usize {
        self.0.0.iter().filter(|node| matches!(node.content, Content::Inner(_))).count() * NODE_BYTES
    }

    fn walk(&self, ray: &SlabRay, mut t_max: f32, counts: &mut Counts, leaf: &mut VisitLeaf<'_>) -> f32 {
        let nodes = &self.0.0;
        let mut stack = vec![(0.0, 0)];
        while let Some((t_near, index)) = stack.pop() {
            if t_near > t_max {
                continue;
            }
            match nodes[index as usize].content {
                Content::Leaf { first, count } => {
                    t_max = leaf(first, count, t_max, counts);
                    if t_max < 0.0 {
                        break;
                    }
                }
                Content::Inner(children) => {
                    counts.fetch(NODE_BYTES, 2);
                    let met = children.map(|child| ray.enter(nodes[child as usize].aabb, t_max));
                    match (met, children) {
                        ([Some(a), Some(b)], [left, right]) if a <= b => stack.extend([(b, right), (a, left)]),
                        ([Some(a), Some(b)], [left, right]) => stack.extend([(a, left), (b, right)]),
                        ([Some(t), None], [child, _]) | ([None, Some(t)], [_, child]) => stack.push((t, child)),
                        ([None, None], _) => {}
                    }
                    // The nearest is visited at once.
                    counts.stack = counts.stack.max(stack.len().saturating_sub(1) as u64);
                }
            }
        }
        t_max
    }
}
