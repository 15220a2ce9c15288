// The sky: radiance that changes with the sine of the elevation, linearly from the horizon up to the zenith and down to
// the ground. Twin of src/trace/kernel/sky.rs.

// Polynomial coefficients in the even powers of the sine of the elevation in cosine_product_integral.
const COSINE_INTEGRAL_6: f32 = 0.012317886;
const COSINE_INTEGRAL_4: f32 = 0.00050638014;
const COSINE_INTEGRAL_2: f32 = 0.107993014;
const COSINE_INTEGRAL_0: f32 = 0.21214621;

fn sky_radiance(direction: vec3<f32>) -> vec3<f32> {
    let sine_elevation = clamp(dot3(direction, params.sky_up), -1.0, 1.0);
    return sky_gradient(max(sine_elevation, 0.0), max(-sine_elevation, 0.0));
}

// Radiance of a white diffuse surface lit by the whole sky (irradiance / pi).
fn sky_irradiance_over_pi(normal: vec3<f32>) -> vec3<f32> {
    let sine_elevation = clamp(dot3(normal, params.sky_up), -1.0, 1.0);
    return sky_gradient(cosine_product_integral(sine_elevation), cosine_product_integral(-sine_elevation));
}

// The sky as reflected by a rough surface. Approximates the specular lobe by a blend of the mirror direction and a
// cosine lobe.
fn sky_blurred(direction: vec3<f32>, roughness: f32) -> vec3<f32> {
    return mix3(sky_radiance(direction), sky_irradiance_over_pi(direction), roughness * roughness);
}

fn sky_gradient(up: f32, down: f32) -> vec3<f32> {
    let towards_zenith = (params.sky_zenith - params.sky_horizon) * up;
    let towards_ground = (params.sky_ground - params.sky_horizon) * down;
    return params.sky_horizon + (towards_zenith + towards_ground);
}

// The integral over all directions w of max(w.n, 0) max(w.up, 0) / pi with n.up = `sine_elevation`. In closed form 2 /
// (3 pi) (sqrt(1 - h^2) + h (pi - acos h)), h being that sine: h / 3 and an even function, here a Chebyshev fit to
// 4e-4.
fn cosine_product_integral(sine_elevation: f32) -> f32 {
    let square = sine_elevation * sine_elevation;
    var even = COSINE_INTEGRAL_6 * square + COSINE_INTEGRAL_4;
    even = even * square + COSINE_INTEGRAL_2;
    even = even * square + COSINE_INTEGRAL_0;
    return max(sine_elevation * (1.0 / 3.0) + even, 0.0);
}
