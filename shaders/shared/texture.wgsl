// Texture sampling with glTF sampler semantics; all texels lie in one array (the paper's Tex). Twin of
// src/trace/kernel/texture.rs.

// sRGB decoding: a linear segment of slope 1/12.92, then a power of (c + 0.055) / 1.055. See linear_from_srgb.
const SRGB_LINEAR_END: f32 = 0.04045;
const SRGB_LINEAR_SLOPE: f32 = 0.07739938; // 1 / 12.92
const SRGB_SCALE: f32 = 0.9478673; // 1 / 1.055
const SRGB_OFFSET: f32 = 0.0521327; // 0.055 / 1.055
// Polynomial coefficients in s, highest power first.
const SRGB_FIT_6: f32 = -1.0750611;
const SRGB_FIT_5: f32 = 4.978437;
const SRGB_FIT_4: f32 = -9.720242;
const SRGB_FIT_3: f32 = 10.42147;
const SRGB_FIT_2: f32 = -6.720234;
const SRGB_FIT_1: f32 = 2.7338104;
const SRGB_FIT_0: f32 = -0.818191;

// Bilinear or nearest sample at `tex_coord`.
fn sample_texture(info: TextureInfo, tex_coord: vec2<f32>) -> vec4<f32> {
    let coord = image_coordinates(info, tex_coord);
    let x = texel_position(coord.x, info.width, info.flags & TEXTURE_MIRROR_U, info.flags & TEXTURE_CLAMP_U);
    let y = texel_position(coord.y, info.height, info.flags & TEXTURE_MIRROR_V, info.flags & TEXTURE_CLAMP_V);
    if (info.flags & TEXTURE_NEAREST) != 0u {
        return load_texel(info, i32(floor(x)), i32(floor(y)));
    }

    // Texel centres lie at half-integers: interpolate the four around the point.
    let left = floor(x - 0.5);
    let top = floor(y - 0.5);
    let across = (x - 0.5) - left;
    let down = (y - 0.5) - top;
    let column = i32(left);
    let row = i32(top);
    let upper = mix4(load_texel(info, column, row), load_texel(info, column + 1, row), across);
    let lower = mix4(load_texel(info, column, row + 1), load_texel(info, column + 1, row + 1), across);
    return mix4(upper, lower, down);
}

fn image_coordinates(info: TextureInfo, tex_coord: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(
        (info.row_u.x * tex_coord.x + info.row_u.y * tex_coord.y) + info.row_u.z,
        (info.row_v.x * tex_coord.x + info.row_v.y * tex_coord.y) + info.row_v.z,
    );
}

// Position of an image coordinate along an axis, in texels: in 0..size or, if mirrored, in 0..2 size.
fn texel_position(coord: f32, size: u32, mirror_flag: u32, clamp_flag: u32) -> f32 {
    if clamp_flag != 0u {
        return clamp(coord, 0.0, 1.0) * f32(size);
    }
    if mirror_flag != 0u {
        return (coord - 2.0 * floor(coord * 0.5)) * f32(size);
    }
    return (coord - floor(coord)) * f32(size);
}

fn load_texel(info: TextureInfo, column: i32, row: i32) -> vec4<f32> {
    let x = wrap_index(column, i32(info.width), info.flags & TEXTURE_MIRROR_U, info.flags & TEXTURE_CLAMP_U);
    let y = wrap_index(row, i32(info.height), info.flags & TEXTURE_MIRROR_V, info.flags & TEXTURE_CLAMP_V);
    let word = texels[info.first_texel + u32(y) * info.width + u32(x)];
    let bytes = vec4<u32>(word & 255u, (word >> 8u) & 255u, (word >> 16u) & 255u, word >> 24u);
    let rgba = vec4<f32>(bytes) * (1.0 / 255.0);
    if (info.flags & TEXTURE_SRGB) != 0u {
        return vec4<f32>(linear_from_srgb(rgba.x), linear_from_srgb(rgba.y), linear_from_srgb(rgba.z), rgba.w);
    }
    return rgba;
}

// Index after wrapping; `i` is at most one texel outside the range of texel_position.
fn wrap_index(i: i32, size: i32, mirror_flag: u32, clamp_flag: u32) -> i32 {
    var wrapped = i;
    if clamp_flag == 0u && mirror_flag != 0u {
        if wrapped < 0 {
            wrapped = -1 - wrapped;
        }
        if wrapped >= 2 * size {
            wrapped -= 2 * size;
        }
        if wrapped >= size {
            wrapped = 2 * size - 1 - wrapped;
        }
    } else if clamp_flag == 0u {
        if wrapped < 0 {
            wrapped += size;
        }
        if wrapped >= size {
            wrapped -= size;
        }
    }
    // For clamped axes, and for NaN coordinates.
    return clamp(wrapped, 0, size - 1);
}

// The sRGB decoding of IEC 61966-2-1, ((c + 0.055) / 1.055)^2.4, to a relative error of 2e-5 (1/400 of the step between
// two 8-bit values): x^2.4 = x^2 s s^-0.2 with s = sqrt(x), and a Chebyshev fit of s^-0.2 that is 1 at 1.
fn linear_from_srgb(c: f32) -> f32 {
    if c <= SRGB_LINEAR_END {
        return c * SRGB_LINEAR_SLOPE;
    }
    let x = c * SRGB_SCALE + SRGB_OFFSET;
    let s = sqrt(x);
    var slope = SRGB_FIT_6 * s + SRGB_FIT_5;
    slope = slope * s + SRGB_FIT_4;
    slope = slope * s + SRGB_FIT_3;
    slope = slope * s + SRGB_FIT_2;
    slope = slope * s + SRGB_FIT_1;
    slope = slope * s + SRGB_FIT_0;
    return ((x * x) * s) * (1.0 + (s - 1.0) * slope);
}

fn mix4(a: vec4<f32>, b: vec4<f32>, weight: f32) -> vec4<f32> {
    return a * (1.0 - weight) + b * weight;
}
