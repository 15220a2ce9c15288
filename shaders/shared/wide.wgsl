// Ordered traversal with a short stack: binary TLAS, eight-wide BLASes. Twin of src/trace/kernel/wide.rs: see there.

const TLAS_STACK_SIZE: u32 = 16u;
const TLAS_LEAF_BIT: u32 = 0x80000000u;
const BLAS_STACK_SIZE: u32 = 31u;
const PENDING_CHILDREN_MASK: u32 = 255u;
const NO_ENTRY: f32 = -1.0;
const UNUSED_COORDINATE: f32 = 0x1.fffffcp+127f;

struct TraversalState {
    // Slab-test operands in world space, and in the current space: world in the TLAS, local in an instance.
    world_ray: SlabRay,
    level_ray: SlabRay,
    // Triangle-test operands in the instance's local space; unset in the TLAS.
    local_shear: ShearRay,
    direction: vec3<f32>,
    t_min: f32,
    ray_mask: u32,
    // The current instance, or NONE in the TLAS.
    instance: u32,
    first_triangle: u32,
    flags: u32,

    // Next TLAS entry: the index of an inner node whose box is hit, or an instance index with TLAS_LEAF_BIT; along
    // escape indices, the index of the next node; NONE to pop from the stack.
    tlas_next: u32,
    // End (exclusive) of the traversal of a TLAS subtree along escape indices; 0 if there is none.
    tlas_rope_end: u32,
    // Stack size on entry of the instance.
    tlas_stack_size: u32,

    // Bit i set: the local direction is negative along axis i.
    octant: u32,
    first_node: u32,
    // Current wide node relative to the BLAS root; mask of its pending children in visit order; their least entry
    // distance.
    wide_node_index: u32,
    pending_children: u32,
    nearest_pending_t: f32,
    // Stack size, both levels.
    stack_size: u32,
    // Stack entries: first (TLAS entry, entry distance bits), then (wide node, entry distance and pending mask).
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
    // An empty TLAS has no nodes, or a zeroed root (escape index 0, which no valid node has).
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

// Advances to the next BLAS leaf whose box the ray intersects within [t_min, t_max]; 0 at the end.
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

// Advances the TLAS traversal by one step; false when it is finished.
fn step_tlas(state: ptr<function, TraversalState>, t_max: f32) -> bool {
    // In a subtree that is traversed along escape indices.
    if (*state).tlas_rope_end != 0u {
        step_tlas_rope(state, t_max);
    } else if (*state).tlas_next != NONE {
        visit_tlas_entry(state, t_max);
    } else if (*state).stack_size > 0u {
        // Pop an entry; skip it if it lies beyond t_max.
        (*state).stack_size -= 1u;
        let entry = (*state).stack[(*state).stack_size];
        if bitcast<f32>(entry.y) <= t_max {
            (*state).tlas_next = entry.x;
        }
    } else {
        return false;
    }
    return true;
}

// Visits the next node of a TLAS subtree that is traversed along escape indices.
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

// Visits the pending TLAS entry: enters an instance, or tests an inner node's two children and pushes the farther.
fn visit_tlas_entry(state: ptr<function, TraversalState>, t_max: f32) {
    // Instance entry.
    if ((*state).tlas_next & TLAS_LEAF_BIT) != 0u {
        let instance = (*state).tlas_next & ~TLAS_LEAF_BIT;
        (*state).tlas_next = NONE;
        enter_instance(state, instance, t_max);
        return;
    }
    let left = (*state).tlas_next + 1u;
    // Stack full: traverse the subtree along escape indices.
    if (*state).stack_size == TLAS_STACK_SIZE {
        (*state).tlas_rope_end = tlas_nodes[(*state).tlas_next].escape_index;
        (*state).tlas_next = left;
        return;
    }
    // Test both children.
    let left_node = tlas_nodes[left];
    let right = left_node.escape_index;
    let right_node = tlas_nodes[right];
    let left_distance = tlas_entry_distance((*state).level_ray, left_node, (*state).t_min, t_max);
    let right_distance = tlas_entry_distance((*state).level_ray, right_node, (*state).t_min, t_max);
    let left_entry = encode_tlas_entry(left, left_node);
    let right_entry = encode_tlas_entry(right, right_node);
    // Order them by entry distance.
    let right_first = left_distance == NO_ENTRY || (right_distance != NO_ENTRY && right_distance < left_distance);
    // Push the farther.
    if left_distance != NO_ENTRY && right_distance != NO_ENTRY {
        let far = select(
            vec2<u32>(right_entry, bitcast<u32>(right_distance)),
            vec2<u32>(left_entry, bitcast<u32>(left_distance)),
            right_first,
        );
        (*state).stack[(*state).stack_size] = far;
        (*state).stack_size += 1u;
    }
    // Continue with the nearer.
    (*state).tlas_next = select(left_entry, right_entry, right_first);
    if left_distance == NO_ENTRY && right_distance == NO_ENTRY {
        (*state).tlas_next = NONE;
    }
}

// Encodes a TLAS node as a traversal entry.
fn encode_tlas_entry(index: u32, node: Node) -> u32 {
    return select(first_primitive(node.primitives) | TLAS_LEAF_BIT, index, node.primitives == 0u);
}

// Distance at which the ray enters a node's box, rounded down; NO_ENTRY if the box is missed or the node is an unused
// leaf, or has no other leaves below it.
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
    // Hidden by the instance's mask?
    if (instances[index].mask & (*state).ray_mask) == 0u {
        return;
    }
    // Transform the ray.
    let origin = transform_point(instances[index].local_from_world, (*state).world_ray.origin);
    let direction = transform_vector(instances[index].local_from_world, (*state).direction);
    (*state).instance = index;
    (*state).first_triangle = instances[index].first_triangle;
    (*state).flags = instances[index].flags;
    (*state).level_ray = slab_ray(origin, direction);
    (*state).first_node = geometries[instances[index].geometry].first_wide_node;
    let is_negative = (*state).level_ray.reciprocal_direction < vec3<f32>(0.0);
    let octant_bits = select(vec3<u32>(0u), vec3<u32>(1u, 2u, 4u), is_negative);
    (*state).octant = octant_bits.x | octant_bits.y | octant_bits.z;
    // Prepare the triangle test, and start at the BLAS root.
    (*state).tlas_stack_size = (*state).stack_size;
    let root = (*state).first_node;
    let extent = grid_extent(wide_node_at(root).origin, wide_node_at(root).exponents);
    (*state).local_shear = shear_ray((*state).level_ray, direction, max(extent, max_component(abs(origin))));
    visit_wide_node(state, 0u, t_max);
}

fn leave_instance(state: ptr<function, TraversalState>) {
    (*state).level_ray = (*state).world_ray;
    (*state).instance = NONE;
}

// Tests the eight children of a wide node and makes the hit ones pending.
fn visit_wide_node(state: ptr<function, TraversalState>, index: u32, t_max: f32) {
    let node = wide_node_at((*state).first_node + index);
    let step = grid_step(node.exponents);
    let offset = node.origin - (*state).level_ray.origin;
    let reciprocal = (*state).level_ray.reciprocal_direction;
    // Swap min and max planes to near and far by the direction's sign; a word holds four children.
    let x = select(node.planes[0], node.planes[0].zwxy, reciprocal.x < 0.0);
    let y = select(node.planes[1], node.planes[1].zwxy, reciprocal.y < 0.0);
    let z = select(node.planes[2], node.planes[2].zwxy, reciprocal.z < 0.0);
    let used_slots = node.exponents >> 24u;
    // Decode and test eight boxes.
    let t_min = (*state).t_min;
    let first_near = vec3<u32>(x.x, y.x, z.x);
    let first_far = vec3<u32>(x.z, y.z, z.z);
    let first = four_child_entry_distances(first_near, first_far, step, offset, reciprocal, t_min, t_max);
    let last_near = vec3<u32>(x.y, y.y, z.y);
    let last_far = vec3<u32>(x.w, y.w, z.w);
    let last = four_child_entry_distances(last_near, last_far, step, offset, reciprocal, t_min, t_max);
    // Collect the slots in use that are hit, and the least entry distance.
    let first_used = vec4<u32>(1u, 2u, 4u, 8u) & vec4<u32>(used_slots);
    let first_hits = select(vec4<u32>(0u), first_used, first != vec4<f32>(NO_ENTRY));
    let last_used = vec4<u32>(16u, 32u, 64u, 128u) & vec4<u32>(used_slots);
    let last_hits = select(vec4<u32>(0u), last_used, last != vec4<f32>(NO_ENTRY));
    let entry_distances = min(
        select(vec4<f32>(F32_MAX), first, first_hits != vec4<u32>(0u)),
        select(vec4<f32>(F32_MAX), last, last_hits != vec4<u32>(0u)),
    );
    let both = first_hits | last_hits;
    // Make them pending, permuted to visit order.
    (*state).wide_node_index = index;
    (*state).pending_children = slots_in_visit_order((both.x | both.y) | (both.z | both.w), (*state).octant);
    let nearest = min(entry_distances.xy, entry_distances.zw);
    (*state).nearest_pending_t = min(nearest.x, nearest.y);
}

// Distance at which the ray enters each of four children's boxes, rounded down; NO_ENTRY for a missed box.
fn four_child_entry_distances(
    near: vec3<u32>,
    far: vec3<u32>,
    step: vec3<f32>,
    offset: vec3<f32>,
    reciprocal: vec3<f32>,
    t_min: f32,
    t_max: f32,
) -> vec4<f32> {
    // Distances to the near and far planes per axis; entry is their maximum, exit their minimum.
    let near_x = (unpack_bytes(near.x) * step.x + offset.x) * reciprocal.x;
    let near_y = (unpack_bytes(near.y) * step.y + offset.y) * reciprocal.y;
    let near_z = (unpack_bytes(near.z) * step.z + offset.z) * reciprocal.z;
    let far_x = (unpack_bytes(far.x) * step.x + offset.x) * reciprocal.x;
    let far_y = (unpack_bytes(far.y) * step.y + offset.y) * reciprocal.y;
    let far_z = (unpack_bytes(far.z) * step.z + offset.z) * reciprocal.z;
    let t_near = max(max(near_x, near_y), max(near_z, vec4<f32>(t_min))) * BOX_ENTRY_SCALE;
    let t_far = min(min(far_x, far_y), min(far_z, vec4<f32>(t_max)));
    return select(vec4<f32>(NO_ENTRY), t_near, t_near <= t_far);
}

fn unpack_bytes(word: u32) -> vec4<f32> {
    return vec4<f32>((vec4<u32>(word) >> vec4<u32>(0u, 8u, 16u, 24u)) & vec4<u32>(255u));
}

// Greatest absolute coordinate of a node's grid, local units.
fn grid_extent(origin: vec3<f32>, exponents: u32) -> f32 {
    let greatest = origin + grid_step(exponents) * 255.0;
    return max(max_component(abs(origin)), max_component(abs(greatest)));
}

// The grid step along each axis (a power of two, local units).
fn grid_step(exponents: u32) -> vec3<f32> {
    return bitcast<vec3<f32>>(((vec3<u32>(exponents) >> vec3<u32>(0u, 8u, 16u)) & vec3<u32>(255u)) << vec3<u32>(23u));
}

// Advances the BLAS traversal by one step: returns a leaf if one was reached, else 0 after popping, descending or
// leaving the instance.
fn step_blas(state: ptr<function, TraversalState>, t_max: f32) -> u32 {
    // No pending child: leave the instance, or pop an ancestor with pending children.
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
    // Take the next child in visit order.
    let slot = firstTrailingBit((*state).pending_children) ^ (*state).octant;
    (*state).pending_children &= (*state).pending_children - 1u;
    let child = wide_child_at((*state).first_node + (*state).wide_node_index, slot);
    // Leaf.
    if primitive_count(child) > 0u {
        return child;
    }
    // Push the pending siblings, and descend.
    if (*state).pending_children != 0u {
        let distance_bits = bitcast<u32>((*state).nearest_pending_t) & ~PENDING_CHILDREN_MASK;
        let siblings = vec2<u32>((*state).wide_node_index, distance_bits | (*state).pending_children);
        (*state).stack[(*state).stack_size] = siblings;
        (*state).stack_size += 1u;
    }
    visit_wide_node(state, child, t_max);
    return 0u;
}

// Permutes a slot mask to visit order: bit i of the result is bit `i ^ octant`.
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
