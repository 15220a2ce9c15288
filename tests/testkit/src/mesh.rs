//! Meshes made in code, and those of a glTF file.

use std::collections::HashMap;
use std::path::Path;

use glam::Vec3;

use super::Random;

/// Triangles over shared vertices.
#[derive(Clone)]
pub struct Mesh {
    pub positions: Vec<Vec3>,
    pub indices: Vec<[u32; 3]>,
}

impl Mesh {
    /// A closed sphere of radius 1: an icosahedron whose faces are split in four `subdivisions` times; 20 * 4^n
    /// triangles.
    pub fn icosphere(subdivisions: u32) -> Self {
        let g = (1.0 + 5f32.sqrt()) / 2.0;
        #[rustfmt::skip]
        let corners = [
            [-1.0, g, 0.0], [1.0, g, 0.0], [-1.0, -g, 0.0], [1.0, -g, 0.0], [0.0, -1.0, g], [0.0, 1.0, g],
            [0.0, -1.0, -g], [0.0, 1.0, -g], [g, 0.0, -1.0], [g, 0.0, 1.0], [-g, 0.0, -1.0], [-g, 0.0, 1.0],
        ];
        #[rustfmt::skip]
        let mut indices = vec![
            [0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2], [10, 7, 6],
            [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10],
            [8, 6, 7], [9, 8, 1],
        ];
        let mut positions: Vec<Vec3> = corners.iter().map(|&c| Vec3::from_array(c).normalize()).collect();
        for _ in 0..subdivisions {
            let mut middles = HashMap::new();
            let mut middle = |a: u32, b: u32| {
                *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    positions.push((positions[a as usize] + positions[b as usize]).normalize());
                    positions.len() as u32 - 1
                })
            };
            let split = |[a, b, c]: [u32; 3]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
            };
            indices = indices.into_iter().flat_map(split).collect();
        }
        Self { positions, indices }
    }

    /// An icosphere whose vertices are moved along their radius by noise. It is closed, and star-shaped about the
    /// origin.
    pub fn displaced_icosphere(subdivisions: u32) -> Self {
        let mut mesh = Self::icosphere(subdivisions);
        let mut random = Random::new(7);
        for p in &mut mesh.positions {
            *p *= 1.0 + 0.2 * (p.x * 9.0).sin() * (p.y * 7.0).cos() + 0.02 * random.signed();
        }
        mesh
    }

    /// Triangles of all sizes and shapes in the cube from -1 to 1.
    pub fn soup(seed: u64, triangles: usize) -> Self {
        let mut random = Random::new(seed);
        let mut positions = Vec::new();
        for _ in 0..triangles {
            let (center, size) = (random.in_cube(), 0.5 * random.unsigned().powi(3));
            positions.extend((0..3).map(|_| center + size * random.in_cube()));
        }
        let indices = (0..triangles as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        Self { positions, indices }
    }

    /// The cube from -1 to 1.
    pub fn cube() -> Self {
        let corner = |i: usize| Vec3::from_array([0, 1, 2].map(|axis| if i >> axis & 1 == 0 { -1.0 } else { 1.0 }));
        #[rustfmt::skip]
        let indices = vec![
            [0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2],
            [1, 3, 7], [1, 7, 5],
        ];
        Self { positions: (0..8).map(corner).collect(), indices }
    }

    /// The first mesh of a binary glTF file without node transforms.
    pub fn glb(path: &Path) -> Self {
        let (document, blob) = {
            let gltf = gltf::Gltf::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            (gltf.document, gltf.blob.unwrap_or_default())
        };
        let mut mesh = Self { positions: Vec::new(), indices: Vec::new() };
        for primitive in document.meshes().flat_map(|m| m.primitives().collect::<Vec<_>>()) {
            let reader = primitive.reader(|_| Some(&blob));
            let base = mesh.positions.len() as u32;
            mesh.positions.extend(reader.read_positions().unwrap().map(Vec3::from_array));
            let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().map(|i| base + i).collect();
            mesh.indices.extend(indices.as_chunks::<3>().0);
        }
        mesh
    }

    /// The same mesh, `factor` times as large.
    pub fn scaled(mut self, factor: f32) -> Self {
        self.positions.iter_mut().for_each(|p| *p *= factor);
        self
    }

    /// The corners of a triangle.
    pub fn triangle(&self, i: usize) -> [Vec3; 3] {
        self.indices[i].map(|v| self.positions[v as usize])
    }
}
