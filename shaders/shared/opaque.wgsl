// Stubs for material.wgsl in query includes for scenes where all is opaque; never called, they only let query.wgsl
// compile.

fn fails_alpha_test(instance: InstanceRecord, primitive: u32, u: f32, v: f32) -> bool {
    return false;
}

fn surface_transmittance(instance: InstanceRecord, primitive: u32, u: f32, v: f32) -> vec3<f32> {
    return vec3<f32>(0.0);
}
