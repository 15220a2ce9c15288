//! Notes on transmissive surfaces of which the file does not say whether they bound a solid.

use std::collections::HashMap;

use rayon::prelude::*;

use super::warnings::Warnings;
use super::{Document, WarningKind};
use crate::graph::{Enclosure, Geometry};

/// A primitive with a transmissive material, which its geometry decides on.
pub(super) struct JudgedPrimitive {
    pub(super) mesh: usize,
    pub(super) primitive: usize,
    /// The index of its geometry in the plan.
    pub(super) geometry: usize,
}

/// Adds a note for each of these primitives: what its surface was taken for, as the compiler will take it. O(n log n)
/// for the triangles of their geometries, on all cores.
pub(super) fn report(
    document: &Document,
    geometries: &[Geometry],
    primitives: &[JudgedPrimitive],
    warnings: &mut Warnings,
) {
    // 1. Judge each geometry once.
    let mut judged: Vec<usize> = primitives.iter().map(|primitive| primitive.geometry).collect();
    judged.sort_unstable();
    judged.dedup();
    let enclosures: HashMap<usize, Enclosure> =
        judged.into_par_iter().map(|geometry| (geometry, Enclosure::of(&geometries[geometry]))).collect();
    // 2. Say so for each primitive.
    for &JudgedPrimitive { mesh, primitive, geometry } in primitives {
        let pointer = format!("/meshes/{mesh}/primitives/{primitive}");
        let guess = "transmission without KHR_materials_volume";
        warnings.add(document, WarningKind::Guess, guess, pointer, text(&enclosures[&geometry]));
    }
}

fn text(enclosure: &Enclosure) -> &'static str {
    match (enclosure.is_solid(), enclosure.closed_area > 0.0 && enclosure.open_area > 0.0) {
        (true, false) => "taken for a solid: its surface encloses a volume",
        (true, true) => "taken for a solid: most of its surface encloses a volume",
        (false, false) => "taken for a thin wall: its surface encloses no volume",
        (false, true) => "taken for a thin wall: most of its surface encloses no volume",
    }
}
