//! Texture sampling with glTF sampler semantics; all texels lie in one array (the paper's Tex). Twin of
//! `shaders/shared/texture.wgsl`.

use glam::{Vec2, Vec4};

use super::KernelScene;
use crate::device::layout::{TextureFlags, TextureInfo};

/// sRGB decoding: a linear segment of slope 1/12.92, then a power of (c + 0.055) / 1.055. See [`linear_from_srgb`].
pub(super) const SRGB_LINEAR_END: f32 = 0.04045;
/// 1 / 12.92; like the two below a rounded quotient, not one of rounded numbers.
pub(super) const SRGB_LINEAR_SLOPE: f32 = 0.077_399_38;
/// 1 / 1.055.
pub(super) const SRGB_SCALE: f32 = 0.947_867_3;
/// 0.055 / 1.055.
pub(super) const SRGB_OFFSET: f32 = 0.052_132_7;
/// Polynomial coefficients in s, highest power first.
pub(super) const SRGB_FIT_6: f32 = -1.075_061_1;
pub(super) const SRGB_FIT_5: f32 = 4.978_437;
pub(super) const SRGB_FIT_4: f32 = -9.720_242;
pub(super) const SRGB_FIT_3: f32 = 10.421_47;
pub(super) const SRGB_FIT_2: f32 = -6.720_234;
pub(super) const SRGB_FIT_1: f32 = 2.733_810_4;
pub(super) const SRGB_FIT_0: f32 = -0.818_191;

/// Bilinear or nearest sample at `tex_coord`.
pub(crate) fn sample_texture(scene: &KernelScene<'_>, info: &TextureInfo, tex_coord: Vec2) -> Vec4 {
    // Transform to image coordinates, and wrap them to a position in texels.
    let coord = image_coordinates(info, tex_coord);
    let [wrap_u, wrap_v] = wrap_modes(info);
    let x = texel_position(coord.x, info.width, wrap_u);
    let y = texel_position(coord.y, info.height, wrap_v);
    if flags(info).contains(TextureFlags::NEAREST) {
        return load_texel(scene, info, x.floor() as i32, y.floor() as i32);
    }

    // Texel centres lie at half-integers: interpolate the four around the point.
    let left = (x - 0.5).floor();
    let top = (y - 0.5).floor();
    let across = (x - 0.5) - left;
    let down = (y - 0.5) - top;
    let column = left as i32;
    let row = top as i32;
    let upper = mix4(load_texel(scene, info, column, row), load_texel(scene, info, column + 1, row), across);
    let lower = mix4(load_texel(scene, info, column, row + 1), load_texel(scene, info, column + 1, row + 1), across);
    mix4(upper, lower, down)
}

/// Texture coordinates to image coordinates, in which the image spans 0 to 1.
pub(crate) fn image_coordinates(info: &TextureInfo, tex_coord: Vec2) -> Vec2 {
    Vec2::new(
        (info.row_u[0] * tex_coord.x + info.row_u[1] * tex_coord.y) + info.row_u[2],
        (info.row_v[0] * tex_coord.x + info.row_v[1] * tex_coord.y) + info.row_v[2],
    )
}

/// Wrap mode of one axis.
#[derive(Clone, Copy, PartialEq)]
enum Wrap {
    Repeat,
    Mirror,
    Clamp,
}

fn wrap_modes(info: &TextureInfo) -> [Wrap; 2] {
    let wrap = |mirror, clamp| {
        if flags(info).contains(clamp) {
            Wrap::Clamp
        } else if flags(info).contains(mirror) {
            Wrap::Mirror
        } else {
            Wrap::Repeat
        }
    };
    [wrap(TextureFlags::MIRROR_U, TextureFlags::CLAMP_U), wrap(TextureFlags::MIRROR_V, TextureFlags::CLAMP_V)]
}

fn flags(info: &TextureInfo) -> TextureFlags {
    TextureFlags::from_bits_retain(info.flags)
}

/// Position of an image coordinate along an axis, in texels: in 0..size or, if mirrored, in 0..2 size.
fn texel_position(coord: f32, size: u32, wrap: Wrap) -> f32 {
    match wrap {
        Wrap::Clamp => coord.clamp(0.0, 1.0) * size as f32,
        Wrap::Mirror => (coord - 2.0 * (coord * 0.5).floor()) * size as f32,
        Wrap::Repeat => (coord - coord.floor()) * size as f32,
    }
}

fn load_texel(scene: &KernelScene<'_>, info: &TextureInfo, column: i32, row: i32) -> Vec4 {
    // Wrap the indices.
    let [wrap_u, wrap_v] = wrap_modes(info);
    let x = wrap_index(column, info.width as i32, wrap_u);
    let y = wrap_index(row, info.height as i32, wrap_v);
    let word = scene.texels[(info.first_texel + y as u32 * info.width + x as u32) as usize];
    // Unpack four 8-bit channels, and decode sRGB; alpha is linear always.
    let bytes = [word & 255, (word >> 8) & 255, (word >> 16) & 255, word >> 24];
    let rgba = Vec4::from_array(bytes.map(|byte| byte as f32)) * (1.0 / 255.0);
    if flags(info).contains(TextureFlags::SRGB) {
        return Vec4::new(linear_from_srgb(rgba.x), linear_from_srgb(rgba.y), linear_from_srgb(rgba.z), rgba.w);
    }
    rgba
}

/// Index after wrapping; `i` is at most one texel outside the range of [`texel_position`].
fn wrap_index(i: i32, size: i32, wrap: Wrap) -> i32 {
    let mut wrapped = i;
    match wrap {
        Wrap::Clamp => {}
        Wrap::Mirror => {
            // Reflect at 0, wrap at twice the size (the period), and reflect at the size.
            if wrapped < 0 {
                wrapped = -1 - wrapped;
            }
            if wrapped >= 2 * size {
                wrapped -= 2 * size;
            }
            if wrapped >= size {
                wrapped = 2 * size - 1 - wrapped;
            }
        }
        Wrap::Repeat => {
            if wrapped < 0 {
                // One period is enough, as the index is at most one texel outside.
                wrapped += size;
            }
            if wrapped >= size {
                wrapped -= size;
            }
        }
    }
    // For clamped axes, and for NaN coordinates.
    wrapped.clamp(0, size - 1)
}

/// The sRGB decoding of IEC 61966-2-1, ((c + 0.055) / 1.055)^2.4, to a relative error of 2e-5 (1/400 of the step
/// between two 8-bit values): x^2.4 = x^2 s s^-0.2 with s = sqrt(x), and a Chebyshev fit of s^-0.2 that is 1 at 1.
///
/// A table of 256 values would be exact, but a shader that indexes a constant array copies it first on some drivers.
pub(crate) fn linear_from_srgb(c: f32) -> f32 {
    if c <= SRGB_LINEAR_END {
        return c * SRGB_LINEAR_SLOPE;
    }
    let x = c * SRGB_SCALE + SRGB_OFFSET;
    let s = x.sqrt();
    // Evaluate the fit by Horner's rule.
    let mut slope = SRGB_FIT_6 * s + SRGB_FIT_5;
    slope = slope * s + SRGB_FIT_4;
    slope = slope * s + SRGB_FIT_3;
    slope = slope * s + SRGB_FIT_2;
    slope = slope * s + SRGB_FIT_1;
    slope = slope * s + SRGB_FIT_0;
    ((x * x) * s) * (1.0 + (s - 1.0) * slope)
}

fn mix4(a: Vec4, b: Vec4, weight: f32) -> Vec4 {
    a * (1.0 - weight) + b * weight
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::DeviceArrays;

    #[test]
    fn srgb_decodes_as_the_standard_says() {
        let exact = |c: f64| if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
        for byte in 0..=255 {
            let (found, expected) =
                (f64::from(linear_from_srgb(byte as f32 * (1.0 / 255.0))), exact(f64::from(byte) / 255.0));
            assert!((found - expected).abs() <= 2e-5 * expected, "{byte}: {found}, expected {expected}");
        }
        assert_eq!(linear_from_srgb(1.0), 1.0, "white stays white");
        assert_eq!(linear_from_srgb(0.0), 0.0);
    }

    /// Three columns and two rows of greys: 0, 10, 20 over 100, 110, 120.
    const GREYS: [[u32; 3]; 2] = [[0, 10, 20], [100, 110, 120]];

    fn sample(flags: TextureFlags, u: f32, v: f32) -> f32 {
        let mut arrays = DeviceArrays::default();
        let words: Vec<u32> = GREYS.iter().flatten().map(|grey| (grey * 0x01_01_01) | 0xff00_0000).collect();
        // Texels of other textures before and after: what is read must lie within this one.
        let texels: Vec<u32> = [&[0xffff_ffff; 4][..], &words, &[0xffff_ffff; 4]].concat();
        arrays.texels.replace(&texels);
        let info = TextureInfo {
            row_u: [1.0, 0.0, 0.0, 0.0],
            row_v: [0.0, 1.0, 0.0, 0.0],
            first_texel: 4,
            width: 3,
            height: 2,
            flags: flags.bits(),
        };
        let rgba = sample_texture(&KernelScene::new(&arrays), &info, Vec2::new(u, v)) * 255.0;
        rgba.x
    }

    /// The texel at an index of an axis that repeats in both directions: written out, not computed.
    const REPEATED: [usize; 12] = [0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2];
    const MIRRORED: [usize; 12] = [0, 1, 2, 2, 1, 0, 0, 1, 2, 2, 1, 0];
    const CLAMPED: [usize; 12] = [0, 0, 0, 0, 0, 0, 0, 1, 2, 2, 2, 2];
    const FIRST: i32 = -6;

    #[test]
    fn texels_are_where_the_wrap_mode_puts_them() {
        let modes =
            [(TextureFlags::empty(), REPEATED), (TextureFlags::MIRROR_U, MIRRORED), (TextureFlags::CLAMP_U, CLAMPED)];
        for (flags, columns) in modes {
            let grey = |i: i32| GREYS[0][columns[(i - FIRST) as usize]] as f32;
            for i in FIRST..FIRST + 12 {
                for within in [0.01, 0.25, 0.5, 0.75, 0.99] {
                    let u = (i as f32 + within) / 3.0;
                    let found = sample(flags | TextureFlags::NEAREST | TextureFlags::CLAMP_V, u, 0.25);
                    assert!((found - grey(i)).abs() < 1e-3, "{flags:?} nearest {u}: {found}, expected {}", grey(i));
                }
            }
            // Bilinear: a quarter of the way from one texel centre to the next.
            for i in FIRST..FIRST + 11 {
                let u = (i as f32 + 0.75) / 3.0;
                let found = sample(flags | TextureFlags::CLAMP_V, u, 0.25);
                let expected = grey(i) * 0.75 + grey(i + 1) * 0.25;
                assert!((found - expected).abs() < 1e-3, "{flags:?} bilinear {u}: {found}, expected {expected}");
            }
        }
    }

    #[test]
    fn rows_go_down_and_wrap_by_their_own_mode() {
        let cases = [
            (
                TextureFlags::empty(),
                [(0.25, 10.0), (0.75, 110.0), (0.5, 60.0), (0.0, 60.0), (1.25, 10.0), (-0.25, 110.0)],
            ),
            (
                TextureFlags::MIRROR_V,
                [(0.25, 10.0), (0.75, 110.0), (0.5, 60.0), (0.0, 10.0), (1.25, 110.0), (-0.25, 10.0)],
            ),
            (
                TextureFlags::CLAMP_V,
                [(0.25, 10.0), (0.75, 110.0), (0.5, 60.0), (0.0, 10.0), (1.25, 110.0), (-0.25, 10.0)],
            ),
        ];
        for (flags, values) in cases {
            for (v, expected) in values {
                let found = sample(flags, 0.5, v);
                assert!((found - expected).abs() < 1e-3, "{flags:?} at {v}: {found}, expected {expected}");
            }
        }
    }

    #[test]
    fn wild_coordinates_read_within_the_texture() {
        for coord in [1e30, -1e30, f32::MAX, f32::INFINITY, f32::NAN, -1e-12, 16_777_217.0] {
            for flags in 0..TextureFlags::SRGB.bits() {
                let grey = sample(TextureFlags::from_bits_retain(flags), coord, -coord);
                assert!(grey.is_nan() || grey <= 120.001, "{coord} {flags}: {grey}");
            }
        }
    }

    #[test]
    fn the_transform_is_applied() {
        let info =
            TextureInfo { row_u: [2.0, 3.0, 0.5, 9.0], row_v: [-1.0, 4.0, 0.25, 9.0], ..bytemuck::Zeroable::zeroed() };
        assert_eq!(image_coordinates(&info, Vec2::new(10.0, 100.0)), Vec2::new(320.5, 390.25));
    }
}
