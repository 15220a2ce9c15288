//! A bottom-level structure as a binary tree, for layouts to start from.

use glam::Vec3;
use ropewalk::device::layout::{NONE, Node};

/// In depth-first order: children come after their parent.
#[derive(Clone, Debug)]
pub struct Tree(pub Vec<TreeNode>);

/// A node of a [`Tree`].
#[derive(Clone, Copy, Debug)]
pub struct TreeNode {
    /// Least and greatest corner.
    pub aabb: [Vec3; 2],
    /// What is below.
    pub content: Content,
}

/// What a node holds.
#[derive(Clone, Copy, Debug)]
pub enum Content {
    /// Two nodes.
    Inner([u32; 2]),
    /// A range of triangles.
    Leaf {
        /// The first.
        first: u32,
        /// How many.
        count: u32,
    },
}

impl TreeNode {
    /// Half the surface of its box.
    pub fn half_area(&self) -> f32 {
        let side = self.aabb[1] - self.aabb[0];
        side.dot(Vec3::new(side.y, side.z, side.x))
    }
}

impl Tree {
    /// Reads a hierarchy's nodes. Where one has more than two children, they become a chain of pairs.
    pub fn new(nodes: &[Node]) -> Self {
        let mut tree = Self(Vec::with_capacity(nodes.len()));
        let mut pending = vec![Siblings { first: 0, end: nodes.len() as u32, place: None }];
        while let Some(Siblings { first, end, place }) = pending.pop() {
            let index = tree.0.len();
            if let Some((parent, side)) = place
                && let Content::Inner(children) = &mut tree.0[parent].content
            {
                children[side] = index as u32;
            }
            let node = &nodes[first as usize];
            let next = if node.escape_index == NONE { end } else { node.escape_index.min(end) };
            if next < end {
                // Siblings follow: a pair of this one and the rest.
                let aabb = siblings_box(nodes, first, end);
                tree.0.push(TreeNode { aabb, content: Content::Inner([0; 2]) });
                pending.push(Siblings { first: next, end, place: Some((index, 1)) });
                pending.push(Siblings { first, end: next, place: Some((index, 0)) });
            } else if node.primitives.primitive_count() > 0 {
                let content = Content::Leaf {
                    first: node.primitives.first_primitive(),
                    count: node.primitives.primitive_count(),
                };
                tree.0.push(TreeNode { aabb: corners(node), content });
            } else {
                // One node: the pair of its children has its box.
                pending.push(Siblings { first: first + 1, end, place });
            }
        }
        tree
    }
}

/// A run of siblings still to be added.
struct Siblings {
    first: u32,
    end: u32,
    /// The parent whose child this will be, and which of its two children.
    place: Option<(usize, usize)>,
}

fn corners(node: &Node) -> [Vec3; 2] {
    [node.min, node.max].map(Vec3::from_array)
}

fn siblings_box(nodes: &[Node], first: u32, end: u32) -> [Vec3; 2] {
    let [mut min, mut max] = corners(&nodes[first as usize]);
    let mut next = nodes[first as usize].escape_index;
    while next < end {
        let aabb = corners(&nodes[next as usize]);
        (min, max) = (min.min(aabb[0]), max.max(aabb[1]));
        next = nodes[next as usize].escape_index;
    }
    [min, max]
}
