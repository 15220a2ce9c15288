// Near children first: the top level's nodes of two children, then the bottom levels' of eight, with one short stack. Twin of
// src/trace/kernel/wide.rs: see there.

const TLAS_STACK_SIZE: u32 = 16u;
const TLAS_LEAF_BIT: u32 = 0x80000000u;
const BLAS_STACK_SIZE: u32 = 31u;
const PENDING_CHILDREN_MASK: u32 = 255u;
const NO_ENTRY: f32 = -1.0;
const UNUSED_COORDINATE: f32 = 0x1.fffffcp+127f;

struct TraversalState {
    // The ray in world space, and in the space of the level that it is in.
    world_ray: SlabRay,
    level_ray: SlabRay,
    // The ray in the space of the instance that it is in, if any.
    local_shear: ShearRay,
    direction: vec3<f32>,
    t_min: f32,
    ray_mask: u32,
    // NONE in the top level.
    instance: u32,
    first_triangle: u32,
    flags: u32,

    // What comes next in the top level: the index of an inner node that is met, or its instance and TOP_LEAF; along escape
    // indices, the index of the next node; NONE where the stack says.
    tlas_next: u32,
    // Where the walk along escape indices ends; 0 where there is none.
    tlas_rope_end: u32,
    // How many of the top level wait.
    tlas_stack_size: u32,

    // Which way the ray goes along x, y and z.
    octant: u32,
    first_node: u32,
    // The wide node whose children are visited, relative to the first; a bit for each that waits, in order; where the first begins.
    wide_node_index: u32,
    pending_children: u32,
    nearest_pending_t: f32,
    // How many wait, of both levels.
    stack_size: u32,
    // First those of the top level, as `top` has them, and where they begin. Then the wide nodes above: where the first of their
    // children begins and who waits share a word.
    stack: array<vec2<u32>, TLAS_STACK_SIZE + BLAS_STACK_SIZE>,
}

fn begin_traversal(ray: RayRecord, ray_mask: u32, order: u32) -> TraversalState {
    var state: TraversalState;
    state.world_ray = slab_ray(ray.origin, ray.direction);
    state.level_ray = state.world_ray;
    state.direction = ray.direction;
    state.t_min = ray.t_min;
    state.ray_mask = ray_mask;
    state.instance = NONE;
    state.tlas_next = NONE;
    let root = tlas_nodes[0];
    // A hierarchy of nothing is absent or zero, and no escape index leads back to node 0.
    if root.escape_index != 0u {
        if order != NEAR_FIRST {
            state.tlas_next = 0u;
            state.tlas_rope_end = NONE;
        } else if tlas_entry_distance(state.level_ray, root, ray.t_min, ray.t_max) != NO_ENTRY {
            state.tlas_next = encode_tlas_entry(0u, root);
        }
    }
    return state;
}

// Goes on to the next leaf of triangles whose box the ray meets up to `t_max`; 0 if there is none.
fn next_leaf(state: ptr<function, TraversalState>, t_max: f32) -> u32 {
    loop {
        if (*state).instance != NONE {
            let leaf = step_blas(state, t_max);
            if leaf != 0u {
                return leaf;
            }
        } else if !step_tlas(state, t_max) {
            return 0u;
        }
    }
    return 0u;
}

// One step in the top level; false at its end.
fn step_tlas(state: ptr<function, TraversalState>, t_max: f32) -> bool {
    if (*state).tlas_rope_end != 0u {
        step_tlas_rope(state, t_max);
    } else if (*state).tlas_next != NONE {
        visit_tlas_entry(state, t_max);
    } else if (*state).stack_size > 0u {
        (*state).stack_size -= 1u;
        let waiting = (*state).stack[(*state).stack_size];
        if bitcast<f32>(waiting.y) <= t_max {
            (*state).tlas_next = waiting.x;
        }
    } else {
        return false;
    }
    return true;
}

// Visits the next node along the escape indices.
fn step_tlas_rope(state: ptr<function, TraversalState>, t_max: f32) {
    if (*state).tlas_next == (*state).tlas_rope_end {
        (*state).tlas_rope_end = 0u;
        (*state).tlas_next = NONE;
        return;
    }
    let node = tlas_nodes[(*state).tlas_next];
    if !intersects_box((*state).level_ray, (*state).t_min, t_max, node.min, node.max) {
        (*state).tlas_next = node.escape_index;
    } else if node.primitives == 0u {
        (*state).tlas_next += 1u;
    } else {
        (*state).tlas_next = node.escape_index;
        enter_instance(state, first_primitive(node.primitives), t_max);
    }
}

// Visits what is met.
fn visit_tlas_entry(state: ptr<function, TraversalState>, t_max: f32) {
    if ((*state).tlas_next & TLAS_LEAF_BIT) != 0u {
        let instance = (*state).tlas_next & ~TLAS_LEAF_BIT;
        (*state).tlas_next = NONE;
        enter_instance(state, instance, t_max);
        return;
    }
    let left = (*state).tlas_next + 1u;
    if (*state).stack_size == TLAS_STACK_SIZE {
        (*state).tlas_rope_end = tlas_nodes[(*state).tlas_next].escape_index;
        (*state).tlas_next = left;
        return;
    }
    let left_node = tlas_nodes[left];
    let right = left_node.escape_index;
    let right_node = tlas_nodes[right];
    let left_near = tlas_entry_distance((*state).level_ray, left_node, (*state).t_min, t_max);
    let right_near = tlas_entry_distance((*state).level_ray, right_node, (*state).t_min, t_max);
    let left_top = encode_tlas_entry(left, left_node);
    let right_top = encode_tlas_entry(right, right_node);
    let right_first = left_near == NO_ENTRY || (right_near != NO_ENTRY && right_near < left_near);
    if left_near != NO_ENTRY && right_near != NO_ENTRY {
        let far = select(
            vec2<u32>(right_top, bitcast<u32>(right_near)),
            vec2<u32>(left_top, bitcast<u32>(left_near)),
            right_first,
        );
        (*state).stack[(*state).stack_size] = far;
        (*state).stack_size += 1u;
    }
    (*state).tlas_next = select(left_top, right_top, right_first);
    if left_near == NO_ENTRY && right_near == NO_ENTRY {
        (*state).tlas_next = NONE;
    }
}

// A node of the top level as `top` has those that are met.
fn encode_tlas_entry(index: u32, node: Node) -> u32 {
    return select(first_primitive(node.primitives) | TLAS_LEAF_BIT, index, node.primitives == 0u);
}

// Where the ray enters a node's box, rounded down; MISSED if it does not, or there is nothing in it.
fn tlas_entry_distance(ray: SlabRay, node: Node, t_min: f32, t_max: f32) -> f32 {
    let a = (node.min - ray.origin) * ray.reciprocal_direction;
    let b = (node.max - ray.origin) * ray.reciprocal_direction;
    let near = min(a, b);
    let far = max(a, b);
    let t_near = max(max(near.x, near.y), max(near.z, t_min)) * BOX_ENTRY_SCALE;
    let t_far = min(min(far.x, far.y), min(far.z, t_max));
    return select(NO_ENTRY, t_near, t_near <= t_far && node.min.x < UNUSED_COORDINATE);
}

fn enter_instance(state: ptr<function, TraversalState>, index: u32, t_max: f32) {
    if (instances[index].mask & (*state).ray_mask) == 0u {
        return;
    }
    let origin = transform_point(instances[index].local_from_world, (*state).world_ray.origin);
    let direction = transform_vector(instances[index].local_from_world, (*state).direction);
    (*state).instance = index;
    (*state).first_triangle = instances[index].first_triangle;
    (*state).flags = instances[index].flags;
    (*state).level_ray = slab_ray(origin, direction);
    (*state).first_node = geometries[instances[index].geometry].first_wide_node;
    let backward = select(vec3<u32>(0u), vec3<u32>(1u, 2u, 4u), (*state).level_ray.reciprocal_direction < vec3<f32>(0.0));
    (*state).octant = backward.x | backward.y | backward.z;
    (*state).tlas_stack_size = (*state).stack_size;
    let least = wide_node_at((*state).first_node).origin;
    let greatest = least + wide_steps(wide_node_at((*state).first_node).exponents) * 255.0;
    let extent = max(max_component(abs(least)), max_component(abs(greatest)));
    (*state).local_shear = shear_ray(origin, direction, max(extent, max_component(abs(origin))));
    visit_wide_node(state, 0u, t_max);
}

fn leave_instance(state: ptr<function, TraversalState>) {
    (*state).level_ray = (*state).world_ray;
    (*state).instance = NONE;
}

// Visits a wide node: finds out which of its children are met.
fn visit_wide_node(state: ptr<function, TraversalState>, index: u32, t_max: f32) {
    let node = wide_node_at((*state).first_node + index);
    let steps = wide_steps(node.exponents);
    let offset = node.origin - (*state).level_ray.origin;
    let reciprocal = (*state).level_ray.reciprocal_direction;
    // Least and greatest planes to near and far ones, four children a word.
    let x = select(node.planes[0], node.planes[0].zwxy, reciprocal.x < 0.0);
    let y = select(node.planes[1], node.planes[1].zwxy, reciprocal.y < 0.0);
    let z = select(node.planes[2], node.planes[2].zwxy, reciprocal.z < 0.0);
    let used = node.exponents >> 24u;
    let first = four_child_entry_distances(vec3<u32>(x.x, y.x, z.x), vec3<u32>(x.z, y.z, z.z), steps, offset, reciprocal, (*state).t_min, t_max);
    let last = four_child_entry_distances(vec3<u32>(x.y, y.y, z.y), vec3<u32>(x.w, y.w, z.w), steps, offset, reciprocal, (*state).t_min, t_max);
    let first_met = select(vec4<u32>(0u), vec4<u32>(1u, 2u, 4u, 8u) & vec4<u32>(used), first != vec4<f32>(NO_ENTRY));
    let last_met = select(vec4<u32>(0u), vec4<u32>(16u, 32u, 64u, 128u) & vec4<u32>(used), last != vec4<f32>(NO_ENTRY));
    let nears = min(
        select(vec4<f32>(F32_MAX), first, first_met != vec4<u32>(0u)),
        select(vec4<f32>(F32_MAX), last, last_met != vec4<u32>(0u)),
    );
    let both = first_met | last_met;
    (*state).wide_node_index = index;
    (*state).pending_children = slots_in_visit_order((both.x | both.y) | (both.z | both.w), (*state).octant);
    (*state).nearest_pending_t = min(min(nears.x, nears.y), min(nears.z, nears.w));
}

// Where the ray enters each of four children's boxes, rounded down; MISSED where it does not.
fn four_child_entry_distances(
    near: vec3<u32>,
    far: vec3<u32>,
    steps: vec3<f32>,
    offset: vec3<f32>,
    reciprocal: vec3<f32>,
    t_min: f32,
    t_max: f32,
) -> vec4<f32> {
    let near_x = (unpack_bytes(near.x) * steps.x + offset.x) * reciprocal.x;
    let near_y = (unpack_bytes(near.y) * steps.y + offset.y) * reciprocal.y;
    let near_z = (unpack_bytes(near.z) * steps.z + offset.z) * reciprocal.z;
    let far_x = (unpack_bytes(far.x) * steps.x + offset.x) * reciprocal.x;
    let far_y = (unpack_bytes(far.y) * steps.y + offset.y) * reciprocal.y;
    let far_z = (unpack_bytes(far.z) * steps.z + offset.z) * reciprocal.z;
    let t_near = max(max(near_x, near_y), max(near_z, vec4<f32>(t_min))) * BOX_ENTRY_SCALE;
    let t_far = min(min(far_x, far_y), min(far_z, vec4<f32>(t_max)));
    return select(vec4<f32>(NO_ENTRY), t_near, t_near <= t_far);
}

fn unpack_bytes(word: u32) -> vec4<f32> {
    return vec4<f32>((vec4<u32>(word) >> vec4<u32>(0u, 8u, 16u, 24u)) & vec4<u32>(255u));
}

// The lengths of a node's steps.
fn wide_steps(exponents: u32) -> vec3<f32> {
    return bitcast<vec3<f32>>(((vec3<u32>(exponents) >> vec3<u32>(0u, 8u, 16u)) & vec3<u32>(255u)) << vec3<u32>(23u));
}

// The next leaf below the wide nodes that wait, or 0: then there is none, or more to be done.
fn step_blas(state: ptr<function, TraversalState>, t_max: f32) -> u32 {
    if (*state).pending_children == 0u {
        if (*state).stack_size == (*state).tlas_stack_size {
            leave_instance(state);
            return 0u;
        }
        (*state).stack_size -= 1u;
        let entry = (*state).stack[(*state).stack_size];
        (*state).nearest_pending_t = bitcast<f32>(entry.y & ~PENDING_CHILDREN_MASK);
        if (*state).nearest_pending_t <= t_max {
            (*state).wide_node_index = entry.x;
            (*state).pending_children = entry.y & PENDING_CHILDREN_MASK;
        }
        return 0u;
    }
    let slot = firstTrailingBit((*state).pending_children) ^ (*state).octant;
    (*state).pending_children &= (*state).pending_children - 1u;
    let child = wide_child_at((*state).first_node + (*state).wide_node_index, slot);
    if primitive_count(child) > 0u {
        return child;
    }
    if (*state).pending_children != 0u {
        (*state).stack[(*state).stack_size] = vec2<u32>((*state).wide_node_index, (bitcast<u32>((*state).nearest_pending_t) & ~PENDING_CHILDREN_MASK) | (*state).pending_children);
        (*state).stack_size += 1u;
    }
    visit_wide_node(state, child, t_max);
    return 0u;
}

// Bits by slot to bits by order: bit i is that of slot i ^ octant.
fn slots_in_visit_order(bits: u32, octant: u32) -> u32 {
    var ordered = bits;
    if (octant & 1u) != 0u {
        ordered = ((ordered & 0x55u) << 1u) | ((ordered >> 1u) & 0x55u);
    }
    if (octant & 2u) != 0u {
        ordered = ((ordered & 0x33u) << 2u) | ((ordered >> 2u) & 0x33u);
    }
    if (octant & 4u) != 0u {
        ordered = ((ordered & 0x0fu) << 4u) | (ordered >> 4u);
    }
    return ordered;
}
