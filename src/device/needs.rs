//! What a scene uses, so that the kernel holds that and no more.

use serde::Serialize;

/// Perceptual roughness from which a reflection is too blurred to trace: the sky stands in for it.
pub const MAX_MIRROR_ROUGHNESS: f32 = 0.5;

bitflags::bitflags! {
    /// The parts of the kernel that a scene needs. A scene rendered with more gives the same image, slower.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct Needs: u32 {
        /// Some material refers to a texture.
        const TEXTURES = 1;
        /// Some material has a normal texture.
        const NORMAL_TEXTURES = 2;
        /// Some geometry has vertex colours.
        const COLORS = 4;
        /// Some material has holes: `closest_hit` asks it about each candidate.
        const ALPHA_MASK = 8;
        /// Some material blends by alpha: paths go on behind it.
        const BLEND = 16;
        /// Some material reflects sharply enough to be seen in ([`MAX_MIRROR_ROUGHNESS`]): paths are mirrored.
        const REFLECTION = 32;
        /// Some material transmits: paths are refracted.
        const REFRACTION = 64;
        /// Some light shines: shadow rays are traced.
        const LIGHTS = 128;
        /// Some material is single-sided: `closest_hit` culls.
        const CULLING = 256;
    }
}

impl Serialize for Needs {
    /// A list of names.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter_names().map(|(name, _)| name.to_lowercase()))
    }
}
