//! Assembles a WGSL module: generated constants and accessors, shared files, one entry point.

mod include;
mod splits;

use std::fmt::Write as _;

pub use include::Include;
pub(crate) use splits::ARRAY_COUNT;
pub use splits::{ArraySplit, ArraySplits};

use super::Traversal;
use crate::device::{MAX_MIRROR_ROUGHNESS, Needs};

/// Entry points of the kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum EntryPoint {
    /// Renders the colour of each pixel (linear radiance).
    Render,
    /// Renders each pixel with its normal, depth and identifiers.
    RenderAovs,
    /// Finds the closest hit of each ray of a batch.
    ClosestHits,
    /// Occlusion query: for each ray of a batch, whether an opaque surface lies between `t_min` and `t_max`.
    AnyHits,
}

/// Specialisation of a kernel module. Made from the [`Needs`] of a scene:
///
/// ```
/// use ropewalk::device::Needs;
/// use ropewalk::trace::Traversal;
/// use ropewalk::trace::shader::KernelVariant;
///
/// let variant = KernelVariant::from(Needs::LIGHTS).with_traversal(Traversal::Rope);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct KernelVariant {
    /// Scene features compiled in.
    pub needs: Needs,
    /// The traversal compiled in.
    pub traversal: Traversal,
    /// How the arrays are split over bindings.
    pub splits: ArraySplits,
}

impl From<Needs> for KernelVariant {
    fn from(needs: Needs) -> Self {
        Self { needs, ..Self::default() }
    }
}

impl KernelVariant {
    /// Compiles in this traversal.
    #[must_use]
    pub fn with_traversal(self, traversal: Traversal) -> Self {
        Self { traversal, ..self }
    }

    /// Reads arrays that are split like this.
    #[must_use]
    pub fn with_splits(self, splits: ArraySplits) -> Self {
        Self { splits, ..self }
    }

    /// The files that declare, intersect and traverse the scene.
    fn scene_files(&self) -> [&'static str; 6] {
        let traversal = match self.traversal {
            Traversal::Rope => include_str!("../../../shaders/shared/rope.wgsl"),
            Traversal::Wide => include_str!("../../../shaders/shared/wide.wgsl"),
        };
        let [types, math, intersect, query, traverse] = SCENE;
        [types, math, intersect, traversal, query, traverse]
    }

    /// Generated declarations that all files rely on: a constant for each flag of [`Needs`], `NEEDS_TEXTURES` for
    /// example, so that the driver eliminates unused branches, and the functions that read arrays.
    fn preamble(&self) -> String {
        let mut source = String::new();
        for (name, flag) in Needs::all().iter_names() {
            // Writing to a string cannot fail.
            let _ = writeln!(source, "const NEEDS_{name}: bool = {};", self.needs.contains(flag));
        }
        // A float literal needs a decimal point in WGSL: `{:?}` writes it.
        let _ = writeln!(source, "const MAX_MIRROR_ROUGHNESS: f32 = {MAX_MIRROR_ROUGHNESS:?};");
        source + &self.splits.source(self.traversal)
    }
}

/// Files of every kernel: types, math, intersection, queries and traversal.
const SCENE: [&str; 5] = [
    include_str!("../../../shaders/shared/types.wgsl"),
    include_str!("../../../shaders/shared/math.wgsl"),
    include_str!("../../../shaders/shared/intersect.wgsl"),
    include_str!("../../../shaders/shared/query.wgsl"),
    include_str!("../../../shaders/shared/traverse.wgsl"),
];

/// Material evaluation, for alpha tests and transmittance.
const MATERIALS: [&str; 2] =
    [include_str!("../../../shaders/shared/texture.wgsl"), include_str!("../../../shaders/shared/material.wgsl")];

/// Stubs for opaque scenes, in place of [`MATERIALS`].
const OPAQUE_STUBS: [&str; 1] = [include_str!("../../../shaders/shared/opaque.wgsl")];

/// Surface reconstruction at a hit.
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
    /// All entry points.
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

    /// The WGSL source of a module with this entry point, specialised for a variant.
    pub fn source(self, variant: impl Into<KernelVariant>) -> String {
        // Only kernels that render need surfaces and shading.
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
