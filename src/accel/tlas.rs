//! The top level: a hierarchy over instances, in device world space.

use rayon::prelude::*;

use super::flatten::flatten;
use super::sah::{self, SahParams};
use super::stats::Stats;
use super::tree::{Extent, Reference, TASK_MINIMUM};
use super::validate::{StructureError, check_nodes};
use crate::device::layout::{Node, PrimitiveRange};
use crate::math::Aabb;

/// The top-level structure. A leaf holds one instance.
#[derive(Clone, Debug, PartialEq)]
pub struct Tlas {
    /// In depth-first order. Empty where there is nothing to hit.
    pub nodes: Vec<Node>,
}

/// What entering an instance costs, in node visits: more than any split saves, since a leaf holds just one.
const PARAMS: SahParams = SahParams { max_leaf_size: 1, primitive_cost: 1.0 };

impl Tlas {
    /// Builds the hierarchy over `instances`, each in the box at the same place in `boxes`; on all threads of the current
    /// rayon pool where there are many. O(n log n).
    ///
    /// An instance whose box is empty (or NaN) is left out: nothing of it can be hit. An infinite box is cut to the range
    /// of `f32`. A box must hold the instance with all rounding errors of its transform; rounding in traversal is taken care
    /// of here.
    ///
    /// # Panics
    /// In debug builds, if an instance index is 2^28 or more (34 GB of instances).
    pub fn build(boxes: &[Aabb], instances: &[u32]) -> Self {
        debug_assert_eq!(boxes.len(), instances.len());
        let tlas = if instances.len() < TASK_MINIMUM {
            Self::build_here(boxes, instances)
        } else {
            rayon::scope(|_| Self::build_here(boxes, instances))
        };
        debug_assert_eq!(tlas.validate(boxes, instances), Ok(()));
        tlas
    }

    fn build_here(boxes: &[Aabb], instances: &[u32]) -> Self {
        // Primitives are numbered by their place, so that the tree's shape does not depend on the instance indices.
        let references: Vec<Reference> = placed(boxes).map(|(place, b)| Reference::new(&b, place)).collect();
        let extent = Extent::of(&references);
        let (mut nodes, order) = flatten(&sah::build(references, &extent, &PARAMS));
        nodes.par_iter_mut().with_min_len(1 << 14).for_each(|node| {
            if node.primitives != PrimitiveRange::INNER {
                node.primitives = PrimitiveRange::leaf(instances[order[node.primitives.first() as usize] as usize], 1);
            }
        });
        Self { nodes }
    }

    /// Checks what traversal relies on: escape order, containment, every instance with a box in exactly one leaf. `boxes` and
    /// `instances` as they were when it was built. O(n log n).
    ///
    /// # Errors
    /// The first [`StructureError`] found.
    pub fn validate(&self, boxes: &[Aabb], instances: &[u32]) -> Result<(), StructureError> {
        let mut expected: Vec<(u32, Aabb)> = placed(boxes).map(|(place, b)| (instances[place as usize], b)).collect();
        expected.sort_unstable_by_key(|&(instance, _)| instance);
        let mut found = vec![false; expected.len()];
        check_nodes(&self.nodes, |range| {
            let slot = expected.binary_search_by_key(&range.first(), |&(instance, _)| instance).ok()?;
            let is_new = range.count() == 1 && !std::mem::replace(&mut found[slot], true);
            is_new.then(|| expected[slot].1)
        })?;
        let missing = found.iter().position(|&f| !f);
        missing.map_or(Ok(()), |slot| Err(StructureError::Missing { primitive: expected[slot].0 }))
    }

    /// Sizes and quality. O(n).
    pub fn stats(&self) -> Stats {
        Stats { bytes: size_of_val(&*self.nodes), ..Stats::of(&self.nodes, PARAMS.primitive_cost) }
    }
}

/// The places of the boxes that are not empty, and those boxes made finite.
fn placed(boxes: &[Aabb]) -> impl Iterator<Item = (u32, Aabb)> {
    let finite = glam::Vec3::splat(f32::MAX);
    (0..)
        .zip(boxes)
        .filter(|(_, b)| !b.is_empty())
        .map(move |(place, b)| (place, Aabb { min: b.min.clamp(-finite, finite), max: b.max.clamp(-finite, finite) }))
}
