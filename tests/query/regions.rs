//! Region queries: boxes and frustums, compared with separating axis tests.

use std::cell::Cell;
use std::collections::HashSet;

use glam::{DVec3, Vec2};
use proptest::prelude::*;
use ropewalk::graph::NodePath;
use ropewalk::math::Bounds;
use ropewalk::query::{HalfSpace, Overlap};
use ropewalk::query::{Queries, Region};
use ropewalk::{Camera, View};

use super::scenes::{Dice, Seed, World, check, compiled, drawn};
use ropewalk_testkit::Random;

/// A convex body with its corners, the directions of its edges and the normals of its faces. Relative to the render
/// origin.
struct Body {
    corners: Vec<DVec3>,
    edges: Vec<DVec3>,
    normals: Vec<DVec3>,
}

impl Body {
    fn new_box(bounds: &Bounds, origin: DVec3) -> Self {
        let corners = bounds.corners().map(|corner| corner - origin).to_vec();
        Self { corners, edges: DVec3::AXES.to_vec(), normals: DVec3::AXES.to_vec() }
    }

    /// A frustum with the corners of its near and far end, in turn.
    fn new_frustum(near: [DVec3; 4], far: [DVec3; 4]) -> Self {
        let sides = (0..4).map(|i| far[i] - near[i]);
        let edges = sides.chain([far[1] - far[0], far[2] - far[1]]);
        let normals = (0..4).map(|i| (far[i] - near[i]).cross(far[(i + 1) % 4] - far[i]));
        let normals = normals.chain([(far[1] - far[0]).cross(far[2] - far[1])]).map(DVec3::normalize);
        Self { corners: [near, far].concat(), edges: edges.collect(), normals: normals.collect() }
    }

    /// The distance between triangle and body along the axis on which it is greatest; negative if no axis separates
    /// them.
    fn separation(&self, [a, b, c]: [DVec3; 3]) -> f64 {
        let sides = [b - a, c - b, a - c];
        let pairs =
            sides.iter().flat_map(|side| self.edges.iter().map(|edge| side.normalize().cross(edge.normalize())));
        // Axes in the triangle's own plane separate it, too.
        let normal = sides[0].normalize().cross(sides[1].normalize());
        let in_plane = sides.iter().map(|side| side.normalize().cross(normal));
        let axes = self.normals.iter().copied().chain([normal]).chain(in_plane).chain(pairs);
        let axes = axes.filter(|axis| axis.length() > 1e-7).map(DVec3::normalize);
        let gap = |axis: DVec3| {
            let range = |points: &[DVec3]| {
                points
                    .iter()
                    .map(|p| p.dot(axis))
                    .fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)))
            };
            let ((low, high), (body_low, body_high)) = (range(&[a, b, c]), range(&self.corners));
            (low - body_high).max(body_low - high)
        };
        axes.map(gap).fold(f64::MIN, f64::max)
    }
}

/// The result as a set, after a check that nothing occurs twice.
fn set(paths: Vec<NodePath>) -> HashSet<NodePath> {
    let count = paths.len();
    let set: HashSet<NodePath> = paths.into_iter().collect();
    assert_eq!(set.len(), count);
    set
}

/// A random region, which is a box or the frustum of some pixels of a view, and the same as a convex body.
fn region(dice: &mut Dice, origin: DVec3) -> (Region, Body) {
    let (a, b) = (dice.point(), dice.point());
    if dice.random.index(2) == 0 {
        let bounds = Bounds { min: a.min(b), max: a.max(b) };
        return (Region::new_box(&bounds).unwrap(), Body::new_box(&bounds, origin));
    }
    let random = &mut dice.random;
    let unit = dice.unit;
    let shift = Vec2::new(random.signed(), random.signed());
    let camera = match random.index(2) {
        0 => Camera::perspective(0.3 + random.unsigned()),
        _ => Camera::orthographic(unit as f32 * 3.0, unit as f32 * 2.0),
    };
    let view = View::look_at(a, b, random.direction().as_dvec3(), camera.with_lens_shift(shift), 40, 30);
    let [columns, rows] = [pixels(random, 40), pixels(random, 30)];
    let region = view.pixel_frustum(columns.clone(), rows.clone()).unwrap();

    // The corners follow the documentation of the camera: the whole field of view at distance 1, then the part of the
    // pixels.
    let axes = view.world_from_view.matrix3;
    let (half_height, is_perspective) = match camera {
        Camera::Perspective { y_fov, .. } => (f64::from(y_fov / 2.0).tan(), true),
        Camera::Orthographic { .. } => (2.25 * f64::from(unit as f32), false),
    };
    let corner = |column: u32, row: u32| {
        let x = (f64::from(column) / 20.0 - 1.0 + f64::from(shift.x)) * half_height * 4.0 / 3.0;
        let y = (1.0 - f64::from(row) / 15.0 + f64::from(shift.y)) * half_height;
        axes.x_axis * x + axes.y_axis * y
    };
    let corners = [
        corner(columns.start, rows.start),
        corner(columns.end, rows.start),
        corner(columns.end, rows.end),
        corner(columns.start, rows.end),
    ];
    let eye = view.world_from_view.translation - origin;
    let far = 1e3 * unit;
    let ends = if is_perspective {
        [[eye; 4], corners.map(|corner| eye + (corner - axes.z_axis) * far)]
    } else {
        [corners.map(|corner| eye + corner), corners.map(|corner| eye + corner - axes.z_axis * far)]
    };
    (region, Body::new_frustum(ends[0], ends[1]))
}

fn pixels(random: &mut Random, count: usize) -> std::ops::Range<u32> {
    let (a, b) = (random.index(count) as u32, random.index(count) as u32);
    a.min(b)..a.max(b) + 1
}

#[test]
fn regions_agree_with_separating_axes() {
    let [touching, inside, apart, ties] = [0; 4].map(Cell::new);
    let add = |cell: &Cell<usize>| cell.set(cell.get() + 1);
    check(300, |seed| {
        let World { mut scene, mut dice } = World::new(seed);
        let mask = dice.mask();
        let (mut compiler, origin) = compiled(&mut scene);
        let drawn = drawn(&mut scene, origin, mask);
        let queries = Queries::new(&mut compiler, &mut scene).unwrap().with_ray_mask(mask);
        for _ in 0..20 {
            let (region, body) = region(&mut dice, origin);
            let found = set(queries.overlapping(&region, Overlap::Touching));
            let found_inside = set(queries.overlapping(&region, Overlap::Inside));
            prop_assert!(found_inside.is_subset(&found));
            prop_assert!(found.iter().all(|path| drawn.iter().any(|drawn| drawn.path == *path)));
            let band = 1e-9 * (1e3 * seed.unit + origin.length());
            for drawn in drawn.iter().filter(|drawn| !drawn.triangles.is_empty()) {
                let triangles: Vec<[DVec3; 3]> = (0..drawn.triangles.len()).map(|i| drawn.world_triangle(i)).collect();
                let separations = triangles.iter().map(|&triangle| body.separation(triangle));
                let least = separations.fold(f64::MAX, f64::min);
                // A triangle is within the region if its farthest corner is.
                let corners = triangles.iter().flatten();
                let out = corners.map(|&p| outside(&region, p + origin)).fold(f64::MIN, f64::max);
                // The frustum's body ends at 1000 units, the frustum does not; instances of instances can be farther
                // out.
                let is_far = triangles.iter().flatten().any(|p| p.length() > 500.0 * seed.unit);
                if is_far || least.abs() < band || out.abs() < band {
                    add(&ties);
                    continue;
                }
                prop_assert_eq!(found.contains(&drawn.path), least < 0.0, "{:?} is apart by {}", drawn.path, least);
                prop_assert_eq!(found_inside.contains(&drawn.path), out < 0.0, "{:?} is out by {}", drawn.path, out);
                add(if least > 0.0 { &apart } else { &touching });
                if out < 0.0 {
                    add(&inside);
                }
            }
        }
        Ok(())
    });
    let counts = [touching, inside, apart, ties].map(|cell| cell.get());
    println!("{counts:?} touching, inside, apart, ties");
    assert!(counts[..3].iter().all(|&count| count > 50) && counts[3] * 20 < counts[0], "{counts:?}");
}

/// The distance of a point from a region, negative inside: by the region's planes, which the body is not made from.
fn outside(region: &Region, point: DVec3) -> f64 {
    let heights = region.half_spaces().iter().map(|half| (half.normal.dot(point) - half.offset) / half.normal.length());
    heights.fold(f64::MIN, f64::max)
}

/// Many planes around a ball: a region of any shape.
#[test]
fn any_planes_make_a_region() {
    let World { mut scene, mut dice } = World::new(Seed { seed: 5, instances: 12, unit: 1.0, offset: 0.0 });
    let (mut compiler, origin) = compiled(&mut scene);
    let drawn = drawn(&mut scene, origin, u32::MAX);
    let queries = Queries::new(&mut compiler, &mut scene).unwrap();
    let mut found = 0;
    for _ in 0..50 {
        let (center, radius) = (dice.point(), f64::from(dice.random.unsigned()) * 2.0);
        let planes: Vec<HalfSpace> = (0..200)
            .map(|_| dice.random.direction().as_dvec3())
            .map(|normal| HalfSpace::through(center + normal * radius, normal))
            .collect();
        let region = Region::new(planes).unwrap();
        let touching = set(queries.overlapping(&region, Overlap::Touching));
        for drawn in &drawn {
            let distances =
                (0..drawn.triangles.len()).map(|i| super::nearest::distance(drawn.world_triangle(i), center - origin));
            let distance = distances.fold(f64::INFINITY, f64::min);
            // The planes are tangent to the ball, so the region is a little larger.
            assert!(distance > radius || touching.contains(&drawn.path));
            assert!(distance < radius * 1.5 || !touching.contains(&drawn.path));
        }
        found += touching.len();
    }
    assert!(found > 10, "{found}");
    let everywhere = Region::new([]).unwrap();
    let shown = drawn.iter().filter(|drawn| !drawn.triangles.is_empty()).count();
    assert_eq!(queries.overlapping(&everywhere, Overlap::Inside).len(), shown);
}
