// The closest hit of each ray of a batch; one invocation per ray.

@group(1) @binding(0) var<uniform> batch: RayBatch;
@group(1) @binding(1) var<storage, read> rays: array<RayRecord>;
@group(1) @binding(2) var<storage, read_write> hits: array<HitRecord>;

@compute @workgroup_size(64)
fn closest_hits(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = batch.first + id.x;
    if id.x < batch.count {
        hits[i] = closest_hit(rays[i], batch.ray_mask);
    }
}
