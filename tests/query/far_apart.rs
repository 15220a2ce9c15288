//! Things that are far apart: batches and queries are exact where their rays start, whoever has rendered from where.

use glam::DVec3;
use ropewalk::math::Bounds;
use ropewalk::query::{Overlap, Region};
use ropewalk::render::{BatchOptions, Precision, RayMask};
use ropewalk::{Camera, Core, Geometry, Material, Ray, Scene, Transform, View};
use ropewalk_testkit::{Mesh, Random};

use super::batch::renderers;

/// A ball of radius 1 at each place; places are multiples of 2^-20 that f64 adds to without rounding.
fn balls(places: &[DVec3]) -> Scene {
    let mut scene = Scene::new();
    let mesh = Mesh::icosphere(2);
    let geometry = scene.add_geometry(Geometry::new(mesh.positions, mesh.indices)).unwrap();
    let material = scene.add_material(Material { double_sided: true, ..Material::default() }).unwrap();
    for &place in places {
        let node = scene.add(scene.root(), Transform::from_translation(place)).unwrap();
        scene.add(node, Core::Geometry { geometry, material }).unwrap();
    }
    scene
}

/// Rays from inside a ball at the origin; starts are multiples of 2^-20.
fn rays(count: usize) -> Vec<Ray> {
    let mut random = Random::new(5);
    let start = |v: DVec3| (v * 2f64.powi(20)).round() / 2f64.powi(20);
    (0..count).map(|_| Ray::new(start(random.in_cube().as_dvec3() * 0.4), random.direction().as_dvec3())).collect()
}

fn moved(rays: &[Ray], place: DVec3) -> Vec<Ray> {
    rays.iter().map(|ray| Ray { origin: ray.origin + place, ..*ray }).collect()
}

/// Of each ray from within a ball at the origin: triangle and t.
fn expected(rays: &[Ray]) -> Vec<(u32, f64)> {
    let mut scene = balls(&[DVec3::ZERO]);
    let mut renderer = renderers().remove(0);
    let queries = renderer.queries(&mut scene).unwrap();
    rays.iter().map(|ray| queries.closest_hit(ray).unwrap().map(|hit| (hit.triangle, hit.distance)).unwrap()).collect()
}

/// Two balls, so far apart; and beside the second one a third and a fourth that f32 does not tell from it.
fn places(distance: f64) -> [DVec3; 4] {
    let far = DVec3::new(distance, -0.75 * distance, 0.25 * distance);
    [DVec3::ZERO, far, far + DVec3::new(3.0, 0.0, 0.0), far + DVec3::new(0.0, 3.0, 0.25)]
}

const DISTANCES: [i32; 4] = [4, 10, 20, 30];

#[test]
fn queries_are_exact_wherever_they_are_asked() {
    let rays = rays(300);
    let expected = expected(&rays);
    for (distance, rendered) in DISTANCES.into_iter().flat_map(|distance| [(distance, false), (distance, true)]) {
        let places = places(2f64.powi(distance));
        let mut scene = balls(&places);
        let mut renderer = renderers().remove(0);
        if rendered {
            let view = View::look_at(DVec3::Z * 3.0, DVec3::ZERO, DVec3::Y, Camera::default(), 2, 2);
            renderer.render(&mut scene, &view).unwrap();
        }
        let queries = renderer.queries(&mut scene).unwrap();
        for (index, &place) in places.iter().enumerate() {
            for (ray, &(triangle, t)) in moved(&rays, place).iter().zip(&expected) {
                let hit = queries.closest_hit(ray).unwrap().unwrap();
                let error = (hit.distance - t).abs();
                // The render origin may be as far away, where f64 is rounded; an edge may then fall to the other side.
                assert!(error < 1e-9 + place.length() * 1e-15, "2^{distance}, ball {index}: {error:e}");
                assert!(hit.triangle == triangle || error < 1e-6, "2^{distance}: {} {triangle}", hit.triangle);
            }
            let around = Bounds { min: place - 1.25, max: place + 1.25 };
            let region = Region::new_box(&around).unwrap();
            assert_eq!(queries.overlapping(&region, Overlap::Inside).len(), 1, "2^{distance}, ball {index}");
            let nearest = queries.nearest(place + DVec3::Z * 2.0, f64::INFINITY).unwrap().unwrap();
            assert!((nearest.distance - 1.0).abs() < 1e-6, "2^{distance}, ball {index}: {}", nearest.distance);
        }
    }
}

#[test]
fn batches_are_exact_where_their_rays_start() {
    let rays = rays(400);
    let expected = expected(&rays);
    let count = rays.len();
    for mut renderer in renderers() {
        let name = renderer.device_info().executor;
        for distance in DISTANCES {
            let places = places(2f64.powi(distance));
            // From one ball, from the other, and from all of them by turns.
            let turns: Vec<usize> = (0..count).map(|i| i % places.len()).collect();
            // Where a batch has one place, positions are off by 2^-16 of a ball, else by up to 2^-8 of a ball.
            for (from, fast) in [(vec![0; count], 3e-5), (vec![1; count], 3e-5), (turns, 4e-3)] {
                let mut scene = balls(&places);
                let batch: Vec<Ray> =
                    rays.iter().zip(&from).map(|(ray, &i)| Ray { origin: ray.origin + places[i], ..*ray }).collect();
                for (precision, bound) in [(Precision::Fast, fast), (Precision::Refined, 1e-12)] {
                    let options = BatchOptions::default().with_precision(precision);
                    let hits = renderer.closest_hits(&mut scene, &batch, options).unwrap();
                    for (i, &(_, t)) in expected.iter().enumerate() {
                        let found = hits.distance(i).unwrap_or_default();
                        let error = (found - t).abs();
                        assert!(error < bound, "{name}, 2^{distance}, {precision:?}: {found} for {t}");
                    }
                }
                let occluded = renderer.any_hits(&mut scene, &batch, RayMask::ALL).unwrap();
                assert!(occluded.iter().all(|&is_hit| is_hit), "{name}, 2^{distance}");
            }
        }
    }
}

#[test]
fn a_frame_near_a_small_thing_is_exact_in_a_scene_of_any_size() {
    // First seen from one ball, then from the other: as if each were alone.
    let look = |place: DVec3| {
        let eye = place + DVec3::new(1.0, 0.5, 4.0);
        let view = View::look_at(eye, place, DVec3::Y, Camera::default(), 32, 32);
        View { aovs: true, ..view }
    };
    let mut renderer = renderers().remove(0);
    let alone = renderer.render(&mut balls(&[DVec3::ZERO]), &look(DVec3::ZERO)).unwrap().image().unwrap();
    for distance in DISTANCES {
        let places = places(2f64.powi(distance));
        let mut scene = balls(&places[..2]);
        for place in [places[0], places[1], places[0]] {
            let image = renderer.render(&mut scene, &look(place)).unwrap().image().unwrap();
            let depths = image.aovs.unwrap().depth.into_iter().zip(&alone.aovs.as_ref().unwrap().depth);
            let different = depths.filter(|(found, expected)| (found - *expected).abs() > 2e-3).count();
            assert!(different <= 2, "2^{distance}: {different} pixels");
        }
    }
}
