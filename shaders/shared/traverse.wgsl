// The ray queries closest hit, any hit and transmittance, independent of the traversal: rope.wgsl and wide.wgsl declare
// the same functions. Twin of src/trace/kernel/traverse.rs, whose one loop over leaves each query repeats here.

fn first_primitive(primitives: u32) -> u32 {
    return primitives & 0x0fffffffu;
}

fn primitive_count(primitives: u32) -> u32 {
    return primitives >> 28u;
}

// The first hit in [t_min, t_max], in the order of hits (query.wgsl): the closest, but for surfaces that touch.
fn closest_hit(ray: RayRecord, ray_mask: u32) -> HitRecord {
    return next_hit(ray, start_of_ray(), ray_mask);
}

// The first hit in [t_min, t_max] of a ray that goes on behind one that it has passed; t_min should be t_min_of(start).
fn next_hit(ray: RayRecord, start: Continuation, ray_mask: u32) -> HitRecord {
    var query = closest_query(ray.t_max, start);
    var state = begin_traversal(ray, ray_mask, NEAR_FIRST);
    loop {
        let leaf = next_leaf(&state, query.t_max);
        if leaf == 0u {
            break;
        }
        // Test each triangle; accept or reject the hits.
        let first = state.first_triangle + first_primitive(leaf);
        let end = first + primitive_count(leaf);
        for (var i = first; i < end; i++) {
            let candidate = candidate_hit(&state, i, query.t_max);
            if candidate.instance != NONE {
                accept_closest(&query, candidate, state.flags);
            }
        }
    }
    return query.hit;
}

// Occlusion query: whether the ray hits an opaque surface in [t_min, t_max].
fn any_hit(ray: RayRecord, ray_mask: u32) -> bool {
    var state = begin_traversal(ray, ray_mask, ANY_ORDER);
    loop {
        let leaf = next_leaf(&state, ray.t_max);
        if leaf == 0u {
            break;
        }
        // Test each triangle; an opaque hit decides the query.
        let first = state.first_triangle + first_primitive(leaf);
        let end = first + primitive_count(leaf);
        for (var i = first; i < end; i++) {
            let candidate = candidate_hit(&state, i, ray.t_max);
            if candidate.instance != NONE && accept_any(candidate, state.flags) {
                return true;
            }
        }
    }
    return false;
}

// Transmittance along the ray in [t_min, t_max], per colour channel: the product over all surfaces hit; 0 if one
// is opaque. The light travels against the ray, from a light source to the ray's origin: a single-sided surface that
// it meets from behind lets it pass, as it lets sight pass from there.
fn transmittance(ray: RayRecord, ray_mask: u32) -> vec3<f32> {
    var product = vec3<f32>(1.0);
    var has_layers = false;
    var has_edges = false;
    var state = begin_traversal(ray, ray_mask, ANY_ORDER);
    loop {
        let leaf = next_leaf(&state, ray.t_max);
        if leaf == 0u {
            break;
        }
        // Layered instances need a second pass.
        if is_layered(state.flags) {
            has_layers = true;
            continue;
        }
        // Test each triangle; an opaque hit decides the query.
        let first = state.first_triangle + first_primitive(leaf);
        let end = first + primitive_count(leaf);
        for (var i = first; i < end; i++) {
            let candidate = candidate_hit(&state, i, ray.t_max);
            if candidate.instance != NONE {
                has_edges = has_edges || is_translucent_edge(candidate, state.flags);
                if accept_transmittance(&product, candidate, state.flags) {
                    return vec3<f32>(0.0);
                }
            }
        }
    }
    // On an edge, the neighbour is hit too: in the second pass a surface counts once.
    if has_edges {
        return transmittance_of_layers(ray, INSTANCE_TRANSLUCENT, ray_mask);
    }
    if has_layers {
        product *= transmittance_of_layers(ray, INSTANCE_LAYERED, ray_mask);
    }
    return product;
}

// Transmittance of the instances with certain flags, found by repeated closest-hit traversals that each go on behind
// the last hit.
fn transmittance_of_layers(ray: RayRecord, instance_flags: u32, ray_mask: u32) -> vec3<f32> {
    var product = vec3<f32>(1.0);
    var start = start_of_ray();
    loop {
        // Find the next layer behind the last one.
        let layer = next_layer(ray, start, instance_flags, ray_mask);
        if layer.instance == NONE {
            break;
        }
        // Multiply by its transmittance; an opaque one ends the ray.
        product *= candidate_transmittance(layer, instances[layer.instance].flags);
        if max_component(product) <= 0.0 {
            return vec3<f32>(0.0);
        }
        start = start_behind(layer, ray.direction);
    }
    return product;
}

// The first hit, of an instance with certain flags, behind the one that the ray has passed.
fn next_layer(ray: RayRecord, start: Continuation, instance_flags: u32, ray_mask: u32) -> HitRecord {
    var query = closest_query(ray.t_max, start);
    var rest = ray;
    rest.t_min = max(ray.t_min, t_min_of(start));
    var state = begin_traversal(rest, ray_mask, NEAR_FIRST);
    loop {
        let leaf = next_leaf(&state, query.t_max);
        if leaf == 0u {
            break;
        }
        if (state.flags & instance_flags) != instance_flags {
            continue;
        }
        // Test each triangle; accept or reject the hits.
        let first = state.first_triangle + first_primitive(leaf);
        let end = first + primitive_count(leaf);
        for (var i = first; i < end; i++) {
            let candidate = candidate_hit(&state, i, query.t_max);
            if candidate.instance != NONE {
                accept_layer(&query, candidate, state.flags);
            }
        }
    }
    return query.hit;
}
