//! The bottom level: a hierarchy over the triangles of one geometry, in local space.

use bytemuck::Zeroable;
use glam::Vec3;
use rayon::prelude::*;

use super::BuildParams;
use super::flatten::flatten;
use super::sah::{self, SahParams};
use super::tree::{Extent, Reference};
use crate::Result;
use crate::device::layout::{Node, Triangle};
use crate::graph::Geometry;
use crate::math::Aabb;

/// A bottom-level structure: nodes and triangles in local space, ready to be copied to the device arrays.
pub struct Blas {
    /// In depth-first order, escape indices relative to the first. Empty if there is nothing to hit.
    pub nodes: Vec<Node>,
    /// In leaf order.
    pub triangles: Vec<Triangle>,
    /// The box around the triangles, not padded.
    pub bounds: Aabb,
}

const CHUNK: usize = 1 << 13;

impl Blas {
    /// Builds.
    pub fn build(geometry: &Geometry, params: &BuildParams) -> Result<Self> {
        let (references, extent) = references(geometry);
        let params = SahParams { max_leaf_size: params.max_leaf_size, primitive_cost: params.primitive_cost };
        let tree = sah::build(references, &extent, params);
        let (nodes, order) = flatten(&tree);
        let triangles = order.par_iter().with_min_len(CHUNK).map(|&p| triangle(geometry, p)).collect();
        Ok(Self { nodes, triangles, bounds: extent.aabb() })
    }
}

fn references(geometry: &Geometry) -> (Vec<Reference>, Extent) {
    let mut references: Vec<Reference> = bytemuck::zeroed_vec(geometry.indices.len());
    let extent = references
        .par_chunks_mut(CHUNK)
        .zip(geometry.indices.par_chunks(CHUNK))
        .enumerate()
        .map(|(chunk, (references, indices))| {
            let mut extent = Extent::EMPTY;
            for (i, (reference, corners)) in references.iter_mut().zip(indices).enumerate() {
                let [a, b, c] = corners.map(|v| geometry.positions[v as usize]);
                let bounds = Aabb { min: a.min(b).min(c), max: a.max(b).max(c) };
                *reference = Reference::new(&bounds, (chunk * CHUNK + i) as u32);
                extent = extent.with(reference);
            }
            extent
        })
        .reduce(|| Extent::EMPTY, Extent::union);
    (references, extent)
}

fn triangle(geometry: &Geometry, primitive: u32) -> Triangle {
    let [v0, v1, v2] = geometry.indices[primitive as usize].map(|v| geometry.positions[v as usize].to_array());
    Triangle { v0, primitive, v1, _pad0: 0, v2, _pad1: 0 }
}
