// One pixel: T. Whitted's recursion (1980) as a loop over a stack of pending rays. Twin of src/trace/kernel/whitted.rs,
// which lists the approximations. Its methods of RayTree are parts of render_pixel here.

// The most pending rays of a pixel: 1, 15 or 19 where at most one, two or three rays leave a surface. Why that is
// enough at any depth is in whitted.rs.
const MAX_PENDING: u32 = 1u
    + 14u * u32((NEEDS_REFRACTION && NEEDS_REFLECTION) || (NEEDS_BLEND && NEEDS_REFLECTION))
    + 4u * u32(NEEDS_BLEND && NEEDS_REFRACTION && NEEDS_REFLECTION);
// A camera is on a surface that is nearer to it than this many times the bound of rounding by which secondary rays are
// offset: once for the surface as it is drawn, once for where the scene has it.
const ON_SURFACE: f32 = 2.0;

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
    // The least distance of a hit of the primary ray: it grows while that leaves surfaces on which the camera is.
    var near = primary.t_min;
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
        let is_primary = pixel.distance == F32_MAX;
        let t_min = max(t_min_of(start), select(0.0, near, is_primary));
        let hit = next_hit(RayRecord(ray.origin, t_min, ray.direction, ray.turn.t), start, params.ray_mask);
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
            if is_primary && is_at_camera(hit.t, ray.direction, surface) {
                // Leave a surface on which the camera is.
                near = just_behind(hit.t);
                tree.pending_count += 1u;
                continue;
            }
            if is_primary {
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

// Whether the camera is on the surface that its ray hits at `t`: nearer than the rounding of positions, and the hit is
// where the camera is, not where a plane that it nearly lies in is far away.
fn is_at_camera(t: f32, direction: vec3<f32>, surface: Surface) -> bool {
    let cosine = max(abs(dot3(direction, surface.geometric_normal)), MIN_COSINE);
    return t * cosine <= surface.ray_offset * ON_SURFACE;
}

// The next greater number; for 0 the least normal one.
fn just_behind(t: f32) -> f32 {
    return max(bitcast<f32>(bitcast<u32>(t) + 1u), F32_MIN_NORMAL);
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

// Adds the surface's emitted and reflected radiance and pushes its secondary rays.
fn shade(tree: ptr<function, RayTree>, ray: PendingRay, hit: HitRecord, surface: Surface) {
    let direction = view_direction(ray);
    let first = (*tree).pending_count;
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
        push_ray(tree, first, behind);
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
        push_ray(tree, first, behind);
    }
    if NEEDS_REFLECTION && sharp > 0.0 {
        let origin = offset_ray_origin(surface, reflected_direction);
        let reflected = throughput * (lobes.specular_reflection * sharp);
        push_ray(tree, first, new_ray(origin, reflected_direction, ray.bounces + 1u, reflected));
    }
}

// Pushes a ray, below the rays of less throughput that were pushed since there were `first` (see whitted.rs,
// MAX_PENDING). Too deep, of too little throughput, or if the pixel has used up its rays or their room, adds sky
// radiance instead.
fn push_ray(tree: ptr<function, RayTree>, first: u32, ray: PendingRay) {
    let is_cut_off = ray.bounces > params.max_depth || max_component(ray.throughput) <= params.min_throughput;
    (*tree).is_limited = (*tree).is_limited || (!is_cut_off && (*tree).pending_count == MAX_PENDING);
    if is_cut_off || (*tree).is_limited {
        (*tree).color += ray.throughput * sky_radiance(view_direction(ray));
        return;
    }
    var place = (*tree).pending_count;
    if MAX_PENDING > 1u {
        let throughput = component_sum(ray.throughput);
        while place > first && component_sum((*tree).pending[place - 1u].throughput) < throughput {
            (*tree).pending[place] = (*tree).pending[place - 1u];
            place -= 1u;
        }
    }
    (*tree).pending[place] = ray;
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
