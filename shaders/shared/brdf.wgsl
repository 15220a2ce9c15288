// How surfaces reflect: Fresnel's equations, and the microfacet model of glTF 2.0 (appendix B). Twin of
// src/trace/kernel/brdf.rs.

const PI: f32 = 3.14159265358979;
// Roughness up to which a surface is a mirror. Above MAX_MIRROR_ROUGHNESS, a constant of the compiler's, nothing is seen in it.
const SHARP_REFLECTION_ROUGHNESS: f32 = 0.1;
// Punctual lights have no size, and a polished surface would show none: they are seen in it as in this roughness.
const MIN_HIGHLIGHT_ROUGHNESS: f32 = 0.1;

// How much of a surface's reflection is traced, 1 for a mirror; the rest is blurred sky.
fn traced_reflection_share(roughness: f32) -> f32 {
    let x = clamp((MAX_MIRROR_ROUGHNESS - roughness) * (1.0 / (MAX_MIRROR_ROUGHNESS - SHARP_REFLECTION_ROUGHNESS)), 0.0, 1.0);
    return (x * x) * (3.0 - 2.0 * x);
}

// What a dielectric reflects of unpolarised light: Fresnel's equations. `eta` is the index of the side that the light comes
// from over that of the other side, 0 for an infinite one; `cosine` is of the angle of incidence. 1 where reflection is total.
fn fresnel_dielectric(cosine: f32, eta: f32) -> f32 {
    let cosine_2 = refracted_cosine(cosine, eta);
    if cosine_2 <= 0.0 || eta <= 0.0 {
        return 1.0;
    }
    let perpendicular = (eta * cosine - cosine_2) / (eta * cosine + cosine_2);
    let parallel = (cosine - eta * cosine_2) / (cosine + eta * cosine_2);
    return 0.5 * (perpendicular * perpendicular + parallel * parallel);
}

// The cosine of the angle of refraction (Snell's law), or 0 where reflection is total.
fn refracted_cosine(cosine: f32, eta: f32) -> f32 {
    // 1 - eta^2 sin^2, without the cancellation at eta = 1
    return sqrt(max((1.0 - eta) * (1.0 + eta) + (eta * cosine) * (eta * cosine), 0.0));
}

// (1 - cosine)^5: Schlick's approximation of how reflectance goes to 1.
fn schlick(cosine: f32) -> f32 {
    let x = clamp(1.0 - cosine, 0.0, 1.0);
    let square = x * x;
    return (square * square) * x;
}

// How much of the rise of reflectance towards grazing angles is left on a rough surface: a fit to the microfacets' albedo.
fn grazing_rise(roughness: f32) -> f32 {
    return 1.0 - roughness * (0.1 + 0.86 * roughness);
}

// How a surface divides the light that comes along the line of view; with what it absorbs, the sum is 1.
struct LobeWeights {
    // Like a mirror, sharp or blurred.
    specular_reflection: vec3<f32>,
    // Through the surface.
    specular_transmission: vec3<f32>,
    // In all directions.
    diffuse: vec3<f32>,
}

// `eta` is as in fresnel_dielectric.
fn lobe_weights(surface: Surface, cosine: f32, eta: f32) -> LobeWeights {
    let base_color = surface.base_color.xyz;
    let rise = grazing_rise(surface.roughness);
    let metal = mix3(base_color, vec3<f32>(1.0), schlick(cosine) * rise);
    var dielectric = fresnel_dielectric(cosine, eta);
    if dielectric < 1.0 {
        let normal_incidence = f0_from_ior(surface.ior);
        dielectric = normal_incidence + (dielectric - normal_incidence) * rise;
    }
    let entering = (1.0 - surface.metallic) * (1.0 - dielectric);
    return LobeWeights(
        mix3(vec3<f32>(dielectric), metal, surface.metallic),
        surface.tint * (entering * surface.transmission),
        base_color * (entering * (1.0 - surface.transmission)),
    );
}

// The light that a surface reflects to the viewer of light from one direction, times that direction's cosine. All unit vectors.
// The model is glTF's, but for one thing: what is mirrored towards the viewer is missing from the matt part there, too.
fn evaluate_brdf(surface: Surface, to_viewer: vec3<f32>, to_light: vec3<f32>) -> vec3<f32> {
    let n_l = dot3(surface.normal, to_light);
    if n_l <= 0.0 {
        return vec3<f32>(0.0);
    }
    let n_v = max(dot3(surface.normal, to_viewer), MIN_COSINE);
    let half_way = normalize_or(to_viewer + to_light, surface.normal);
    let n_h = clamp(dot3(surface.normal, half_way), 0.0, 1.0);
    let edge = schlick(dot3(to_viewer, half_way));

    let f0 = f0_from_ior(surface.ior);
    let dielectric = f0 + (1.0 - f0) * edge;
    let metal = mix3(surface.base_color.xyz, vec3<f32>(1.0), edge);
    let fresnel = mix3(vec3<f32>(dielectric), metal, surface.metallic);
    let towards_viewer = f0 + (1.0 - f0) * (schlick(n_v) * grazing_rise(surface.roughness));
    let matt = (1.0 - surface.metallic) * (1.0 - max(dielectric, towards_viewer)) * (1.0 - surface.transmission);

    let roughness = max(surface.roughness, MIN_HIGHLIGHT_ROUGHNESS);
    let specular = fresnel * ggx_specular(n_l, n_v, n_h, roughness * roughness);
    return (surface.base_color.xyz * (matt / PI) + specular) * n_l;
}

// GGX's distribution times Smith's height-correlated visibility.
fn ggx_specular(n_l: f32, n_v: f32, n_h: f32, alpha: f32) -> f32 {
    let square = alpha * alpha;
    // (n_h^2 (square - 1) + 1) without the cancellation at n_h = 1
    let spread = (1.0 - n_h * n_h) + (n_h * n_h) * square;
    let distribution = square / (PI * spread * spread);
    let light_side = n_l * sqrt(n_v * n_v * (1.0 - square) + square);
    let viewer_side = n_v * sqrt(n_l * n_l * (1.0 - square) + square);
    return distribution * (0.5 / (light_side + viewer_side));
}
