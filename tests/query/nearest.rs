//! The nearest point, compared with the nearest of all triangles by the method of C. Ericson.

use std::cell::Cell;

use glam::DVec3;
use proptest::prelude::*;
use ropewalk::query::Queries;

use super::scenes::{World, check, compiled, drawn};

/// The distance of a point from a triangle (C. Ericson, *Real-Time Collision Detection*, 5.1.5).
pub fn distance([a, b, c]: [DVec3; 3], point: DVec3) -> f64 {
    let (ab, ac) = (b - a, c - a);
    let along = |from: DVec3| ((point - from).dot(ab), (point - from).dot(ac));
    let ((d1, d2), (d3, d4), (d5, d6)) = (along(a), along(b), along(c));
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    let nearest = if d1 <= 0.0 && d2 <= 0.0 {
        a
    } else if d3 >= 0.0 && d4 <= d3 {
        b
    } else if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        a + ab * (d1 / (d1 - d3))
    } else if d6 >= 0.0 && d5 <= d6 {
        c
    } else if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        a + ac * (d2 / (d2 - d6))
    } else if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))
    } else {
        a + (ab * vb + ac * vc) / (va + vb + vc)
    };
    nearest.distance(point)
}

#[test]
fn nearest_points_agree_with_brute_force() {
    let found = Cell::new(0);
    check(400, |seed| {
        let World { mut scene, mut dice } = World::new(seed);
        let mask = dice.mask();
        let (mut compiler, origin) = compiled(&mut scene);
        let drawn = drawn(&mut scene, origin, mask);
        let queries = Queries::new(&mut compiler, &mut scene).unwrap().with_ray_mask(mask);
        for _ in 0..20 {
            let point = dice.point();
            let all = drawn.iter().flat_map(|drawn| (0..drawn.triangles.len()).map(|i| drawn.world_triangle(i)));
            let least = all.map(|triangle| distance(triangle, point - origin)).fold(f64::INFINITY, f64::min);
            let Some(hit) = queries.nearest(point, f64::INFINITY).unwrap() else {
                prop_assert!(least.is_infinite());
                continue;
            };
            found.set(found.get() + 1);
            let band = 1e-12 * (seed.unit * 10.0 + (point - origin).length() + point.length());
            prop_assert!((hit.distance - least).abs() <= band, "{} is not {least}", hit.distance);
            prop_assert!((hit.position.distance(point) - least).abs() <= band, "{} is not there", hit.position);
            let own = drawn.iter().find(|drawn| drawn.path == hit.path).unwrap();
            let index = own.triangles.iter().position(|(i, _)| *i == hit.triangle).unwrap();
            let [a, b, c] = own.world_triangle(index);
            prop_assert!((distance([a, b, c], point - origin) - least).abs() <= band);
            let weights = hit.barycentrics;
            let position = a * weights.x + b * weights.y + c * weights.z + origin;
            prop_assert!(weights.min_element() >= 0.0 && (weights.element_sum() - 1.0).abs() < 1e-12);
            prop_assert!(position.distance(hit.position) <= band);
            let above = hit.geometric_normal.dot(point - hit.position);
            prop_assert!(above.abs() <= 1e-3 * least + band || hit.back_face == (above < 0.0), "{above} above");

            // A point at exactly the greatest distance is found.
            prop_assert_eq!(queries.nearest(point, hit.distance).unwrap(), Some(hit.clone()));
            if least > band {
                prop_assert_eq!(queries.nearest(point, least * 1.01).unwrap(), Some(hit.clone()));
                prop_assert_eq!(queries.nearest(point, least - band).unwrap(), None);
            }
        }
        Ok(())
    });
    assert!(found.get() > 3000, "{}", found.get());
}
