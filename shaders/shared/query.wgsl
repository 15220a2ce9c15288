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

// Relative width of one step of the order in which a ray meets surfaces that touch: see HitOrder in
// src/trace/kernel/query.rs.
const TOUCH_STEP: f32 = 1.9073486328125e-6; // 2^-19
// Times a depth: the greatest t of a hit that may come before a hit at that depth.
const T_BEFORE_SCALE: f32 = 1.0 + 4.0 * TOUCH_STEP;
// Times the depth of the hit that was passed: the greatest depth of what may be the same surface once more.
const SAME_SURFACE_SCALE: f32 = 1.0 + 2.0 * TOUCH_STEP;
// Barycentric weight up to which a hit counts as one on the edge of its triangle: the rounding of the weights.
const EDGE_WEIGHT: f32 = 2.384185791015625e-7; // 2^-22

// Where a ray goes on: behind a hit that it has passed. The next hit is then the first one after that in the order of
// hits, so that a ray through many layers meets each of them once, however close they are.
struct Continuation {
    // The place of the hit that was passed in the order of hits.
    depth: f32,
    instance: u32,
    primitive: u32,
    // Whether it was a back face, and whether it was on an edge of its triangle.
    is_back: bool,
    is_on_edge: bool,
    // Whether the ray passes all translucent surfaces.
    only_opaque: bool,
}

struct ClosestQuery {
    // Where the ray goes on.
    start: Continuation,
    // The first hit so far; before one is found its instance is NONE.
    hit: HitRecord,
    // The depth of `hit`.
    depth: f32,
    // The greatest t of a hit that may come before `hit`, or the ray's t_max.
    t_max: f32,
}

// A ray that has passed nothing yet.
fn start_of_ray() -> Continuation {
    return Continuation(-1.0, NONE, NONE, false, false, false);
}

// A ray that has passed a hit of an instance with these flags.
fn start_behind(hit: HitRecord, flags: u32) -> Continuation {
    return Continuation(hit_depth(hit, flags), hit.instance, hit.primitive, hit.back_face != 0u, is_on_edge(hit), false);
}

// The least t of a hit that may come next.
fn t_min_of(start: Continuation) -> f32 {
    return max(start.depth * (1.0 - 2.0 * TOUCH_STEP), 0.0);
}

fn closest_query(t_max: f32, start: Continuation) -> ClosestQuery {
    return ClosestQuery(start, HitRecord(F32_MAX, 0.0, 0.0, NONE, NONE, NONE, 0u, 0u), F32_MAX, t_max);
}

fn accept_closest(query: ptr<function, ClosestQuery>, candidate: HitRecord, flags: u32) {
    let depth = hit_depth(candidate, flags);
    if is_first(query, candidate, depth) && !is_culled(candidate, flags) && !is_cut_out(candidate, flags) {
        if !(*query).start.only_opaque || is_opaque_at(candidate, flags) {
            keep_first(query, candidate, depth);
        }
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

// For the first hit of a layered instance: as accept_closest, but neither culls nor tests alpha.
fn accept_layer(query: ptr<function, ClosestQuery>, candidate: HitRecord, flags: u32) {
    let depth = hit_depth(candidate, flags);
    if is_first(query, candidate, depth) {
        keep_first(query, candidate, depth);
    }
}

// Whether a candidate comes before the first hit so far, but after the one that the ray has passed.
fn is_first(query: ptr<function, ClosestQuery>, candidate: HitRecord, depth: f32) -> bool {
    let hit = (*query).hit;
    return is_before(depth, candidate.instance, candidate.primitive, (*query).depth, hit.instance, hit.primitive)
        && is_after_start((*query).start, candidate, depth);
}

// Makes a candidate the first hit.
fn keep_first(query: ptr<function, ClosestQuery>, candidate: HitRecord, depth: f32) {
    (*query).hit = candidate;
    (*query).depth = depth;
    (*query).t_max = min((*query).t_max, depth * T_BEFORE_SCALE);
}

// The depth of a hit, by which hits are ordered: t, but less for a translucent surface and more for a back face.
fn hit_depth(hit: HitRecord, flags: u32) -> f32 {
    let is_translucent = (flags & INSTANCE_TRANSLUCENT) != 0u;
    let front_scale = select(1.0, 1.0 - 2.0 * TOUCH_STEP, is_translucent);
    let back_scale = select(1.0 + TOUCH_STEP, 1.0 - TOUCH_STEP, is_translucent);
    return hit.t * select(front_scale, back_scale, hit.back_face != 0u);
}

// The order of hits: by depth, then by instance, then by primitive.
fn is_before(a: f32, a_instance: u32, a_primitive: u32, b: f32, b_instance: u32, b_primitive: u32) -> bool {
    if a != b {
        return a < b;
    }
    return a_instance < b_instance || (a_instance == b_instance && a_primitive < b_primitive);
}

// Whether a hit comes after the one that was passed. A ray along an edge hits both of its triangles: the second one is
// the same surface once more, and does not count.
fn is_after_start(start: Continuation, hit: HitRecord, depth: f32) -> bool {
    if !(NEEDS_ALPHA_MASK || NEEDS_BLEND || NEEDS_REFRACTION) {
        return true;
    }
    let is_same_surface = hit.instance == start.instance && (hit.back_face != 0u) == start.is_back
        && depth <= start.depth * SAME_SURFACE_SCALE && (start.is_on_edge || is_on_edge(hit));
    return is_before(start.depth, start.instance, start.primitive, depth, hit.instance, hit.primitive)
        && !is_same_surface;
}

// Whether a hit is on an edge of its triangle, to within rounding.
fn is_on_edge(hit: HitRecord) -> bool {
    return min(min(hit.u, hit.v), (1.0 - hit.u) - hit.v) <= EDGE_WEIGHT;
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
