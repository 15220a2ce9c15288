//! Hypothetical node layouts: layouts that Ropewalk does not have, each with a simple scalar traversal that counts what
//! a ray reads.
//!
//! Boxes and leaves are those of Ropewalk's builders. Layouts differ in what a node holds and in the order in which
//! children are visited. What the two traversals of the kernel read,
//! [`KernelCounts`](crate::kernel_counts::KernelCounts) tells.

mod octant_ropes;
mod pair;
mod scene;
mod tree;
mod wide;

use glam::Vec3;

pub use scene::{LayoutScene, Totals, paper_arrays};
pub use tree::{Tree, TreeNode};

/// A hypothetical layout, of both levels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Eight depth-first arrays with escape indices, one for each octant of ray directions, the nearer child first.
    /// 32-byte nodes.
    OctantRopes,
    /// The same without the inner nodes that cost more box tests than they save.
    PrunedOctantRopes,
    /// 64-byte nodes that hold the boxes of two children. The nearer child is visited first, the other waits on a
    /// stack.
    Pair,
    /// 64-byte nodes of four children with 8-bit boxes, visited by distance.
    Wide4,
    /// 80-byte nodes of eight children with 8-bit boxes, visited in the order of the direction's octant, without
    /// distances on the stack (Ylitie, Karras, Laine 2017). The kernel's wide nodes are visited by distance.
    Wide8Octant,
}

impl Layout {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::OctantRopes, Self::PrunedOctantRopes, Self::Pair, Self::Wide4, Self::Wide8Octant];

    /// For tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::OctantRopes => "8 octant ropes",
            Self::PrunedOctantRopes => "8 octant ropes, pruned",
            Self::Pair => "2 child boxes, stack",
            Self::Wide4 => "4-wide, 8-bit boxes, stack",
            Self::Wide8Octant => "8-wide, octant order, stack",
        }
    }

    fn lay_out(self, tree: &Tree) -> Box<dyn Walk> {
        match self {
            Self::OctantRopes => Box::new(octant_ropes::OctantRopes::new(tree, false)),
            Self::PrunedOctantRopes => Box::new(octant_ropes::OctantRopes::new(tree, true)),
            Self::Pair => Box::new(pair::Pairs::new(tree)),
            Self::Wide4 => Box::new(wide::Wide::<4>::new(tree, wide::Order::Distance)),
            Self::Wide8Octant => Box::new(wide::Wide::<8>::new(tree, wide::Order::Octant)),
        }
    }
}

/// What one ray has read and tested.
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

/// Tests the triangles of a leaf, given its first triangle, their number and the greatest distance that matters.
/// Returns the new greatest distance; a negative one ends the traversal.
pub(crate) type VisitLeaf<'a> = dyn FnMut(u32, u32, f32, &mut Counts) -> f32 + 'a;

/// A hierarchy in some layout.
trait Walk: Send + Sync {
    /// Bytes of all nodes.
    fn node_bytes(&self) -> usize;

    /// Visits the leaves whose boxes the ray enters before `t_max`. Returns the greatest distance that matters after
    /// the last leaf.
    fn walk(&self, ray: &SlabRay, t_max: f32, counts: &mut Counts, leaf: &mut VisitLeaf<'_>) -> f32;
}

/// A ray as the slab test needs it. It starts at its origin.
#[derive(Clone, Copy, Debug)]
struct SlabRay {
    origin: Vec3,
    reciprocal: Vec3,
}

/// Widens the slab test against rounding, as in the kernel (`src/trace/kernel/intersect.rs` has the proof).
const BOX_SLACK: f32 = 1.0 - 1.0 / (1 << 18) as f32;
/// The least absolute value of a direction's component: shorter ones are replaced by it, so that their reciprocals are
/// finite.
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
