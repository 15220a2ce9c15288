//! Acceleration structures.
#![allow(missing_docs)]
mod bins;
mod blas;
mod flatten;
mod sah;
mod tree;
pub use blas::Blas;

/// How.
#[derive(Clone, Copy, Debug)]
pub struct BuildParams {
    pub max_leaf_size: usize,
    pub primitive_cost: f32,
}

impl Default for BuildParams {
    fn default() -> Self {
        Self { max_leaf_size: 15, primitive_cost: 1.0 }
    }
}

use flatten::flatten;
use tree::{Extent, Reference};
pub struct Tlas {
    pub nodes: Vec<crate::device::layout::Node>,
}
impl Tlas {
    pub fn build(b: &[crate::math::Aabb], slots: &[u32]) -> Tlas {
        let mut e = Extent::EMPTY;
        let refs: Vec<Reference> = b
            .iter()
            .enumerate()
            .map(|(i, b)| {
                let r = Reference::new(b, i as u32);
                e = e.with(&r);
                r
            })
            .collect();
        let tree = sah::build(refs, &e, sah::SahParams { max_leaf_size: 1, primitive_cost: 1.0 });
        let (mut nodes, order) = flatten(&tree);
        for n in &mut nodes {
            if n.primitives.count() > 0 {
                n.primitives = crate::device::layout::PrimitiveRange::leaf(
                    slots[order[n.primitives.first() as usize] as usize],
                    1,
                );
            }
        }
        Tlas { nodes }
    }
}
