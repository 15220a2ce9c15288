// How surfaces reflect: Fresnel's equations, and the microfacet model of glTF 2.0 (appendix B). Twin of
// src/trace/kernel/brdf.rs.

const PI: f32 = 3.14159265358979;
// Up to this roughness reflections are traced in full; between it and MAX_MIRROR_ROUGHNESS they fade to the blurred
// sky.
const SHARP_REFLECTION_ROUGHNESS: f32 = 0.1;
// Least roughness for highlights: a punctual light has no extent, so a smooth surface would show no highlight.
const MIN_HIGHLIGHT_ROUGHNESS: f32 = 0.1;

// Share of the specular reflection that is traced as a ray (1 when smooth); the rest is the blurred sky.
fn traced_reflection_share(roughness: f32) -> f32 {
    let range = MAX_MIRROR_ROUGHNESS - SHARP_REFLECTION_ROUGHNESS;
    let x = clamp((MAX_MIRROR_ROUGHNESS - roughness) * (1.0 / range), 0.0, 1.0);
    return (x * x) * (3.0 - 2.0 * x);
}

// Fresnel reflectance of a dielectric for unpolarised light; 1 under total internal reflection. `eta` is the index of
// refraction of the side that the light comes from over that of the other side, 0 for an infinite one; `cosine` is that
// of the angle of incidence.
fn fresnel_dielectric(cosine: f32, eta: f32) -> f32 {
    let cosine_transmitted = refracted_cosine(cosine, eta);
    if cosine_transmitted <= 0.0 || eta <= 0.0 {
        return 1.0;
    }
    let perpendicular = (eta * cosine - cosine_transmitted) / (eta * cosine + cosine_transmitted);
    let parallel = (cosine - eta * cosine_transmitted) / (cosine + eta * cosine_transmitted);
    return 0.5 * (perpendicular * perpendicular + parallel * parallel);
}

// The cosine of the angle of refraction (Snell's law), or 0 where reflection is total.
fn refracted_cosine(cosine: f32, eta: f32) -> f32 {
    // 1 - eta^2 sin^2, without the cancellation at eta = 1
    return sqrt(max((1.0 - eta) * (1.0 + eta) + (eta * cosine) * (eta * cosine), 0.0));
}

// (1 - cosine)^5: Schlick's approximation of the rise of reflectance toward grazing angles.
fn schlick(cosine: f32) -> f32 {
    let x = clamp(1.0 - cosine, 0.0, 1.0);
    let square = x * x;
    return (square * square) * x;
}

// Factor on Schlick's grazing term for rough surfaces; a fit to the directional albedo of GGX.
fn grazing_rise(roughness: f32) -> f32 {
    return 1.0 - roughness * (0.1 + 0.86 * roughness);
}

// Weights of the three lobes for the view direction; with absorption they sum to 1.
struct LobeWeights {
    // Specular reflection.
    specular_reflection: vec3<f32>,
    // Specular transmission.
    specular_transmission: vec3<f32>,
    // Diffuse reflection.
    diffuse: vec3<f32>,
}

// `eta` is as in fresnel_dielectric.
fn lobe_weights(surface: Surface, cosine: f32, eta: f32) -> LobeWeights {
    let base_color = surface.base_color.xyz;
    // Fresnel reflectance as a metal and as a dielectric.
    let rise = grazing_rise(surface.roughness);
    let metal = mix3(base_color, vec3<f32>(1.0), schlick(cosine) * rise);
    var dielectric = fresnel_dielectric(cosine, eta);
    if dielectric < 1.0 {
        let normal_incidence = f0_from_ior(surface.ior);
        dielectric = normal_incidence + (dielectric - normal_incidence) * rise;
    }
    // What is not reflected is transmitted or reflected diffusely.
    let entering = (1.0 - surface.metallic) * (1.0 - dielectric);
    return LobeWeights(
        mix3(vec3<f32>(dielectric), metal, surface.metallic),
        surface.tint * (entering * surface.transmission),
        base_color * (entering * (1.0 - surface.transmission)),
    );
}

// BRDF times the light's cosine (glTF 2.0 appendix B). All unit vectors. Unlike there, the diffuse lobe is also reduced
// by the specular reflectance toward the viewer.
fn evaluate_brdf(surface: Surface, to_viewer: vec3<f32>, to_light: vec3<f32>) -> vec3<f32> {
    let n_l = dot3(surface.normal, to_light);
    if n_l <= 0.0 {
        return vec3<f32>(0.0);
    }
    let n_v = max(dot3(surface.normal, to_viewer), MIN_COSINE);
    let half_way = normalize_or(to_viewer + to_light, surface.normal);
    let n_h = clamp(dot3(surface.normal, half_way), 0.0, 1.0);
    let schlick_weight = schlick(dot3(to_viewer, half_way));

    // Fresnel reflectance of the microfacets.
    let f0 = f0_from_ior(surface.ior);
    let dielectric = f0 + (1.0 - f0) * schlick_weight;
    let metal = mix3(surface.base_color.xyz, vec3<f32>(1.0), schlick_weight);
    let fresnel = mix3(vec3<f32>(dielectric), metal, surface.metallic);
    // Diffuse energy left.
    let towards_viewer = f0 + (1.0 - f0) * (schlick(n_v) * grazing_rise(surface.roughness));
    let diffuse = (1.0 - surface.metallic) * (1.0 - max(dielectric, towards_viewer)) * (1.0 - surface.transmission);

    // GGX specular.
    let roughness = max(surface.roughness, MIN_HIGHLIGHT_ROUGHNESS);
    let specular = fresnel * ggx_specular(n_l, n_v, n_h, roughness * roughness);
    return (surface.base_color.xyz * (diffuse / PI) + specular) * n_l;
}

// GGX's distribution times Smith's height-correlated visibility.
fn ggx_specular(n_l: f32, n_v: f32, n_h: f32, alpha: f32) -> f32 {
    let alpha_squared = alpha * alpha;
    // (n_h^2 (alpha_squared - 1) + 1) without the cancellation at n_h = 1
    let spread = (1.0 - n_h * n_h) + (n_h * n_h) * alpha_squared;
    let distribution = alpha_squared / (PI * spread * spread);
    let light_side = n_l * sqrt(n_v * n_v * (1.0 - alpha_squared) + alpha_squared);
    let viewer_side = n_v * sqrt(n_l * n_l * (1.0 - alpha_squared) + alpha_squared);
    return distribution * (0.5 / (light_side + viewer_side));
}
