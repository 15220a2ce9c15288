//! From a build tree to device nodes: the one place where depth-first order and escape indices are set.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering::Relaxed};

use glam::{Vec3, Vec4, Vec4Swizzles};

use super::sah::{MAX_DEPTH, SahParams};
use super::tree::{BuildNode, BuildTree, Content, LaneBox};
use super::wide::{LEAF_SIZE, collapse};
use crate::device::layout::{NONE, Node, PrimitiveRange, WideNode};

/// No inner node of a [`Blas`](super::Blas) has more children.
pub const MAX_CHILDREN: usize = 8;

/// Trees of fewer nodes are flattened by one thread, others side by side down to [`TASK_DEPTH`].
const PARALLEL_MINIMUM: usize = 1 << 12;
/// See [`PARALLEL_MINIMUM`].
const TASK_DEPTH: u32 = 12;

/// What becomes of a build tree.
#[derive(Default)]
pub(super) struct Flat {
    /// In depth-first order.
    pub(super) nodes: Vec<Node>,
    /// The same, eight children a node.
    pub(super) wide_nodes: Vec<WideNode>,
    /// The primitives in leaf order: a leaf's range counts in it.
    pub(super) order: Vec<u32>,
}

/// Flattens a tree; `None` if it has more than [`MAX_DEPTH`] levels. O(n).
///
/// Each node's escape index is that of the node after its subtree (paper, section 3), or [`NONE`]. Of the two children of a node
/// of the tree the one with the larger surface comes first: it is hit more often, and what it hides need not be visited.
///
/// An inner node n with k children under a node a is left out, so that they become a's, where that makes fewer fetches: n is
/// fetched as often as a's box is met, and its children as often as its own box is; without it they are fetched as often as a's
/// is. How often that is goes by the surface A, so the condition is k A(a) < A(a) + k A(n). It is decided from the leaves up,
/// with a the node directly above. In the same way a subtree becomes a leaf where that is cheaper.
pub(super) fn flatten(tree: &BuildTree, params: &SahParams) -> Option<Flat> {
    if tree.nodes.is_empty() {
        return Some(Flat::default());
    }
    let parts = bytemuck::zeroed_vec(tree.nodes.len());
    let task_depth = if tree.nodes.len() < PARALLEL_MINIMUM { 0 } else { TASK_DEPTH };
    let heights = bytemuck::zeroed_vec(tree.nodes.len());
    let flattener = Flattener { tree, params, parts, heights, task_depth };
    let plan = flattener.plan(0, 0)?;
    let whole = plan.part;
    flattener.store(0, Part { tops: 1, ..whole }, plan.height);
    let mut order = bytemuck::zeroed_vec(whole.primitives as usize);
    let mut nodes = bytemuck::zeroed_vec(whole.nodes as usize);
    let place = Place { node: 0, primitive: 0, end: whole.nodes, depth: 0 };
    let emit = || flattener.emit(0, place, &mut nodes, &mut order);
    let ((), wide_nodes) = flattener.join(0, emit, || collapse(&flattener));
    Some(Flat { nodes, wide_nodes, order })
}

/// A tree, and what becomes of it.
pub(super) struct Flattener<'a> {
    tree: &'a BuildTree,
    params: &'a SahParams,
    /// What becomes of the subtree of each node, packed. Atomic for the threads that plan: they know which subtree is whose.
    parts: Vec<AtomicU64>,
    /// See [`height`](Self::height).
    heights: Vec<AtomicU8>,
    task_depth: u32,
}

/// What is below a node of the tree.
#[derive(Clone, Copy)]
pub(super) struct Subtree {
    pub(super) node: usize,
    /// The first of its primitives in the order of leaves.
    pub(super) first: u32,
}

/// What a subtree gives.
#[derive(Clone, Copy)]
pub(super) struct Part {
    pub(super) nodes: u32,
    pub(super) primitives: u32,
    /// How many of the nodes have none of the others above them: more than one where the root is left out.
    tops: u32,
}

impl Part {
    fn pack(self) -> u64 {
        u64::from(self.nodes) << 34 | u64::from(self.primitives) << 4 | u64::from(self.tops)
    }

    fn unpack(packed: u64) -> Self {
        let [nodes, primitives, tops] = [packed >> 34, packed >> 4, packed].map(|bits| bits as u32);
        Self { nodes, primitives: primitives & ((1 << 30) - 1), tops: tops & 15 }
    }
}

/// What a subtree gives with its root kept, with the root's children for tops.
#[derive(Clone, Copy)]
struct Plan {
    part: Part,
    /// Of the root's box, half the surface.
    area: f64,
    /// Of all that is below the root, in fetches times area.
    cost: f64,
    /// See [`Flattener::height`].
    height: u8,
}

impl Plan {
    /// Adds one of two children, and decides whether it is left out. Returns what it gives.
    fn add(&mut self, child: Plan) -> Part {
        let children = f64::from(child.part.tops);
        let saved = children * child.area + self.area - children * self.area;
        let left_out =
            child.part.tops > 0 && saved > 0.0 && self.part.tops + child.part.tops <= MAX_CHILDREN as u32 + 1;
        let part =
            if left_out { Part { nodes: child.part.nodes - 1, ..child.part } } else { Part { tops: 1, ..child.part } };
        self.part.nodes += part.nodes;
        self.part.primitives += part.primitives;
        self.part.tops += part.tops - 1;
        self.cost += child.cost + self.area;
        if left_out {
            self.cost -= saved;
        }
        part
    }
}

/// Where a subtree goes.
#[derive(Clone, Copy)]
struct Place {
    node: u32,
    primitive: u32,
    /// How many nodes there are in all.
    end: u32,
    depth: u32,
}

impl Flattener<'_> {
    /// Decides for all nodes below one whether they are kept. `None` if the tree is too deep, which recursion never is.
    fn plan(&self, index: usize, depth: u32) -> Option<Plan> {
        let node = &self.tree.nodes[index];
        let area = half_area(node);
        let leaf = |primitives: u32| Plan {
            part: Part { nodes: 1, primitives, tops: 0 },
            area,
            cost: area * f64::from(primitives) * f64::from(self.params.primitive_cost),
            height: 0,
        };
        let child = match node.content() {
            Content::Primitives(range) => return Some(leaf(range.len() as u32)),
            Content::Children(child) => child,
        };
        if depth + 1 == MAX_DEPTH as u32 {
            return None;
        }
        let plan = |child| self.plan(child, depth + 1);
        let plans = self.join(depth, || plan(child), || plan(child + 1));
        let mut whole = Plan { part: Part { nodes: 1, primitives: 0, tops: 2 }, area, cost: 0.0, height: 0 };
        for (child, plan) in [child, child + 1].into_iter().zip([plans.0?, plans.1?]) {
            let part = whole.add(plan);
            self.store(child, part, plan.height);
            whole.height = whole.height.max(plan.height + 1);
        }
        if whole.part.primitives <= LEAF_SIZE {
            whole.height = 0;
        }
        let leaf = self.primitives_of_leaf(index, &whole).map(leaf);
        leaf.filter(|leaf| leaf.cost <= whole.cost).or(Some(whole))
    }

    /// How many primitives there would be in a leaf instead of a subtree, if they are not too many.
    fn primitives_of_leaf(&self, index: usize, whole: &Plan) -> Option<u32> {
        let (primitives, most) = (whole.part.primitives as usize, self.params.max_leaf_size);
        if !self.tree.repeats {
            return (primitives <= most).then_some(primitives as u32);
        }
        // More may be more of the same.
        let mut room = [0; PrimitiveRange::MAX_COUNT as usize];
        let is_worth_a_look = primitives <= 2 * most;
        is_worth_a_look.then(|| self.tree.gather(index, &mut room[..most], 0)).flatten().map(|count| count as u32)
    }

    /// Writes a subtree to slices of its size. Recursion is as deep as the tree.
    fn emit(&self, index: usize, place: Place, mut nodes: &mut [Node], order: &mut [u32]) {
        let tree_node = &self.tree.nodes[index];
        let part = self.part(index);
        let mut inside = Place { depth: place.depth + 1, ..place };
        if part.tops == 1
            && let Some(node) = nodes.split_off_first_mut()
        {
            inside.node += 1;
            let next = inside.node + nodes.len() as u32;
            let [min, max] = self.corners(index);
            let escape_index = if next == place.end { NONE } else { next };
            let is_leaf = nodes.is_empty();
            let primitives =
                if is_leaf { PrimitiveRange::leaf(place.primitive, part.primitives) } else { PrimitiveRange::INNER };
            *node = Node { min: min.to_array(), escape_index, max: max.to_array(), primitives };
            if is_leaf {
                self.tree.gather(index, order, 0);
                return;
            }
        }
        match tree_node.content() {
            Content::Primitives(_) => {}
            Content::Children(child) => {
                let [first, second] = self.larger_first(child);
                let part = self.part(first);
                let (first_nodes, second_nodes) = nodes.split_at_mut(part.nodes as usize);
                let (first_order, second_order) = order.split_at_mut(part.primitives as usize);
                let second_place =
                    Place { node: inside.node + part.nodes, primitive: place.primitive + part.primitives, ..inside };
                self.join(
                    place.depth,
                    || self.emit(first, inside, first_nodes, first_order),
                    || self.emit(second, second_place, second_nodes, second_order),
                );
            }
        }
    }

    /// All of the tree.
    pub(super) fn root(&self) -> Subtree {
        Subtree { node: 0, first: 0 }
    }

    /// Of an inner node, in the order in which they are written.
    pub(super) fn children(&self, subtree: Subtree) -> [Subtree; 2] {
        match self.tree.nodes[subtree.node].content() {
            Content::Primitives(_) => [subtree; 2],
            Content::Children(child) => {
                let [first, second] = self.larger_first(child);
                [(first, 0), (second, self.part(first).primitives)]
                    .map(|(node, before)| Subtree { node, first: subtree.first + before })
            }
        }
    }

    /// The least and greatest corner of a node's box.
    pub(super) fn corners(&self, node: usize) -> [Vec3; 2] {
        let BuildNode { min, max, .. } = self.tree.nodes[node];
        padded(min, max).into()
    }

    /// Half the surface of a node's box.
    pub(super) fn half_area(&self, node: usize) -> f64 {
        half_area(&self.tree.nodes[node])
    }

    /// Levels of inner nodes, where [few](LEAF_SIZE) primitives are a leaf.
    pub(super) fn height(&self, node: usize) -> u8 {
        self.heights[node].load(Relaxed)
    }

    /// Does both, side by side near the root.
    fn join<A: Send, B: Send>(&self, depth: u32, a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B + Send) -> (A, B) {
        if depth < self.task_depth { rayon::join(a, b) } else { (a(), b()) }
    }

    fn store(&self, index: usize, part: Part, height: u8) {
        self.parts[index].store(part.pack(), Relaxed);
        self.heights[index].store(height, Relaxed);
    }

    pub(super) fn part(&self, index: usize) -> Part {
        Part::unpack(self.parts[index].load(Relaxed))
    }

    fn larger_first(&self, child: usize) -> [usize; 2] {
        let [left, right] = [child, child + 1].map(|index| half_area(&self.tree.nodes[index]));
        if right > left { [child + 1, child] } else { [child, child + 1] }
    }
}

/// In f64, where no box of finite floats has an infinite area.
fn half_area(node: &BuildNode) -> f64 {
    let d = node.max.as_dvec3() - node.min.as_dvec3();
    d.x * d.y + d.y * d.z + d.z * d.x
}

/// The box moved outward on every side: by 2 to 4 ulp of the coordinate, 2^-22 of the box's longest side and the smallest
/// normal number.
///
/// A slab test misses rays that lie exactly in a face plane, and all rays through a flat box. Ulps alone do not help a
/// flat box at coordinate 0, hence the share of the longest side; nor would a subnormal number, which a GPU may take for
/// zero. A box inside another stays inside: every operation here is monotonic. The result is finite.
pub(super) fn padded(min: Vec3, max: Vec3) -> (Vec3, Vec3) {
    let padded = padded_lanes(LaneBox { min: min.extend(0.0), max: max.extend(0.0) });
    (padded.min.xyz(), padded.max.xyz())
}

/// The same, four lanes at a time.
#[inline]
pub(super) fn padded_lanes(LaneBox { min, max }: LaneBox) -> LaneBox {
    const ULPS: f32 = 1.0 / (1 << 22) as f32;
    // What is in the fourth lanes may be a subnormal number, which would slow the other lanes a hundredfold.
    let (min, max) = (min.with_w(0.0), max.with_w(0.0));
    let half_side = (max * 0.5 - min * 0.5).max_element();
    let margin = Vec4::splat(half_side * (2.0 * ULPS) + f32::MIN_POSITIVE);
    let finite = Vec4::splat(f32::MAX);
    LaneBox {
        min: (min - (min.abs() * ULPS + margin)).max(-finite),
        max: (max + (max.abs() * ULPS + margin)).min(finite),
    }
}
