// Near children first: the top level's nodes of two children, then the bottom levels' of eight, with one short stack. Twin of
// src/trace/kernel/wide.rs: see there.

const TOP_STACK: u32 = 16u;
const TOP_LEAF: u32 = 0x80000000u;
const WIDE_STACK: u32 = 31u;
const WAITING_BITS: u32 = 255u;
const MISSED: f32 = -1.0;
const UNUSED: f32 = 0x1.fffffcp+127f;

struct Traversal {
    // The ray in world space, and in the space of the level that it is in.
    world: SlabRay,
    level: SlabRay,
    // The ray in the space of the instance that it is in, if any.
    shear: ShearRay,
    direction: vec3<f32>,
    t_min: f32,
    ray_mask: u32,
    // NONE in the top level.
    instance: u32,
    first_triangle: u32,
    flags: u32,

    // What comes next in the top level: the index of an inner node that is met, or its instance and TOP_LEAF; along escape
    // indices, the index of the next node; NONE where the stack says.
    top: u32,
    // Where the walk along escape indices ends; 0 where there is none.
    rope_end: u32,
    // How many of the top level wait.
    top_count: u32,

    // Which way the ray goes along x, y and z.
    octant: u32,
    first_node: u32,
    // The wide node whose children are visited, relative to the first; a bit for each that waits, in order; where the first begins.
    node: u32,
    waiting: u32,
    near: f32,
    // How many wait, of both levels.
    count: u32,
    // First those of the top level, as `top` has them, and where they begin. Then the wide nodes above: where the first of their
    // children begins and who waits share a word.
    stack: array<vec2<u32>, TOP_STACK + WIDE_STACK>,
}

fn traversal(ray: Ray, ray_mask: u32, near_first: bool) -> Traversal {
    var t: Traversal;
    t.world = slab_ray(ray.origin, ray.direction);
    t.level = t.world;
    t.direction = ray.direction;
    t.t_min = ray.t_min;
    t.ray_mask = ray_mask;
    t.instance = NONE;
    t.top = NONE;
    let root = tlas_nodes[0];
    // A hierarchy of nothing is absent or zero, and no escape index leads back to node 0.
    if root.escape_index != 0u {
        if !near_first {
            t.top = 0u;
            t.rope_end = NONE;
        } else if meet_top(t.level, root, ray.t_min, ray.t_max) != MISSED {
            t.top = top_of(0u, root);
        }
    }
    return t;
}

// Goes on to the next leaf of triangles whose box the ray meets up to `t_max`; 0 if there is none.
fn next_leaf(t: ptr<function, Traversal>, t_max: f32) -> u32 {
    loop {
        if (*t).instance != NONE {
            let leaf = step_wide(t, t_max);
            if leaf != 0u {
                return leaf;
            }
        } else if !step_top(t, t_max) {
            return 0u;
        }
    }
    return 0u;
}

// One step in the top level; false at its end.
fn step_top(t: ptr<function, Traversal>, t_max: f32) -> bool {
    if (*t).rope_end != 0u {
        step_rope(t, t_max);
    } else if (*t).top != NONE {
        open_top(t, t_max);
    } else if (*t).count > 0u {
        (*t).count -= 1u;
        let waiting = (*t).stack[(*t).count];
        if bitcast<f32>(waiting.y) <= t_max {
            (*t).top = waiting.x;
        }
    } else {
        return false;
    }
    return true;
}

// Visits the next node along the escape indices.
fn step_rope(t: ptr<function, Traversal>, t_max: f32) {
    if (*t).top == (*t).rope_end {
        (*t).rope_end = 0u;
        (*t).top = NONE;
        return;
    }
    let node = tlas_nodes[(*t).top];
    if !meets_box((*t).level, (*t).t_min, t_max, node.min, node.max) {
        (*t).top = node.escape_index;
    } else if node.primitives == 0u {
        (*t).top += 1u;
    } else {
        (*t).top = node.escape_index;
        enter_instance(t, leaf_first(node.primitives), t_max);
    }
}

// Visits what is met.
fn open_top(t: ptr<function, Traversal>, t_max: f32) {
    if ((*t).top & TOP_LEAF) != 0u {
        let instance = (*t).top & ~TOP_LEAF;
        (*t).top = NONE;
        enter_instance(t, instance, t_max);
        return;
    }
    let left = (*t).top + 1u;
    if (*t).count == TOP_STACK {
        (*t).rope_end = tlas_nodes[(*t).top].escape_index;
        (*t).top = left;
        return;
    }
    let left_node = tlas_nodes[left];
    let right = left_node.escape_index;
    let right_node = tlas_nodes[right];
    let left_near = meet_top((*t).level, left_node, (*t).t_min, t_max);
    let right_near = meet_top((*t).level, right_node, (*t).t_min, t_max);
    let left_top = top_of(left, left_node);
    let right_top = top_of(right, right_node);
    let right_first = left_near == MISSED || (right_near != MISSED && right_near < left_near);
    if left_near != MISSED && right_near != MISSED {
        let far = select(
            vec2<u32>(right_top, bitcast<u32>(right_near)),
            vec2<u32>(left_top, bitcast<u32>(left_near)),
            right_first,
        );
        (*t).stack[(*t).count] = far;
        (*t).count += 1u;
    }
    (*t).top = select(left_top, right_top, right_first);
    if left_near == MISSED && right_near == MISSED {
        (*t).top = NONE;
    }
}

// A node of the top level as `top` has those that are met.
fn top_of(index: u32, node: Node) -> u32 {
    return select(leaf_first(node.primitives) | TOP_LEAF, index, node.primitives == 0u);
}

// Where the ray enters a node's box, rounded down; MISSED if it does not, or there is nothing in it.
fn meet_top(ray: SlabRay, node: Node, t_min: f32, t_max: f32) -> f32 {
    let a = (node.min - ray.origin) * ray.reciprocal;
    let b = (node.max - ray.origin) * ray.reciprocal;
    let near = min(a, b);
    let far = max(a, b);
    let t_near = max(max(near.x, near.y), max(near.z, t_min)) * BOX_SLACK;
    let t_far = min(min(far.x, far.y), min(far.z, t_max));
    return select(MISSED, t_near, t_near <= t_far && node.min.x < UNUSED);
}

fn enter_instance(t: ptr<function, Traversal>, index: u32, t_max: f32) {
    if (instances[index].mask & (*t).ray_mask) == 0u {
        return;
    }
    let origin = transform_point(instances[index].local_from_world, (*t).world.origin);
    let direction = transform_vector(instances[index].local_from_world, (*t).direction);
    (*t).instance = index;
    (*t).first_triangle = instances[index].first_triangle;
    (*t).flags = instances[index].flags;
    (*t).level = slab_ray(origin, direction);
    (*t).first_node = geometries[instances[index].geometry].first_wide_node;
    let backward = select(vec3<u32>(0u), vec3<u32>(1u, 2u, 4u), (*t).level.reciprocal < vec3<f32>(0.0));
    (*t).octant = backward.x | backward.y | backward.z;
    (*t).top_count = (*t).count;
    let least = wide_node_at((*t).first_node).origin;
    let greatest = least + wide_steps(wide_node_at((*t).first_node).exponents) * 255.0;
    let extent = max(max_component(abs(least)), max_component(abs(greatest)));
    (*t).shear = shear_ray(origin, direction, max(extent, max_component(abs(origin))));
    open_wide(t, 0u, t_max);
}

fn leave_instance(t: ptr<function, Traversal>) {
    (*t).level = (*t).world;
    (*t).instance = NONE;
}

// Visits a wide node: finds out which of its children are met.
fn open_wide(t: ptr<function, Traversal>, index: u32, t_max: f32) {
    let node = wide_node_at((*t).first_node + index);
    let steps = wide_steps(node.exponents);
    let offset = node.origin - (*t).level.origin;
    let reciprocal = (*t).level.reciprocal;
    // Least and greatest planes to near and far ones, four children a word.
    let x = select(node.planes[0], node.planes[0].zwxy, reciprocal.x < 0.0);
    let y = select(node.planes[1], node.planes[1].zwxy, reciprocal.y < 0.0);
    let z = select(node.planes[2], node.planes[2].zwxy, reciprocal.z < 0.0);
    let used = node.exponents >> 24u;
    let first = meet_four(vec3<u32>(x.x, y.x, z.x), vec3<u32>(x.z, y.z, z.z), steps, offset, reciprocal, (*t).t_min, t_max);
    let last = meet_four(vec3<u32>(x.y, y.y, z.y), vec3<u32>(x.w, y.w, z.w), steps, offset, reciprocal, (*t).t_min, t_max);
    let first_met = select(vec4<u32>(0u), vec4<u32>(1u, 2u, 4u, 8u) & vec4<u32>(used), first != vec4<f32>(MISSED));
    let last_met = select(vec4<u32>(0u), vec4<u32>(16u, 32u, 64u, 128u) & vec4<u32>(used), last != vec4<f32>(MISSED));
    let nears = min(
        select(vec4<f32>(F32_MAX), first, first_met != vec4<u32>(0u)),
        select(vec4<f32>(F32_MAX), last, last_met != vec4<u32>(0u)),
    );
    let both = first_met | last_met;
    (*t).node = index;
    (*t).waiting = in_order((both.x | both.y) | (both.z | both.w), (*t).octant);
    (*t).near = min(min(nears.x, nears.y), min(nears.z, nears.w));
}

// Where the ray enters each of four children's boxes, rounded down; MISSED where it does not.
fn meet_four(
    near: vec3<u32>,
    far: vec3<u32>,
    steps: vec3<f32>,
    offset: vec3<f32>,
    reciprocal: vec3<f32>,
    t_min: f32,
    t_max: f32,
) -> vec4<f32> {
    let near_x = (bytes_of(near.x) * steps.x + offset.x) * reciprocal.x;
    let near_y = (bytes_of(near.y) * steps.y + offset.y) * reciprocal.y;
    let near_z = (bytes_of(near.z) * steps.z + offset.z) * reciprocal.z;
    let far_x = (bytes_of(far.x) * steps.x + offset.x) * reciprocal.x;
    let far_y = (bytes_of(far.y) * steps.y + offset.y) * reciprocal.y;
    let far_z = (bytes_of(far.z) * steps.z + offset.z) * reciprocal.z;
    let t_near = max(max(near_x, near_y), max(near_z, vec4<f32>(t_min))) * BOX_SLACK;
    let t_far = min(min(far_x, far_y), min(far_z, vec4<f32>(t_max)));
    return select(vec4<f32>(MISSED), t_near, t_near <= t_far);
}

fn bytes_of(word: u32) -> vec4<f32> {
    return vec4<f32>((vec4<u32>(word) >> vec4<u32>(0u, 8u, 16u, 24u)) & vec4<u32>(255u));
}

// The lengths of a node's steps.
fn wide_steps(exponents: u32) -> vec3<f32> {
    return bitcast<vec3<f32>>(((vec3<u32>(exponents) >> vec3<u32>(0u, 8u, 16u)) & vec3<u32>(255u)) << vec3<u32>(23u));
}

// The next leaf below the wide nodes that wait, or 0: then there is none, or more to be done.
fn step_wide(t: ptr<function, Traversal>, t_max: f32) -> u32 {
    if (*t).waiting == 0u {
        if (*t).count == (*t).top_count {
            leave_instance(t);
            return 0u;
        }
        (*t).count -= 1u;
        let entry = (*t).stack[(*t).count];
        (*t).near = bitcast<f32>(entry.y & ~WAITING_BITS);
        if (*t).near <= t_max {
            (*t).node = entry.x;
            (*t).waiting = entry.y & WAITING_BITS;
        }
        return 0u;
    }
    let slot = firstTrailingBit((*t).waiting) ^ (*t).octant;
    (*t).waiting &= (*t).waiting - 1u;
    let child = wide_child_at((*t).first_node + (*t).node, slot);
    if leaf_count(child) > 0u {
        return child;
    }
    if (*t).waiting != 0u {
        (*t).stack[(*t).count] = vec2<u32>((*t).node, (bitcast<u32>((*t).near) & ~WAITING_BITS) | (*t).waiting);
        (*t).count += 1u;
    }
    open_wide(t, child, t_max);
    return 0u;
}

// Bits by slot to bits by order: bit i is that of slot i ^ octant.
fn in_order(bits: u32, octant: u32) -> u32 {
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
