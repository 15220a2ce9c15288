//! Batches of rays on every executor, compared with exact queries of single rays.

use glam::DVec3;
use ropewalk::render::RayMask;
use ropewalk::trace::{Cpu, Emulated};
use ropewalk::{Core, Error, Geometry, Material, Ray, Renderer, Scene, Transform};

use ropewalk_testkit::{Mesh, Random};

/// Renderers on every executor.
pub fn renderers() -> Vec<Renderer> {
    #[cfg(feature = "gpu")]
    let gpu = ropewalk_testkit::gpu::tracer().map(Renderer::with_tracer);
    #[cfg(not(feature = "gpu"))]
    let gpu = None;
    let others = [Renderer::with_tracer(Cpu::default()), Renderer::with_tracer(Emulated::default())];
    others.into_iter().chain(gpu).collect()
}

/// Spheres of 1280 triangles in a cube of that half size around a point of the world.
fn scene(center: DVec3, size: f64) -> Scene {
    let mut random = Random::new(7);
    let mut scene = Scene::new();
    let mesh = Mesh::icosphere(3);
    let geometry = scene.add_geometry(Geometry::new(mesh.positions, mesh.indices)).unwrap();
    let material = scene.add_material(Material::default()).unwrap();
    for i in 0..30 {
        let translation = center + random.in_cube().as_dvec3() * size;
        let scale = DVec3::splat(0.2 * size);
        let place = Transform::Trs { translation, rotation: glam::DQuat::IDENTITY, scale };
        let place = scene.add(scene.root(), place).unwrap();
        scene.set_mask(place, 1 << (i % 2)).unwrap();
        scene.add(place, Core::Geometry { geometry, material }).unwrap();
    }
    scene
}

/// Rays from near and very far, of all lengths and limits, at the spheres and beside them.
fn rays(center: DVec3, size: f64, count: usize) -> Vec<Ray> {
    let mut random = Random::new(8);
    let mut ray = || {
        let distance = [0.5, 3.0, 1e3, 1e7][random.index(4)];
        let from = center + random.direction().as_dvec3() * distance * size;
        let to = center + random.in_cube().as_dvec3() * size;
        let direction = (to - from) * [1.0, 1e-20, 1e20, 1e-120, 1e120][random.index(5)];
        let end = (to - from).length() / direction.length();
        let mut ray = Ray::new(from, direction);
        match random.index(4) {
            0 => ray.t_max = end * f64::from(random.unsigned()),
            1 => ray.t_min = end * f64::from(random.signed()) * 2.0,
            2 => (ray.direction, ray.t_min) = (-direction, f64::NEG_INFINITY),
            _ => {}
        }
        ray
    };
    (0..count).map(|_| ray()).collect()
}

#[test]
fn every_device_hits_what_exact_queries_hit() {
    const RAYS: usize = 4000;
    for (center, size) in
        [(DVec3::ZERO, 1.0), (DVec3::new(1e6, -2e6, 3e5), 1.0), (DVec3::ZERO, 1e-9), (DVec3::X * 1e12, 1e10)]
    {
        let mut scene = scene(center, size);
        let rays = rays(center, size, RAYS);
        for mut renderer in renderers() {
            for mask in [u32::MAX, 2] {
                let device = renderer.device_info().executor;
                let queries = renderer.queries(&mut scene).unwrap().with_ray_mask(mask);
                let expected: Vec<_> = rays.iter().map(|ray| queries.closest_hit(ray).unwrap()).collect();
                let hits = renderer.closest_hits(&mut scene, &rays, RayMask(mask)).unwrap();
                assert_eq!(hits.len(), RAYS);
                let (mut differ, mut compared) = (0, 0);
                for (i, (found, expected)) in hits.iter().zip(&expected).enumerate() {
                    assert_eq!(found.as_ref().map(|hit| hit.distance), hits.distance(i));
                    let same = match (&found, expected) {
                        (Some(found), Some(expected)) => {
                            compared += 1;
                            let off = found.position.distance(expected.position);
                            (&found.path, found.triangle) == (&expected.path, expected.triangle)
                                && off <= 1e-4 * size
                                && (found.distance - expected.distance).abs() * rays[i].direction.length()
                                    <= 1e-4 * size + 1e-9 * expected.position.distance(rays[i].origin)
                        }
                        (None, None) => true,
                        _ => false,
                    };
                    differ += usize::from(!same);
                }
                println!("{device} at {center}, {size}: {differ} of {compared} differ");
                assert!(compared > RAYS / 10, "{device}: {compared} hits");
                // The answers may differ where a ray passes an edge, or starts or ends at a surface, within the
                // rounding of f32.
                assert!(differ * 200 < RAYS, "{device} at {center}, {size}: {differ} of {RAYS} differ");
            }
        }
    }
}

#[test]
fn any_hits_are_what_stops_light() {
    let mut scene = scene(DVec3::ZERO, 1.0);
    let rays = rays(DVec3::ZERO, 1.0, 2000);
    for mut renderer in renderers() {
        let device = renderer.device_info().executor;
        let found = renderer.any_hits(&mut scene, &rays, RayMask::ALL).unwrap();
        let queries = renderer.queries(&mut scene).unwrap();
        // Everything is opaque and two-sided, so both queries must give the same answer.
        let expected: Vec<bool> = rays.iter().map(|ray| queries.any_hit(ray).unwrap()).collect();
        assert_eq!(found.len(), expected.len());
        let stopped = expected.iter().filter(|&&any| any).count();
        let differ = found.iter().zip(&expected).filter(|(a, b)| a != b).count();
        assert!(
            stopped > 200 && stopped < 1900 && differ * 200 < rays.len(),
            "{device}: {differ} differ, {stopped} stop"
        );
    }
}

#[test]
fn batches_follow_the_scene_and_refuse_what_is_no_ray() {
    for mut renderer in renderers() {
        let mut scene = Scene::new();
        let ray = Ray::new(DVec3::new(0.1, 0.2, 5.0), DVec3::NEG_Z);
        assert!(renderer.closest_hits(&mut scene, &[ray], RayMask(1)).unwrap().get(0).is_none());
        assert!(renderer.any_hits(&mut scene, &[], RayMask(1)).unwrap().is_empty());
        let mesh = Mesh::cube();
        let geometry = scene.add_geometry(Geometry::new(mesh.positions, mesh.indices)).unwrap();
        let material = scene.add_material(Material::default()).unwrap();
        let place = scene.add(scene.root(), Transform::IDENTITY).unwrap();
        scene.add(place, Core::Geometry { geometry, material }).unwrap();
        for z in [0.0, -1.0, 2.0] {
            scene.set_local(place, Transform::from_translation(DVec3::Z * z)).unwrap();
            let hits = renderer.closest_hits(&mut scene, &[ray, ray], RayMask(1)).unwrap();
            assert!((hits.distance(1).unwrap() - (4.0 - z)).abs() < 1e-6 && hits.distance(2).is_none());
            assert_eq!(hits.get(2), None);
        }
        for bad in [Ray { t_min: f64::NAN, ..ray }, Ray::new(DVec3::ZERO, DVec3::ZERO), Ray::new(DVec3::NAN, DVec3::X)]
        {
            let error = renderer.closest_hits(&mut scene, &[ray, bad], RayMask(1)).unwrap_err();
            assert!(matches!(error, Error::OutOfRange { .. }), "{error}");
        }
        // Extreme coordinates, directions and intervals cause no error, and no hit away from the geometry.
        let wild = [
            Ray::new(DVec3::MAX, DVec3::MIN),
            Ray::new(DVec3::MIN, DVec3::splat(1e-320)),
            Ray { t_min: f64::INFINITY, ..ray },
        ];
        let hits = renderer.closest_hits(&mut scene, &wild, RayMask(1)).unwrap();
        assert!(hits.iter().flatten().all(|hit| hit.position.abs().max_element() < 4.0));
    }
}
