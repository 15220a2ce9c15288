//! Refits a bottom-level structure after its triangles moved: new boxes in an unchanged hierarchy.

use std::ops::Range;

use glam::{Vec3, Vec4, Vec4Swizzles};
use rayon::prelude::*;

use super::refit_wide::refit_wide;
use super::triangle_bounds::triangle_bounds;
use crate::accel::degenerate::is_degenerate;
use crate::accel::padding::pad_bounds;
use crate::accel::stats::half_area;
use crate::accel::tree::SimdAabb;
use crate::device::layout::{Node, Triangle, WideNode};
use crate::graph::Geometry;
use crate::math::Aabb;

/// Subtrees of at most this many nodes are refitted by one thread.
const TASK_SIZE: usize = 1 << 11;

/// The result of refitting one structure.
#[derive(Clone, Debug)]
pub(crate) struct RefitReport {
    /// The box around the triangles, not padded.
    pub(crate) bounds: Aabb,
    /// SAH cost (see [`BvhStats::sah_cost`](crate::accel::BvhStats::sah_cost)) before the refit.
    pub(crate) old_cost: f64,
    /// SAH cost after the refit.
    pub(crate) cost: f64,
    /// The ranges of nodes that changed; ascending.
    pub(crate) changed_nodes: Vec<Range<usize>>,
    /// From the first to the last wide node that changed.
    pub(crate) changed_wide_nodes: Option<Range<usize>>,
    /// The ranges of triangles that changed; ascending.
    pub(crate) changed_triangles: Vec<Range<usize>>,
}

/// Copies the corners of the triangles from `geometry` and recomputes all boxes, leaves to root. O(n) on all threads of
/// the current rayon pool. Leaf boxes are padded as by a builder; the box of an inner node is the union of its
/// children's.
///
/// `None` if the structure must be rebuilt, since its triangles are no longer the hittable ones of the geometry: some
/// became, or ceased to be, degenerate. `merged` is how many triangles were left out because they coincide with others;
/// callers must have checked that they still do, and must not pass a structure with duplicates. After `None` the arrays
/// hold unspecified values.
pub(crate) fn refit(
    nodes: &mut [Node],
    wide_nodes: &mut [WideNode],
    triangles: &mut [Triangle],
    geometry: &Geometry,
    merged: usize,
    triangle_cost: f32,
) -> Option<RefitReport> {
    // 1. Give up if the number of hittable triangles has changed.
    let hittable = triangles.len() + merged;
    if hittable != geometry.indices.len() && hittable != count_non_degenerate(geometry) {
        return None;
    }
    // 2. Refit subtrees in parallel, each with its own triangles.
    let node_count = nodes.len();
    let old_root = nodes.first().map_or(1.0, half_area);
    let (upper_nodes, ranges) = find_refit_tasks(nodes);
    let tasks = tasks(nodes, triangles, ranges);
    let subtrees: Vec<(RefitTask<'_>, RefittedSubtree)> = tasks
        .into_par_iter()
        .map(|mut task| {
            let subtree = task.refit(geometry, node_count, triangle_cost)?;
            Some((task, subtree))
        })
        .collect::<Option<_>>()?;
    // 3. Collect their bounds, costs and changed ranges.
    let mut bounds = SimdAabb::EMPTY;
    let mut refitted = RefitReport {
        bounds: Aabb::EMPTY,
        old_cost: 0.0,
        cost: 0.0,
        changed_nodes: Vec::new(),
        changed_wide_nodes: None,
        changed_triangles: Vec::new(),
    };
    for (task, subtree) in subtrees {
        bounds = bounds.union(subtree.bounds);
        refitted.old_cost += subtree.costs[0];
        refitted.cost += subtree.costs[1];
        if subtree.has_changed {
            push_merging(&mut refitted.changed_nodes, task.first_node..task.first_node + task.nodes.len());
            push_merging(
                &mut refitted.changed_triangles,
                task.first_triangle..task.first_triangle + task.triangles.len(),
            );
        }
    }
    refitted.bounds = Aabb { min: bounds.min.xyz(), max: bounds.max.xyz() };
    // 4. Refit the inner nodes above those subtrees.
    for index in upper_nodes.into_iter().rev() {
        let old = nodes[index];
        let (bounds, children) = children_bounds(nodes, index, 0, node_count);
        nodes[index] = with_bounds(&old, &bounds);
        refitted.old_cost += half_area(&old) * children;
        refitted.cost += half_area(&nodes[index]) * children;
        if nodes[index] != old {
            refitted.changed_nodes.push(index..index + 1);
        }
    }
    refitted.changed_nodes.sort_unstable_by_key(|range| range.start);
    // The root is fetched once; all other terms are relative to its area.
    refitted.old_cost = 1.0 + refitted.old_cost / old_root;
    refitted.cost = 1.0 + refitted.cost / nodes.first().map_or(1.0, half_area);
    // 5. Refit the wide nodes.
    if !refitted.changed_triangles.is_empty() {
        refitted.changed_wide_nodes = refit_wide(wide_nodes, triangles);
    }
    Some(refitted)
}

/// The number of triangles that are not degenerate; others are never hit.
fn count_non_degenerate(geometry: &Geometry) -> usize {
    let is_non_degenerate =
        |triangle: &&[u32; 3]| !is_degenerate(triangle.map(|vertex| geometry.positions[vertex as usize]));
    geometry.indices.par_chunks(1 << 13).map(|chunk| chunk.iter().filter(is_non_degenerate).count()).sum()
}

/// Splits the hierarchy into subtrees of at most [`TASK_SIZE`] nodes and the inner nodes above them. Returns those
/// nodes and the ranges of the subtrees; both ascending.
fn find_refit_tasks(nodes: &[Node]) -> (Vec<usize>, Vec<Range<usize>>) {
    let (mut upper_nodes, mut subtrees, mut index) = (Vec::new(), Vec::new(), 0);
    // Descend from the root, and cut off each subtree that is small enough.
    while index < nodes.len() {
        let end = nodes[index].subtree_end(nodes.len());
        if end - index > TASK_SIZE {
            upper_nodes.push(index);
            index += 1;
        } else {
            subtrees.push(index..end);
            index = end;
        }
    }
    (upper_nodes, subtrees)
}

/// A subtree with its triangles, which are contiguous because both are in leaf order.
struct RefitTask<'a> {
    nodes: &'a mut [Node],
    first_node: usize,
    triangles: &'a mut [Triangle],
    first_triangle: usize,
}

/// Divides the arrays between the subtrees.
fn tasks<'a>(
    mut nodes: &'a mut [Node],
    mut triangles: &'a mut [Triangle],
    subtrees: Vec<Range<usize>>,
) -> Vec<RefitTask<'a>> {
    let triangle_count = triangles.len();
    // 1. The first triangle of each subtree is that of its first leaf in depth-first order.
    let first_triangle = |subtree: &Range<usize>| {
        let leaf = nodes[subtree.start..].iter().find(|node| node.is_leaf());
        leaf.map_or(triangle_count, |leaf| leaf.primitives.first_primitive() as usize)
    };
    let starts: Vec<usize> = subtrees.iter().map(first_triangle).chain([triangle_count]).collect();
    // 2. Divide both arrays at these points.
    let mut node_start = 0;
    let mut tasks = Vec::with_capacity(subtrees.len());
    for (subtree, starts) in subtrees.into_iter().zip(starts.windows(2)) {
        let (_, rest) = std::mem::take(&mut nodes).split_at_mut(subtree.start - node_start);
        let (task_nodes, rest) = rest.split_at_mut(subtree.len());
        (nodes, node_start) = (rest, subtree.end);
        let (task_triangles, rest) = std::mem::take(&mut triangles).split_at_mut(starts[1] - starts[0]);
        triangles = rest;
        tasks.push(RefitTask {
            nodes: task_nodes,
            first_node: subtree.start,
            triangles: task_triangles,
            first_triangle: starts[0],
        });
    }
    tasks
}

/// What refitting one subtree found.
struct RefittedSubtree {
    bounds: SimdAabb,
    /// SAH cost before and after, in fetches times half area, not yet divided by the root's area.
    costs: [f64; 2],
    has_changed: bool,
}

impl RefitTask<'_> {
    /// Refits the subtree; `None` if a triangle is degenerate.
    fn refit(&mut self, geometry: &Geometry, node_count: usize, triangle_cost: f32) -> Option<RefittedSubtree> {
        // 1. Update the triangles.
        let mut subtree =
            RefittedSubtree { bounds: SimdAabb::EMPTY, costs: [0.0; 2], has_changed: self.update_triangles(geometry)? };
        // 2. Refit the nodes, children before parents: leaves from their triangles, inner nodes from their children.
        for index in (0..self.nodes.len()).rev() {
            let node = self.nodes[index];
            let count = node.primitives.primitive_count();
            let (bounds, fetches) = if count > 0 {
                let first = node.primitives.first_primitive() as usize - self.first_triangle;
                let bounds = triangle_bounds(&self.triangles[first..first + count as usize]);
                subtree.bounds = subtree.bounds.union(bounds);
                (pad_bounds(bounds), f64::from(count) * f64::from(triangle_cost))
            } else {
                children_bounds(self.nodes, index, self.first_node, node_count)
            };
            let new = with_bounds(&node, &bounds);
            self.nodes[index] = new;
            subtree.costs[0] += half_area(&node) * fetches;
            subtree.costs[1] += half_area(&new) * fetches;
        }
        Some(subtree)
    }

    /// Copies the corners of the triangles from `geometry`. Returns whether any of them changed; `None` as in
    /// [`refit`](Self::refit), or if a coordinate is not finite.
    fn update_triangles(&mut self, geometry: &Geometry) -> Option<bool> {
        // For each triangle: load its corners, check that they span an area and are finite, compare them with the old
        // ones, store them.
        let (mut difference, mut is_non_degenerate, mut finiteness_probe) = (0, true, Vec3::ZERO);
        for triangle in &mut *self.triangles {
            let corners = geometry.indices.get(triangle.primitive as usize)?;
            let [a, b, c] = corners.map(|v| geometry.positions.get(v as usize).copied().unwrap_or(Vec3::NAN));
            is_non_degenerate &= !is_degenerate([a, b, c]);
            // `x * 0` is NaN for an infinite or NaN coordinate, so the sum stays zero only if all are finite.
            finiteness_probe += (a + b * 0.0 + c * 0.0) * 0.0;
            let new = Triangle::new([a, b, c].map(|corner| corner.to_array()), triangle.primitive);
            let [new_bits, old_bits] = [new, *triangle].map(bytemuck::cast::<_, [u32; 12]>);
            difference |= new_bits.iter().zip(&old_bits).fold(0, |bits, (a, b)| bits | (a ^ b));
            *triangle = new;
        }
        (is_non_degenerate && finiteness_probe == Vec3::ZERO).then_some(difference != 0)
    }
}

/// The box around an inner node's children, and their number. `nodes` is the part of the whole array that starts at
/// index `first`.
fn children_bounds(nodes: &[Node], index: usize, first: usize, node_count: usize) -> (SimdAabb, f64) {
    let (mut bounds, mut children) = (SimdAabb::EMPTY, 0.0);
    let end_of = |node: &Node| node.subtree_end(node_count) - first;
    // Visit the children along their escape indices.
    let (mut child, end) = (index + 1, end_of(&nodes[index]));
    while child < end {
        let [min, max] = bytemuck::cast::<_, [Vec4; 2]>(nodes[child]);
        bounds = bounds.union(SimdAabb { min, max });
        children += 1.0;
        child = end_of(&nodes[child]);
    }
    (bounds, children)
}

/// The node with another box; its escape index and primitives, in the fourth lanes, are kept.
#[inline]
fn with_bounds(node: &Node, bounds: &SimdAabb) -> Node {
    let [min, max] = bytemuck::cast::<_, [Vec4; 2]>(*node);
    bytemuck::cast([bounds.min.with_w(min.w), bounds.max.with_w(max.w)])
}

/// Appends a range, merging it with the last one if they touch.
fn push_merging(ranges: &mut Vec<Range<usize>>, range: Range<usize>) {
    match ranges.last_mut() {
        Some(last) if last.end == range.start => last.end = range.end,
        _ => ranges.push(range),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::stats::BvhStats;
    use crate::accel::validate::validate_nodes;
    use crate::accel::{Blas, BlasBuildParams};
    use crate::device::layout::NONE;

    const COST: f32 = 1.5;

    /// A wavy sheet of 2 * 100 * 100 triangles.
    fn sheet(phase: f32) -> Geometry {
        let place = |i: u32| {
            let [x, y] = [i % 101, i / 101].map(|i| i as f32 / 10.0);
            Vec3::new(x, y, (x + phase).sin() * (y * (1.0 + phase)).cos())
        };
        let cells = (0..10_000_u32).map(|i| i + i / 100);
        let triangles = cells.flat_map(|a| [[a, a + 1, a + 102], [a, a + 102, a + 101]]);
        Geometry::new((0..101 * 101).map(place).collect::<Vec<_>>(), triangles.collect::<Vec<_>>())
    }

    /// The same hierarchy with four of five inner nodes removed, so that others have up to 2^5 children.
    fn thinned(nodes: &[Node]) -> Vec<Node> {
        let stays = |(i, node): (usize, &Node)| i == 0 || node.primitives.primitive_count() > 0 || i % 5 == 0;
        let mut places = vec![0; nodes.len() + 1];
        for (i, node) in nodes.iter().enumerate() {
            places[i + 1] = places[i] + u32::from(stays((i, node)));
        }
        let linked = |(_, node): (usize, &Node)| match node.escape_index {
            NONE => *node,
            escape_index => Node { escape_index: places[escape_index as usize], ..*node },
        };
        nodes.iter().enumerate().filter(|&node| stays(node)).map(linked).collect()
    }

    #[test]
    fn nodes_of_many_children_and_costs() {
        let blas = Blas::build(&sheet(0.0), &BlasBuildParams::default()).unwrap();
        for mut nodes in [blas.nodes.clone(), thinned(&blas.nodes)] {
            let mut triangles = blas.triangles.clone();
            let old_cost = BvhStats::of(&nodes, COST).sah_cost;
            let refitted = refit(&mut nodes, &mut [], &mut triangles, &sheet(1.0), 0, COST).unwrap();
            let valid = validate_nodes(&nodes, |range| {
                let first = range.first_primitive() as usize;
                let bounds = triangle_bounds(&triangles[first..first + range.primitive_count() as usize]);
                Some(Aabb { min: bounds.min.xyz(), max: bounds.max.xyz() })
            });
            assert_eq!(valid, Ok(()));
            let cost = BvhStats::of(&nodes, COST).sah_cost;
            assert!(cost > old_cost * 1.01, "{old_cost} to {cost}");
            assert!((refitted.old_cost / old_cost - 1.0).abs() < 1e-9, "{} {old_cost}", refitted.old_cost);
            assert!((refitted.cost / cost - 1.0).abs() < 1e-9, "{} {cost}", refitted.cost);
            let total = |ranges: &[Range<usize>]| ranges.iter().map(ExactSizeIterator::len).sum::<usize>();
            assert_eq!(total(&refitted.changed_nodes), nodes.len());
            assert_eq!(total(&refitted.changed_triangles), triangles.len());
        }
    }

    #[test]
    fn only_what_changed_is_told() {
        let mut blas = Blas::build(&sheet(0.0), &BlasBuildParams::default()).unwrap();
        assert!(blas.refit(&sheet(0.0)));
        let before = blas.clone();
        let mut geometry = sheet(0.0);
        geometry.positions =
            geometry.positions.iter().enumerate().map(|(i, p)| if i == 5 { *p * 0.99 } else { *p }).collect();
        let refitted = refit(&mut blas.nodes, &mut blas.wide_nodes, &mut blas.triangles, &geometry, 0, COST).unwrap();
        let told = |ranges: &[Range<usize>], i: usize| ranges.iter().any(|range| range.contains(&i));
        for (i, (new, old)) in blas.nodes.iter().zip(&before.nodes).enumerate() {
            assert!(new == old || told(&refitted.changed_nodes, i), "node {i}");
        }
        for (i, (new, old)) in blas.triangles.iter().zip(&before.triangles).enumerate() {
            assert!(new == old || told(&refitted.changed_triangles, i), "triangle {i}");
        }
        let count: usize = refitted.changed_triangles.iter().map(ExactSizeIterator::len).sum();
        assert!(count > 0 && count < blas.triangles.len() / 2, "{count} of {}", blas.triangles.len());
        let nothing = refit(&mut blas.nodes, &mut blas.wide_nodes, &mut blas.triangles, &geometry, 0, COST).unwrap();
        assert!(nothing.changed_nodes.is_empty() && nothing.changed_triangles.is_empty());
    }
}
