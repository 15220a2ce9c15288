// Ambient visibility: for the surface in each pixel, the cosine-weighted part of the hemisphere in which nothing is hit
// within a radius. This text follows that of `ropewalk::trace::shader::Include`, which declares the scene, `RayRecord`,
// `closest_hit`, `any_hit`, `surface_at` and `offset_ray_origin`.

struct OcclusionParams {
    eye: vec3<f32>,
    width: u32,
    right: vec3<f32>,
    height: u32,
    up: vec3<f32>,
    samples: u32,
    forward: vec3<f32>,
    radius: f32,
}

@group(0) @binding(0) var<uniform> occlusion: OcclusionParams;
@group(0) @binding(1) var<storage, read_write> visibility: array<f32>;

@compute @workgroup_size(8, 8)
fn occlude(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= occlusion.width || id.y >= occlusion.height {
        return;
    }
    let pixel = id.y * occlusion.width + id.x;
    let x = (f32(id.x) + 0.5) / f32(occlusion.width) * 2.0 - 1.0;
    let y = 1.0 - (f32(id.y) + 0.5) / f32(occlusion.height) * 2.0;
    let direction = normalize3(occlusion.forward + occlusion.right * x + occlusion.up * y);

    // 1. The surface that the camera ray hits.
    let hit = closest_hit(RayRecord(occlusion.eye, 0.0, direction, F32_MAX), 0xffffffffu);
    if hit.instance == NONE {
        visibility[pixel] = 1.0;
        return;
    }
    let surface = surface_at(hit, direction);

    // 2. Rays from there, with a cosine-weighted distribution.
    var open = 0u;
    for (var i = 0u; i < occlusion.samples; i += 1u) {
        let outward = occlusion_direction(surface.normal, pixel * occlusion.samples + i);
        let ray = RayRecord(offset_ray_origin(surface, outward), 0.0, outward, occlusion.radius);
        let blocked = any_hit(ray, 0xffffffffu);
        open += select(1u, 0u, blocked);
    }
    visibility[pixel] = f32(open) / f32(occlusion.samples);
}

// A cosine-distributed direction: the normal plus a point of the unit sphere, normalized.
fn occlusion_direction(normal: vec3<f32>, index: u32) -> vec3<f32> {
    let z = 1.0 - 2.0 * occlusion_random(2u * index);
    let angle = 6.2831853 * occlusion_random(2u * index + 1u);
    let ring = sqrt(max(1.0 - z * z, 0.0));
    let sum = normal + vec3<f32>(ring * cos(angle), ring * sin(angle), z);
    // The point opposite to the normal gives the zero vector.
    return select(normal, normalize3(sum), dot3(sum, sum) > 1e-6);
}

// A pseudorandom number in [0, 1), a hash of `index` (PCG): M. Jarzynski, M. Olano, Hash Functions for GPU Rendering
// (JCGT 2020).
fn occlusion_random(index: u32) -> f32 {
    let state = index * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return f32(((word >> 22u) ^ word) >> 8u) * 5.9604645e-8;
}
