// Both levels along escape indices, in one fixed order, without a stack. Twin of src/trace/kernel/rope.rs: see there.

// Where a ray is on its way through the two levels.
struct Traversal {
    // The ray in world space, and in the space of the level that it is in.
    world: SlabRay,
    level: SlabRay,
    // The ray in the space of the instance that it is in, if any.
    shear: ShearRay,
    direction: vec3<f32>,
    t_min: f32,
    ray_mask: u32,
    // Next node of the level, relative to its first, or NONE at its end.
    index: u32,
    // NONE in the top level.
    instance: u32,
    // Where to go on in the top level after the instance.
    resume: u32,
    first_node: u32,
    first_triangle: u32,
    flags: u32,
}

// Order is one and the same, whatever is wished.
fn traversal(ray: Ray, ray_mask: u32, near_first: bool) -> Traversal {
    var t: Traversal;
    t.world = slab_ray(ray.origin, ray.direction);
    t.level = t.world;
    t.direction = ray.direction;
    t.t_min = ray.t_min;
    t.ray_mask = ray_mask;
    // A hierarchy of nothing is absent or zero, and no escape index leads back to node 0.
    t.index = select(0u, NONE, tlas_nodes[0].escape_index == 0u);
    t.instance = NONE;
    t.resume = NONE;
    return t;
}

// Goes on to the next leaf of triangles whose box the ray meets up to `t_max`; 0 if there is none.
fn next_leaf(t: ptr<function, Traversal>, t_max: f32) -> u32 {
    loop {
        if (*t).index == NONE {
            if (*t).instance == NONE {
                return 0u;
            }
            leave_instance(t);
            continue;
        }
        let in_instance = (*t).instance != NONE;
        var node: Node;
        if in_instance {
            node = blas_node_at((*t).first_node + (*t).index);
        } else {
            node = tlas_nodes[(*t).index];
        }
        if !meets_box((*t).level, (*t).t_min, t_max, node.min, node.max) {
            (*t).index = node.escape_index;
        } else if node.primitives == 0u {
            (*t).index += 1u;
        } else {
            (*t).index = node.escape_index;
            if in_instance {
                return node.primitives;
            }
            enter_instance(t, leaf_first(node.primitives));
        }
    }
    return 0u;
}

fn enter_instance(t: ptr<function, Traversal>, index: u32) {
    if (instances[index].mask & (*t).ray_mask) == 0u {
        return;
    }
    let origin = transform_point(instances[index].local_from_world, (*t).world.origin);
    let direction = transform_vector(instances[index].local_from_world, (*t).direction);
    (*t).first_node = instances[index].first_node;
    (*t).first_triangle = instances[index].first_triangle;
    (*t).flags = instances[index].flags;
    (*t).resume = (*t).index;
    (*t).instance = index;
    (*t).index = 0u;
    (*t).level = slab_ray(origin, direction);
    let root = blas_node_at((*t).first_node);
    let extent = max_component(max(max(abs(root.min), abs(root.max)), abs(origin)));
    (*t).shear = shear_ray(origin, direction, extent);
}

fn leave_instance(t: ptr<function, Traversal>) {
    (*t).level = (*t).world;
    (*t).index = (*t).resume;
    (*t).instance = NONE;
}
