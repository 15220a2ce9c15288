// The sky: radiance that changes with the sine of the elevation, linearly from the horizon up to the zenith and down to the
// ground. Twin of src/trace/kernel/sky.rs.

// Of the even powers of the height in cosine_overlap.
const COSINE_INTEGRAL_6: f32 = 0.012317886;
const COSINE_INTEGRAL_4: f32 = 0.00050638014;
const COSINE_INTEGRAL_2: f32 = 0.107993014;
const COSINE_INTEGRAL_0: f32 = 0.21214621;

fn sky_radiance(direction: vec3<f32>) -> vec3<f32> {
    let height = clamp(dot3(direction, params.sky_up), -1.0, 1.0);
    return sky_gradient(max(height, 0.0), max(-height, 0.0));
}

// What a white, matt surface reflects under the whole sky: irradiance over pi.
fn sky_irradiance_over_pi(normal: vec3<f32>) -> vec3<f32> {
    let height = clamp(dot3(normal, params.sky_up), -1.0, 1.0);
    return sky_gradient(cosine_product_integral(height), cosine_product_integral(-height));
}

// The sky as a rough surface mirrors it: between the radiance and the ambient light. Approximate: GGX is no cosine lobe.
fn sky_blurred(direction: vec3<f32>, roughness: f32) -> vec3<f32> {
    return mix3(sky_radiance(direction), sky_irradiance_over_pi(direction), roughness * roughness);
}

fn sky_gradient(up: f32, down: f32) -> vec3<f32> {
    let towards_zenith = (params.sky_zenith - params.sky_horizon) * up;
    let towards_ground = (params.sky_ground - params.sky_horizon) * down;
    return params.sky_horizon + (towards_zenith + towards_ground);
}

// The integral over all directions w of max(w.n, 0) max(w.up, 0) / pi with n.up = `height`. In closed form
// 2 / (3 pi) (sqrt(1 - h^2) + h (pi - acos h)): h / 3 and an even function, here a Chebyshev fit to 4e-4.
fn cosine_product_integral(height: f32) -> f32 {
    let square = height * height;
    let even = ((COSINE_INTEGRAL_6 * square + COSINE_INTEGRAL_4) * square + COSINE_INTEGRAL_2) * square + COSINE_INTEGRAL_0;
    return max(height * (1.0 / 3.0) + even, 0.0);
}
