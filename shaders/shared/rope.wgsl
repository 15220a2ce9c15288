// Both levels along escape indices, in one fixed order, without a stack. Twin of src/trace/kernel/rope.rs: see there.

// Where a ray is on its way through the two levels.
struct TraversalState {
    // The ray in world space, and in the space of the level that it is in.
    world_ray: SlabRay,
    level_ray: SlabRay,
    // The ray in the space of the instance that it is in, if any.
    local_shear: ShearRay,
    direction: vec3<f32>,
    t_min: f32,
    ray_mask: u32,
    // Next node of the level, relative to its first, or NONE at its end.
    node_index: u32,
    // NONE in the top level.
    instance: u32,
    // Where to go on in the top level after the instance.
    tlas_resume_index: u32,
    first_node: u32,
    first_triangle: u32,
    flags: u32,
}

// Order is one and the same, whatever is wished.
fn begin_traversal(ray: RayRecord, ray_mask: u32, order: u32) -> TraversalState {
    var state: TraversalState;
    state.world_ray = slab_ray(ray.origin, ray.direction);
    state.level_ray = state.world_ray;
    state.direction = ray.direction;
    state.t_min = ray.t_min;
    state.ray_mask = ray_mask;
    // A hierarchy of nothing is absent or zero, and no escape index leads back to node 0.
    state.node_index = select(0u, NONE, tlas_nodes[0].escape_index == 0u);
    state.instance = NONE;
    state.tlas_resume_index = NONE;
    return state;
}

// Goes on to the next leaf of triangles whose box the ray meets up to `t_max`; 0 if there is none.
fn next_leaf(state: ptr<function, TraversalState>, t_max: f32) -> u32 {
    loop {
        if (*state).node_index == NONE {
            if (*state).instance == NONE {
                return 0u;
            }
            leave_instance(state);
            continue;
        }
        let in_instance = (*state).instance != NONE;
        var node: Node;
        if in_instance {
            node = blas_node_at((*state).first_node + (*state).node_index);
        } else {
            node = tlas_nodes[(*state).node_index];
        }
        if !intersects_box((*state).level_ray, (*state).t_min, t_max, node.min, node.max) {
            (*state).node_index = node.escape_index;
        } else if node.primitives == 0u {
            (*state).node_index += 1u;
        } else {
            (*state).node_index = node.escape_index;
            if in_instance {
                return node.primitives;
            }
            enter_instance(state, first_primitive(node.primitives));
        }
    }
    return 0u;
}

fn enter_instance(state: ptr<function, TraversalState>, index: u32) {
    if (instances[index].mask & (*state).ray_mask) == 0u {
        return;
    }
    let origin = transform_point(instances[index].local_from_world, (*state).world_ray.origin);
    let direction = transform_vector(instances[index].local_from_world, (*state).direction);
    (*state).first_node = instances[index].first_node;
    (*state).first_triangle = instances[index].first_triangle;
    (*state).flags = instances[index].flags;
    (*state).tlas_resume_index = (*state).node_index;
    (*state).instance = index;
    (*state).node_index = 0u;
    (*state).level_ray = slab_ray(origin, direction);
    let root = blas_node_at((*state).first_node);
    let extent = max_component(max(max(abs(root.min), abs(root.max)), abs(origin)));
    (*state).local_shear = shear_ray(origin, direction, extent);
}

fn leave_instance(state: ptr<function, TraversalState>) {
    (*state).level_ray = (*state).world_ray;
    (*state).node_index = (*state).tlas_resume_index;
    (*state).instance = NONE;
}
