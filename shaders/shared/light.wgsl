// Direct light from points, spots and directions, as KHR_lights_punctual defines them. Twin of src/trace/kernel/light.rs.

// Light as it arrives at a point.
struct IncidentLight {
    // Unit, towards the light.
    direction: vec3<f32>,
    // Of a surface that faces the light: lux times colour.
    irradiance: vec3<f32>,
}

// What a surface reflects to the viewer of all lights, shadows included.
fn direct_light(surface: Surface, to_viewer: vec3<f32>) -> vec3<f32> {
    var sum = vec3<f32>(0.0);
    for (var i = 0u; i < params.light_count; i += 1u) {
        let light = lights[i];
        let arrival = incident_light(light, surface.position);
        let facing = dot3(surface.geometric_normal, arrival.direction);
        if facing < MIN_COSINE || max_component(arrival.irradiance) <= 0.0 {
            continue;
        }
        let reflected = evaluate_brdf(surface, to_viewer, arrival.direction) * arrival.irradiance;
        if max_component(reflected) <= 0.0 {
            continue;
        }
        let to_light = shadow_ray(light, offset_ray_origin(surface, arrival.direction));
        let visible = transmittance(to_light, params.ray_mask) * shadow_terminator(surface, arrival.direction, facing);
        sum += reflected * visible;
    }
    return sum;
}

fn incident_light(light: LightRecord, point: vec3<f32>) -> IncidentLight {
    if light.kind == LIGHT_DIRECTIONAL {
        return IncidentLight(-light.direction, light.color);
    }
    let to_light = light.position - point;
    let distance = length3(to_light);
    if distance <= 0.0 {
        return IncidentLight(to_light, vec3<f32>(0.0));
    }
    let direction = to_light * (1.0 / distance);
    var strength = range_attenuation(distance, light.range) / (distance * distance);
    if light.kind == LIGHT_SPOT {
        let cone = clamp(-dot3(light.direction, direction) * light.cone_scale + light.cone_offset, 0.0, 1.0);
        strength *= cone * cone;
    }
    return IncidentLight(direction, light.color * strength);
}

// From a point to a light, and no farther.
fn shadow_ray(light: LightRecord, start: vec3<f32>) -> RayRecord {
    if light.kind == LIGHT_DIRECTIONAL {
        return RayRecord(start, 0.0, -light.direction, F32_MAX);
    }
    return RayRecord(start, 0.0, light.position - start, 1.0);
}

// Falls smoothly to 0 at the light's range.
fn range_attenuation(distance: f32, range: f32) -> f32 {
    let ratio = distance / range;
    let square = ratio * ratio;
    return clamp(1.0 - square * square, 0.0, 1.0);
}

// Softens the edge where a facet of a smooth surface turns from the light before its shading normal does. 1 where both
// normals agree. (M. J.-Y. Chiang, Y. K. Li, B. Burley, "Taming the Shadow Terminator", SIGGRAPH 2019 talks.)
fn shadow_terminator(surface: Surface, direction: vec3<f32>, facing: f32) -> f32 {
    let smooth_facing = dot3(surface.normal, direction) * dot3(surface.normal, surface.geometric_normal);
    let g = min(facing / max(smooth_facing, MIN_COSINE * MIN_COSINE), 1.0);
    return ((1.0 - g) * g + 1.0) * g;
}
