// Camera rays, through pixel centres. Twin of src/trace/kernel/camera.rs.

// The primary ray of a pixel; (0, 0) is the upper left one. Its direction is a unit vector.
fn camera_ray(x: u32, y: u32) -> RayRecord {
    let ndc_x = (f32(x) + 0.5) / f32(params.width) * 2.0 - 1.0;
    let ndc_y = 1.0 - (f32(y) + 0.5) / f32(params.height) * 2.0;
    let in_plane = params.right * ndc_x + params.up * ndc_y;
    if params.orthographic != 0u {
        return RayRecord(params.eye + in_plane, params.near, params.forward, F32_MAX);
    }
    return RayRecord(params.eye, params.near, normalize3(params.forward + in_plane), F32_MAX);
}
