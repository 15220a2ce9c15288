//! How far a geometry reaches in any direction: its support function, for tight boxes of placed geometries.

use glam::{DAffine3, DVec3, Vec3};

use super::Blas;
use crate::device::layout::{Node, PrimitiveRange, Triangle};
use crate::math::{Aabb, Bounds};

/// What it takes to find the box around a transformed geometry in well under a microsecond, however many triangles it has.
///
/// - Of a geometry with at most 64 different corners these are kept: the box is exact.
/// - Of others it is kept how far they reach in some directions: the vectors from the centre of a cube to the points of a grid
///   on its surface, 16 by 16 cells a face from 16,384 triangles on, else 8 by 8. How far is a convex function on each face, so
///   interpolating it between the corners of a triangle of the grid never gives too little. It gives too much by at most 0.09
///   (0.18 for 8 cells) of half the diagonal of the geometry's box (where an edge of its hull is seen end on), by 0.004 (0.016) of
///   the radius for a sphere, and by nothing along the axes of the local space. Where the transformed box of the geometry
///   is smaller, that counts.
///
/// Memory: at most 7 kB, 2 kB for 8 cells.
#[derive(Clone, Debug)]
pub struct SupportFunction {
    bounds: Bounds,
    shape: SupportSamples,
}

impl Default for SupportFunction {
    /// Of nothing.
    fn default() -> Self {
        Self { bounds: Bounds::EMPTY, shape: SupportSamples::Corners(Vec::new()) }
    }
}

#[derive(Clone, Debug)]
enum SupportSamples {
    /// All corners.
    Corners(Vec<Vec3>),
    Grid(DirectionGrid),
}

/// Geometries with so many different corners or fewer keep them.
const MAX_EXACT_VERTICES: usize = 64;

/// Geometries with so many triangles get the finer grid: its cost is small beside that of their hierarchy.
const FINE_GRID_TRIANGLES: usize = 1 << 14;

/// What has just been refitted gets a grid with so many cells along an edge.
const REFIT_GRID_CELLS: usize = 2;

/// How far a geometry reaches from the centre of its box, in units of half the box's diagonal.
#[derive(Clone, Debug)]
struct DirectionGrid {
    /// Along an edge of the cube; even, so that the axes are vectors of the grid.
    cells: usize,
    /// For each vector, see [`index`](Self::index).
    support_values: Box<[f32]>,
}

impl SupportFunction {
    /// Of the triangles of a bottom-level structure. It costs a search through the hierarchy for each direction, each starting
    /// with what the one before has found: 1 ms for the Stanford dragon.
    pub fn new(blas: &Blas) -> Self {
        let cells = if blas.triangles.len() < FINE_GRID_TRIANGLES { 8 } else { 16 };
        Self::with_cells(&blas.nodes, &blas.triangles, blas.bounds, cells)
    }

    /// The same of a structure that was just refitted, in little time beside that of the refit: with 2 by 2 cells a face, boxes are
    /// larger (of a sphere, a fifth in area).
    pub(crate) fn coarse(nodes: &[Node], triangles: &[Triangle], bounds: Aabb) -> Self {
        Self::with_cells(nodes, triangles, bounds, REFIT_GRID_CELLS)
    }

    fn with_cells(nodes: &[Node], triangles: &[Triangle], bounds: Aabb, cells: usize) -> Self {
        let bounds = Bounds::from(bounds);
        let shape = match distinct_vertices(triangles) {
            Some(corners) => SupportSamples::Corners(corners),
            None => SupportSamples::Grid(DirectionGrid::new(nodes, triangles, &bounds, cells)),
        };
        Self { bounds, shape }
    }

    /// A box around the transformed geometry, in the space that `world_from_local` leads to; empty if there is nothing to hit.
    /// The result is rounded: by some ulp of the coordinates, in f64.
    pub fn world_bounds(&self, world_from_local: &DAffine3) -> Bounds {
        match &self.shape {
            SupportSamples::Corners(corners) => corners.iter().fold(Bounds::EMPTY, |bounds, corner| {
                let corner = world_from_local.transform_point3(corner.as_dvec3());
                bounds.union(Bounds { min: corner, max: corner })
            }),
            SupportSamples::Grid(grid) => {
                let half = self.bounds.max * 0.5 - self.bounds.min * 0.5;
                let unit = half.length();
                let rows = world_from_local.matrix3.transpose();
                let center = world_from_local.transform_point3(self.bounds.center());
                let reach = |direction: DVec3| {
                    let of_box = direction.abs().dot(half);
                    (grid.support_value(direction) * unit).min(of_box)
                };
                let upper = DVec3::new(reach(rows.x_axis), reach(rows.y_axis), reach(rows.z_axis));
                let lower = DVec3::new(reach(-rows.x_axis), reach(-rows.y_axis), reach(-rows.z_axis));
                Bounds { min: center - lower, max: center + upper }
            }
        }
    }
}

/// The different corners of all triangles, if they are few.
fn distinct_vertices(triangles: &[Triangle]) -> Option<Vec<Vec3>> {
    // No closed surface has more triangles for its corners; others may keep the grid.
    if triangles.len() > 2 * MAX_EXACT_VERTICES {
        return None;
    }
    let mut corners: Vec<[f32; 3]> = triangles.iter().flat_map(|t| [t.v0, t.v1, t.v2]).collect();
    corners.sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    corners.dedup();
    (corners.len() <= MAX_EXACT_VERTICES).then(|| corners.into_iter().map(Vec3::from).collect())
}

impl DirectionGrid {
    fn new(nodes: &[Node], triangles: &[Triangle], bounds: &Bounds, cells: usize) -> Self {
        let mut grid = Self { cells, support_values: vec![0.0; 6 * (cells + 1) * (cells + 1)].into_boxed_slice() };
        let (center, unit) = (bounds.center(), bounds.radius());
        let mut farthest = center;
        for face in 0..6 {
            for v in 0..=cells {
                // There and back, so that one direction is near the next.
                for step in 0..=cells {
                    let u = if v % 2 == 0 { step } else { cells - step };
                    let direction = grid.grid_direction(face, u, v);
                    farthest = support_point(nodes, triangles, direction, farthest);
                    let reach = ((farthest - center) / unit).dot(direction);
                    grid.support_values[grid.index(face, u, v)] = (reach as f32).next_up();
                }
            }
        }
        grid
    }

    /// Faces 0 to 2 look along the positive axes, 3 to 5 along the negative ones.
    fn grid_direction(&self, face: usize, u: usize, v: usize) -> DVec3 {
        let axis = face % 3;
        let coordinate = |point: usize| 2.0 * point as f64 / self.cells as f64 - 1.0;
        let mut vector = DVec3::ZERO;
        vector[axis] = if face < 3 { 1.0 } else { -1.0 };
        vector[(axis + 1) % 3] = coordinate(u);
        vector[(axis + 2) % 3] = coordinate(v);
        vector
    }

    fn index(&self, face: usize, u: usize, v: usize) -> usize {
        (face * (self.cells + 1) + v) * (self.cells + 1) + u
    }

    /// How far a geometry reaches along `direction`, or more.
    fn support_value(&self, direction: DVec3) -> f64 {
        // 1. The face of the cube that the direction goes through, and where.
        let length = direction.abs();
        let axis = if length.x >= length.y && length.x >= length.z { 0 } else { 1 + usize::from(length.z > length.y) };
        let depth = length[axis];
        if depth == 0.0 {
            return 0.0;
        }
        let face = if direction[axis] > 0.0 { axis } else { axis + 3 };
        let place = |axis: usize| (direction[axis % 3] / depth + 1.0) * (0.5 * self.cells as f64);
        let [u, v] = [place(axis + 1), place(axis + 2)];
        // 2. The triangle around that place, and how much of it is due to each corner.
        let cell = |place: f64| (place as usize).min(self.cells - 1);
        let (i, j) = (cell(u), cell(v));
        let (s, t) = (u - i as f64, v - j as f64);
        let at = |u: usize, v: usize| f64::from(self.support_values[self.index(face, u, v)]);
        let (a, b) = (at(i + 1, j), at(i, j + 1));
        let reach = if s + t <= 1.0 {
            at(i, j) * (1.0 - s - t) + a * s + b * t
        } else {
            at(i + 1, j + 1) * (s + t - 1.0) + a * (1.0 - t) + b * (1.0 - s)
        };
        reach * depth
    }
}

/// The corner farthest along `direction`, or `start` if none is farther.
fn support_point(nodes: &[Node], triangles: &[Triangle], direction: DVec3, start: DVec3) -> DVec3 {
    let (mut farthest, mut reach) = (start, start.dot(direction));
    let mut index = 0;
    while let Some(node) = nodes.get(index) {
        let (min, max) = (Vec3::from(node.min).as_dvec3(), Vec3::from(node.max).as_dvec3());
        let most = (min * direction).max(max * direction).element_sum();
        if most > reach {
            index += 1;
            if node.primitives == PrimitiveRange::INNER {
                continue;
            }
            let first = node.primitives.first_primitive() as usize;
            for triangle in &triangles[first..first + node.primitives.primitive_count() as usize] {
                for corner in [triangle.v0, triangle.v1, triangle.v2] {
                    let corner = Vec3::from(corner).as_dvec3();
                    if corner.dot(direction) > reach {
                        (farthest, reach) = (corner, corner.dot(direction));
                    }
                }
            }
        } else {
            // NONE lies beyond the end.
            index = node.escape_index as usize;
        }
    }
    farthest
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, Vec3Swizzles};

    use super::*;
    use crate::accel::BlasBuildParams;
    use crate::graph::Geometry;

    #[test]
    fn coarse_boxes_hold_everything_and_are_a_fifth_larger() {
        let point = |i: u32| {
            let (u, z) = (i as f32 * 2.399_963, 1.0 - (i as f32 + 0.5) / 1000.0);
            Vec3::new((1.0 - z * z).sqrt() * u.cos(), (1.0 - z * z).sqrt() * u.sin(), z)
        };
        let positions: Vec<Vec3> = (0..2000).map(point).collect();
        let geometry = Geometry::new(positions.clone(), (0..1998).map(|i| [i, i + 1, i + 2]).collect::<Vec<_>>());
        let blas = Blas::build(&geometry, &BlasBuildParams::default()).unwrap();
        let support = SupportFunction::coarse(&blas.nodes, &blas.triangles, blas.bounds);
        let (mut area, mut exact_area) = (0.0, 0.0);
        for i in 0..100 {
            let axis = DVec3::new((f64::from(i)).sin(), (f64::from(i) * 2.0).cos(), 0.5).normalize();
            let placement = DAffine3::from_quat(DQuat::from_axis_angle(axis, f64::from(i)));
            let bounds = support.world_bounds(&placement);
            let exact = positions.iter().fold(Bounds::EMPTY, |bounds, p| {
                let p = placement.transform_point3(p.as_dvec3());
                bounds.union(Bounds { min: p, max: p })
            });
            assert!(bounds.min.cmple(exact.min + 1e-6).all() && bounds.max.cmpge(exact.max - 1e-6).all());
            let half_area = |b: &Bounds| (b.max - b.min).dot((b.max - b.min).yzx());
            area += half_area(&bounds);
            exact_area += half_area(&exact);
        }
        let ratio = area / exact_area;
        assert!((1.01..1.25).contains(&ratio), "{ratio}");
    }
}
