//! The features that a scene uses: executors compile or run a kernel with only these.

use serde::Serialize;

/// Perceptual roughness from which a reflection is too blurred to trace: the sky's radiance is used instead.
pub const MAX_MIRROR_ROUGHNESS: f32 = 0.5;

bitflags::bitflags! {
    /// The parts of the kernel that a scene needs. A kernel with more parts renders the same image, more slowly.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct Needs: u32 {
        /// Some material refers to a texture.
        const TEXTURES = 1;
        /// Some material has a normal texture.
        const NORMAL_TEXTURES = 2;
        /// Some geometry has vertex colours.
        const COLORS = 4;
        /// Some material has an alpha mask, or blends and may be fully transparent somewhere: closest-hit queries test
        /// each candidate for a hole.
        const ALPHA_MASK = 8;
        /// Some material blends by alpha: paths continue behind its surface.
        const BLEND = 16;
        /// Some material has a roughness below [`MAX_MIRROR_ROUGHNESS`]: its reflections are traced.
        const REFLECTION = 32;
        /// Some material transmits light: paths are refracted.
        const REFRACTION = 64;
        /// Some light is visible: shadow rays are traced.
        const LIGHTS = 128;
        /// Some material is single-sided: closest-hit queries cull back faces.
        const CULLING = 256;
    }
}

impl Serialize for Needs {
    /// Serialises as a list of lower-case names.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter_names().map(|(name, _)| name.to_lowercase()))
    }
}
