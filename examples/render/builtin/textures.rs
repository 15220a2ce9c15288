//! Textures made in code: all of them tile.

use glam::{IVec2, Vec2, Vec3, ivec2, vec2};
use ropewalk::graph::Texture;
use ropewalk::image::srgb_from_linear;

/// Two by two marble slabs, light and dark in turn, with joints between them.
pub(crate) fn marble_checker(size: u32) -> Texture {
    from_fn(size, |p| {
        let slab = (p * 2.0).floor();
        let within = p * 2.0 - slab;
        let joint = within.min(1.0 - within).min_element() < 0.008;
        let is_light = (slab.x + slab.y) as i32 % 2 == 0;
        // Light and dark slabs use different seeds. Both patterns tile, so that the texture repeats.
        let veins = veins(p, if is_light { 0 } else { 7 });
        match (joint, is_light) {
            (true, _) => Vec3::splat(0.05),
            (false, true) => Vec3::new(0.74, 0.70, 0.63).lerp(Vec3::new(0.42, 0.38, 0.34), veins),
            (false, false) => Vec3::new(0.055, 0.065, 0.075).lerp(Vec3::new(0.32, 0.33, 0.32), veins * veins),
        }
    })
}

/// Pale marble with grey and rusty veins.
pub(crate) fn marble(size: u32) -> Texture {
    from_fn(size, |p| {
        let (grey, rust) = (veins(p, 3), veins(p, 11));
        let white = Vec3::new(0.80, 0.76, 0.69).lerp(Vec3::new(0.46, 0.44, 0.43), grey);
        white.lerp(Vec3::new(0.56, 0.40, 0.27), 0.5 * rust)
    })
}

/// A texture of `size` by `size` texels whose linear colour at `p`, each coordinate in 0 to 1, is `color(p)`.
pub(crate) fn from_fn(size: u32, color: impl Fn(Vec2) -> Vec3) -> Texture {
    let texel = |x: u32, y: u32| {
        let linear = color((vec2(x as f32, y as f32) + 0.5) / size as f32);
        let [r, g, b] = linear.to_array().map(|c| (srgb_from_linear(c) * 255.0 + 0.5) as u8);
        [r, g, b, 255]
    };
    let texels = (0..size).flat_map(|y| (0..size).map(move |x| (x, y))).map(|(x, y)| texel(x, y)).collect();
    Texture { width: size, height: size, texels }
}

/// Thin lines, 0 to 1, at the zeros of a sine wave distorted by noise. Tiles with period 1.
fn veins(p: Vec2, seed: u32) -> f32 {
    let turbulence = (0..5).map(|octave| noise(p, 2 << octave, seed + octave) / (1 << octave) as f32).sum::<f32>();
    let wave = (std::f32::consts::TAU * (p.x + p.y + 0.7 * turbulence)).sin().abs();
    (1.0 - wave).powi(6)
}

/// Value noise between -1 and 1, with `cells` by `cells` random values over the unit square. Tiles with period 1.
fn noise(p: Vec2, cells: i32, seed: u32) -> f32 {
    let scaled = p * cells as f32;
    let cell = scaled.floor();
    let t = scaled - cell;
    let t = t * t * (3.0 - 2.0 * t);
    let corner = |dx, dy| random((cell.as_ivec2() + ivec2(dx, dy)).rem_euclid(IVec2::splat(cells)), seed);
    let upper = corner(0, 0) + (corner(1, 0) - corner(0, 0)) * t.x;
    let lower = corner(0, 1) + (corner(1, 1) - corner(0, 1)) * t.x;
    upper + (lower - upper) * t.y
}

/// A pseudorandom number between -1 and 1: a hash of its arguments (two rounds of the PCG output function).
fn random(cell: IVec2, seed: u32) -> f32 {
    let pcg = |v: u32| {
        let state = v.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
        (word >> 22) ^ word
    };
    let hash = pcg(pcg(cell.x as u32 ^ pcg(seed)).wrapping_add(cell.y as u32));
    hash as f32 / u32::MAX as f32 * 2.0 - 1.0
}
