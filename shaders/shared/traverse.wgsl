// The ray queries closest hit, any hit and transmittance, independent of the traversal: rope.wgsl and wide.wgsl declare
// the same functions. Twin of src/trace/kernel/traverse.rs, whose one loop over leaves each query repeats here.

fn first_primitive(primitives: u32) -> u32 {
    return primitives & 0x0fffffffu;
}

fn primitive_count(primitives: u32) -> u32 {
    return primitives >> 28u;
}

// The closest hit in [t_min, t_max]; of hits at equal t the one of the lower instance, then the lower primitive.
fn closest_hit(ray: RayRecord, ray_mask: u32) -> HitRecord {
    var hit = HitRecord(ray.t_max, 0.0, 0.0, NONE, NONE, NONE, 0u, 0u);
    var state = begin_traversal(ray, ray_mask, NEAR_FIRST);
    loop {
        let leaf = next_leaf(&state, hit.t);
        if leaf == 0u {
            break;
        }
        // Test each triangle; accept or reject the hits.
        let first = state.first_triangle + first_primitive(leaf);
        let end = first + primitive_count(leaf);
        for (var i = first; i < end; i++) {
            let candidate = candidate_hit(&state, i, hit.t);
            if candidate.instance != NONE {
                accept_closest(&hit, candidate, state.flags);
            }
        }
    }
    if hit.instance == NONE {
        hit.t = F32_MAX;
    }
    return hit;
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

// Transmittance along the ray in [t_min, t_max], per colour channel: the product over all surfaces hit; 0 if one is
// opaque.
fn transmittance(ray: RayRecord, ray_mask: u32) -> vec3<f32> {
    var product = vec3<f32>(1.0);
    var has_layers = false;
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
            if candidate.instance != NONE && accept_transmittance(&product, candidate, state.flags) {
                return vec3<f32>(0.0);
            }
        }
    }
    if has_layers {
        product *= transmittance_of_layers(ray, ray_mask);
    }
    return product;
}

// Transmittance of layered instances, found by repeated closest-hit traversals that each start at the last hit.
fn transmittance_of_layers(ray: RayRecord, ray_mask: u32) -> vec3<f32> {
    var product = vec3<f32>(1.0);
    var layer = HitRecord(-1.0, 0.0, 0.0, NONE, NONE, NONE, 0u, 0u);
    loop {
        // Find the next layer after the last one.
        layer = next_layer(ray, ray_mask, layer);
        if layer.instance == NONE {
            break;
        }
        // Multiply by its transmittance; an opaque one ends the ray.
        product *= candidate_transmittance(layer, instances[layer.instance].flags);
        if max_component(product) <= 0.0 {
            return vec3<f32>(0.0);
        }
    }
    return product;
}

// The first hit of a layered instance after `last`, in the order of t, instance and primitive.
fn next_layer(ray: RayRecord, ray_mask: u32, last: HitRecord) -> HitRecord {
    var hit = HitRecord(ray.t_max, 0.0, 0.0, NONE, NONE, NONE, 0u, 0u);
    var rest = ray;
    rest.t_min = max(ray.t_min, last.t);
    var state = begin_traversal(rest, ray_mask, NEAR_FIRST);
    loop {
        let leaf = next_leaf(&state, hit.t);
        if leaf == 0u {
            break;
        }
        if !is_layered(state.flags) {
            continue;
        }
        // Test each triangle; accept or reject the hits.
        let first = state.first_triangle + first_primitive(leaf);
        let end = first + primitive_count(leaf);
        for (var i = first; i < end; i++) {
            let candidate = candidate_hit(&state, i, hit.t);
            if candidate.instance != NONE {
                accept_layer(&hit, last, candidate);
            }
        }
    }
    return hit;
}
