// One pixel: T. Whitted's recursion (1980) as a loop over a stack of pending rays. Twin of src/trace/kernel/whitted.rs,
// which lists the approximations. Its methods of RayTree are parts of render_pixel here.

// Greatest number of reflections and refractions of a ray, whatever params.max_depth says.
const MAX_DEPTH: u32 = 8u;
// Most blended surfaces that a ray passes between two reflections or refractions.
const MAX_LAYERS: u32 = 32u;
// Most rays of a pixel, shadow rays not counted.
const MAX_RAYS: u32 = 256u;
// Rays of less throughput see the sky instead of the scene. For radiance up to 1 that cannot change an 8-bit pixel, as
// half the smallest sRGB step is 0.5 / 255 / 12.92 = 1.24 * 2^-13; brighter radiance can.
const MIN_THROUGHPUT: f32 = 1.220703125e-4; // 2^-13
// Each level of depth leaves at most one pending ray for each of these needs: one behind a blended surface, and the
// first pushed of the refracted and the reflected ray (with reflection alone that ray is traced next). One more is the
// ray to be traced next.
const MAX_PENDING: u32 = 1u + MAX_DEPTH * (u32(NEEDS_REFRACTION) + u32(NEEDS_BLEND));

struct Pixel {
    // Linear radiance, and 1: the sky is part of the image.
    color: vec4<f32>,
    // Unit shading normal, facing the camera, world space; zero where the primary ray missed.
    normal: vec3<f32>,
    // Distance from the camera, world units; F32_MAX where the primary ray missed.
    distance: f32,
    // Node slot, node version, primitive, instance; NONE (version 1: the null key) where the primary ray missed.
    ids: vec4<u32>,
}

struct PendingRay {
    origin: vec3<f32>,
    bounces: u32,
    direction: vec3<f32>,
    layers: u32,
    // Factor by which its radiance contributes to the pixel.
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
    var tree: RayTree;
    // Push the primary ray.
    tree.pending[0] = PendingRay(primary.origin, 0u, primary.direction, 0u, vec3<f32>(1.0));
    tree.pending_count = 1u;
    for (var traced = 0u; traced < MAX_RAYS && tree.pending_count > 0u; traced += 1u) {
        // Trace the next ray.
        tree.pending_count -= 1u;
        let ray = tree.pending[tree.pending_count];
        let hit = closest_hit(RayRecord(ray.origin, 0.0, ray.direction, F32_MAX), params.ray_mask);
        // Miss: the sky. Hit: shade, and push secondary rays.
        if hit.instance == NONE {
            tree.color += ray.throughput * sky_radiance(ray.direction);
        } else {
            let surface = surface_at(hit, ray.direction);
            if traced == 0u {
                pixel.normal = surface.normal;
                pixel.distance = hit.t;
                pixel.ids = vec4<u32>(instances[hit.instance].node_key, hit.primitive, hit.instance);
            }
            shade(&tree, ray, surface);
        }
    }
    // Rays still pending after MAX_RAYS contribute sky radiance.
    for (var i = 0u; i < tree.pending_count; i += 1u) {
        tree.color += tree.pending[i].throughput * sky_radiance(tree.pending[i].direction);
    }
    pixel.color = vec4<f32>(tree.color, 1.0);
    return pixel;
}

// Adds the surface's emitted and reflected radiance and pushes its secondary rays. The ray behind a blended surface is
// pushed first, so it is traced last, and no other ray of this surface is pending then (see MAX_PENDING).
fn shade(tree: ptr<function, RayTree>, ray: PendingRay, surface: Surface) {
    // 1. Alpha blends the surface over the ray behind it.
    var throughput = ray.throughput;
    if NEEDS_BLEND && (surface.flags & MATERIAL_BLEND) != 0u {
        let alpha = surface.base_color.w;
        let origin = offset_ray_origin(surface, ray.direction);
        push_ray(tree, PendingRay(origin, ray.bounces, ray.direction, ray.layers + 1u, throughput * (1.0 - alpha)));
        throughput *= alpha;
    }
    if (surface.flags & MATERIAL_UNLIT) != 0u {
        (*tree).color += throughput * surface.base_color.xyz;
        return;
    }

    // 2. Add emitted light and the light reflected from the lights and the sky.
    let to_viewer = -ray.direction;
    let cosine = dot3(surface.normal, to_viewer);
    let eta = relative_ior(surface);
    let lobes = lobe_weights(surface, cosine, eta);
    let reflected_direction = clamp_cosine(surface.normal * (2.0 * cosine) - to_viewer, surface.geometric_normal);
    let sharp = traced_reflection_share(surface.roughness);
    var radiance = surface.emissive + lobes.diffuse * sky_irradiance_over_pi(surface.normal);
    if sharp < 1.0 {
        radiance += lobes.specular_reflection * (sky_blurred(reflected_direction, surface.roughness) * (1.0 - sharp));
    }
    if NEEDS_LIGHTS {
        radiance += direct_light(surface, to_viewer);
    }
    (*tree).color += throughput * radiance;

    // 3. Push the refracted and the reflected ray.
    if NEEDS_REFRACTION && surface.transmission > 0.0 {
        let direction = refracted_direction(surface, ray.direction, cosine, eta);
        let origin = offset_ray_origin(surface, direction);
        let transmitted = throughput * lobes.specular_transmission;
        push_ray(tree, PendingRay(origin, ray.bounces + 1u, direction, 0u, transmitted));
    }
    if NEEDS_REFLECTION && sharp > 0.0 {
        let origin = offset_ray_origin(surface, reflected_direction);
        let reflected = throughput * (lobes.specular_reflection * sharp);
        push_ray(tree, PendingRay(origin, ray.bounces + 1u, reflected_direction, 0u, reflected));
    }
}

// Pushes a ray; beyond the depth or layer limit, or below MIN_THROUGHPUT, adds sky radiance instead.
fn push_ray(tree: ptr<function, RayTree>, ray: PendingRay) {
    let is_deep = ray.bounces > min(params.max_depth, MAX_DEPTH) || ray.layers > MAX_LAYERS;
    let count = (*tree).pending_count;
    if is_deep || max_component(ray.throughput) < MIN_THROUGHPUT || count == MAX_PENDING {
        (*tree).color += ray.throughput * sky_radiance(ray.direction);
        return;
    }
    (*tree).pending[count] = ray;
    (*tree).pending_count = count + 1u;
}

// Relative index of refraction, n of the viewer's side over n of the other (air = 1); 0 if the latter is infinite.
fn relative_ior(surface: Surface) -> f32 {
    if surface.is_inside || surface.ior <= 0.0 {
        return surface.ior;
    }
    return 1.0 / surface.ior;
}

// Direction of the transmitted ray: refracted by Snell's law, or unchanged by a thin wall.
fn refracted_direction(surface: Surface, direction: vec3<f32>, cosine: f32, eta: f32) -> vec3<f32> {
    if surface.thin {
        return direction;
    }
    let bent = direction * eta + surface.normal * (eta * cosine - refracted_cosine(cosine, eta));
    return clamp_cosine(normalize_or(bent, direction), -surface.geometric_normal);
}
