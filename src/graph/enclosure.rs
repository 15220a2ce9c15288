//! Whether the surface of a geometry encloses a volume: a transmissive surface that does bounds a solid, which
//! refracts; any other is a thin wall, which light passes without bending.
//!
//! The geometry is judged component by component (triangles that are connected by vertices):
//!
//! 1. *Weld.* Vertices at equal positions are one. The vertices of edges that are still without a partner are then
//!    welded within a tolerance ([`weld_tolerance`]), so that a seam whose two sides were rounded differently closes.
//!    The rest of the mesh is left alone: no detail is lost, however fine.
//! 2. *Boundary.* An edge is matched if triangles use it equally often in both directions. Unmatched edges that are
//!    connected are one loop, the rim of a hole.
//! 3. *Volume.* The signed volume, each hole closed by a fan around its middle. 6 V / A is the diameter of a ball, and
//!    a measure of how wide any other body is.
//! 4. *Holes.* A component is closed if each of its holes is small beside that width ([`MAX_HOLE`]), and if it is
//!    thicker than the tolerance.
//! 5. *Nesting.* Surfaces around a solid face away from it. So a closed component of positive volume bounds a solid
//!    unless it lies in another such solid; one of negative volume is a cavity if it lies in a solid, else it was
//!    turned inside out. Two shells, one in the other, that face the same way have no wall between them.
//!
//! | surface | is |
//! |---|---|
//! | ball, box, pane with thickness, cup or bottle with an inner and an outer side | a solid |
//! | scan with holes in its base, bottle of one surface: the holes are small beside the body | a solid |
//! | ball in which a smaller one is turned inward: a bulb, a bubble in glass | a solid with a cavity |
//! | disc, sheet, curtain, two sheets back to back | thin |
//! | cup, bowl, box without a lid, open pipe, of one surface | thin |
//! | ball turned inside out | thin |
//! | two balls, one in the other, both facing outward | thin, both |

use std::collections::HashMap;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::Geometry;
use crate::math::{Aabb, Bounds};

/// The largest hole of a closed component: its length over pi (the diameter of a round hole), in units of 6 V / A (the
/// diameter of a ball). The largest of the five holes of the Stanford bunny has 0.45, the end of a long pipe 2/3, the
/// rim of a bowl 1.
const MAX_HOLE: f64 = 0.55;

/// How many of the largest closed components may enclose others.
const MAX_ENCLOSING: usize = 256;

/// How many solid angles are summed to find what lies in what, for each triangle of the geometry; beyond that the
/// direction in which a component faces is believed.
const MAX_SOLID_ANGLES: usize = 32;

/// How much of a surface encloses a volume.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Enclosure {
    /// The area of all components that bound a solid, in the geometry's units.
    pub(crate) closed_area: f64,
    /// The area of all others.
    pub(crate) open_area: f64,
}

impl Enclosure {
    /// Judges a geometry. O(n log n) for n triangles.
    pub(crate) fn of(geometry: &Geometry) -> Self {
        let surface = Surface::new(geometry);
        let mut enclosure = Self::default();
        for (component, is_solid) in surface.components.iter().zip(surface.bounds_solid()) {
            *(if is_solid { &mut enclosure.closed_area } else { &mut enclosure.open_area }) += component.area;
        }
        enclosure
    }

    /// Whether most of the surface, by area, bounds a solid. Then the whole is drawn as a solid, for one geometry is
    /// drawn in one way.
    pub(crate) fn is_solid(&self) -> bool {
        self.closed_area > self.open_area
    }
}

/// The components of a geometry's surface.
struct Surface<'a> {
    geometry: &'a Geometry,
    /// The index of each triangle's component.
    component_of: Vec<u32>,
    components: Vec<Component>,
    tolerance: f64,
}

/// Triangles that are connected by vertices.
struct Component {
    area: f64,
    /// The signed volume, all holes closed.
    volume: f64,
    /// The length of the longest loop of unmatched edges.
    longest_loop: f64,
    bounds: Bounds,
    /// One of its vertices.
    vertex: DVec3,
}

/// Directed edges of which this many more run from the first vertex to the second than back.
type UnmatchedEdge = (u32, u32, usize);

impl<'a> Surface<'a> {
    fn new(geometry: &'a Geometry) -> Self {
        let position = |vertex: u32| geometry.positions[vertex as usize].as_dvec3();
        let bounds = geometry.bounds();
        let tolerance = weld_tolerance(&bounds);
        // 1. Weld vertices at equal positions, then those of unmatched edges within the tolerance.
        let mut welded = weld_equal(geometry);
        let unmatched = unmatched_edges(geometry, &welded);
        let partners = weld_near(geometry, &unmatched, &bounds, tolerance);
        for vertex in &mut welded {
            *vertex = partners.get(&*vertex).copied().unwrap_or(*vertex);
        }
        let unmatched = if partners.is_empty() { unmatched } else { unmatched_edges(geometry, &welded) };

        // 2. Components are connected by vertices, loops by unmatched edges.
        let (mut connected, mut loops) = (DisjointSets::new(welded.len()), DisjointSets::new(welded.len()));
        for triangle in &*geometry.indices {
            let [a, b, c] = triangle.map(|vertex| welded[vertex as usize]);
            connected.unite(a, b);
            connected.unite(b, c);
        }
        unmatched.iter().for_each(|&(a, b, _)| loops.unite(a, b));
        let mut rims: HashMap<u32, (f64, DVec3)> = HashMap::new();
        for &(a, b, count) in &unmatched {
            let (rim, length) = (rims.entry(loops.find(a)).or_default(), position(a).distance(position(b)));
            rim.0 += count as f64 * length;
            rim.1 += (position(a) + position(b)) * (0.5 * count as f64 * length);
        }

        // 3. Sum area and volume over the triangles of each component, then over the fans that close its holes.
        let mut index_of_root: HashMap<u32, u32> = HashMap::new();
        let mut components: Vec<Component> = Vec::new();
        let mut component_of = Vec::with_capacity(geometry.indices.len());
        for triangle in &*geometry.indices {
            let root = connected.find(welded[triangle[0] as usize]);
            let index = *index_of_root.entry(root).or_insert_with(|| {
                components.push(Component::empty(position(triangle[0])));
                components.len() as u32 - 1
            });
            component_of.push(index);
            components[index as usize].add(triangle.map(position));
        }
        for &(a, b, count) in &unmatched {
            let component = &mut components[index_of_root[&connected.find(a)] as usize];
            let (length, moment) = rims[&loops.find(a)];
            let middle = if length > 0.0 { moment / length } else { position(a) };
            component.longest_loop = component.longest_loop.max(length);
            component.volume += count as f64 * component.volume_to([position(b), position(a), middle]);
        }
        Self { geometry, component_of, components, tolerance }
    }

    /// Whether each component bounds a solid.
    fn bounds_solid(&self) -> Vec<bool> {
        let mut is_solid: Vec<bool> = self.components.iter().map(|c| c.is_closed(self.tolerance)).collect();
        // 1. The closed components, the largest first: what encloses another one is larger.
        let mut closed: Vec<usize> = (0..is_solid.len()).filter(|&i| is_solid[i]).collect();
        let volume = |component: usize| self.components[component].volume;
        closed.sort_by(|&a, &b| volume(b).abs().total_cmp(&volume(a).abs()));
        if let [only] = closed[..] {
            is_solid[only] = volume(only) > 0.0;
        }
        if closed.len() < 2 {
            return is_solid;
        }
        let triangles = self.triangles_by_component();
        let mut budget = self.geometry.indices.len().saturating_mul(MAX_SOLID_ANGLES);
        for (i, &inner) in closed.iter().enumerate() {
            // 2. The smallest component around it. What was found of larger ones holds for this one.
            let around = closed[..i.min(MAX_ENCLOSING)].iter().rev().find(|&&outer| {
                let [outer_component, inner_component] = [outer, inner].map(|c| &self.components[c]);
                // Where the budget is spent, it is what the winding says.
                let says = (volume(outer) > 0.0) != (volume(inner) > 0.0);
                outer_component.bounds.contains(&inner_component.bounds)
                    && match budget.checked_sub(triangles[outer].len()) {
                        None => says,
                        Some(rest) => {
                            budget = rest;
                            self.winding_number(&triangles[outer], inner_component.vertex).abs() > 0.5
                        }
                    }
            });
            // 3. Solids face outward; what lies in another surface faces the other way.
            match around {
                None => is_solid[inner] = volume(inner) > 0.0,
                Some(&outer) if (volume(outer) > 0.0) == (volume(inner) > 0.0) => {
                    is_solid[inner] = false;
                    // Two shells of like size that face the same way are a thin wall, drawn twice.
                    if 2.0 * self.components[inner].area >= self.components[outer].area {
                        is_solid[outer] = false;
                    }
                }
                Some(_) => {}
            }
        }
        is_solid
    }

    /// The triangles of each component.
    fn triangles_by_component(&self) -> Vec<Vec<u32>> {
        let mut triangles = vec![Vec::new(); self.components.len()];
        (0..).zip(&self.component_of).for_each(|(triangle, &component)| triangles[component as usize].push(triangle));
        triangles
    }

    /// How often triangles wind around a point: the sum of their solid angles over 4 pi (A. van Oosterom, J. Strackee,
    /// *The Solid Angle of a Plane Triangle*, 1983). About 1 within a closed surface that faces outward, 0 outside.
    fn winding_number(&self, triangles: &[u32], point: DVec3) -> f64 {
        let solid_angle = |&triangle: &u32| {
            let corners = self.geometry.indices[triangle as usize];
            let [a, b, c] = corners.map(|vertex| self.geometry.positions[vertex as usize].as_dvec3() - point);
            let [la, lb, lc] = [a, b, c].map(DVec3::length);
            let denominator = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
            2.0 * a.dot(b.cross(c)).atan2(denominator)
        };
        triangles.iter().map(solid_angle).sum::<f64>() / (4.0 * std::f64::consts::PI)
    }
}

impl Component {
    fn empty(vertex: DVec3) -> Self {
        Self { area: 0.0, volume: 0.0, longest_loop: 0.0, bounds: Bounds::EMPTY, vertex }
    }

    fn add(&mut self, [a, b, c]: [DVec3; 3]) {
        self.area += (b - a).cross(c - a).length() * 0.5;
        self.volume += self.volume_to([a, b, c]);
        let (min, max) = (a.min(b).min(c), a.max(b).max(c));
        self.bounds = self.bounds.union(Bounds { min, max });
    }

    /// The signed volume between a triangle and a vertex of the component.
    fn volume_to(&self, corners: [DVec3; 3]) -> f64 {
        let [a, b, c] = corners.map(|corner| corner - self.vertex);
        a.dot(b.cross(c)) / 6.0
    }

    /// Whether it has thickness, and no hole that is large beside it.
    fn is_closed(&self, tolerance: f64) -> bool {
        let width = 6.0 * self.volume.abs() / self.area;
        width > 6.0 * tolerance && self.longest_loop / std::f64::consts::PI <= MAX_HOLE * width
    }
}

/// How far apart two vertices may be that are one: 2^-18 of the size of the mesh, which is less than the eye sees and
/// 32 roundings of coordinates around the origin; but at least four roundings of its coordinates, wherever it is.
fn weld_tolerance(bounds: &Aabb) -> f64 {
    let [min, max] = [bounds.min, bounds.max].map(Vec3::as_dvec3);
    let (extent, farthest) = ((max - min).max_element(), min.abs().max(max.abs()).max_element());
    (extent * 2f64.powi(-18)).max(farthest * 2f64.powi(-21))
}

/// For each vertex, the first vertex at the same position.
fn weld_equal(geometry: &Geometry) -> Vec<u32> {
    let mut first_at = HashMap::with_capacity(geometry.positions.len());
    let vertices = geometry.positions.iter().zip(0..);
    // Adding 0.0 turns -0.0 into 0.0.
    vertices.map(|(p, i)| *first_at.entry(p.to_array().map(|x| (x + 0.0).to_bits())).or_insert(i)).collect()
}

/// The edges that triangles use more often in one direction than in the other, between welded vertices.
fn unmatched_edges(geometry: &Geometry, welded: &[u32]) -> Vec<UnmatchedEdge> {
    // 1. List the directed edges of all triangles, but those of zero length.
    let mut edges: Vec<(u32, u32, bool)> = geometry
        .indices
        .par_iter()
        .flat_map_iter(|&[a, b, c]| [[a, b], [b, c], [c, a]])
        .map(|edge| edge.map(|vertex| welded[vertex as usize]))
        .filter(|[a, b]| a != b)
        .map(|[a, b]| (a.min(b), a.max(b), a < b))
        .collect();
    // 2. Sort them by their ends: all uses of an edge are then consecutive.
    edges.par_sort_unstable();
    // 3. Count them by direction.
    let unmatched = edges.chunk_by(|e, f| (e.0, e.1) == (f.0, f.1)).filter_map(|uses| {
        let (low, high, _) = uses[0];
        let forward = uses.iter().filter(|edge| edge.2).count();
        let backward = uses.len() - forward;
        let (from, to) = if forward > backward { (low, high) } else { (high, low) };
        (forward != backward).then_some((from, to, forward.abs_diff(backward)))
    });
    unmatched.collect()
}

/// For each vertex of an unmatched edge that has an earlier one within the tolerance: the nearest of those, which
/// stands for both. Vertices are looked up in a grid, of which a cell holds few that stand for others: O(edges).
fn weld_near(geometry: &Geometry, unmatched: &[UnmatchedEdge], bounds: &Aabb, tolerance: f64) -> HashMap<u32, u32> {
    /// The side of a cell in tolerances: most vertices are farther than one from the next cell.
    const CELL: f64 = 8.0;

    let mut vertices: Vec<u32> = unmatched.iter().flat_map(|&(a, b, _)| [a, b]).collect();
    vertices.sort_unstable();
    vertices.dedup();
    let mut representatives: HashMap<[u32; 3], Vec<(u32, DVec3)>> = HashMap::new();
    let mut partners = HashMap::new();
    for vertex in vertices {
        let position = geometry.positions[vertex as usize].as_dvec3() - bounds.min.as_dvec3();
        // A cast saturates: what is below 0 is in the first cell.
        let cell = |position: DVec3| (position / (tolerance * CELL)).to_array().map(|x| x as u32);
        let (low, high) = (cell(position - tolerance), cell(position + tolerance));
        let cells = (low[0]..=high[0])
            .flat_map(|x| (low[1]..=high[1]).flat_map(move |y| (low[2]..=high[2]).map(move |z| [x, y, z])));
        let near = cells.filter_map(|cell| representatives.get(&cell)).flatten();
        let near =
            near.map(|&(other, at)| (at.distance(position), other)).filter(|&(distance, _)| distance <= tolerance);
        match near.min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((_, representative)) => {
                partners.insert(vertex, representative);
            }
            None => representatives.entry(cell(position)).or_default().push((vertex, position)),
        }
    }
    partners
}

/// Sets of vertices that are united (union-find, with path halving).
struct DisjointSets {
    parents: Vec<u32>,
}

impl DisjointSets {
    fn new(len: usize) -> Self {
        Self { parents: (0..len as u32).collect() }
    }

    fn find(&mut self, mut vertex: u32) -> u32 {
        while self.parents[vertex as usize] != vertex {
            let above = self.parents[self.parents[vertex as usize] as usize];
            self.parents[vertex as usize] = above;
            vertex = above;
        }
        vertex
    }

    fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parents[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::{PI, TAU};

    use super::*;

    /// A surface of revolution about the z axis: rings of vertices at these radii and heights, from below, seen from
    /// outside; each ring has a vertex more than quads, so that there is a seam, and `turn` is the angle of the last.
    fn lathe(profile: &[(f32, f32)], turn: f32) -> Geometry {
        const COLUMNS: u32 = 32;
        let angle = |column: u32| turn * column as f32 / COLUMNS as f32;
        let ring = |&(radius, height): &(f32, f32)| {
            (0..=COLUMNS).map(move |c| Vec3::new(radius * angle(c).cos(), radius * angle(c).sin(), height))
        };
        let positions: Vec<Vec3> = profile.iter().flat_map(ring).collect();
        let quads = (0..profile.len() as u32 - 1).flat_map(|row| (0..COLUMNS).map(move |c| row * (COLUMNS + 1) + c));
        let triangles = quads.flat_map(|a| {
            let (b, c, d) = (a + 1, a + COLUMNS + 1, a + COLUMNS + 2);
            [[a, b, d], [a, d, c]]
        });
        Geometry::new(positions, triangles.collect::<Vec<_>>())
    }

    /// An arc of a sphere's profile, from one polar angle to another, 0 being the bottom.
    fn arc(radius: f32, from: f32, to: f32) -> Vec<(f32, f32)> {
        let angle = |i: u16| from + (to - from) * f32::from(i) / 16.0;
        (0..=16).map(|i| (radius * angle(i).sin().abs(), -radius * angle(i).cos())).collect()
    }

    /// A UV sphere as programs write it: sin(2 pi) and sin(pi) are not 0 in f32, so neither seam nor poles close.
    fn ball(radius: f32) -> Geometry {
        lathe(&arc(radius, 0.0, PI), TAU)
    }

    /// The faces of a cube that `keep` selects; each has its own four vertices.
    fn cube(keep: impl Fn(usize) -> bool) -> Geometry {
        let (mut positions, mut indices) = (Vec::new(), Vec::new());
        let axes = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z];
        for (_, axis) in axes.into_iter().enumerate().filter(|&(i, _)| keep(i)) {
            let (u, v) = axis.any_orthonormal_pair();
            let first = positions.len() as u32;
            positions.extend([axis - u - v, axis + u - v, axis + u + v, axis - u + v]);
            // All faces wind the same way, seen from outside.
            let [b, d] = if u.cross(v).dot(axis) > 0.0 { [1, 3] } else { [3, 1] };
            indices.extend([[first, first + b, first + 2], [first, first + 2, first + d]]);
        }
        Geometry::new(positions, indices)
    }

    fn moved(geometry: &Geometry, place: impl Fn(Vec3) -> Vec3) -> Geometry {
        Geometry { positions: geometry.positions.iter().map(|&p| place(p)).collect(), ..geometry.clone() }
    }

    fn inverted(geometry: &Geometry) -> Geometry {
        Geometry { indices: geometry.indices.iter().map(|&[a, b, c]| [a, c, b]).collect(), ..geometry.clone() }
    }

    /// Several geometries in one.
    fn together(parts: &[Geometry]) -> Geometry {
        let (mut positions, mut indices) = (Vec::new(), Vec::new());
        for part in parts {
            let first = positions.len() as u32;
            positions.extend_from_slice(&part.positions);
            indices.extend(part.indices.iter().map(|triangle| triangle.map(|vertex| first + vertex)));
        }
        Geometry::new(positions, indices)
    }

    /// What each surface is, wherever it is, however it is turned and whatever its size.
    #[test]
    fn the_table_of_surfaces() {
        let cup = [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0)];
        let double_cup = [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (0.95, 2.0), (0.95, 0.05), (0.0, 0.05)];
        let bottle = [(0.0, 0.0), (3.5, 0.0), (3.5, 20.0), (1.0, 24.0), (1.0, 28.0)];
        let sheet = cube(|face| face == 0);
        let tessellated: Vec<(f32, f32)> = (0..=20).map(|i| (i as f32, 0.0)).collect();
        let table = [
            ("a cube", cube(|_| true), true),
            ("a UV sphere with open seams", ball(1.0), true),
            ("a pane with thickness", moved(&cube(|_| true), |p| p * Vec3::new(1.0, 1.0, 1e-3)), true),
            ("a cup with thickness", lathe(&double_cup, TAU), true),
            ("a ball with a hole of a fifth of its width", lathe(&arc(1.0, 0.0, PI - 0.2), TAU), true),
            ("a bottle of one surface", lathe(&bottle, TAU), true),
            ("a bulb: a ball in which another is turned inward", together(&[ball(1.0), inverted(&ball(0.95))]), true),
            ("a ball in a cavity", together(&[ball(1.0), inverted(&ball(0.9)), ball(0.5)]), true),
            ("a ball with a small ball in it", together(&[ball(1.0), ball(0.2)]), true),
            ("two balls side by side", together(&[ball(1.0), moved(&ball(1.0), |p| p + 3.0)]), true),
            ("a ball in the hole of a ring", ball_in_ring(), true),
            ("a ball and a smaller sheet", together(&[ball(1.0), moved(&sheet, |p| p * 0.5 + 3.0)]), true),
            ("a ball and a larger sheet", together(&[ball(1.0), moved(&sheet, |p| p * 9.0 + 30.0)]), false),
            ("a sheet", sheet.clone(), false),
            ("two sheets that face away from each other", cube(|face| face % 3 == 0), false),
            ("two sheets back to back", together(&[sheet.clone(), inverted(&sheet)]), false),
            ("a disc", lathe(&tessellated, TAU), false),
            ("a box without a lid", cube(|face| face != 1), false),
            ("a cup of one surface", lathe(&cup, TAU), false),
            ("a bowl", lathe(&arc(1.0, 0.0, PI / 2.0), TAU), false),
            ("a fishbowl", lathe(&arc(1.0, 0.0, PI * 0.78), TAU), false),
            ("a pipe", lathe(&[(1.0, 0.0), (1.0, 40.0)], TAU), false),
            ("three quarters of a ball", lathe(&arc(1.0, 0.0, PI), TAU * 0.75), false),
            ("a ball turned inside out", inverted(&ball(1.0)), false),
            ("two shells that both face outward", together(&[ball(1.0), ball(0.95)]), false),
        ];
        let turn = glam::Quat::from_rotation_y(0.7) * glam::Quat::from_rotation_x(0.4);
        for (name, geometry, expected) in table {
            let turned = moved(&geometry, |p| turn * p);
            let far = moved(&geometry, |p| p + Vec3::new(100.0, -200.0, 50.0));
            let small = moved(&geometry, |p| turn * p * 1e-30);
            let large = moved(&geometry, |p| turn * p * 1e30);
            for (i, placed) in [geometry, turned, far, small, large].iter().enumerate() {
                let enclosure = Enclosure::of(placed);
                assert_eq!(enclosure.is_solid(), expected, "{name}, placement {i}: {enclosure:?}");
            }
        }
    }

    /// The ball is outside of the ring, but its box is within the ring's.
    fn ball_in_ring() -> Geometry {
        let tube = |i: u16| TAU * f32::from(i) / 16.0;
        let profile: Vec<(f32, f32)> = (0..=16).map(|i| (3.0 + tube(i).cos(), tube(i).sin())).collect();
        together(&[lathe(&profile, TAU), ball(0.9)])
    }

    #[test]
    fn components_are_judged_one_by_one() {
        let sheet = moved(&cube(|face| face == 0), |p| p + 9.0);
        let enclosure = Enclosure::of(&together(&[cube(|_| true), sheet, moved(&inverted(&ball(1.0)), |p| p - 9.0)]));
        assert!((enclosure.closed_area - 24.0).abs() < 1e-6, "{enclosure:?}");
        assert!((enclosure.open_area - 4.0 - 12.4).abs() < 0.2, "{enclosure:?}");
    }

    #[test]
    fn a_seam_closes_within_the_tolerance_and_not_beyond() {
        // Two halves of a cube that meet at x = 0, with a gap between them.
        let with_gap = |gap: f32| {
            let half = |side: f32| {
                moved(&cube(|face| face % 3 != 0 || (face == 0) == (side > 0.0)), move |p| {
                    Vec3::new(if p.x * side > 0.0 { p.x } else { gap * 0.5 * side }, p.y, p.z)
                })
            };
            Surface::new(&together(&[half(1.0), half(-1.0)])).components.len()
        };
        assert_eq!(with_gap(2.0 * 2f32.powi(-19)), 1);
        assert_eq!(with_gap(2.0 * 2f32.powi(-17)), 2);
    }

    #[test]
    fn fine_detail_is_not_welded() {
        // A speck that is smaller than the tolerance of the mesh that it is in.
        let speck = moved(&ball(1.0), |p| p * 1e-4 + Vec3::new(0.5, 0.0, 0.0));
        let far = moved(&cube(|_| true), |p| p + 500.0);
        let geometry = together(&[speck, far]);
        let surface = Surface::new(&geometry);
        assert_eq!(surface.components.len(), 2);
        assert!((surface.components[0].volume / 4.19e-12 - 1.0).abs() < 0.1, "{}", surface.components[0].volume);
    }

    #[test]
    fn faces_turned_inside_out_do_not_close() {
        let mut geometry = cube(|_| true);
        geometry.indices = geometry
            .indices
            .iter()
            .enumerate()
            .map(|(i, &[a, b, c])| if i < 4 { [a, c, b] } else { [a, b, c] })
            .collect();
        assert!(!Enclosure::of(&geometry).is_solid());
    }

    #[test]
    fn nothing_encloses_nothing() {
        assert_eq!(Enclosure::of(&Geometry::default()), Enclosure::default());
        let line = Geometry::new([Vec3::ZERO, Vec3::X, Vec3::X * 2.0], [[0, 1, 2]]);
        assert!(!Enclosure::of(&line).is_solid());
        let point = Geometry::new([Vec3::ONE], [[0, 0, 0]]);
        assert!(!Enclosure::of(&point).is_solid());
    }

    /// A geometry of many bubbles takes no longer than its triangles justify, and what they face is believed.
    #[test]
    fn thousands_of_cavities() {
        let speck = inverted(&cube(|_| true));
        let at = |i: usize| Vec3::new((i % 20) as f32, (i / 20 % 20) as f32, (i / 400) as f32) * 0.08 - 0.8;
        let mut parts = vec![ball(2.0)];
        parts.extend((0..8000).map(|i| moved(&speck, |p| p * 0.01 + at(i))));
        let enclosure = Enclosure::of(&together(&parts));
        assert!(enclosure.open_area == 0.0 && enclosure.closed_area > 50.0, "{enclosure:?}");
    }
}
