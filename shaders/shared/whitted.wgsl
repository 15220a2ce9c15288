// One pixel: T. Whitted's recursion (1980) as a loop over a stack of pending rays. Twin of src/trace/kernel/whitted.rs,
// which lists the approximations. Its methods of RayTree are parts of render_pixel here.

// Greatest number of reflections and refractions of a ray, whatever params.max_depth says.
const MAX_DEPTH: u32 = 8u;
// Rays of less throughput see the sky instead of the scene. For radiance up to 1 that cannot change an 8-bit pixel, as
// half the smallest sRGB step is 0.5 / 255 / 12.92 = 1.24 * 2^-13; brighter radiance can.
const MIN_THROUGHPUT: f32 = 1.220703125e-4; // 2^-13
// Each level of depth leaves at most one pending ray for each of these needs: one behind a blended surface, and the
// first pushed of the refracted and the reflected ray (with reflection alone that ray is traced next). One more is the
// ray to be traced next.
const MAX_PENDING: u32 = 1u + MAX_DEPTH * (u32(NEEDS_REFRACTION) + u32(NEEDS_BLEND));

struct Pixel {
    // Linear radiance, and 1 (the sky is part of the image) plus the unlit_share.
    color: vec4<f32>,
    // Unit shading normal, facing the camera, world space; zero where the primary ray missed.
    normal: vec3<f32>,
    // Distance from the camera, world units; F32_MAX where the primary ray missed.
    distance: f32,
    // Node slot, node version, primitive, instance; NONE (version 1: the null key) where the primary ray missed.
    ids: vec4<u32>,
    // Whether the pixel needed more rays than params.max_rays.
    is_limited: bool,
}

// A ray to be traced.
struct PendingRay {
    origin: vec3<f32>,
    direction: vec3<f32>,
    // Which hits it has passed.
    start: Continuation,
    turn: Turn,
    bounces: u32,
    // Factor by which its radiance contributes to the pixel.
    throughput: vec3<f32>,
}

// Where a refracted ray turns: if it hits nothing up to `t`, it goes on from `origin` in `direction`. Up to there it
// goes straight on, but what it hits is shaded as seen along `direction`. F32_MAX for a ray that does not turn.
struct Turn {
    t: f32,
    origin: vec3<f32>,
    direction: vec3<f32>,
}

struct RayTree {
    color: vec3<f32>,
    // Whether the pixel has used up its rays.
    is_limited: bool,
    pending_count: u32,
    // The sum of the components of the radiance in `color` that came from unlit surfaces.
    unlit: f32,
    pending: array<PendingRay, MAX_PENDING>,
}

// A ray from a point, with nothing passed yet.
fn new_ray(origin: vec3<f32>, direction: vec3<f32>, bounces: u32, throughput: vec3<f32>) -> PendingRay {
    let never = Turn(F32_MAX, vec3<f32>(0.0), vec3<f32>(0.0));
    return PendingRay(origin, direction, start_of_ray(), never, bounces, throughput);
}

fn turns(ray: PendingRay) -> bool {
    return NEEDS_REFRACTION && ray.turn.t < F32_MAX;
}

// The direction along which light arrives, reversed.
fn view_direction(ray: PendingRay) -> vec3<f32> {
    if turns(ray) {
        return ray.turn.direction;
    }
    return ray.direction;
}

fn render_pixel(x: u32, y: u32) -> Pixel {
    var pixel = Pixel(vec4<f32>(0.0), vec3<f32>(0.0), F32_MAX, vec4<u32>(NONE, 1u, NONE, NONE), false);
    let primary = camera_ray(x, y);
    var tree: RayTree;
    // Push the primary ray.
    tree.pending[0] = new_ray(primary.origin, primary.direction, 0u, vec3<f32>(1.0));
    tree.pending_count = 1u;
    for (var traced = 0u; tree.pending_count > 0u; traced += 1u) {
        // Pop the next ray. A pixel that has used up its rays sees what is opaque.
        tree.pending_count -= 1u;
        let ray = tree.pending[tree.pending_count];
        tree.is_limited = tree.is_limited || traced >= params.max_rays;
        var start = ray.start;
        start.only_opaque = tree.is_limited;
        // Trace it.
        let hit = next_hit(RayRecord(ray.origin, t_min_of(start), ray.direction, ray.turn.t), start, params.ray_mask);
        if hit.instance == NONE && turns(ray) {
            // Nothing up to the turn: go on from there.
            tree.pending[tree.pending_count] =
                new_ray(ray.turn.origin, ray.turn.direction, ray.bounces, ray.throughput);
            tree.pending_count += 1u;
        } else if hit.instance == NONE {
            // Miss: the sky.
            tree.color += ray.throughput * sky_radiance(ray.direction);
        } else {
            // Hit: shade, and push secondary rays.
            let surface = surface_at(hit, view_direction(ray));
            if traced == 0u {
                pixel.normal = surface.normal;
                pixel.distance = hit.t;
                pixel.ids = vec4<u32>(instances[hit.instance].node_key, hit.primitive, hit.instance);
            }
            shade(&tree, ray, hit, surface);
        }
    }
    pixel.color = vec4<f32>(tree.color, 1.0 + unlit_share(tree.color, tree.unlit));
    pixel.is_limited = tree.is_limited;
    return pixel;
}

// The share of a pixel's radiance that came from unlit surfaces, 0 to 1, by the sums of components: tone mapping leaves
// it alone.
fn unlit_share(color: vec3<f32>, unlit: f32) -> f32 {
    if unlit > 0.0 {
        return min(unlit / component_sum(color), 1.0);
    }
    return 0.0;
}

fn component_sum(color: vec3<f32>) -> f32 {
    return (color.x + color.y) + color.z;
}

// Adds the surface's emitted and reflected radiance and pushes its secondary rays. The ray behind a blended surface is
// pushed first, so it is traced last, and no other ray of this surface is pending then (see MAX_PENDING).
fn shade(tree: ptr<function, RayTree>, ray: PendingRay, hit: HitRecord, surface: Surface) {
    let direction = view_direction(ray);
    var behind = ray;
    // Only where something is seen behind the surface does the ray go on.
    if (NEEDS_BLEND && (surface.flags & MATERIAL_BLEND) != 0u) || (NEEDS_REFRACTION && surface.transmission > 0.0) {
        behind.start = start_behind(hit, ray.direction);
    }
    // 1. Alpha blends the surface over the ray behind it.
    var throughput = ray.throughput;
    if NEEDS_BLEND && (surface.flags & MATERIAL_BLEND) != 0u {
        let alpha = surface.base_color.w;
        behind.throughput = throughput * (1.0 - alpha);
        push_ray(tree, behind);
        throughput *= alpha;
    }
    if (surface.flags & MATERIAL_UNLIT) != 0u {
        let radiance = throughput * surface.base_color.xyz;
        (*tree).color += radiance;
        (*tree).unlit += component_sum(radiance);
        return;
    }

    // 2. Add emitted light and the light reflected from the lights and the sky.
    let to_viewer = -direction;
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
        if !surface.thin {
            behind.turn = turn_at(ray, hit.t, surface, refracted_direction(surface, direction, cosine, eta));
        }
        behind.bounces = ray.bounces + 1u;
        behind.throughput = throughput * lobes.specular_transmission;
        push_ray(tree, behind);
    }
    if NEEDS_REFLECTION && sharp > 0.0 {
        let origin = offset_ray_origin(surface, reflected_direction);
        let reflected = throughput * (lobes.specular_reflection * sharp);
        push_ray(tree, new_ray(origin, reflected_direction, ray.bounces + 1u, reflected));
    }
}

// Pushes a ray; beyond the depth limit, below MIN_THROUGHPUT, or if the pixel has used up its rays, adds sky radiance
// instead.
fn push_ray(tree: ptr<function, RayTree>, ray: PendingRay) {
    let is_deep = ray.bounces > min(params.max_depth, MAX_DEPTH);
    let is_last = (*tree).is_limited || (*tree).pending_count == MAX_PENDING;
    if is_deep || is_last || max_component(ray.throughput) < MIN_THROUGHPUT {
        (*tree).color += ray.throughput * sky_radiance(view_direction(ray));
        return;
    }
    (*tree).pending[(*tree).pending_count] = ray;
    (*tree).pending_count += 1u;
}

// The turn of a ray that hits a surface at `t` and is refracted into `direction`. It comes after all that touches the
// surface: twice the offset of secondary rays, and four steps of the order of hits, measured along the normal.
fn turn_at(ray: PendingRay, t: f32, surface: Surface, direction: vec3<f32>) -> Turn {
    let cosine = max(abs(dot3(ray.direction, surface.geometric_normal)), MIN_COSINE);
    let turn_t = t + (2.0 * surface.ray_offset + 4.0 * TOUCH_STEP * t) / cosine;
    return Turn(turn_t, offset_ray_origin(surface, direction), direction);
}

// Relative index of refraction, n of the viewer's side over n of the other (air = 1); 0 if the latter is infinite.
fn relative_ior(surface: Surface) -> f32 {
    if surface.is_inside || surface.ior <= 0.0 {
        return surface.ior;
    }
    return 1.0 / surface.ior;
}

// Direction of the ray that enters or leaves a solid, by Snell's law; kept on the far side of the surface.
fn refracted_direction(surface: Surface, direction: vec3<f32>, cosine: f32, eta: f32) -> vec3<f32> {
    let bent = direction * eta + surface.normal * (eta * cosine - refracted_cosine(cosine, eta));
    return clamp_cosine(normalize_or(bent, direction), -surface.geometric_normal);
}
