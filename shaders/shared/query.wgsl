// The rules of the ray queries: which candidate hits a query accepts, and what it keeps of them. Twin of
// src/trace/kernel/query.rs: accept_closest is ClosestQuery::accept_hit there, and so on for each query.

// The flags of a layered instance, see is_layered.
const INSTANCE_LAYERED: u32 = INSTANCE_TRANSLUCENT | INSTANCE_HAS_DUPLICATES;

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
    var depth = hit.t;
    if is_candidate {
        depth = hit_depth(hit.t, hit.back, (*state).flags, triangle, (*state).local_shear.direction);
    }
    return HitRecord(hit.t, hit.u, hit.v, instance, triangle.primitive, index, select(0u, 1u, hit.back), depth);
}

// Width of one step of the order in which a ray meets surfaces that touch, relative to t, for a surface at right angles
// to the ray: more than twice the rounding of t.
const TOUCH_STEP: f32 = 1.9073486328125e-6; // 2^-19
// Greatest factor by which a step is wider where a surface is seen at a grazing angle, as the rounding of t is greater
// there.
const MAX_GRAZING: f32 = 64.0;
// Times a depth: the greatest t of a hit that may come before a hit at that depth.
const T_BEFORE_SCALE: f32 = 1.0 + 4.0 * TOUCH_STEP * MAX_GRAZING;
// Times a depth: the least t of a hit that may come after a hit at that depth.
const T_AFTER_SCALE: f32 = 1.0 - 2.0 * TOUCH_STEP * MAX_GRAZING;
// Barycentric weight up to which a hit counts as one on the edge of its triangle: the rounding of the weights.
const EDGE_WEIGHT: f32 = 2.384185791015625e-7; // 2^-22

// Where a ray goes on: behind a hit that it has passed. The next hit is then the first one after that in the order of
// hits, so that a ray through many layers meets each of them once, however close they are.
struct Continuation {
    // The place of the hit that was passed in the order of hits.
    depth: f32,
    instance: u32,
    primitive: u32,
    // The greatest depth of what may be the surface that was passed once more.
    same_surface_end: f32,
    // Whether it was a back face, and whether it was on an edge of its triangle.
    is_back: bool,
    is_on_edge: bool,
    // Whether the ray passes all translucent surfaces.
    only_opaque: bool,
}

struct ClosestQuery {
    // Where the ray goes on.
    start: Continuation,
    // The first of all candidates offered so far; before there is one its instance is NONE.
    hit: HitRecord,
    // The greatest t of a hit that may come before `hit`, or the ray's t_max.
    t_max: f32,
}

// A ray that has passed nothing yet.
fn start_of_ray() -> Continuation {
    return Continuation(-1.0, NONE, NONE, -1.0, false, false, false);
}

// A ray of this direction that has passed a hit.
fn start_behind(hit: HitRecord, direction: vec3<f32>) -> Continuation {
    let local_direction = transform_vector(instances[hit.instance].local_from_world, direction);
    let end = hit.depth + hit.depth * (2.0 * TOUCH_STEP * grazing(triangle_at(hit.triangle), local_direction));
    return Continuation(hit.depth, hit.instance, hit.primitive, end, hit.back_face != 0u, is_on_edge(hit), false);
}

// The least t of a hit that may come next.
fn t_min_of(start: Continuation) -> f32 {
    return max(start.depth * T_AFTER_SCALE, 0.0);
}

fn closest_query(t_max: f32, start: Continuation) -> ClosestQuery {
    return ClosestQuery(start, HitRecord(F32_MAX, 0.0, 0.0, NONE, NONE, NONE, 0u, F32_MAX), t_max);
}

fn accept_closest(query: ptr<function, ClosestQuery>, candidate: HitRecord, flags: u32) {
    if is_first(query, candidate) && !is_culled(candidate, flags) && !is_cut_out(candidate, flags) {
        if !(*query).start.only_opaque || is_opaque_at(candidate, flags) {
            keep_first(query, candidate);
        }
    }
}

// Returns whether the query is decided.
fn accept_any(candidate: HitRecord, flags: u32) -> bool {
    return is_opaque_at(candidate, flags);
}

// Returns whether the query is decided.
fn accept_transmittance(transmittance: ptr<function, vec3<f32>>, candidate: HitRecord, flags: u32) -> bool {
    if is_lit_from_behind(candidate, flags) {
        return false;
    }
    *transmittance *= candidate_transmittance(candidate, flags);
    return max_component(*transmittance) <= 0.0;
}

// Whether a candidate is on an edge of a translucent triangle.
fn is_translucent_edge(candidate: HitRecord, flags: u32) -> bool {
    return (NEEDS_ALPHA_MASK || NEEDS_BLEND || NEEDS_REFRACTION) && (flags & INSTANCE_TRANSLUCENT) != 0u
        && !is_lit_from_behind(candidate, flags) && is_on_edge(candidate);
}

// For the first hit of a layered instance that dims light: as accept_closest, but does not test alpha, and culls as
// shadow rays do.
fn accept_layer(query: ptr<function, ClosestQuery>, candidate: HitRecord, flags: u32) {
    if is_first(query, candidate) && !is_lit_from_behind(candidate, flags) {
        keep_first(query, candidate);
    }
}

// Whether a candidate comes before the first hit so far, but after the one that the ray has passed.
fn is_first(query: ptr<function, ClosestQuery>, candidate: HitRecord) -> bool {
    let hit = (*query).hit;
    return is_before(candidate.depth, candidate.instance, candidate.primitive, hit.depth, hit.instance, hit.primitive)
        && is_after_start((*query).start, candidate);
}

// Makes a candidate the first hit.
fn keep_first(query: ptr<function, ClosestQuery>, candidate: HitRecord) {
    (*query).hit = candidate;
    (*query).t_max = min((*query).t_max, candidate.depth * T_BEFORE_SCALE);
}

// The depth of a hit, by which hits are ordered: t, but that of a translucent surface is two steps less, that of a back
// face one step more.
fn hit_depth(t: f32, is_back: bool, flags: u32, triangle: Triangle, direction: vec3<f32>) -> f32 {
    let is_translucent = (flags & INSTANCE_TRANSLUCENT) != 0u;
    let steps = select(0.0, 1.0, is_back) - select(0.0, 2.0, is_translucent);
    if steps == 0.0 {
        return t;
    }
    return t + t * (steps * TOUCH_STEP * grazing(triangle, direction));
}

// How much greater the rounding of t is along this direction than at right angles to a plane along two axes: about 1
// over the cosine, at most MAX_GRAZING.
fn grazing(triangle: Triangle, direction: vec3<f32>) -> f32 {
    let edge_1 = triangle.v1 - triangle.v0;
    let edge_2 = triangle.v2 - triangle.v0;
    let scale = reciprocal_power_of_two(max_component(max(abs(edge_1), abs(edge_2))));
    let a = edge_1 * scale;
    let b = edge_2 * scale;
    let plus = vec3<f32>(a.y * b.z, a.z * b.x, a.x * b.y);
    let minus = vec3<f32>(a.z * b.y, a.x * b.z, a.y * b.x);
    let slope = abs(dot3(plus - minus, direction));
    let bound = dot3(abs(plus) + abs(minus), abs(direction));
    if slope * MAX_GRAZING <= bound {
        return MAX_GRAZING;
    }
    return bound / slope;
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
fn is_after_start(start: Continuation, hit: HitRecord) -> bool {
    if !(NEEDS_ALPHA_MASK || NEEDS_BLEND || NEEDS_REFRACTION) {
        return true;
    }
    let is_same_surface = hit.instance == start.instance && (hit.back_face != 0u) == start.is_back
        && hit.depth <= start.same_surface_end && (start.is_on_edge || is_on_edge(hit));
    return is_before(start.depth, start.instance, start.primitive, hit.depth, hit.instance, hit.primitive)
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

// Whether light that travels against the ray, as that of a shadow ray does, meets the back of a single-sided triangle.
// It passes, as sight does from there. The ray, which comes from the other side, hits the front.
fn is_lit_from_behind(candidate: HitRecord, flags: u32) -> bool {
    return NEEDS_CULLING && candidate.back_face == 0u && (flags & INSTANCE_CULL_BACK) != 0u;
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
    return (NEEDS_ALPHA_MASK || NEEDS_BLEND || NEEDS_REFRACTION) && (flags & INSTANCE_LAYERED) == INSTANCE_LAYERED;
}
