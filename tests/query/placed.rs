//! Queries are exact in f64, wherever a frame was seen from.

use glam::{DVec3, Vec3};
use ropewalk::compile::Compiler;
use ropewalk::query::Queries;
use ropewalk::{Core, Geometry, Material, Ray, Scene, Transform};

/// A random vector of this length.
fn direction(rng: &mut fastrand::Rng, length: f64) -> DVec3 {
    DVec3::from_array([0; 3].map(|_| rng.f64() * 2.0 - 1.0)).normalize_or(DVec3::X) * length
}

/// A tilted triangle around the origin of its space, about `size` wide.
fn triangle(rng: &mut fastrand::Rng, size: f64) -> [Vec3; 3] {
    let along = [DVec3::new(-1.0, -0.9, 0.3), DVec3::new(1.1, -0.8, -0.2), DVec3::new(0.1, 1.2, 0.4)];
    along.map(|v| ((v + direction(rng, 0.1)) * size).as_vec3())
}

/// A scene of triangles at these places, compiled for an eye; then for a second one, which may move the render origin.
fn compiled(triangles: &[([Vec3; 3], DVec3)], eyes: [DVec3; 2]) -> (Scene, Compiler) {
    let mut scene = Scene::new();
    let material = scene.add_material(Material { double_sided: true, ..Material::default() }).unwrap();
    for (corners, place) in triangles {
        let geometry = scene.add_geometry(Geometry::new(corners.to_vec(), [[0, 1, 2]])).unwrap();
        let node = scene.add(scene.root(), Transform::from_translation(*place)).unwrap();
        scene.add(node, Core::Geometry { geometry, material }).unwrap();
    }
    let mut compiler = Compiler::new();
    for eye in eyes {
        compiler.compile(&mut scene, eye).unwrap();
    }
    (scene, compiler)
}

/// The largest distance of a hit's position from the triangle's plane, of its t from the exact one times the
/// direction's length, over random rays that start about as far away as the triangle is large.
fn largest_error(
    rng: &mut fastrand::Rng,
    scene: &mut Scene,
    compiler: &mut Compiler,
    corners: [Vec3; 3],
    place: DVec3,
) -> f64 {
    let queries = Queries::new(compiler, scene).unwrap();
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    let normal = (b - a).cross(c - a).normalize();
    let size = (b - a).length();
    let mut largest = 0.0_f64;
    for _ in 0..20 {
        // Aim at a point of the triangle, not from its plane. Coordinates are relative to its place, so that the test's
        // own are exact enough.
        let (u, v) = (0.05 + rng.f64() * 0.4, 0.05 + rng.f64() * 0.4);
        let away = normal * size + direction(rng, size * 0.7);
        let from = (a + (b - a) * u + (c - a) * v + away + place) - place;
        let along = a + (b - a) * u + (c - a) * v - from;
        let hit = queries.closest_hit(&Ray::new(from + place, along)).unwrap().unwrap();
        let t = normal.dot(a - from) / normal.dot(along);
        let slope = normal.dot(along.normalize()).abs();
        largest = largest.max(((hit.distance - t) * along.length() * slope).abs());
        largest = largest.max(normal.dot(hit.position - place - a).abs());
    }
    largest
}

#[test]
fn an_identity_placement_is_exact_wherever_a_frame_was_seen_from() {
    let mut rng = fastrand::Rng::with_seed(12);
    let mut worst = 0.0_f64;
    for i in 0..600 {
        let distance = [3.0, 12e3, 1e5, 1e7][i % 4];
        let length = distance * (0.5 + rng.f64());
        let eye = direction(&mut rng, length);
        let corners = triangle(&mut rng, 2.0);
        // Alone; above a ground that reaches as far as the eye; and after the eye has come from elsewhere.
        let ground = triangle(&mut rng, distance * 2.0).map(|v| v - Vec3::Z * (2.0 * distance) as f32);
        let triangles = [(corners, DVec3::ZERO), (ground, DVec3::new(0.1, 0.2, 0.3))];
        let shown = if i / 4 % 2 == 0 { &triangles[..1] } else { &triangles[..] };
        let before = if i / 8 % 2 == 0 { eye } else { direction(&mut rng, distance * 300.0) };
        let (mut scene, mut compiler) = compiled(shown, [before, eye]);
        let error = largest_error(&mut rng, &mut scene, &mut compiler, corners, DVec3::ZERO);
        // What is left is the rounding of f64, relative to the render origin.
        let rounding = (compiler.origin().length() + 4.0) * f64::EPSILON;
        assert!(error <= 4.0 * rounding, "from {eye}, origin {}: {error:e}", compiler.origin());
        worst = worst.max(error / rounding);
    }
    println!("at most {worst} times the rounding of f64");
    assert!(worst > 0.0);
}

#[test]
fn a_scene_that_grows_moves_an_origin_that_f32_does_not_hold() {
    let mut rng = fastrand::Rng::with_seed(13);
    for _ in 0..50 {
        // A thing of a micrometre, ten kilometres away from the world's origin: no origin in its reach fits f32.
        let eye = direction(&mut rng, 1e4);
        let speck = triangle(&mut rng, 1e-6);
        let (mut scene, mut compiler) = compiled(&[(speck, eye)], [eye; 2]);
        assert!(compiler.origin().distance(eye) < 1e-8, "{} for {eye}", compiler.origin());
        // A thing at the world's origin takes its place.
        let speck = scene.children(scene.root()).unwrap().next().unwrap();
        scene.remove(speck).unwrap();
        let corners = triangle(&mut rng, 2.0);
        let geometry = scene.add_geometry(Geometry::new(corners.to_vec(), [[0, 1, 2]])).unwrap();
        let material = scene.add_material(Material { double_sided: true, ..Material::default() }).unwrap();
        scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
        let report = compiler.compile(&mut scene, eye).unwrap();
        assert!(report.rebased);
        let error = largest_error(&mut rng, &mut scene, &mut compiler, corners, DVec3::ZERO);
        assert!(error <= 4e4 * f64::EPSILON, "from {eye}, origin {}: {error:e}", compiler.origin());
        // From now on it stays.
        assert!(!compiler.compile(&mut scene, eye + DVec3::splat(0.1)).unwrap().rebased);
    }
}

#[test]
fn placements_are_exact_wherever_they_are() {
    let mut rng = fastrand::Rng::with_seed(14);
    for i in 0..300 {
        let eye = direction(&mut rng, [12e3, 1e5][i % 2]);
        let corners = triangle(&mut rng, 2.0);
        // Any place, and one that f32 has relative to the render origin.
        let any = direction(&mut rng, 100.0);
        for place in [any, (any * 64.0).round() / 64.0] {
            let (mut scene, mut compiler) = compiled(&[(corners, place)], [eye; 2]);
            let error = largest_error(&mut rng, &mut scene, &mut compiler, corners, place);
            assert!(error <= 4e5 * f64::EPSILON, "{place} from {eye}, origin {}: {error:e}", compiler.origin());
        }
    }
}
