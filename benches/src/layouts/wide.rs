//! Nodes of several children whose boxes are stored in 8 bits a plane, rounded outward (Ylitie, Karras, Laine 2017).

use glam::Vec3;

use super::tree::Content;
use super::{Counts, SlabRay, Tree, VisitLeaf, Walk};

/// In which order children are visited.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Order {
    /// By the distance at which the ray enters their boxes. One on the stack is dropped if a nearer hit has been found
    /// since.
    Distance,
    /// By where their centres lie along the diagonal of the direction's octant. The stack has no distances: nothing is
    /// dropped.
    Octant,
}

/// A child of a wide node, its box as decoded from 8 bits a plane.
#[derive(Clone, Copy)]
struct Child {
    aabb: [Vec3; 2],
    /// A node of the array, or a leaf.
    content: Content,
}

/// Up to `N` children a node.
pub(super) struct Wide<const N: usize> {
    nodes: Vec<Vec<Child>>,
    order: Order,
}

impl<const N: usize> Wide<N> {
    /// Frame 16 bytes, boxes 6 bytes a child; links 4 bytes each for four children, for eight 16 bytes in all.
    const NODE_BYTES: usize = if N == 4 { 64 } else { 80 };

    /// Collapses the tree from the top: the child with the largest box is replaced by its own, while there is room.
    pub(super) fn new(tree: &Tree, order: Order) -> Self {
        let mut wide = Self { nodes: vec![Vec::new()], order };
        let mut pending = vec![(0, 0)];
        while let Some((root, place)) = pending.pop() {
            let mut children: Vec<u32> = vec![root];
            while children.len() < N {
                let inner = |&(_, &child): &(usize, &u32)| matches!(tree.0[child as usize].content, Content::Inner(_));
                let area = |&(_, &child): &(usize, &u32)| tree.0[child as usize].half_area();
                let opened = children.iter().enumerate().filter(inner).max_by(|a, b| area(a).total_cmp(&area(b)));
                let Some((index, _)) = opened else { break };
                let Content::Inner([left, right]) = tree.0[children[index] as usize].content else { break };
                children[index] = left;
                children.push(right);
            }
            let [origin, top] = tree.0[root as usize].aabb;
            let scale = ((top - origin) / 255.0).map(power_of_two_above);
            for child in children {
                let node = &tree.0[child as usize];
                let content = match node.content {
                    Content::Inner(_) => {
                        let index = wide.nodes.len() as u32;
                        wide.nodes.push(Vec::new());
                        pending.push((child, index as usize));
                        Content::Inner([index; 2])
                    }
                    leaf @ Content::Leaf { .. } => leaf,
                };
                wide.nodes[place].push(Child { aabb: quantised(node.aabb, origin, scale), content });
            }
        }
        wide
    }
}

/// The least power of two that is not below a value.
fn power_of_two_above(value: f32) -> f32 {
    value.max(f32::MIN_POSITIVE).log2().ceil().exp2()
}

/// The box as it is decoded after it was stored with 8 bits a plane.
fn quantised([min, max]: [Vec3; 2], origin: Vec3, scale: Vec3) -> [Vec3; 2] {
    let low = (((min - origin) / scale).floor()).clamp(Vec3::ZERO, Vec3::splat(255.0));
    let high = (((max - origin) / scale).ceil()).clamp(Vec3::ZERO, Vec3::splat(255.0));
    [origin + low * scale, origin + high * scale]
}

impl<const N: usize> Walk for Wide<N> {
    fn node_bytes(&self) -> usize {
        self.nodes.len() * Self::NODE_BYTES
    }

    fn walk(&self, ray: &SlabRay, mut t_max: f32, counts: &mut Counts, leaf: &mut VisitLeaf<'_>) -> f32 {
        let signs = ray.signs();
        let mut stack = vec![(0.0, Content::Inner([0; 2]))];
        let mut met: Vec<(f32, f32, Content)> = Vec::with_capacity(N);
        while let Some((t_near, content)) = stack.pop() {
            if self.order == Order::Distance && t_near > t_max {
                continue;
            }
            match content {
                Content::Leaf { first, count } => {
                    t_max = leaf(first, count, t_max, counts);
                    if t_max < 0.0 {
                        break;
                    }
                }
                Content::Inner([index, _]) => {
                    let children = &self.nodes[index as usize];
                    counts.fetch(Self::NODE_BYTES, children.len());
                    met.clear();
                    for child in children {
                        let Some(t) = ray.enter(child.aabb, t_max) else { continue };
                        let along =
                            if self.order == Order::Distance { t } else { signs.dot(child.aabb[0] + child.aabb[1]) };
                        met.push((along, t, child.content));
                    }
                    met.sort_by(|a, b| b.0.total_cmp(&a.0));
                    stack.extend(met.iter().map(|&(_, t, content)| (t, content)));
                    counts.stack = counts.stack.max(stack.len().saturating_sub(1) as u64);
                }
            }
        }
        t_max
    }
}
