// Presents a traced frame: filtered to the window's pixels, tone mapped and sRGB encoded, with the functions of
// `ropewalk::image`. A texel's alpha is 1 plus the share of its radiance that came from unlit surfaces, which tone
// mapping leaves alone.

struct Viewport {
    // In pixels of the window.
    origin: vec2f,
    size: vec2f,
}

@group(0) @binding(0) var frame: texture_2d<f32>;
@group(0) @binding(1) var<uniform> viewport: Viewport;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    // One triangle that covers the viewport.
    return vec4f(select(-1.0, 3.0, index == 1u), select(-1.0, 3.0, index == 2u), 0.0, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = floor(position.xy - viewport.origin);
    let texels = vec2f(textureDimensions(frame));
    let scale = texels / viewport.size;
    // Radiance, and its unlit share.
    var linear: vec4f;
    if all(scale >= vec2f(1.0)) {
        linear = mean(vec2i(pixel), vec2i(scale + 0.5));
    } else {
        linear = smoothed((pixel + 0.5) * scale - 0.5, vec2i(texels) - 1);
    }
    return vec4f(srgb(mix(neutral(linear.rgb), linear.rgb, linear.a)), 1.0);
}

// Mean radiance of the rays of a pixel, and its unlit share.
fn mean(pixel: vec2i, rays: vec2i) -> vec4f {
    var sum = vec3f(0.0);
    var unlit = 0.0;
    for (var y = 0; y < rays.y; y++) {
        for (var x = 0; x < rays.x; x++) {
            let ray = textureLoad(frame, pixel * rays + vec2i(x, y), 0);
            sum += ray.rgb;
            unlit += (ray.a - 1.0) * (ray.r + ray.g + ray.b);
        }
    }
    let share = select(0.0, min(unlit / (sum.r + sum.g + sum.b), 1.0), unlit > 0.0);
    return vec4f(sum / f32(rays.x * rays.y), share);
}

// Bilinear interpolation of the four nearest rays. `load` limits their radiance, so that bright ones do not spread.
fn smoothed(at: vec2f, last: vec2i) -> vec4f {
    let low = floor(at);
    let t = at - low;
    let a = clamp(vec2i(low), vec2i(0), last);
    let b = clamp(vec2i(low) + 1, vec2i(0), last);
    let above = mix(load(a.x, a.y), load(b.x, a.y), t.x);
    let below = mix(load(a.x, b.y), load(b.x, b.y), t.x);
    return mix(above, below, t.y);
}

fn load(x: i32, y: i32) -> vec4f {
    let ray = textureLoad(frame, vec2i(x, y), 0);
    return vec4f(min(ray.rgb, vec3f(4.0)), ray.a - 1.0);
}

// The Khronos PBR Neutral tone mapper; `khronos_pbr_neutral` of src/image/tonemap.rs.
fn neutral(radiance: vec3f) -> vec3f {
    let start = 0.8 - 0.04;
    let desaturation = 0.15;
    let linear = clamp(radiance, vec3f(0.0), vec3f(1e30));
    let darkest = min(linear.r, min(linear.g, linear.b));
    let offset = select(0.04, darkest - 6.25 * darkest * darkest, darkest < 0.08);
    let color = linear - offset;
    let peak = max(color.r, max(color.g, color.b));
    if peak < start {
        return color;
    }
    let headroom = 1.0 - start;
    let new_peak = 1.0 - headroom * headroom / (peak + headroom - start);
    let white = 1.0 - 1.0 / (desaturation * (peak - new_peak) + 1.0);
    return mix(color / peak * new_peak, vec3f(new_peak), white);
}

// `srgb_from_linear` of src/image/tonemap.rs.
fn srgb(linear: vec3f) -> vec3f {
    let curved = 1.055 * pow(max(linear, vec3f(0.0)), vec3f(1.0 / 2.4)) - 0.055;
    return select(curved, 12.92 * linear, linear <= vec3f(0.0031308));
}
