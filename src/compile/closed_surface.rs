//! Whether a surface is closed: a transmissive closed surface refracts as a solid, an open one is a thin sheet that
//! light passes without bending.

use std::collections::HashMap;

use rayon::prelude::*;

use crate::graph::Geometry;

/// The largest ratio of the squared boundary length to the surface area at which a surface counts as closed. A closed
/// surface has 0; a flat disc has 4 pi, the least of all flat sheets; a bottle's opening and the holes of a scan stay
/// below the limit.
const MAX_BOUNDARY_RATIO: f64 = 1.0;

/// Whether a geometry is a closed surface, small holes aside. Vertices at equal positions are welded; an edge is
/// matched if triangles use it equally often in both directions, and unmatched edges form the boundary.
/// O(triangles log triangles).
pub(super) fn is_closed_surface(geometry: &Geometry) -> bool {
    // 1. Weld vertices, and list the directed edges of all triangles, but those of zero length.
    let vertices = weld_vertices(geometry);
    let mut edges: Vec<(u32, u32, bool)> = geometry
        .indices
        .par_iter()
        .flat_map_iter(|&[a, b, c]| [[a, b], [b, c], [c, a]])
        .map(|edge| edge.map(|vertex| vertices[vertex as usize]))
        .filter(|[a, b]| a != b)
        .map(|[a, b]| (a.min(b), a.max(b), a < b))
        .collect();
    // 2. Sort the directed edges by their ends: all uses of an edge are then consecutive.
    edges.par_sort_unstable();
    let position = |vertex: u32| geometry.positions[vertex as usize].as_dvec3();
    // 3. The boundary: each unmatched edge, as often as it is unmatched.
    let boundary: f64 = edges
        .chunk_by(|e, f| (e.0, e.1) == (f.0, f.1))
        .map(|uses| {
            let forward = uses.iter().filter(|edge| edge.2).count();
            let unmatched = forward.abs_diff(uses.len() - forward);
            unmatched as f64 * position(uses[0].0).distance(position(uses[0].1))
        })
        .sum();
    // 4. Compare its length with the area.
    let area: f64 = geometry
        .indices
        .iter()
        .map(|triangle| triangle.map(position))
        .map(|[a, b, c]| (b - a).cross(c - a).length() * 0.5)
        .sum();
    boundary * boundary <= MAX_BOUNDARY_RATIO * area
}

/// For each vertex, the first vertex at the same position.
fn weld_vertices(geometry: &Geometry) -> Vec<u32> {
    let mut first_at = HashMap::with_capacity(geometry.positions.len());
    let vertices = geometry.positions.iter().zip(0..);
    // Adding 0.0 turns -0.0 into 0.0.
    vertices.map(|(p, i)| *first_at.entry(p.to_array().map(|x| (x + 0.0).to_bits())).or_insert(i)).collect()
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

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

    #[test]
    fn a_cube_encloses_and_its_faces_do_not() {
        assert!(is_closed_surface(&cube(|_| true)));
        assert!(!is_closed_surface(&cube(|face| face == 0)), "one sheet");
        assert!(!is_closed_surface(&cube(|face| face % 3 == 0)), "two sheets that face away from each other");
        assert!(!is_closed_surface(&cube(|face| face != 1)), "a box without a lid");
    }

    #[test]
    fn a_small_hole_lets_nothing_out() {
        let mut geometry = cube(|_| true);
        // A triangle with a triangular hole of 1 % of its size.
        let corners = geometry.indices[0];
        let middle = corners.iter().map(|&i| geometry.positions[i as usize]).sum::<Vec3>() / 3.0;
        let hole = corners.map(|i| middle.lerp(geometry.positions[i as usize], 0.01));
        let ([a, b, c], d) = (corners, geometry.positions.len() as u32);
        let (e, f) = (d + 1, d + 2);
        geometry.positions = geometry.positions.iter().copied().chain(hole).collect();
        let ring = [[a, b, e], [a, e, d], [b, c, f], [b, f, e], [c, a, d], [c, d, f]];
        geometry.indices = geometry.indices[1..].iter().copied().chain(ring).collect();
        assert!(is_closed_surface(&geometry));
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
        assert!(!is_closed_surface(&geometry));
    }

    #[test]
    fn nothing_encloses_nothing() {
        assert!(is_closed_surface(&Geometry::default()), "and nothing is seen of it");
        let line = Geometry::new([Vec3::ZERO, Vec3::X, Vec3::X * 2.0], [[0, 1, 2]]);
        assert!(!is_closed_surface(&line));
    }
}
