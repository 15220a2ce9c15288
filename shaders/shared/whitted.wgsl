// One pixel: T. Whitted's recursion (1980) as a loop over rays that wait. Twin of src/trace/kernel/whitted.rs: see there. What
// is a Path there, driven from outside, is one loop here.

// The most reflections and refractions of a path, whatever params.max_depth says.
const MAX_DEPTH: u32 = 8u;
// The most blended surfaces that a path goes through between two of those.
const MAX_LAYERS: u32 = 32u;
// The most rays of a pixel, shadow rays not counted.
const MAX_RAYS: u32 = 256u;
// A ray that carries less cannot change an 8-bit pixel: half the smallest sRGB step is 0.5 / 255 / 12.92 = 1.24 * 2^-13.
const MIN_THROUGHPUT: f32 = 1.220703125e-4; // 2^-13
// A level of depth leaves at most one ray waiting for each of these needs; one more is the ray to be traced next.
const MAX_PENDING: u32 = 1u + MAX_DEPTH * (u32(NEEDS_REFRACTION) + u32(NEEDS_BLEND));

struct Pixel {
    // Linear radiance, and 1: the sky is part of the image.
    color: vec4<f32>,
    // Unit shading normal, towards the camera; zero where nothing was met.
    normal: vec3<f32>,
    // Distance from the camera, or F32_MAX.
    depth: f32,
    // Node slot, node version, primitive, instance; NONE (version 1: the null key) where nothing was met.
    ids: vec4<u32>,
}

struct PendingRay {
    origin: vec3<f32>,
    bounces: u32,
    direction: vec3<f32>,
    layers: u32,
    // The part of what it sees that reaches the camera.
    throughput: vec3<f32>,
}

struct RayTree {
    color: vec3<f32>,
    pending_count: u32,
    pending: array<PendingRay, MAX_PENDING>,
}

fn render_pixel(x: u32, y: u32) -> Pixel {
    var pixel = Pixel(vec4<f32>(0.0), vec3<f32>(0.0), F32_MAX, vec4<u32>(NONE, 1u, NONE, NONE));
    let primary = camera_ray(x, y);
    var paths: RayTree;
    paths.pending[0] = PendingRay(primary.origin, 0u, primary.direction, 0u, vec3<f32>(1.0));
    paths.pending_count = 1u;
    for (var traced = 0u; traced < MAX_RAYS && paths.pending_count > 0u; traced += 1u) {
        paths.pending_count -= 1u;
        let ray = paths.pending[paths.pending_count];
        let hit = closest_hit(RayRecord(ray.origin, 0.0, ray.direction, F32_MAX), params.ray_mask);
        if hit.instance == NONE {
            paths.color += ray.throughput * sky_radiance(ray.direction);
        } else {
            let surface = surface_at(hit, ray.direction);
            if traced == 0u {
                pixel.normal = surface.normal;
                pixel.depth = hit.t;
                pixel.ids = vec4<u32>(instances[hit.instance].node_key, hit.primitive, hit.instance);
            }
            shade(&paths, ray, surface);
        }
    }
    // Rays beyond the limit see the sky.
    for (var i = 0u; i < paths.pending_count; i += 1u) {
        paths.color += paths.pending[i].throughput * sky_radiance(paths.pending[i].direction);
    }
    pixel.color = vec4<f32>(paths.color, 1.0);
    return pixel;
}

// Adds what the surface sends back along the ray, and the rays that must be traced to know the rest. What lies behind a
// blended surface comes last, so that nothing of this surface waits while it is traced: see MAX_PENDING.
fn shade(paths: ptr<function, RayTree>, ray: PendingRay, surface: Surface) {
    // 1. Alpha divides the light between what lies behind and the surface.
    var throughput = ray.throughput;
    if NEEDS_BLEND && (surface.flags & MATERIAL_BLEND) != 0u {
        let alpha = surface.base_color.w;
        let start = offset_ray_origin(surface, ray.direction);
        push_ray(paths, PendingRay(start, ray.bounces, ray.direction, ray.layers + 1u, throughput * (1.0 - alpha)));
        throughput *= alpha;
    }
    if (surface.flags & MATERIAL_UNLIT) != 0u {
        (*paths).color += throughput * surface.base_color.xyz;
        return;
    }

    // 2. Light from the surface itself, from lights, and from the sky.
    let to_viewer = -ray.direction;
    let cosine = dot3(surface.normal, to_viewer);
    let eta = relative_ior(surface);
    let shares = lobe_weights(surface, cosine, eta);
    let mirrored = clamp_cosine(surface.normal * (2.0 * cosine) - to_viewer, surface.geometric_normal);
    let sharp = traced_reflection_share(surface.roughness);
    var radiance = surface.emissive + shares.diffuse * sky_irradiance_over_pi(surface.normal);
    if sharp < 1.0 {
        radiance += shares.specular_reflection * (sky_blurred(mirrored, surface.roughness) * (1.0 - sharp));
    }
    if NEEDS_LIGHTS {
        radiance += direct_light(surface, to_viewer);
    }
    (*paths).color += throughput * radiance;

    // 3. Light through the surface, and light mirrored by it.
    if NEEDS_REFRACTION && surface.transmission > 0.0 {
        let direction = refracted_direction(surface, ray.direction, cosine, eta);
        push_ray(paths, PendingRay(offset_ray_origin(surface, direction), ray.bounces + 1u, direction, 0u, throughput * shares.specular_transmission));
    }
    if NEEDS_REFLECTION && sharp > 0.0 {
        let start = offset_ray_origin(surface, mirrored);
        push_ray(paths, PendingRay(start, ray.bounces + 1u, mirrored, 0u, throughput * (shares.specular_reflection * sharp)));
    }
}

// Lets a ray wait to be traced; one that is too deep or carries too little sees the sky at once.
fn push_ray(paths: ptr<function, RayTree>, ray: PendingRay) {
    let is_deep = ray.bounces > min(params.max_depth, MAX_DEPTH) || ray.layers > MAX_LAYERS;
    let count = (*paths).pending_count;
    if is_deep || max_component(ray.throughput) < MIN_THROUGHPUT || count == MAX_PENDING {
        (*paths).color += ray.throughput * sky_radiance(ray.direction);
        return;
    }
    (*paths).pending[count] = ray;
    (*paths).pending_count = count + 1u;
}

// Index of refraction of the viewer's side over that of the other, 0 where that is infinite.
fn relative_ior(surface: Surface) -> f32 {
    if surface.is_inside || surface.ior <= 0.0 {
        return surface.ior;
    }
    return 1.0 / surface.ior;
}

// Where a ray goes on behind the surface: bent by Snell's law, or straight through a thin one.
fn refracted_direction(surface: Surface, direction: vec3<f32>, cosine: f32, eta: f32) -> vec3<f32> {
    if surface.thin {
        return direction;
    }
    let bent = direction * eta + surface.normal * (eta * cosine - refracted_cosine(cosine, eta));
    return clamp_cosine(normalize_or(bent, direction), -surface.geometric_normal);
}
