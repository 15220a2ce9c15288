//! Assembly of WGSL: what the scene needs, the shared files, one entry point.

mod include;
mod splits;

use std::fmt::Write as _;

pub use include::Include;
pub(crate) use splits::ARRAY_COUNT;
pub use splits::{ArraySplit, ArraySplits};

use super::Traversal;
use crate::device::{MAX_MIRROR_ROUGHNESS, Needs};

/// The kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum EntryPoint {
    /// Renders the colour of each pixel.
    Render,
    /// Renders each pixel with its normal, depth and identifiers.
    RenderAovs,
    /// The closest hit of each ray of a batch.
    ClosestHits,
    /// For each ray of a batch, whether it meets anything opaque.
    AnyHits,
}

/// What tells one module of an entry point from another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct KernelVariant {
    /// What it can do.
    pub needs: Needs,
    /// What it walks.
    pub traversal: Traversal,
    /// How the arrays are bound.
    pub splits: ArraySplits,
}

impl From<Needs> for KernelVariant {
    fn from(needs: Needs) -> Self {
        Self { needs, ..Self::default() }
    }
}

impl KernelVariant {
    /// The files by which the scene is walked.
    fn scene_files(&self) -> [&'static str; 6] {
        let walk = match self.traversal {
            Traversal::Rope => include_str!("../../../shaders/shared/rope.wgsl"),
            Traversal::Wide => include_str!("../../../shaders/shared/wide.wgsl"),
        };
        let [types, math, intersect, query, traverse] = SCENE;
        [types, math, intersect, walk, query, traverse]
    }

    /// What all files rely on: a constant for each flag of [`Needs`], `NEEDS_TEXTURES` for example (the driver's compiler drops
    /// what none needs), and the functions that read arrays.
    fn preamble(&self) -> String {
        let mut source = String::new();
        for (name, flag) in Needs::all().iter_names() {
            // Writing to a string cannot fail.
            let _ = writeln!(source, "const NEEDS_{name}: bool = {};", self.needs.contains(flag));
        }
        // A float literal needs its point in WGSL: `{:?}` writes it.
        let _ = writeln!(source, "const MAX_MIRROR_ROUGHNESS: f32 = {MAX_MIRROR_ROUGHNESS:?};");
        source + &self.splits.source(self.traversal)
    }
}

/// Files of every kernel: the scene, and what rays ask of it.
const SCENE: [&str; 5] = [
    include_str!("../../../shaders/shared/types.wgsl"),
    include_str!("../../../shaders/shared/math.wgsl"),
    include_str!("../../../shaders/shared/intersect.wgsl"),
    include_str!("../../../shaders/shared/query.wgsl"),
    include_str!("../../../shaders/shared/traverse.wgsl"),
];

/// What traversal asks of materials, where not everything is opaque.
const MATERIALS: [&str; 2] =
    [include_str!("../../../shaders/shared/texture.wgsl"), include_str!("../../../shaders/shared/material.wgsl")];

/// What stands in for that where everything is.
const OPAQUE_STUBS: [&str; 1] = [include_str!("../../../shaders/shared/opaque.wgsl")];

/// What lies at a hit.
const SURFACES: [&str; 2] =
    [include_str!("../../../shaders/shared/surface.wgsl"), include_str!("../../../shaders/shared/offset.wgsl")];

/// Files of the kernels that render.
const SHADING: [&str; 5] = [
    include_str!("../../../shaders/shared/camera.wgsl"),
    include_str!("../../../shaders/shared/sky.wgsl"),
    include_str!("../../../shaders/shared/brdf.wgsl"),
    include_str!("../../../shaders/shared/light.wgsl"),
    include_str!("../../../shaders/shared/whitted.wgsl"),
];

impl EntryPoint {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Render, Self::RenderAovs, Self::ClosestHits, Self::AnyHits];

    /// The name of the entry point in its module.
    pub fn name(self) -> &'static str {
        match self {
            Self::Render => "render",
            Self::RenderAovs => "render_aovs",
            Self::ClosestHits => "closest_hits",
            Self::AnyHits => "any_hits",
        }
    }

    /// The module's source, of a kernel that can do what its variant says.
    pub fn source(self, variant: impl Into<KernelVariant>) -> String {
        let shading = match self {
            Self::Render | Self::RenderAovs => [&SURFACES[..], &SHADING[..]].concat(),
            Self::ClosestHits | Self::AnyHits => Vec::new(),
        };
        let variant = variant.into();
        let files = [&variant.scene_files()[..], &MATERIALS[..], &shading, &[self.file()]].concat();
        variant.preamble() + &files.concat()
    }

    fn file(self) -> &'static str {
        match self {
            Self::Render | Self::RenderAovs => include_str!("../../../shaders/render.wgsl"),
            Self::ClosestHits => include_str!("../../../shaders/closest_hits.wgsl"),
            Self::AnyHits => include_str!("../../../shaders/any_hits.wgsl"),
        }
    }
}
