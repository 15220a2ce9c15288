// Occlusion query: for each ray of a batch, whether it hits an opaque surface (1) or not (0); one invocation per ray.

@group(1) @binding(0) var<uniform> batch: RayBatch;
@group(1) @binding(1) var<storage, read> rays: array<RayRecord>;
@group(1) @binding(2) var<storage, read_write> is_occluded: array<u32>;

@compute @workgroup_size(64)
fn any_hits(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = batch.first + id.x;
    if id.x < batch.count {
        is_occluded[i] = select(0u, 1u, any_hit(rays[i], batch.ray_mask));
    }
}
