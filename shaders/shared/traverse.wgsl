// The three queries, whichever way the hierarchies are walked: rope.wgsl and wide.wgsl declare the same. Twin of
// src/trace/kernel/traverse.rs.

fn first_primitive(primitives: u32) -> u32 {
    return primitives & 0x0fffffffu;
}

fn primitive_count(primitives: u32) -> u32 {
    return primitives >> 28u;
}

// The closest hit in [t_min, t_max]; of hits at equal t the one of the lower instance, then the lower primitive.
fn closest_hit(ray: RayRecord, ray_mask: u32) -> HitRecord {
    var hit = HitRecord(ray.t_max, 0.0, 0.0, NONE, NONE, NONE, 0u, 0u);
    var state = begin_traversal(ray, ray_mask, true);
    loop {
        let leaf = next_leaf(&state, hit.t);
        if leaf == 0u {
            break;
        }
        let first = state.first_triangle + first_primitive(leaf);
        let end = first + primitive_count(leaf);
        for (var i = first; i < end; i++) {
            let triangle = triangle_at(i);
            let crossing = intersect_triangle(state.local_shear, triangle);
            if !crossing.is_hit || crossing.t < ray.t_min || !is_before(crossing.t, state.instance, triangle.primitive, hit) {
                continue;
            }
            if NEEDS_CULLING && crossing.back && (state.flags & INSTANCE_CULL_BACK) != 0u {
                continue;
            }
            if NEEDS_ALPHA_MASK && (state.flags & INSTANCE_ALPHA_MASK) != 0u {
                if fails_alpha_test(instances[state.instance], triangle, crossing.u, crossing.v) {
                    continue;
                }
            }
            let back = select(0u, 1u, crossing.back);
            hit = HitRecord(crossing.t, crossing.u, crossing.v, state.instance, triangle.primitive, i, back, 0u);
        }
    }
    if hit.instance == NONE {
        hit.t = F32_MAX;
    }
    return hit;
}

fn is_before(t: f32, instance: u32, primitive: u32, hit: HitRecord) -> bool {
    if t != hit.t {
        return t < hit.t;
    }
    return instance < hit.instance || (instance == hit.instance && primitive < hit.primitive);
}

// How much light gets through between t_min and t_max.
fn transmittance(ray: RayRecord, ray_mask: u32) -> vec3<f32> {
    var light = vec3<f32>(1.0);
    var has_layers = false;
    var state = begin_traversal(ray, ray_mask, false);
    loop {
        let leaf = next_leaf(&state, ray.t_max);
        if leaf == 0u {
            break;
        }
        if is_layered(state.flags) {
            has_layers = true;
            continue;
        }
        let first = state.first_triangle + first_primitive(leaf);
        let end = first + primitive_count(leaf);
        for (var i = first; i < end; i++) {
            let triangle = triangle_at(i);
            let crossing = intersect_triangle(state.local_shear, triangle);
            if crossing.is_hit && crossing.t >= ray.t_min && crossing.t <= ray.t_max {
                light *= candidate_transmittance(state.instance, state.flags, triangle, crossing.u, crossing.v);
                if max_component(light) <= 0.0 {
                    return vec3<f32>(0.0);
                }
            }
        }
    }
    if has_layers {
        var layer = HitRecord(-1.0, 0.0, 0.0, NONE, NONE, NONE, 0u, 0u);
        loop {
            layer = next_layer(ray, ray_mask, layer);
            if layer.instance == NONE {
                break;
            }
            let flags = instances[layer.instance].flags;
            light *= candidate_transmittance(layer.instance, flags, triangle_at(layer.triangle), layer.u, layer.v);
            if max_component(light) <= 0.0 {
                return vec3<f32>(0.0);
            }
        }
    }
    return light;
}

// Whether what is crossed is to be taken layer by layer: it may be met more than once, but counts once.
fn is_layered(flags: u32) -> bool {
    let layered = INSTANCE_TRANSLUCENT | INSTANCE_HAS_DUPLICATES;
    return (NEEDS_ALPHA_MASK || NEEDS_BLEND || NEEDS_REFRACTION) && (flags & layered) == layered;
}

// The first crossing of a layered instance after `last`, in the order of t, instance and primitive.
fn next_layer(ray: RayRecord, ray_mask: u32, last: HitRecord) -> HitRecord {
    var hit = HitRecord(ray.t_max, 0.0, 0.0, NONE, NONE, NONE, 0u, 0u);
    var rest = ray;
    rest.t_min = max(ray.t_min, last.t);
    var state = begin_traversal(rest, ray_mask, true);
    loop {
        let leaf = next_leaf(&state, hit.t);
        if leaf == 0u {
            break;
        }
        if !is_layered(state.flags) {
            continue;
        }
        let first = state.first_triangle + first_primitive(leaf);
        let end = first + primitive_count(leaf);
        for (var i = first; i < end; i++) {
            let triangle = triangle_at(i);
            let crossing = intersect_triangle(state.local_shear, triangle);
            let is_met = crossing.is_hit && crossing.t >= ray.t_min;
            if is_met && is_after(crossing.t, state.instance, triangle.primitive, last)
                && is_before(crossing.t, state.instance, triangle.primitive, hit) {
                hit = HitRecord(crossing.t, crossing.u, crossing.v, state.instance, triangle.primitive, i, 0u, 0u);
            }
        }
    }
    return hit;
}

fn is_after(t: f32, instance: u32, primitive: u32, hit: HitRecord) -> bool {
    if t != hit.t {
        return t > hit.t;
    }
    return instance > hit.instance || (instance == hit.instance && primitive > hit.primitive);
}

// Whether anything that lets no light through lies between t_min and t_max.
fn any_hit(ray: RayRecord, ray_mask: u32) -> bool {
    var state = begin_traversal(ray, ray_mask, false);
    loop {
        let leaf = next_leaf(&state, ray.t_max);
        if leaf == 0u {
            break;
        }
        let first = state.first_triangle + first_primitive(leaf);
        let end = first + primitive_count(leaf);
        for (var i = first; i < end; i++) {
            let triangle = triangle_at(i);
            let crossing = intersect_triangle(state.local_shear, triangle);
            if crossing.is_hit && crossing.t >= ray.t_min && crossing.t <= ray.t_max {
                if max_component(candidate_transmittance(state.instance, state.flags, triangle, crossing.u, crossing.v)) <= 0.0 {
                    return true;
                }
            }
        }
    }
    return false;
}

fn candidate_transmittance(instance: u32, flags: u32, triangle: Triangle, u: f32, v: f32) -> vec3<f32> {
    if (NEEDS_ALPHA_MASK || NEEDS_BLEND || NEEDS_REFRACTION) && (flags & INSTANCE_TRANSLUCENT) != 0u {
        return surface_transmittance(instances[instance], triangle, u, v);
    }
    return vec3<f32>(0.0);
}
