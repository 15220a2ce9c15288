//! The bottom level: a hierarchy over the triangles of one geometry, in local space.

mod collapse;
mod flatten;
mod prune;
mod refit;
mod refit_wide;

use glam::Vec3;
use rayon::prelude::*;

pub use self::collapse::MAX_WIDE_DEPTH;
use self::collapse::collapse;
use self::flatten::flatten;
pub use self::prune::MAX_CHILDREN;
use self::prune::PrunedTree;
pub(crate) use self::refit::{RefitReport, refit};
use super::build::{SahParams, build_tree, triangle_references};
use super::stats::BvhStats;
use super::tree::PARALLEL_SUBTREE_THRESHOLD;
use super::validate::{BvhError, validate_nodes};
use crate::Result;
use crate::device::layout::{Node, PrimitiveRange, Triangle, WideNode};
use crate::graph::{BlasKind, Geometry, Quality};
use crate::math::Aabb;

/// A bottom-level structure: arrays that are copied to the device as they are, at any offset.
#[derive(Clone, Debug, PartialEq)]
pub struct Blas {
    /// In depth-first order, escape indices relative to the first. Empty where there is nothing to hit.
    pub nodes: Vec<Node>,
    /// The same hierarchy with eight children a node, indices relative to the first. Empty where `nodes` is.
    pub wide_nodes: Vec<WideNode>,
    /// In leaf order; [`Triangle::primitive`] is the triangle's index in the geometry.
    pub triangles: Vec<Triangle>,
    /// The box around `triangles`, local space, not padded; empty without any.
    pub bounds: Aabb,
    /// Whether some triangle is in several leaves, each with a box around a part of it. It is in `triangles` as often: whoever
    /// counts what a ray crosses must see to it that it counts once.
    pub has_duplicates: bool,
    triangle_cost: f32,
}

/// How a [`Blas`] is built.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlasBuildParams {
    /// What is built, and by which builder.
    pub structure: BlasKind,
    /// The most triangles in a leaf, 1 to 15 (clamped).
    pub max_leaf_size: u32,
    /// Cost of testing a triangle, in units of fetching a node and testing its box. Dearer triangles make smaller leaves:
    /// 1.0 gives 3.0 triangles a leaf on the Stanford dragon, 1.5 gives 2.25, 2.0 gives 1.8.
    pub triangle_cost: f32,
}

impl BlasBuildParams {
    /// One triangle a leaf, as in the paper.
    pub const PAPER: Self = Self { structure: BlasKind::Bvh(Quality::Medium), max_leaf_size: 1, triangle_cost: 1.5 };

    /// By default, but this structure.
    pub fn new(structure: BlasKind) -> Self {
        Self { structure, ..Self::default() }
    }
}

impl Default for BlasBuildParams {
    /// As many triangles a leaf as the heuristic likes.
    fn default() -> Self {
        Self { structure: BlasKind::default(), max_leaf_size: PrimitiveRange::MAX_COUNT, triangle_cost: 1.5 }
    }
}

impl Blas {
    /// Builds the structure, on all threads of the current rayon pool. O(n log n); temporary memory about 120 bytes a
    /// triangle, up to 280 for a kd-tree.
    ///
    /// [`Quality::Low`] merges neighbours along a space-filling curve. [`Quality::Medium`] divides triangles by the surface area
    /// heuristic, from the top down. [`Quality::High`] cuts space, too, where boxes overlap, with up to 30 % more triangles in the
    /// leaves, then moves subtrees to where they are better. [`BlasKind::KdTree`] cuts space as long as leaves then have no more
    /// than twice the triangles, and divides them where that is used up: the planes are the heuristic's, nodes are cells cut
    /// down to what is in them.
    ///
    /// Triangles with two equal corners are left out: no ray hits them. Other triangles without area stay in, and it is the
    /// triangle test that misses them.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`](crate::Error::InvalidGeometry) as [`Geometry::validate`] says. Geometry that a scene holds
    /// is valid.
    pub fn build(geometry: &Geometry, params: &BlasBuildParams) -> Result<Self> {
        if geometry.indices.len() < PARALLEL_SUBTREE_THRESHOLD {
            Self::build_in_pool(geometry, params)
        } else {
            // One entry into the pool, not one for each parallel loop.
            rayon::scope(|_| Self::build_in_pool(geometry, params))
        }
    }

    fn build_in_pool(geometry: &Geometry, params: &BlasBuildParams) -> Result<Self> {
        // 1. The boxes of the triangles.
        let (mut references, extent) = triangle_references(geometry)?;
        let count = references.len();
        // 2. A build tree, and from that device nodes. Only the tree of `Quality::Low` can be too deep for them.
        let sah_params = SahParams {
            max_leaf_size: params.max_leaf_size.clamp(1, PrimitiveRange::MAX_COUNT) as usize,
            primitive_cost: params.triangle_cost,
        };
        let mut build_nodes = |structure: BlasKind| {
            let tree = build_tree(geometry, &mut references, &extent, structure, &sah_params);
            let pruned = PrunedTree::new(&tree, &sah_params)?;
            Some(pruned.join_near_root(0, || flatten(&pruned), || collapse(&pruned)))
        };
        let nodes = build_nodes(params.structure).or_else(|| build_nodes(BlasKind::Bvh(Quality::Medium)));
        let (flat, wide_nodes) = nodes.unwrap_or_default();
        // 3. The triangles, in the order of the leaves.
        let triangles = flat.order.par_iter().with_min_len(CHUNK).map(|&p| triangle(geometry, p)).collect();
        let (bounds, repeats) = (extent.aabb(), flat.order.len() > count);
        let blas = Self {
            nodes: flat.nodes,
            wide_nodes,
            triangles,
            bounds,
            has_duplicates: repeats,
            triangle_cost: params.triangle_cost,
        };
        debug_assert_eq!(blas.validate(), Ok(()));
        Ok(blas)
    }

    /// Puts the triangles where those of `geometry` are now: the same ones, with their corners elsewhere. The nodes get new boxes
    /// and stay where they are. O(n), on all threads of the current rayon pool; a fifth of the time of a build.
    ///
    /// Whether it could: not where triangles got or lost two equal corners, nor where the structure has some triangles more
    /// than once, as [`Quality::High`] and [`BlasKind::KdTree`] do (their leaves hold clipped triangles, and with whole ones they
    /// would be worse than a new structure). It must then be built anew: what it holds is unspecified.
    ///
    /// The more the geometry deforms, the worse the structure: compare [`stats`](Self::stats) with those when it was built.
    #[must_use]
    pub fn refit(&mut self, geometry: &Geometry) -> bool {
        if self.has_duplicates {
            return false;
        }
        let refitted = refit(&mut self.nodes, &mut self.wide_nodes, &mut self.triangles, geometry, self.triangle_cost);
        if let Some(refitted) = &refitted {
            self.bounds = refitted.bounds;
            debug_assert_eq!(self.validate(), Ok(()));
        }
        refitted.is_some()
    }

    /// Checks what traversal relies on: escape order, containment, no triangle twice in a leaf, and none in several if nothing
    /// [repeats](Self::has_duplicates); of one that is in several, that some points of it are in their boxes. O(n log n).
    ///
    /// # Errors
    /// The first [`BvhError`] found.
    pub fn validate(&self) -> Result<(), BvhError> {
        let copies = self.duplicated_primitives();
        let is_whole = |triangle: &&Triangle| copies.binary_search(&triangle.primitive).is_err();
        // 1. Nodes, and the triangles that are in one leaf.
        let mut next_triangle = 0;
        validate_nodes(&self.nodes, |range| {
            let first = range.first_primitive() as usize;
            let triangles = self.triangles.get(first..first + range.primitive_count() as usize)?;
            let in_order = first == next_triangle;
            next_triangle += triangles.len();
            in_order.then(|| Aabb::from_points(triangles.iter().filter(is_whole).flat_map(corners)))
        })?;
        // 2. The triangles that are in several.
        if let Some(&primitive) = copies.first().filter(|_| !self.has_duplicates) {
            return Err(BvhError::Repeated { primitive });
        }
        if let Some(triangle) = self.triangles.get(next_triangle) {
            return Err(BvhError::Missing { primitive: triangle.primitive });
        }
        let mut parts: Vec<(&Triangle, &Node)> = Vec::new();
        for node in self.nodes.iter().filter(|node| node.primitives != PrimitiveRange::INNER) {
            let triangles = &self.triangles[node.primitives.first_primitive() as usize..]
                [..node.primitives.primitive_count() as usize];
            parts.extend(triangles.iter().filter(|triangle| !is_whole(triangle)).map(|triangle| (triangle, node)));
        }
        parts.sort_by_key(|(triangle, _)| triangle.primitive);
        parts.chunk_by(|(a, _), (b, _)| a.primitive == b.primitive).try_for_each(check_duplicates)
    }

    /// Sizes and quality. O(n), and a sort where triangles [repeat](Self::has_duplicates).
    pub fn stats(&self) -> BvhStats {
        let bytes = size_of_val(&*self.nodes) + size_of_val(&*self.wide_nodes) + size_of_val(&*self.triangles);
        let duplicate_count = if self.has_duplicates { self.duplicated_primitives().len() } else { 0 };
        BvhStats { bytes, duplicate_count, ..BvhStats::of(&self.nodes, self.triangle_cost) }
    }

    /// The primitives of all triangles but the first of each primitive, ascending.
    fn duplicated_primitives(&self) -> Vec<u32> {
        let mut primitives: Vec<u32> = self.triangles.iter().map(|t| t.primitive).collect();
        primitives.sort_unstable();
        primitives.windows(2).filter(|pair| pair[0] == pair[1]).map(|pair| pair[0]).collect()
    }
}

/// Triangles that one thread takes at a time.
const CHUNK: usize = 1 << 13;

fn triangle(geometry: &Geometry, primitive: u32) -> Triangle {
    let [v0, v1, v2] = geometry.indices[primitive as usize].map(|v| geometry.positions[v as usize].to_array());
    Triangle { v0, primitive, v1, _pad0: 0, v2, _pad1: 0 }
}

/// The leaves of one triangle: all different, and around its corners and its middles.
fn check_duplicates(parts: &[(&Triangle, &Node)]) -> Result<(), BvhError> {
    let Some(&(triangle, _)) = parts.first() else { return Ok(()) };
    let primitive = triangle.primitive;
    if parts.windows(2).any(|pair| std::ptr::eq(pair[0].1, pair[1].1)) {
        return Err(BvhError::Repeated { primitive });
    }
    let [a, b, c] = corners(triangle);
    let points = [a, b, c, a.midpoint(b), b.midpoint(c), c.midpoint(a), (a / 3.0 + b / 3.0) + c / 3.0];
    let is_covered = |point: &Vec3| {
        let contains =
            |node: &Node| Vec3::from(node.min).cmple(*point).all() && Vec3::from(node.max).cmpge(*point).all();
        parts.iter().any(|(_, node)| contains(node))
    };
    if points.iter().all(is_covered) { Ok(()) } else { Err(BvhError::Missing { primitive }) }
}

fn corners(triangle: &Triangle) -> [Vec3; 3] {
    [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from_array)
}
