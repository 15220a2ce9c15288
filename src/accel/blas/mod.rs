//! The bottom level: a hierarchy over the triangles of one geometry, in local space.

mod collapse;
mod flatten;
mod prune;
mod quantize;
mod refit;
mod refit_wide;
mod triangle_bounds;

use glam::Vec3;
use rayon::prelude::*;

pub use self::collapse::MAX_WIDE_DEPTH;
use self::collapse::collapse;
use self::flatten::flatten;
pub use self::prune::MAX_CHILDREN;
use self::prune::PrunedTree;
pub(crate) use self::refit::{RefitReport, refit};
use super::build::coincident::{CoincidentTriangles, MergedTriangles};
use super::build::{build_tree, triangle_references};
use super::padding::SIDE_MARGIN;
use super::stats::BvhStats;
use super::tree::{PARALLEL_SUBTREE_THRESHOLD, SahParams};
use super::validate::{BvhError, validate_nodes};
use crate::device::layout::{Node, PrimitiveRange, Triangle, WideNode};
use crate::graph::{BlasKind, Geometry, Quality};
use crate::math::Aabb;
use crate::{Cancel, Result};

/// A bottom-level acceleration structure of one geometry: position-independent arrays that can be copied to any offset
/// of the device arrays.
#[derive(Clone, Debug, PartialEq)]
pub struct Blas {
    /// Binary nodes in depth-first order, escape indices relative to the first. Empty if no triangle can be hit.
    pub nodes: Vec<Node>,
    /// The same hierarchy as 8-wide nodes, indices relative to the first. Empty if `nodes` is.
    pub wide_nodes: Vec<WideNode>,
    /// Triangles in leaf order; [`Triangle::primitive`] is the triangle's index in the geometry.
    pub triangles: Vec<Triangle>,
    /// The box around `triangles`, local space, not padded; empty without any.
    pub bounds: Aabb,
    /// Whether some triangle is in several leaves (spatial splits), each of which bounds a part of it. It is then in
    /// `triangles` once for each: queries that count hits or multiply transmittance must count a triangle once.
    pub has_duplicates: bool,
    triangle_cost: f32,
    /// The triangles that are not in `triangles` since they coincide with others.
    merged: MergedTriangles,
}

/// How a [`Blas`] is built.
///
/// ```
/// use ropewalk::accel::BlasBuildParams;
/// use ropewalk::graph::{BlasKind, Quality};
///
/// let params = BlasBuildParams::new(BlasKind::Bvh(Quality::High)).with_max_leaf_size(4);
/// assert_eq!(params.max_leaf_size, 4);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct BlasBuildParams {
    /// Which structure is built, and so which builder.
    pub structure: BlasKind,
    /// The most triangles in a leaf, 1 to 15 (clamped).
    pub max_leaf_size: u32,
    /// Cost of a triangle test in units of one node fetch and box test. Higher values make smaller leaves: 1.0 gives
    /// 3.0 triangles a leaf on the Stanford dragon, 1.5 gives 2.25, 2.0 gives 1.8.
    pub triangle_cost: f32,
    /// The share of its longest side by which the box of a node is padded, on every side, besides a few ulps of its
    /// coordinates. [`DEFAULT_BOX_MARGIN`](Self::DEFAULT_BOX_MARGIN), 2^-18, is what the tolerance of the triangle test
    /// requires (`docs/ACCURACY.md`): with less, rays through edges may be lost, and structures may disagree; with
    /// more, boxes are met in vain. A [refit](Blas::refit) pads by the default.
    pub box_margin: f32,
}

impl BlasBuildParams {
    /// The default of [`box_margin`](Self::box_margin): 2^-18.
    pub const DEFAULT_BOX_MARGIN: f32 = SIDE_MARGIN;

    /// One triangle in each leaf, as in the paper.
    pub const PAPER: Self = Self {
        structure: BlasKind::Bvh(Quality::Medium),
        max_leaf_size: 1,
        triangle_cost: 1.5,
        box_margin: SIDE_MARGIN,
    };

    /// The default parameters with this structure.
    pub fn new(structure: BlasKind) -> Self {
        Self::default().with_structure(structure)
    }

    /// These parameters with another [structure](Self::structure).
    #[must_use]
    pub const fn with_structure(self, structure: BlasKind) -> Self {
        Self { structure, ..self }
    }

    /// These parameters with another [leaf size](Self::max_leaf_size).
    #[must_use]
    pub const fn with_max_leaf_size(self, max_leaf_size: u32) -> Self {
        Self { max_leaf_size, ..self }
    }

    /// These parameters with another [cost of a triangle test](Self::triangle_cost).
    #[must_use]
    pub const fn with_triangle_cost(self, triangle_cost: f32) -> Self {
        Self { triangle_cost, ..self }
    }

    /// These parameters with another [padding of boxes](Self::box_margin).
    #[must_use]
    pub const fn with_box_margin(self, box_margin: f32) -> Self {
        Self { box_margin, ..self }
    }
}

impl Default for BlasBuildParams {
    /// A BVH of medium quality, triangle cost 1.5, and leaves of up to 15 triangles where the SAH prefers them.
    fn default() -> Self {
        Self {
            structure: BlasKind::default(),
            max_leaf_size: PrimitiveRange::MAX_COUNT,
            triangle_cost: 1.5,
            box_margin: Self::DEFAULT_BOX_MARGIN,
        }
    }
}

impl Blas {
    /// Builds the structure, on all threads of the current rayon pool. O(n log n); temporary memory about 120 bytes a
    /// triangle, up to 280 for a kd-tree.
    ///
    /// - [`Quality::Low`]: agglomerative clustering along a Morton curve.
    /// - [`Quality::Medium`]: top-down binned SAH with object splits.
    /// - [`Quality::High`]: also spatial splits where boxes overlap, with up to 30 % more triangle references, followed
    ///   by reinsertion.
    /// - [`BlasKind::KdTree`]: spatial splits wherever possible until there are twice as many references as triangles,
    ///   object splits after that; planes are chosen by the SAH, and node boxes are clipped to their contents.
    ///
    /// Of triangles that coincide, the one of the lowest index stands for all, and the others are left out: triangles
    /// whose corners have the same positions, texture coordinates and colours, in the same winding, from whichever
    /// corner on. It would win at equal distance anyway, with one difference: light that passes is dimmed once by all
    /// of them. Triangles of opposite winding, of which a ray may cull one, are both kept.
    ///
    /// Degenerate triangles, whose corners lie exactly on one line (two equal corners do, too), are left out: no ray
    /// hits them, and no query finds them. Any other triangle is kept, however narrow.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`](crate::Error::InvalidGeometry) as [`Geometry::validate`] says. Geometry that a scene
    /// holds is valid.
    pub fn build(geometry: &Geometry, params: &BlasBuildParams) -> Result<Self> {
        Self::build_with_cancel(geometry, params, &Cancel::new())
    }

    /// As [`build`](Self::build), until the token stops it.
    ///
    /// # Errors
    /// As [`build`](Self::build), and [`Error::Cancelled`](crate::Error::Cancelled).
    pub fn build_with_cancel(geometry: &Geometry, params: &BlasBuildParams, cancel: &Cancel) -> Result<Self> {
        if geometry.indices.len() < PARALLEL_SUBTREE_THRESHOLD {
            Self::build_in_pool(geometry, params, cancel)
        } else {
            // Enter the rayon pool once instead of once per parallel loop.
            rayon::scope(|_| Self::build_in_pool(geometry, params, cancel))
        }
    }

    fn build_in_pool(geometry: &Geometry, params: &BlasBuildParams, cancel: &Cancel) -> Result<Self> {
        cancel.check()?;
        // 1. Bound the triangles.
        let (mut references, extent) = triangle_references(geometry)?;
        let count = references.len();
        // 2. Build a tree and write it as binary and wide device nodes. Only a clustered tree (`Quality::Low`) can be
        // too deep to be flattened; a binned SAH tree then replaces it.
        let sah_params = SahParams {
            max_leaf_size: params.max_leaf_size.clamp(1, PrimitiveRange::MAX_COUNT) as usize,
            primitive_cost: params.triangle_cost,
        };
        let coincident = CoincidentTriangles::new(geometry);
        let mut build_nodes = |structure: BlasKind| {
            let tree = build_tree(geometry, &mut references, &extent, structure, &sah_params, &coincident, cancel)?;
            let Some(pruned) = PrunedTree::new(&tree, &sah_params, params.box_margin) else { return Ok(None) };
            cancel.check()?;
            Ok(Some(pruned.join_near_root(0, || flatten(&pruned), || collapse(&pruned))))
        };
        let nodes = match build_nodes(params.structure)? {
            None => build_nodes(BlasKind::Bvh(Quality::Medium))?,
            nodes => nodes,
        };
        let (flat, wide_nodes) = nodes.unwrap_or_default();
        cancel.check()?;
        // 3. Copy the triangles in leaf order.
        let triangles = flat.primitive_indices.par_iter().with_min_len(CHUNK).map(|&p| triangle(geometry, p)).collect();
        let merged = coincident.finish();
        let has_duplicates = flat.primitive_indices.len() > count - merged.count();
        let blas = Self {
            nodes: flat.nodes,
            wide_nodes,
            triangles,
            bounds: extent.aabb(),
            has_duplicates,
            triangle_cost: params.triangle_cost,
            merged,
        };
        debug_assert_eq!(blas.validate(), Ok(()));
        Ok(blas)
    }

    /// Refits the structure to `geometry`, which must have the same triangles with other corner positions. Boxes are
    /// recomputed; the hierarchy stays. O(n) on all threads of the current rayon pool, about a fifth of a build's time.
    ///
    /// Returns false if a rebuild is needed: a triangle became or ceased to be [degenerate](Self::build), one that was
    /// left out no longer coincides with the one that stands for it, or the structure has duplicates
    /// ([`Quality::High`], [`BlasKind::KdTree`]: their leaves hold clipped triangles, and unclipped ones would make its
    /// boxes worse than those of a rebuild). Triangles that have come to coincide are all kept until the next build.
    /// The contents are unspecified after a degenerate triangle, unchanged otherwise.
    ///
    /// The structure gets worse the more the geometry deforms: compare [`stats`](Self::stats) with those after the
    /// build.
    #[must_use]
    pub fn refit(&mut self, geometry: &Geometry) -> bool {
        if self.has_duplicates || !self.merged.still_coincide(geometry) {
            return false;
        }
        let Self { nodes, wide_nodes, triangles, merged, triangle_cost, .. } = self;
        let refitted = refit(nodes, wide_nodes, triangles, geometry, merged.count(), *triangle_cost);
        if let Some(refitted) = &refitted {
            self.bounds = refitted.bounds;
            debug_assert_eq!(self.validate(), Ok(()));
        }
        refitted.is_some()
    }

    /// Checks the invariants that traversal relies on: escape indices, containment, no triangle twice in a leaf, and
    /// none in several leaves unless the structure [has duplicates](Self::has_duplicates). For a duplicated triangle,
    /// seven sample points of it must be covered by its leaves' boxes. O(n log n).
    ///
    /// # Errors
    /// The first [`BvhError`] found.
    pub fn validate(&self) -> Result<(), BvhError> {
        let duplicated = self.duplicated_primitives();
        let is_in_one_leaf = |triangle: &&Triangle| duplicated.binary_search(&triangle.primitive).is_err();
        // 1. Check the nodes, and the triangles that are in one leaf only.
        let mut next_triangle = 0;
        validate_nodes(&self.nodes, |range| {
            let first = range.first_primitive() as usize;
            let triangles = self.triangles.get(first..first + range.primitive_count() as usize)?;
            let in_order = first == next_triangle;
            next_triangle += triangles.len();
            in_order.then(|| Aabb::from_points(triangles.iter().filter(is_in_one_leaf).flat_map(corners)))
        })?;
        // 2. Check the triangles that are in several leaves.
        if let Some(&primitive) = duplicated.first().filter(|_| !self.has_duplicates) {
            return Err(BvhError::Repeated { primitive });
        }
        if let Some(triangle) = self.triangles.get(next_triangle) {
            return Err(BvhError::Missing { primitive: triangle.primitive });
        }
        let mut parts: Vec<(&Triangle, &Node)> = Vec::new();
        for node in self.nodes.iter().filter(|node| node.is_leaf()) {
            let triangles = &self.triangles[node.primitives.first_primitive() as usize..]
                [..node.primitives.primitive_count() as usize];
            parts
                .extend(triangles.iter().filter(|triangle| !is_in_one_leaf(triangle)).map(|triangle| (triangle, node)));
        }
        parts.sort_by_key(|(triangle, _)| triangle.primitive);
        parts.chunk_by(|(a, _), (b, _)| a.primitive == b.primitive).try_for_each(check_duplicates)
    }

    /// How many triangles of the geometry were left out because they [coincide](Self::build) with others.
    pub fn coincident_count(&self) -> usize {
        self.merged.count()
    }

    /// The triangles that were left out because they coincide with others.
    pub(crate) fn merged(&self) -> &MergedTriangles {
        &self.merged
    }

    /// Measures size and quality. O(n); O(n log n) for a structure with [duplicates](Self::has_duplicates).
    pub fn stats(&self) -> BvhStats {
        let bytes = size_of_val(&*self.nodes) + size_of_val(&*self.wide_nodes) + size_of_val(&*self.triangles);
        let duplicate_count = if self.has_duplicates { self.duplicated_primitives().len() } else { 0 };
        BvhStats { bytes, duplicate_count, ..BvhStats::of(&self.nodes, self.triangle_cost) }
    }

    /// The primitive index of every reference beyond the first of each primitive, ascending.
    fn duplicated_primitives(&self) -> Vec<u32> {
        let mut primitives: Vec<u32> = self.triangles.iter().map(|t| t.primitive).collect();
        primitives.sort_unstable();
        primitives.windows(2).filter(|pair| pair[0] == pair[1]).map(|pair| pair[0]).collect()
    }
}

/// Triangles per parallel chunk.
const CHUNK: usize = 1 << 13;

fn triangle(geometry: &Geometry, primitive: u32) -> Triangle {
    Triangle::new(geometry.indices[primitive as usize].map(|v| geometry.positions[v as usize].to_array()), primitive)
}

/// Checks the leaves of one duplicated triangle: all leaves differ, and their boxes cover its corners, edge midpoints
/// and centroid.
fn check_duplicates(parts: &[(&Triangle, &Node)]) -> Result<(), BvhError> {
    let Some(&(triangle, _)) = parts.first() else { return Ok(()) };
    let primitive = triangle.primitive;
    // 1. No leaf holds it twice.
    if parts.windows(2).any(|pair| std::ptr::eq(pair[0].1, pair[1].1)) {
        return Err(BvhError::Repeated { primitive });
    }
    // 2. Every sample point is in the box of some leaf.
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
