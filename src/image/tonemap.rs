//! Tone mapping and sRGB encoding.

use glam::Vec3;

/// How linear radiance becomes a colour for a display, where 1 is white. Colours of unlit surfaces are never changed:
/// see [`Image::unlit`](super::Image::unlit).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ToneMapping {
    /// By [`khronos_pbr_neutral`]: colours above 0.8 are compressed, so that bright ones keep their shape, and all lose
    /// up to 0.04 for what a dielectric reflects.
    #[default]
    KhronosPbrNeutral,
    /// Not at all: components above 1 are cut off.
    None,
}

impl ToneMapping {
    /// The colour for a display of a radiance of which this share, 0 to 1, came from unlit surfaces: the share is shown
    /// as it is, the rest is compressed. NaN and negative components are taken as 0, infinite ones as the largest f32.
    pub(super) fn map(self, linear: Vec3, unlit: f32) -> Vec3 {
        let linear = to_finite(linear);
        match self {
            Self::KhronosPbrNeutral => khronos_pbr_neutral(linear).lerp(linear, unlit),
            Self::None => linear,
        }
    }
}

fn to_finite(linear: Vec3) -> Vec3 {
    linear.map(|c| if c > 0.0 { c.min(f32::MAX) } else { 0.0 })
}

/// Compresses linear radiance into 0 to 1 for a display, by the Khronos PBR Neutral tone mapper: colours up to 0.8 keep
/// their hue and saturation, so that a base colour under white light of strength 1 appears unchanged; brighter colours
/// roll off to white.
///
/// NaN and negative components are taken as 0, infinite ones as the largest f32.
///
/// Source: <https://github.com/KhronosGroup/ToneMapping/tree/main/PBR_Neutral>.
pub fn khronos_pbr_neutral(linear: Vec3) -> Vec3 {
    /// The largest component at which compression starts: 0.8, less the offset that is subtracted first.
    const START_COMPRESSION: f32 = 0.8 - 0.04;
    /// How fast compressed colours lose saturation.
    const DESATURATION: f32 = 0.15;

    let linear = to_finite(linear);

    // 1. Subtract the Fresnel offset (F0 = 0.04), as the Khronos reference does.
    // A dielectric reflects that much of white surroundings; darker colours lose less.
    let darkest = linear.min_element();
    let offset = if darkest < 0.08 { darkest - 6.25 * darkest * darkest } else { 0.04 };
    let color = linear - offset;

    // 2. Colours below the shoulder are done.
    let peak = color.max_element();
    if peak < START_COMPRESSION {
        return color;
    }
    // 3. Compress the peak to below 1, and desaturate by how much that took away.
    let headroom = 1.0 - START_COMPRESSION;
    let new_peak = 1.0 - headroom * headroom / (peak + headroom - START_COMPRESSION);
    let white = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    (color / peak * new_peak).lerp(Vec3::splat(new_peak), white)
}

/// The sRGB transfer function (IEC 61966-2-1), from linear light to encoded value; 0 to 1 on both sides.
pub fn srgb_from_linear(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// One pixel of [`Image::to_rgba8`](super::Image::to_rgba8).
pub(super) fn rgba8(tone_mapping: ToneMapping, [r, g, b, a]: [f32; 4], unlit: f32) -> [u8; 4] {
    // A cast from float to integer saturates, and turns NaN into 0.
    let quantized = |c: f32| (c * 255.0 + 0.5) as u8;
    let [r, g, b] = tone_mapping.map(Vec3::new(r, g, b), unlit).map(srgb_from_linear).to_array().map(quantized);
    [r, g, b, quantized(a)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_matches_the_standard_in_f64() {
        let exact = |x: f64| if x <= 0.0031308 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
        for i in 0..=10_000 {
            let x = i as f32 / 10_000.0;
            let error = (f64::from(srgb_from_linear(x)) - exact(f64::from(x))).abs();
            assert!(error < 1e-6, "{x}: off by {error}");
        }
    }

    #[test]
    fn every_srgb_code_survives_decoding_and_encoding() {
        for code in 0..=255_u8 {
            let encoded = f64::from(code) / 255.0;
            let linear = if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) };
            assert_eq!((srgb_from_linear(linear as f32) * 255.0 + 0.5) as u8, code);
        }
    }

    #[test]
    fn colours_below_the_shoulder_only_lose_the_offset() {
        assert_eq!(khronos_pbr_neutral(Vec3::new(0.5, 0.3, 0.2)), Vec3::new(0.5, 0.3, 0.2) - 0.04);
        assert_eq!(khronos_pbr_neutral(Vec3::ZERO), Vec3::ZERO);
        // Saturated colours have no white to take away.
        assert_eq!(khronos_pbr_neutral(Vec3::new(0.7, 0.0, 0.0)), Vec3::new(0.7, 0.0, 0.0));
    }

    #[test]
    fn brighter_grey_is_never_darker_and_stays_below_one() {
        let greys = (0..100_000).map(|i| khronos_pbr_neutral(Vec3::splat(i as f32 * 0.001)).x);
        let mut last = -1.0;
        for grey in greys {
            let rounding = 2.0 * f32::EPSILON;
            assert!(grey >= last - rounding && grey <= 1.0, "{grey} after {last}");
            last = grey;
        }
        assert!(last > 0.99);
    }

    #[test]
    fn numbers_that_are_not_finite_do_no_harm() {
        for tone_mapping in [ToneMapping::KhronosPbrNeutral, ToneMapping::None] {
            for unlit in [0.0, 0.5, 1.0] {
                let rgba8 = |pixel| rgba8(tone_mapping, pixel, unlit);
                assert_eq!(rgba8([f32::NAN; 4]), [0, 0, 0, 0]);
                assert_eq!(rgba8([f32::NEG_INFINITY, -1.0, 0.0, 1.0]), [0, 0, 0, 255]);
                assert_eq!(rgba8([f32::INFINITY; 4]), [255; 4]);
                assert_eq!(rgba8([f32::MAX; 4]), [255; 4]);
            }
        }
    }

    /// Every 8-bit colour of an unlit surface comes back, and every other one that is not tone mapped.
    #[test]
    fn unlit_colours_are_not_compressed() {
        let linear = |code: u8| {
            let encoded = f64::from(code) / 255.0;
            (if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }) as f32
        };
        for code in 0..=255 {
            let pixel = [linear(255), linear(code), linear(0), 1.0];
            assert_eq!(rgba8(ToneMapping::KhronosPbrNeutral, pixel, 1.0), [255, code, 0, 255]);
            assert_eq!(rgba8(ToneMapping::None, pixel, 0.0), [255, code, 0, 255]);
        }
        let compressed = rgba8(ToneMapping::KhronosPbrNeutral, [linear(255), linear(127), 0.0, 1.0], 0.0);
        assert_eq!(compressed, [241, 123, 33, 255]);
    }
}
