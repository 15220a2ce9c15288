//! Meshes that are hard on a builder.

use glam::Vec3;
use ropewalk::graph::{BlasKind, Geometry, Quality};

use ropewalk_testkit::{Mesh, Random};

/// All kinds of bottom-level structures.
pub(crate) const STRUCTURES: [BlasKind; 4] =
    [BlasKind::Bvh(Quality::Low), BlasKind::Bvh(Quality::Medium), BlasKind::Bvh(Quality::High), BlasKind::KdTree];

pub(crate) fn geometry(mesh: &Mesh) -> Geometry {
    Geometry::new(mesh.positions.clone(), mesh.indices.clone())
}

/// Meshes that are hard to build well, each with its name and of at most a few thousand triangles.
pub(crate) fn adversarial() -> Vec<(&'static str, Mesh)> {
    vec![
        ("one triangle", Mesh::soup(1, 1)),
        ("two triangles", Mesh::soup(2, 2)),
        ("sixteen triangles", Mesh::soup(3, 16)),
        ("identical triangles", identical(1000)),
        ("coincident among others", coincident()),
        ("concentric triangles", concentric(300)),
        ("triangles without area", without_area()),
        ("needles", needles(600)),
        ("triangles on a line", on_a_line(500)),
        ("geometric series", geometric_series(1.1, 300)),
        ("huge and tiny", huge_and_tiny()),
        ("thin grid", grid(700, 1, 0, 0.0)),
        ("flat grid at 0", grid(20, 20, 2, 0.0)),
        ("flat grid at 3", grid(20, 20, 1, 3.0)),
        ("far from the origin", offset(Mesh::soup(5, 600).scaled(50.0), Vec3::new(1e3, -2e3, 5e2))),
        ("1e-20", Mesh::soup(6, 600).scaled(1e-20)),
        ("1e20", Mesh::soup(7, 600).scaled(1e20)),
    ]
}

/// Meshes with coordinates beyond the range of the kernel's arithmetic: their structures must be valid, but rays need
/// not hit them.
pub(crate) fn beyond_arithmetic() -> Vec<(&'static str, Mesh)> {
    let series = geometric_series(2.0, 250);
    let smallest = series.positions.iter().map(|p| p.max_element()).fold(f32::MAX, f32::min);
    assert!(smallest < 1e-36 && series.positions.iter().any(|p| p.max_element() > 1e36));
    vec![
        ("series over all exponents", series),
        ("subnormal", Mesh::soup(8, 400).scaled(1e-41)),
        ("near the greatest float", Mesh::soup(9, 400).scaled(2e38)),
        ("all of f32", {
            let mut m = Mesh::soup(10, 400);
            m.positions.iter_mut().for_each(|p| *p = p.map(|c| c.signum() * f32::MAX));
            m
        }),
    ]
}

pub(crate) fn identical(count: usize) -> Mesh {
    let positions = vec![Vec3::ZERO, Vec3::X, Vec3::new(0.25, 1.0, 0.5)];
    Mesh { positions, indices: vec![[0, 1, 2]; count] }
}

/// Triangles of which each is there many times, from each of its corners and in both windings, among others.
pub(crate) fn coincident() -> Mesh {
    let mut mesh = Mesh::soup(15, 400);
    let triangles = mesh.indices.clone();
    for (i, [a, b, c]) in triangles.into_iter().enumerate().step_by(2) {
        // Some have the same vertices, others have vertices of their own.
        let mut vertex = |v: u32| {
            if i % 4 == 0 {
                return v;
            }
            mesh.positions.push(mesh.positions[v as usize]);
            mesh.positions.len() as u32 - 1
        };
        let [d, e, f] = [a, b, c].map(&mut vertex);
        mesh.indices.extend([[d, e, f], [e, f, d], [f, d, e], [d, f, e], [e, d, f], [a, b, c]]);
    }
    mesh
}

/// Triangles whose boxes all have the same centre.
pub(crate) fn concentric(count: u32) -> Mesh {
    from_triangles((1..=count).map(|i| {
        let r = i as f32;
        [Vec3::new(-r, -r, -r), Vec3::new(r, r, -r), Vec3::new(r, -r, r)]
    }))
}

/// Triangles with an area, between triangles with two equal corners and triangles whose corners lie on a line.
fn without_area() -> Mesh {
    let mut mesh = Mesh::soup(4, 300);
    let good = mesh.indices.clone();
    for [a, b, c] in good.into_iter().step_by(6) {
        let middle = mesh.positions.len() as u32;
        mesh.positions.push(mesh.positions[a as usize].midpoint(mesh.positions[b as usize]));
        mesh.indices.extend([[a, a, b], [c, b, c], [a, a, a], [a, middle, b]]);
    }
    mesh
}

fn needles(count: usize) -> Mesh {
    let mut random = Random::new(11);
    from_triangles((0..count).map(|_| {
        let (from, to) = (random.in_cube(), random.in_cube());
        [from, to, to + random.in_cube() * 1e-3]
    }))
}

/// Thin triangles along a diagonal of space, whose boxes are mostly empty.
fn on_a_line(count: u32) -> Mesh {
    from_triangles((0..count).map(|i| {
        let p = Vec3::splat(i as f32);
        [p, p + 1.0, p + Vec3::new(0.8, 0.1, 0.4)]
    }))
}

/// Triangles in a row, each `ratio` times as large as the one before and `ratio` times as far from the origin.
fn geometric_series(ratio: f32, count: i32) -> Mesh {
    from_triangles((0..count).map(|i| {
        let size = ratio.powi(i - count / 2);
        [Vec3::new(1.0, 0.0, 0.1) * size, Vec3::new(1.4, 0.1, 0.0) * size, Vec3::new(1.1, 0.4, 0.3) * size]
    }))
}

fn huge_and_tiny() -> Mesh {
    let mut mesh = Mesh::soup(12, 200).scaled(1e6);
    append(&mut mesh, &Mesh::soup(13, 400));
    append(&mut mesh, &Mesh::soup(14, 400).scaled(1e-3));
    mesh
}

/// Two triangles a cell of a lattice in the plane where `axis` is `level`, lattice points at integers.
pub(crate) fn grid(columns: u32, rows: u32, axis: usize, level: f32) -> Mesh {
    let mut positions = Vec::new();
    for row in 0..=rows {
        for column in 0..=columns {
            let mut p = Vec3::splat(level);
            p[(axis + 1) % 3] = column as f32;
            p[(axis + 2) % 3] = row as f32;
            positions.push(p);
        }
    }
    let cells = (0..rows).flat_map(|row| (0..columns).map(move |column| row * (columns + 1) + column));
    let indices = cells.flat_map(|a| [[a, a + 1, a + columns + 2], [a, a + columns + 2, a + columns + 1]]).collect();
    Mesh { positions, indices }
}

fn offset(mut mesh: Mesh, by: Vec3) -> Mesh {
    mesh.positions.iter_mut().for_each(|p| *p += by);
    mesh
}

fn append(mesh: &mut Mesh, other: &Mesh) {
    let base = mesh.positions.len() as u32;
    mesh.positions.extend(&other.positions);
    mesh.indices.extend(other.indices.iter().map(|t| t.map(|v| v + base)));
}

fn from_triangles(triangles: impl Iterator<Item = [Vec3; 3]>) -> Mesh {
    let positions: Vec<Vec3> = triangles.flatten().collect();
    let indices = (0..positions.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Mesh { positions, indices }
}
