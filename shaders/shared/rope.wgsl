// Stackless two-level traversal along escape indices, in depth-first order (paper, section 3). Twin of
// src/trace/kernel/rope.rs: see there.

// State of a two-level traversal.
struct TraversalState {
    // Slab-test operands in world space, and in the current space: world in the TLAS, local in an instance.
    world_ray: SlabRay,
    level_ray: SlabRay,
    // Triangle-test operands in the instance's local space; unset in the TLAS.
    local_shear: ShearRay,
    direction: vec3<f32>,
    t_min: f32,
    ray_mask: u32,
    // Next node of the current level, relative to its first, or NONE at the end of the level.
    node_index: u32,
    // The current instance, or NONE in the TLAS.
    instance: u32,
    // TLAS node to continue at after the current instance.
    tlas_resume_index: u32,
    first_node: u32,
    first_triangle: u32,
    flags: u32,
}

// The rope traversal has one order; `order` is ignored.
fn begin_traversal(ray: RayRecord, ray_mask: u32, order: u32) -> TraversalState {
    var state: TraversalState;
    state.world_ray = slab_ray(ray.origin, ray.direction);
    state.level_ray = state.world_ray;
    state.direction = ray.direction;
    state.t_min = ray.t_min;
    state.ray_mask = ray_mask;
    // An empty TLAS has no nodes, or a zeroed root (escape index 0, which no valid node has).
    state.node_index = select(0u, NONE, tlas_nodes[0].escape_index == 0u);
    state.instance = NONE;
    state.tlas_resume_index = NONE;
    return state;
}

// Advances to the next BLAS leaf whose box the ray intersects within [t_min, t_max]; 0 at the end.
fn next_leaf(state: ptr<function, TraversalState>, t_max: f32) -> u32 {
    loop {
        // End of the level: return to the TLAS, or finish.
        if (*state).node_index == NONE {
            if (*state).instance == NONE {
                return 0u;
            }
            leave_instance(state);
            continue;
        }
        // Fetch the node of the current level.
        let in_instance = (*state).instance != NONE;
        var node: Node;
        if in_instance {
            node = blas_node_at((*state).first_node + (*state).node_index);
        } else {
            node = tlas_nodes[(*state).node_index];
        }
        // Miss: follow the escape index. Inner node: its first child follows. Leaf: continue behind it.
        if !intersects_box((*state).level_ray, (*state).t_min, t_max, node.min, node.max) {
            (*state).node_index = node.escape_index;
        } else if node.primitives == 0u {
            (*state).node_index += 1u;
        } else {
            (*state).node_index = node.escape_index;
            // Return the triangles of a BLAS leaf; enter the instance of a TLAS leaf.
            if in_instance {
                return node.primitives;
            }
            enter_instance(state, first_primitive(node.primitives));
        }
    }
    return 0u;
}

fn enter_instance(state: ptr<function, TraversalState>, index: u32) {
    // Hidden by the instance's mask?
    if (instances[index].mask & (*state).ray_mask) == 0u {
        return;
    }
    // Transform the ray.
    let origin = transform_point(instances[index].local_from_world, (*state).world_ray.origin);
    let direction = transform_vector(instances[index].local_from_world, (*state).direction);
    (*state).first_node = instances[index].first_node;
    (*state).first_triangle = instances[index].first_triangle;
    (*state).flags = instances[index].flags;
    // Save where the TLAS continues, and start at the BLAS root.
    (*state).tlas_resume_index = (*state).node_index;
    (*state).instance = index;
    (*state).node_index = 0u;
    (*state).level_ray = slab_ray(origin, direction);
    // Prepare the triangle test.
    let root = blas_node_at((*state).first_node);
    let extent = max_component(max(max(abs(root.min), abs(root.max)), abs(origin)));
    (*state).local_shear = shear_ray((*state).level_ray, direction, extent);
}

fn leave_instance(state: ptr<function, TraversalState>) {
    (*state).level_ray = (*state).world_ray;
    (*state).node_index = (*state).tlas_resume_index;
    (*state).instance = NONE;
}
