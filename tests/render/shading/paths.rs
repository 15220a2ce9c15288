//! Reflection and refraction compared with closed forms and with an analytic ray tracer in f64.

use glam::{DAffine3, DVec3, Vec3, Vec4};
use ropewalk::graph::{AlphaMode, WallKind};
use ropewalk::{Camera, DeviceChoice, Geometry, Material, Renderer, RendererOptions, Scene, Sky, View};

use super::scenes::{at, black, cube, front, middle, put, render, sphere, square};

#[test]
fn two_mirrors_show_each_other_to_the_depth_asked_for() {
    let mut scene = Scene::new();
    let glowing_mirror = Material { emissive: Vec3::ONE, ..Material::mirror(Vec3::splat(0.5)) };
    put(&mut scene, square(1.0), glowing_mirror.clone(), at(0.0, 0.0, -1.0));
    let facing_back = DAffine3::from_translation(DVec3::Z) * DAffine3::from_rotation_y(std::f64::consts::PI);
    put(&mut scene, square(1.0), glowing_mirror, facing_back);
    for depth in (0..9).chain([100, 1000, u32::MAX]) {
        let camera = Camera::orthographic(0.3, 0.3);
        let mut view = View::look_at(DVec3::ZERO, DVec3::NEG_Z, DVec3::Y, camera, 4, 4);
        view.sky = black();
        (view.max_depth, view.min_throughput) = (depth, 0.0);
        // 1 + 1/2 + 1/4 and so on: as many mirrors as rays.
        let expected = 2.0 - 0.5f32.powi(depth.min(1000) as i32);
        for color in &render(&mut scene, &view).color {
            assert!((color[0] - expected).abs() < 1e-6, "depth {depth}: {}, expected {expected}", color[0]);
        }
    }
}

/// Where surfaces send light three ways, or two, each again and again, what is pending stays bounded: no pixel is
/// limited. A lower limit of throughput may need more, and says so.
#[test]
fn rays_that_branch_at_any_depth_stay_few() {
    let blended = Material { alpha_mode: AlphaMode::Blend, ..Material::glass(1.5) };
    for (material, limited) in [(Material::glass(1.5), true), (blended, true)] {
        let mut scene = Scene::new();
        for layer in 0..40 {
            let tint = Vec4::new(1.0, 0.9, 0.8, 0.5);
            let pane = Material { base_color: tint, wall: WallKind::Thin, ior: 9.0, ..material.clone() };
            put(&mut scene, square(2.0), pane, at(0.0, 0.0, f64::from(layer) * 0.1));
        }
        for (min_throughput, limited) in [(View::DEFAULT_MIN_THROUGHPUT, false), (1e-8, limited)] {
            let view = View { max_depth: 1000, max_rays: 1_000_000, min_throughput, ..front(1, black()) };
            let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu)).unwrap();
            let frame = renderer.render(&mut scene, &view).unwrap();
            assert_eq!(frame.limited_pixels().unwrap() > 0, limited, "{min_throughput}");
        }
    }
}

#[test]
fn blended_layers_cover_what_is_behind() {
    let mut scene = Scene::new();
    let layer = Material {
        base_color: Vec4::new(1.0, 1.0, 1.0, 0.25),
        alpha_mode: AlphaMode::Blend,
        unlit: true,
        ..Material::default()
    };
    for count in 1..=5 {
        put(&mut scene, square(1.0), layer.clone(), at(0.0, 0.0, f64::from(count) * 1e-3));
        let expected = 1.0 - 0.75f32.powi(count);
        let found = middle(&mut scene, black()).x;
        assert!((found - expected).abs() < 1e-6, "{count} layers: {found}, expected {expected}");
    }
}

#[test]
fn panes_do_not_bend_light() {
    let mut scene = Scene::new();
    let pane = Material { base_color: Vec4::new(0.5, 1.0, 0.25, 1.0), ..Material::glass(1.5) };
    put(&mut scene, square(2.0), pane, DAffine3::from_rotation_y(1.0));
    let sky = Sky { up: Vec3::Z, zenith: Vec3::ZERO, horizon: Vec3::ZERO, ground: Vec3::ONE };
    // From both sides: straight ahead there is 1, tinted once, less one reflection, which sees the sky -cos(2) below
    // its horizon.
    for (eye, up) in [(DVec3::Z * 4.0, Vec3::Z), (DVec3::Z * -4.0, Vec3::NEG_Z)] {
        let camera = Camera::orthographic(0.1, 0.1);
        let mut view = View::look_at(eye, DVec3::ZERO, DVec3::Y, camera, 1, 1);
        view.sky = Sky { up, ..sky };
        let expected = Vec3::new(0.5, 1.0, 0.25) * (1.0 - fresnel(1.0f64.cos(), 1.0 / 1.5)) as f32;
        let mirrored = (-2.0f64.cos() * fresnel(1.0f64.cos(), 1.0 / 1.5)) as f32;
        let found = Vec3::from_slice(&render(&mut scene, &view).color[0]);
        assert!((found - expected - mirrored).abs().max_element() < 1e-5, "{found}, expected {expected}");
    }
}

#[test]
fn glass_cubes_shift_what_is_behind_without_turning_it() {
    // A ray through two parallel faces of glass goes on in its direction: its colour is the sky's there, less two
    // reflections.
    let mut scene = Scene::new();
    put(&mut scene, cube(), Material::glass(1.5), DAffine3::from_rotation_y(0.3));
    let sky = Sky { up: Vec3::Z, zenith: Vec3::ZERO, horizon: Vec3::ZERO, ground: Vec3::ONE };
    let mut view = front(1, sky);
    view.max_depth = 2;
    let found = f64::from(render(&mut scene, &view).color[0][0]);
    let reflectance = fresnel(0.3f64.cos(), 1.0 / 1.5);
    // The first reflection sees the sky above, the light reflected inside leaves sideways: depth 2 sees the sky in
    // place of it.
    let straight = (1.0 - reflectance) * (1.0 - reflectance);
    assert!(found >= straight - 1e-5, "{found}, at least {straight}");
    assert!(found < straight + 2.0 * reflectance, "{found}, {straight} and a little");
}

/// Several geometries in one.
fn together(parts: &[Geometry]) -> Geometry {
    let (mut positions, mut indices) = (Vec::new(), Vec::new());
    for part in parts {
        let first = positions.len() as u32;
        positions.extend_from_slice(&part.positions);
        indices.extend(part.indices.iter().map(|triangle| triangle.map(|vertex| first + vertex)));
    }
    Geometry::new(positions, indices)
}

/// A hollow bulb of thin glass hardly bends light, a ball does: 33 degrees at 0.7 of its radius. The sky is black
/// straight ahead, and white to both sides.
#[test]
fn a_bulb_is_hollow_and_a_ball_is_solid() {
    let scaled = |scale: f32| {
        let ball = sphere(6);
        Geometry::new(ball.positions.iter().map(|&p| p * scale).collect::<Vec<_>>(), ball.indices)
    };
    let inward = |scale: f32| {
        let ball = scaled(scale);
        Geometry::new(ball.positions, ball.indices.iter().map(|&[a, b, c]| [a, c, b]).collect::<Vec<_>>())
    };
    let sky = Sky { up: Vec3::X, zenith: Vec3::ONE, horizon: Vec3::ZERO, ground: Vec3::ONE };
    let seen = |geometry: Geometry, wall: WallKind| {
        let mut scene = Scene::new();
        put(&mut scene, geometry, Material { wall, ..Material::glass(1.5) }, DAffine3::IDENTITY);
        let eye = DVec3::new(0.7, 0.0, 10.0);
        let camera = Camera::orthographic(0.01, 0.01);
        let mut view = View::look_at(eye, eye - DVec3::Z, DVec3::Y, camera, 1, 1);
        (view.sky, view.max_depth) = (sky, 8);
        render(&mut scene, &view).color[0][0]
    };
    let ball = seen(scaled(1.0), WallKind::Auto);
    assert!(ball > 0.45, "a ball: {ball}");
    // Either way in which a bulb's inner shell may face; and a ball of one surface that is said to be thin.
    let hollow = [
        ("a bulb", together(&[scaled(1.0), inward(0.99)]), WallKind::Auto),
        ("two outward shells", together(&[scaled(1.0), scaled(0.99)]), WallKind::Auto),
        ("a ball turned inside out", inward(1.0), WallKind::Auto),
        ("a thin ball", scaled(1.0), WallKind::Thin),
    ];
    for (name, geometry, wall) in hollow {
        let found = seen(geometry, wall);
        assert!(found < 0.3, "{name}: {found}");
    }
    assert_eq!(seen(scaled(1.0), WallKind::Solid), ball);
}

fn fresnel(cosine: f64, eta: f64) -> f64 {
    let sine_2 = eta * eta * (1.0 - cosine * cosine);
    if sine_2 >= 1.0 {
        return 1.0;
    }
    let cosine_2 = (1.0 - sine_2).sqrt();
    let s = (eta * cosine - cosine_2) / (eta * cosine + cosine_2);
    let p = (cosine - eta * cosine_2) / (cosine + eta * cosine_2);
    (s * s + p * p) * 0.5
}

/// The radiance along a ray that may hit a unit sphere of glass under a sky, computed recursively.
struct GlassBall {
    ior: f64,
    tint: DVec3,
    sky: Sky,
    max_depth: u32,
}

impl GlassBall {
    fn sky(&self, direction: DVec3) -> DVec3 {
        let height = direction.dot(self.sky.up.as_dvec3());
        let (horizon, end) =
            (self.sky.horizon.as_dvec3(), if height > 0.0 { self.sky.zenith } else { self.sky.ground });
        horizon + (end.as_dvec3() - horizon) * height.abs()
    }

    fn radiance(&self, origin: DVec3, direction: DVec3, depth: u32) -> DVec3 {
        let b = origin.dot(direction);
        let discriminant = b * b - origin.length_squared() + 1.0;
        let inside = origin.length() < 1.0 + 1e-9 && b < 0.0;
        let t = if inside { -2.0 * b } else { -b - discriminant.max(0.0).sqrt() };
        if depth > self.max_depth || discriminant < 0.0 || t < 1e-9 {
            return self.sky(direction);
        }
        let point = origin + direction * t;
        let normal = if inside { -point } else { point };
        let eta = if inside { self.ior } else { 1.0 / self.ior };
        let cosine = -direction.dot(normal);
        let reflectance = fresnel(cosine, eta);
        let mut sum = self.radiance(point, direction + normal * 2.0 * cosine, depth + 1) * reflectance;
        if reflectance < 1.0 {
            let cosine_2 = (1.0 - eta * eta * (1.0 - cosine * cosine)).sqrt();
            let refracted = direction * eta + normal * (eta * cosine - cosine_2);
            sum += self.radiance(point, refracted.normalize(), depth + 1) * self.tint * (1.0 - reflectance);
        }
        sum
    }
}

#[test]
fn a_dense_sphere_of_glass_looks_like_a_true_one() {
    let sky = Sky {
        zenith: Vec3::new(0.2, 0.4, 0.9),
        horizon: Vec3::new(0.9, 0.8, 0.7),
        ground: Vec3::new(0.1, 0.3, 0.05),
        up: Vec3::new(0.2, 1.0, 0.3).normalize(),
    };
    for (ior, max_depth) in [(1.5f32, 2), (1.5, 4), (2.4, 3), (1.0, 3)] {
        let base_color = Vec3::new(0.81, 1.0, 0.25);
        let ball = GlassBall { ior: ior.into(), tint: DVec3::new(0.9, 1.0, 0.5), sky, max_depth };
        let mut scene = Scene::new();
        let glass = Material { base_color: base_color.extend(1.0), ..Material::glass(ior) };
        put(&mut scene, sphere(7), glass, DAffine3::IDENTITY);
        let size = 64;
        let mut view = View::look_at(DVec3::Z * 4.0, DVec3::ZERO, DVec3::Y, Camera::default(), size, size);
        view.sky = sky;
        view.max_depth = max_depth;
        let image = render(&mut scene, &view);
        let half = f64::from(std::f32::consts::FRAC_PI_8.tan());
        let (mut errors, mut ball_pixels) = (Vec::new(), 0);
        for y in 0..size {
            for x in 0..size {
                let across = |i: u32| (f64::from(i) + 0.5) / f64::from(size) * 2.0 - 1.0;
                let direction = DVec3::new(across(x) * half, -across(y) * half, -1.0).normalize();
                let expected = ball.radiance(DVec3::Z * 4.0, direction, 0);
                ball_pixels += u32::from((expected - ball.sky(direction)).abs().max_element() > 1e-3);
                let found = Vec3::from_slice(&image.color[(y * size + x) as usize]).as_dvec3();
                errors.push((found - expected).abs().max_element());
            }
        }
        errors.sort_by(f64::total_cmp);
        let (mean, percentile) = (errors.iter().sum::<f64>() / errors.len() as f64, errors[errors.len() * 99 / 100]);
        eprintln!("ior {ior}, depth {max_depth}: mean error {mean:e}, 99 % below {percentile:e}");
        assert!(ball_pixels > 1000 || ior == 1.0, "{ball_pixels} pixels show the ball");
        // 131,072 triangles: the silhouette's pixels differ, and near it the angle of refraction is sensitive.
        assert!(mean < 1e-3 && percentile < 1e-2, "ior {ior}, depth {max_depth}: mean {mean:e}, 99 % {percentile:e}");
    }
}
