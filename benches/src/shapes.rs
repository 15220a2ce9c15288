//! Generated geometry, of a given number of triangles or copies.

use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec3, Vec3};
use ropewalk::{Core, CoreKey, Geometry, Material, Scene, Transform};

use crate::Result;

/// A sphere of radius 1, of 2 * `columns` * (`rows` - 1) triangles: bands of quads between two fans.
pub fn sphere(rows: u32, columns: u32) -> Geometry {
    bands(rows, columns, DVec3::as_vec3)
}

/// A sphere with bumps that hide each other, of about so many triangles: the same shape, however many there are.
pub fn bumpy_sphere(triangles: u32) -> Geometry {
    const BUMPS: f64 = 8.0;
    const HEIGHT: f64 = 0.25;
    let rows = (0.5 + 0.5 * f64::from(triangles).sqrt()).round().max(2.0) as u32;
    bands(rows, 2 * rows, |p| {
        let wave = (BUMPS * p.x).sin() * (BUMPS * p.y).sin() * (BUMPS * p.z).sin();
        (p * (1.0 + HEIGHT * wave)).as_vec3()
    })
}

/// A sphere whose points are then displaced by a function.
fn bands(rows: u32, columns: u32, place: impl Fn(DVec3) -> Vec3) -> Geometry {
    let mut positions = vec![place(DVec3::Y)];
    for row in 1..rows {
        let (radius, height) = (PI * f64::from(row) / f64::from(rows)).sin_cos();
        for column in 0..columns {
            let (sine, cosine) = (TAU * f64::from(column) / f64::from(columns)).sin_cos();
            positions.push(place(DVec3::new(radius * cosine, height, -radius * sine)));
        }
    }
    positions.push(place(DVec3::NEG_Y));
    let vertex = |row: u32, column: u32| 1 + (row - 1) * columns + column % columns;
    let last = positions.len() as u32 - 1;
    let mut indices = Vec::new();
    for c in 0..columns {
        indices.push([0, vertex(1, c), vertex(1, c + 1)]);
        indices.push([vertex(rows - 1, c + 1), vertex(rows - 1, c), last]);
        for r in 1..rows - 1 {
            let [a, b, d, e] = [vertex(r, c), vertex(r, c + 1), vertex(r + 1, c), vertex(r + 1, c + 1)];
            indices.extend([[a, d, e], [a, e, b]]);
        }
    }
    Geometry::new(positions, indices)
}

/// Adds the geometry and returns a core that shows it.
///
/// # Errors
/// As [`Scene::add_geometry`].
pub fn geometry_core(scene: &mut Scene, geometry: Geometry) -> Result<CoreKey> {
    let geometry = scene.add_geometry(geometry)?;
    let material = scene.add_material(Material::default())?;
    Ok(scene.add_core(Core::Geometry { geometry, material })?)
}

/// Copies of a geometry, turned at random, scaled so that the cube that holds their centres has a side of 1. `overlap`:
/// the boxes of all together, in volumes of the cube.
///
/// # Errors
/// As [`Scene::add_geometry`].
pub fn add_copies(scene: &mut Scene, geometry: Geometry, count: u32, overlap: f64) -> Result<()> {
    let core = geometry_core(scene, geometry)?;
    let Some(key) = scene.core(core)?.geometry() else { return Ok(()) };
    let bounds = scene.geometry_bounds(key)?;
    let size = bounds.max - bounds.min;
    let scale = (overlap / (f64::from(count) * size.x * size.y * size.z)).cbrt();
    let mut random = fastrand::Rng::with_seed(1);
    let root = scene.root();
    for _ in 0..count {
        let mut signed = || random.f64() * 2.0 - 1.0;
        let rotation = DQuat::from_xyzw(signed(), signed(), signed(), signed()).normalize();
        let place = 0.5 * DVec3::new(signed(), signed(), signed());
        let translation = place - rotation * (scale * bounds.center());
        let node = scene.add(root, Transform::Trs { translation, rotation, scale: DVec3::splat(scale) })?;
        scene.add(node, core)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bumpy_spheres_are_of_about_the_size_asked_for_and_of_one_shape() {
        for count in [1 << 10, 1 << 14, 1 << 18] {
            let geometry = bumpy_sphere(count);
            let ratio = geometry.indices.len() as f64 / f64::from(count);
            assert!((0.9..1.1).contains(&ratio), "{count}: {ratio}");
            let mean = geometry.positions.iter().map(|p| f64::from(p.length())).sum::<f64>();
            let mean = mean / geometry.positions.len() as f64;
            assert!((0.98..1.02).contains(&mean), "{count}: mean radius {mean}");
        }
    }
}
