//! Ways to lay out a hierarchy, as replicas that count what a ray does in each: simple, scalar, not fast.
//!
//! The boxes and leaves are those of Ropewalk's own builders; layouts differ in what a node holds and in the order of the walk.

mod pair;
mod rope;
mod scene;
mod tree;
mod wide;

use glam::Vec3;

pub use scene::{LayoutScene, Totals, paper_arrays};
pub use tree::{Tree, TreeNode};

/// Which layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// The paper's: ropes in one fixed order. 32-byte nodes.
    Rope,
    /// The same without the inner nodes that cost more than they save.
    PrunedRope,
    /// Eight arrays of ropes, one for each octant of directions, the nearer child first.
    OctantRopes,
    /// The same, pruned.
    PrunedOctantRopes,
    /// 64-byte nodes that hold the boxes of two children. The nearer first, the other on a stack.
    Pair,
    /// 64-byte nodes of four children with 8-bit boxes, by distance.
    Wide4,
    /// 80-byte nodes of eight children with 8-bit boxes, by distance.
    Wide8,
    /// The same in the order of the direction's octant, without distances on the stack (Ylitie, Karras, Laine 2017).
    Wide8Octant,
}

impl Layout {
    /// All of them, the paper's first.
    pub const ALL: [Self; 8] = [
        Self::Rope,
        Self::PrunedRope,
        Self::OctantRopes,
        Self::PrunedOctantRopes,
        Self::Pair,
        Self::Wide4,
        Self::Wide8,
        Self::Wide8Octant,
    ];

    /// For tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rope => "rope",
            Self::PrunedRope => "rope, pruned",
            Self::OctantRopes => "8 octant ropes",
            Self::PrunedOctantRopes => "8 octant ropes, pruned",
            Self::Pair => "2 child boxes, stack",
            Self::Wide4 => "4-wide, 8-bit boxes, stack",
            Self::Wide8 => "8-wide, 8-bit boxes, stack",
            Self::Wide8Octant => "8-wide, octant order, stack",
        }
    }

    fn lay_out(self, tree: &Tree) -> Box<dyn Walk> {
        match self {
            Self::Rope => Box::new(rope::Rope::new(tree, false)),
            Self::PrunedRope => Box::new(rope::Rope::new(tree, true)),
            Self::OctantRopes => Box::new(rope::OctantRopes::new(tree, false)),
            Self::PrunedOctantRopes => Box::new(rope::OctantRopes::new(tree, true)),
            Self::Pair => Box::new(pair::Pairs::new(tree)),
            Self::Wide4 => Box::new(wide::Wide::<4>::new(tree, wide::Order::Distance)),
            Self::Wide8 => Box::new(wide::Wide::<8>::new(tree, wide::Order::Distance)),
            Self::Wide8Octant => Box::new(wide::Wide::<8>::new(tree, wide::Order::Octant)),
        }
    }
}

/// What one ray has done.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    /// Nodes fetched.
    pub nodes: u64,
    /// Boxes tested.
    pub boxes: u64,
    /// Triangles tested.
    pub triangles: u64,
    /// Bytes fetched: nodes, triangles, instances.
    pub bytes: u64,
    /// The most entries on the stack at once.
    pub stack: u64,
}

impl Counts {
    fn fetch(&mut self, bytes: usize, boxes: usize) {
        self.nodes += 1;
        self.boxes += boxes as u64;
        self.bytes += bytes as u64;
    }
}

/// Tests a leaf's triangles up to some distance and returns the distance up to which others matter; a negative one ends the walk.
pub(crate) type VisitLeaf<'a> = dyn FnMut(u32, u32, f32, &mut Counts) -> f32 + 'a;

/// A structure laid out.
trait Walk: Send + Sync {
    /// Bytes of all nodes.
    fn node_bytes(&self) -> usize;

    /// Visits the leaves that the ray meets. Returns the distance that the last of them left.
    fn walk(&self, ray: &SlabRay, t_max: f32, counts: &mut Counts, leaf: &mut VisitLeaf<'_>) -> f32;
}

/// A ray as boxes see it. It starts at its origin.
#[derive(Clone, Copy, Debug)]
struct SlabRay {
    origin: Vec3,
    reciprocal: Vec3,
}

/// As in the kernel: see its proof.
const BOX_SLACK: f32 = 1.0 - 1.0 / (1 << 18) as f32;
/// Directions are taken to be no shorter along an axis.
const LEAST_COMPONENT: f32 = 1e-18;

impl SlabRay {
    fn new(origin: Vec3, direction: Vec3) -> Self {
        let bounded = direction.abs().max(Vec3::splat(LEAST_COMPONENT));
        Self { origin, reciprocal: (bounded * direction.signum()).recip() }
    }

    /// Where the ray enters the box, if it does before `t_max`.
    fn enter(&self, [min, max]: [Vec3; 2], t_max: f32) -> Option<f32> {
        let (a, b) = ((min - self.origin) * self.reciprocal, (max - self.origin) * self.reciprocal);
        let t_near = a.min(b).max_element().max(0.0);
        let t_far = a.max(b).min_element().min(t_max);
        (t_near * BOX_SLACK <= t_far).then_some(t_near)
    }

    /// 1 or -1 along each axis.
    fn signs(&self) -> Vec3 {
        self.reciprocal.signum()
    }
}
