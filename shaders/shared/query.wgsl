// The rules of the ray queries: which candidate hits a query accepts, and what it keeps of them. Twin of
// src/trace/kernel/query.rs: accept_closest is ClosestQuery::accept_hit there, and so on for each query.

// The orders in which a traversal visits nodes: near ones first, so that hits shorten the ray early; or the order of
// least cost a node, as an early hit does not shorten the ray.
const NEAR_FIRST: u32 = 0u;
const ANY_ORDER: u32 = 1u;

// The hit with triangle `index` of the current instance as a candidate, if it lies in [t_min, t_max]; else its instance
// is NONE.
fn candidate_hit(state: ptr<function, TraversalState>, index: u32, t_max: f32) -> HitRecord {
    let triangle = triangle_at(index);
    let hit = intersect_triangle((*state).local_shear, triangle);
    // Clip to the part of the ray that can still change the result.
    let is_candidate = hit.is_hit && hit.t >= (*state).t_min && hit.t <= t_max;
    let instance = select(NONE, (*state).instance, is_candidate);
    return HitRecord(hit.t, hit.u, hit.v, instance, triangle.primitive, index, select(0u, 1u, hit.back), 0u);
}

fn accept_closest(hit: ptr<function, HitRecord>, candidate: HitRecord, flags: u32) {
    if is_before(candidate, *hit) && !is_culled(candidate, flags) && !is_cut_out(candidate, flags) {
        *hit = candidate;
    }
}

// Returns whether the query is decided.
fn accept_any(candidate: HitRecord, flags: u32) -> bool {
    return is_opaque_at(candidate, flags);
}

// Returns whether the query is decided.
fn accept_transmittance(transmittance: ptr<function, vec3<f32>>, candidate: HitRecord, flags: u32) -> bool {
    *transmittance *= candidate_transmittance(candidate, flags);
    return max_component(*transmittance) <= 0.0;
}

// For the first hit of a layered instance after `last`, in the order of t, instance and primitive.
fn accept_layer(hit: ptr<function, HitRecord>, last: HitRecord, candidate: HitRecord) {
    if is_before(last, candidate) && is_before(candidate, *hit) {
        *hit = candidate;
    }
}

// Whether one hit comes before another: the nearer one; of hits at equal t the one of the lower instance, then the
// lower primitive.
fn is_before(a: HitRecord, b: HitRecord) -> bool {
    if a.t != b.t {
        return a.t < b.t;
    }
    return a.instance < b.instance || (a.instance == b.instance && a.primitive < b.primitive);
}

// Whether a candidate is a back face of an instance whose back faces are culled.
fn is_culled(candidate: HitRecord, flags: u32) -> bool {
    return NEEDS_CULLING && candidate.back_face != 0u && (flags & INSTANCE_CULL_BACK) != 0u;
}

// Alpha test: whether a candidate lies in a hole of an alpha-masked material.
fn is_cut_out(candidate: HitRecord, flags: u32) -> bool {
    if NEEDS_ALPHA_MASK && (flags & INSTANCE_ALPHA_MASK) != 0u {
        return fails_alpha_test(instances[candidate.instance], candidate.primitive, candidate.u, candidate.v);
    }
    return false;
}

// Whether a candidate stops all light.
fn is_opaque_at(candidate: HitRecord, flags: u32) -> bool {
    return max_component(candidate_transmittance(candidate, flags)) <= 0.0;
}

// The transmittance of a candidate per colour channel: 0 unless its instance is translucent.
fn candidate_transmittance(candidate: HitRecord, flags: u32) -> vec3<f32> {
    if (NEEDS_ALPHA_MASK || NEEDS_BLEND || NEEDS_REFRACTION) && (flags & INSTANCE_TRANSLUCENT) != 0u {
        return surface_transmittance(instances[candidate.instance], candidate.primitive, candidate.u, candidate.v);
    }
    return vec3<f32>(0.0);
}

// Whether an instance is layered: translucent, and with triangles that several leaves refer to. A traversal may offer
// a hit of it more than once, but it must dim light once, so it is traversed hit by hit in order of t.
fn is_layered(flags: u32) -> bool {
    let layered = INSTANCE_TRANSLUCENT | INSTANCE_HAS_DUPLICATES;
    return (NEEDS_ALPHA_MASK || NEEDS_BLEND || NEEDS_REFRACTION) && (flags & layered) == layered;
}
