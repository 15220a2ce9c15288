// The two-level traversal and its three queries. Twin of src/trace/kernel/traverse.rs: see there.

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

fn traversal(ray: Ray, ray_mask: u32) -> Traversal {
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

fn leaf_first(primitives: u32) -> u32 {
    return primitives & 0x0fffffffu;
}

fn leaf_count(primitives: u32) -> u32 {
    return primitives >> 28u;
}

// The closest hit in [t_min, t_max]; of hits at equal t the one of the lower instance, then the lower primitive.
fn closest_hit(ray: Ray, ray_mask: u32) -> Hit {
    var hit = Hit(ray.t_max, 0.0, 0.0, NONE, NONE, NONE, 0u, 0u);
    var t = traversal(ray, ray_mask);
    loop {
        let leaf = next_leaf(&t, hit.t);
        if leaf == 0u {
            break;
        }
        let first = t.first_triangle + leaf_first(leaf);
        let end = first + leaf_count(leaf);
        for (var i = first; i < end; i++) {
            let triangle = triangle_at(i);
            let crossing = cross_triangle(t.shear, triangle);
            if !crossing.is_hit || crossing.t < ray.t_min || !is_closer(crossing.t, t.instance, triangle.primitive, hit) {
                continue;
            }
            if NEEDS_CULLING && crossing.back && (t.flags & INSTANCE_CULL_BACK) != 0u {
                continue;
            }
            if NEEDS_ALPHA_MASK && (t.flags & INSTANCE_ALPHA_MASK) != 0u {
                if is_hole(instances[t.instance], triangle, crossing.u, crossing.v) {
                    continue;
                }
            }
            let back = select(0u, 1u, crossing.back);
            hit = Hit(crossing.t, crossing.u, crossing.v, t.instance, triangle.primitive, i, back, 0u);
        }
    }
    if hit.instance == NONE {
        hit.t = F32_MAX;
    }
    return hit;
}

fn is_closer(t: f32, instance: u32, primitive: u32, hit: Hit) -> bool {
    if t != hit.t {
        return t < hit.t;
    }
    return instance < hit.instance || (instance == hit.instance && primitive < hit.primitive);
}

// How much light gets through between t_min and t_max.
fn transmittance(ray: Ray, ray_mask: u32) -> vec3<f32> {
    var light = vec3<f32>(1.0);
    var t = traversal(ray, ray_mask);
    loop {
        let leaf = next_leaf(&t, ray.t_max);
        if leaf == 0u {
            break;
        }
        let first = t.first_triangle + leaf_first(leaf);
        let end = first + leaf_count(leaf);
        for (var i = first; i < end; i++) {
            let triangle = triangle_at(i);
            let crossing = cross_triangle(t.shear, triangle);
            if crossing.is_hit && crossing.t >= ray.t_min && crossing.t <= ray.t_max {
                light *= passes_crossing(t.instance, t.flags, triangle, crossing);
                if max_component(light) <= 0.0 {
                    return vec3<f32>(0.0);
                }
            }
        }
    }
    return light;
}

// Whether anything that lets no light through lies between t_min and t_max.
fn any_hit(ray: Ray, ray_mask: u32) -> bool {
    var t = traversal(ray, ray_mask);
    loop {
        let leaf = next_leaf(&t, ray.t_max);
        if leaf == 0u {
            break;
        }
        let first = t.first_triangle + leaf_first(leaf);
        let end = first + leaf_count(leaf);
        for (var i = first; i < end; i++) {
            let triangle = triangle_at(i);
            let crossing = cross_triangle(t.shear, triangle);
            if crossing.is_hit && crossing.t >= ray.t_min && crossing.t <= ray.t_max {
                if max_component(passes_crossing(t.instance, t.flags, triangle, crossing)) <= 0.0 {
                    return true;
                }
            }
        }
    }
    return false;
}

fn passes_crossing(instance: u32, flags: u32, triangle: Triangle, crossing: Crossing) -> vec3<f32> {
    if (NEEDS_ALPHA_MASK || NEEDS_BLEND || NEEDS_REFRACTION) && (flags & INSTANCE_TRANSLUCENT) != 0u {
        return passes(instances[instance], triangle, crossing.u, crossing.v);
    }
    return vec3<f32>(0.0);
}
