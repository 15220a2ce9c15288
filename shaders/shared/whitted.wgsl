// Stub: colours what the primary ray hits.

struct Pixel {
    color: vec4<f32>,
    normal: vec3<f32>,
    depth: f32,
    ids: vec4<u32>,
}

fn render_pixel(x: u32, y: u32) -> Pixel {
    let sx = (f32(x) + 0.5) / f32(params.width) * 2.0 - 1.0;
    let sy = 1.0 - (f32(y) + 0.5) / f32(params.height) * 2.0;
    let offset = params.right * sx + params.up * sy;
    var ray = Ray(params.eye, 0.0, params.forward + offset, F32_MAX);
    if params.orthographic != 0u {
        ray = Ray(params.eye + offset, 0.0, params.forward, F32_MAX);
    }
    let hit = closest_hit(ray, params.ray_mask);
    if hit.instance == NONE {
        return Pixel(vec4<f32>(0.0), vec3<f32>(0.0), F32_MAX, vec4<u32>(NONE, 1u, NONE, NONE));
    }
    let behind = transmittance(Ray(ray.origin, hit.t * 1.001, ray.direction, F32_MAX), params.ray_mask);
    let color = vec3<f32>(hit.u, hit.v, 1.0 - hit.u - hit.v) * (0.5 + 0.5 * behind);
    let node = instances[hit.instance].node;
    return Pixel(vec4<f32>(color, 1.0), vec3<f32>(0.0), hit.t, vec4<u32>(node, hit.primitive, hit.instance));
}
