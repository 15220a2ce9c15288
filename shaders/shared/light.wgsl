// Direct light from point, spot and directional lights, as KHR_lights_punctual defines them. Twin of
// src/trace/kernel/light.rs, where sample_light is one iteration of direct_light.

// Incident light at a point.
struct IncidentLight {
    // Unit vector toward the light.
    direction: vec3<f32>,
    // Irradiance at normal incidence (lux, linear RGB).
    irradiance: vec3<f32>,
}

// Radiance that a surface reflects toward the viewer from all lights, with shadows.
fn direct_light(surface: Surface, to_viewer: vec3<f32>) -> vec3<f32> {
    var sum = vec3<f32>(0.0);
    for (var i = 0u; i < params.light_count; i += 1u) {
        let light = lights[i];
        let incident = incident_light(light, surface.position);
        // Skip lights below the horizon or out of range.
        let geometric_cosine = dot3(surface.geometric_normal, incident.direction);
        if geometric_cosine < MIN_COSINE || max_component(incident.irradiance) <= 0.0 {
            continue;
        }
        // BRDF.
        let reflected = evaluate_brdf(surface, to_viewer, incident.direction) * incident.irradiance;
        if max_component(reflected) <= 0.0 {
            continue;
        }
        // Shadow ray.
        let to_light = shadow_ray(light, offset_ray_origin(surface, incident.direction));
        let terminator = shadow_terminator(surface, incident.direction, geometric_cosine);
        let visible = transmittance(to_light, params.ray_mask) * terminator;
        sum += reflected * visible;
    }
    return sum;
}

fn incident_light(light: LightRecord, point: vec3<f32>) -> IncidentLight {
    // Directional: the same everywhere.
    if light.kind == LIGHT_DIRECTIONAL {
        return IncidentLight(-light.direction, light.color);
    }
    let to_light = light.position - point;
    let distance = length3(to_light);
    if distance <= 0.0 {
        return IncidentLight(to_light, vec3<f32>(0.0));
    }
    // Inverse square of the distance, cut off at the range.
    let direction = to_light * (1.0 / distance);
    var attenuation = range_attenuation(distance, light.range) / (distance * distance);
    // Spot cone.
    if light.kind == LIGHT_SPOT {
        let cone = clamp(-dot3(light.direction, direction) * light.cone_scale + light.cone_offset, 0.0, 1.0);
        attenuation *= cone * cone;
    }
    return IncidentLight(direction, light.color * attenuation);
}

// Shadow ray; `t_max` is 1 at a point or spot light.
fn shadow_ray(light: LightRecord, start: vec3<f32>) -> RayRecord {
    if light.kind == LIGHT_DIRECTIONAL {
        return RayRecord(start, 0.0, -light.direction, F32_MAX);
    }
    return RayRecord(start, 0.0, light.position - start, 1.0);
}

// Window that falls smoothly to 0 at the light's range (KHR_lights_punctual).
fn range_attenuation(distance: f32, range: f32) -> f32 {
    let ratio = distance / range;
    let square = ratio * ratio;
    return clamp(1.0 - square * square, 0.0, 1.0);
}

// Shadow terminator correction: fades the light where the geometric normal is nearer to grazing than the shading
// normal; 1 where both agree. (M. J.-Y. Chiang, Y. K. Li, B. Burley, "Taming the Shadow Terminator", SIGGRAPH 2019
// talks.)
fn shadow_terminator(surface: Surface, direction: vec3<f32>, geometric_cosine: f32) -> f32 {
    let shading_cosine = dot3(surface.normal, direction) * dot3(surface.normal, surface.geometric_normal);
    let g = min(geometric_cosine / max(shading_cosine, MIN_COSINE * MIN_COSINE), 1.0);
    return ((1.0 - g) * g + 1.0) * g;
}
