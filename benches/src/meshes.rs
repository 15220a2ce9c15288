//! Meshes whose corners have few bits, so that rays can be aimed at their edges and corners exactly.

use crate::shapes::{bumpy_sphere, sphere};
use glam::{Mat3, Quat, Vec3};
use ropewalk::Geometry;

use crate::aim::quantised;

/// The corners of all triangles of a geometry.
pub fn corners_of(geometry: &Geometry) -> Vec<[Vec3; 3]> {
    let corners = |triangle: &[u32; 3]| triangle.map(|vertex| geometry.positions[vertex as usize]);
    geometry.indices.iter().map(corners).collect()
}

/// The triangles with another place for each corner.
pub fn moved(triangles: &[[Vec3; 3]], place: impl Fn(Vec3) -> Vec3) -> Vec<[Vec3; 3]> {
    triangles.iter().map(|corners| corners.map(&place)).collect()
}

/// The unit sphere, of 2,208 triangles, closed.
pub fn round() -> Vec<[Vec3; 3]> {
    moved(&corners_of(&sphere(24, 48)), quantised)
}

/// A sphere with bumps that hide each other, of about 4,000 triangles, closed.
pub fn bumpy() -> Vec<[Vec3; 3]> {
    moved(&corners_of(&bumpy_sphere(4000)), quantised)
}

/// The square from -1 to 1 at z = 0 in n x n cells of two triangles each, at heights given by a function of place.
pub fn grid(n: u32, height: impl Fn(f32, f32) -> f32) -> Vec<[Vec3; 3]> {
    let corner = |x: u32, y: u32| {
        let [x, y] = [x, y].map(|i| 2.0 * i as f32 / n as f32 - 1.0);
        Vec3::new(x, y, height(x, y))
    };
    let cell = |i: u32| {
        let (x, y) = (i % n, i / n);
        let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
        [[a, b, c], [a, c, d]]
    };
    (0..n * n).flat_map(cell).collect()
}

/// The cube from -1 to 1, each side a grid.
pub fn cube(n: u32) -> Vec<[Vec3; 3]> {
    let side = moved(&grid(n, |_, _| 1.0), |p| p);
    let turns = [
        [Vec3::X, Vec3::Y, Vec3::Z],
        [Vec3::Y, Vec3::Z, Vec3::X],
        [Vec3::Z, Vec3::X, Vec3::Y],
        [Vec3::Y, Vec3::X, Vec3::NEG_Z],
        [Vec3::Z, Vec3::Y, Vec3::NEG_X],
        [Vec3::X, Vec3::Z, Vec3::NEG_Y],
    ];
    turns.iter().flat_map(|&[x, y, z]| moved(&side, |p| Mat3::from_cols(x, y, z) * p)).collect()
}

/// A fan of n triangles around a centre, its rim a circle of radius 1 at z = 0.
pub fn fan(n: u32, center: Vec3) -> Vec<[Vec3; 3]> {
    let rim = |i: u32| {
        let (sine, cosine) = (std::f32::consts::TAU * (i % n) as f32 / n as f32).sin_cos();
        quantised(Vec3::new(cosine, sine, 0.0))
    };
    (0..n).map(|i| [center, rim(i), rim(i + 1)]).collect()
}

/// A turn about no axis in particular.
pub fn turn() -> Quat {
    Quat::from_axis_angle(Vec3::new(1.0, 2.0, 3.0).normalize(), 1.0)
}
