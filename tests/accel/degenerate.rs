//! Triangles without area: no structure holds them, nothing finds them, and the surface around them stays closed.

use std::collections::BTreeSet;

use glam::{DVec3, Vec3};
use ropewalk::compile::Compiler;
use ropewalk::device::layout::{NONE, RayRecord};
use ropewalk::graph::BlasKind;
use ropewalk::math::Bounds;
use ropewalk::query::{Overlap, Queries, Ray, Region};
use ropewalk::{Core, Geometry, Material, Scene};
use ropewalk_testkit::oracle::has_area;
use ropewalk_testkit::{Mesh, Random, tracers};

use super::meshes::STRUCTURES;

/// A closed mesh in which some vertices lie within the edges of other triangles.
struct WithFillers {
    mesh: Mesh,
    /// The triangles that fill these edges: each with its corners on one line.
    fillers: BTreeSet<u32>,
}

/// The cube from -1 to 1. Each edge of the twelve triangles, diagonals of the faces among them, has two vertices in it
/// that only the triangles on one side use. Two triangles without area fill it, so that every edge has a partner.
fn cube_with_fillers(random: &mut Random) -> WithFillers {
    let Mesh { mut positions, indices } = Mesh::cube();
    let (mut faces, mut fillers) = (Vec::new(), Vec::new());
    for corners in indices {
        // 1. The outline of the triangle, with vertices in the edges that run to a higher index. They are exactly in
        //    them: each coordinate is that of both ends, or the same fraction of 1 or -1.
        let mut outline = Vec::new();
        for (from, to) in [0, 1, 2].map(|k| (corners[k], corners[(k + 1) % 3])) {
            outline.push(from);
            if from > to {
                continue;
            }
            let [start, end] = [from, to].map(|vertex| positions[vertex as usize]);
            let (first, second) = (-random.unsigned(), random.unsigned());
            let [first, second] = [first, second].map(|place| {
                let along = |k: usize| if start[k] == end[k] { start[k] } else { place * end[k] };
                positions.push(Vec3::from_array([0, 1, 2].map(along)));
                positions.len() as u32 - 1
            });
            outline.extend([first, second]);
            // 2. What lies between the edge, which runs back on the other side, and its parts.
            fillers.extend([[from, to, second], [from, second, first]]);
        }
        // 3. A fan around a point within the triangle.
        let [a, b, c] = corners.map(|vertex| positions[vertex as usize]);
        positions.push(a * 0.25 + b * 0.25 + c * 0.5);
        let middle = positions.len() as u32 - 1;
        let ends = outline[1..].iter().chain(&outline[..1]);
        faces.extend(outline.iter().zip(ends).map(|(&from, &to)| [middle, from, to]));
    }
    // 4. Fillers between faces in the list of triangles.
    let all: Vec<(bool, [u32; 3])> =
        faces.into_iter().map(|t| (false, t)).chain(fillers.into_iter().map(|t| (true, t))).collect();
    let count = all.len();
    let mixed: Vec<(bool, [u32; 3])> = (0..count).map(|i| all[i * 35 % count]).collect();
    let fillers = (0..).zip(&mixed).filter(|(_, (is_filler, _))| *is_filler).map(|(i, _)| i).collect();
    WithFillers { mesh: Mesh { positions, indices: mixed.into_iter().map(|(_, t)| t).collect() }, fillers }
}

/// A scene of one geometry, compiled.
fn compiled(mesh: &Mesh, structure: BlasKind) -> (Scene, Compiler) {
    let mut scene = Scene::new();
    let geometry = Geometry::new(mesh.positions.clone(), mesh.indices.clone()).with_blas_kind(structure);
    let geometry = scene.add_geometry(geometry).unwrap();
    let material = scene.add_material(Material::default()).unwrap();
    scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
    let mut compiler = Compiler::new();
    compiler.compile(&mut scene, DVec3::ZERO).unwrap();
    (scene, compiler)
}

/// Rays from inside the cube: a third in any direction, a third at vertices within edges, and a third at points of the
/// fillers' sides.
fn rays_from_inside(WithFillers { mesh, fillers }: &WithFillers, random: &mut Random, count: usize) -> Vec<RayRecord> {
    let size = mesh.positions[0].x.abs();
    let fillers: Vec<u32> = fillers.iter().copied().collect();
    let ray = |i: usize| {
        let origin = if random.index(4) == 0 { Vec3::ZERO } else { random.in_cube() * (0.9 * size) };
        let corners = mesh.triangle(fillers[random.index(fillers.len())] as usize);
        let (from, to) = (corners[random.index(3)], corners[random.index(3)]);
        let direction = match i % 3 {
            0 => random.direction() * size,
            1 => from - origin,
            _ => from.lerp(to, random.unsigned()) - origin,
        };
        RayRecord { origin: origin.to_array(), t_min: 0.0, direction: direction.to_array(), t_max: f32::MAX }
    };
    (0..count).map(ray).collect()
}

/// Where a ray from inside leaves the cube from -`size` to `size`.
fn exit(ray: &RayRecord, size: f32) -> f64 {
    let [origin, direction] = [ray.origin, ray.direction].map(|v| DVec3::from_array(v.map(f64::from)));
    let distances = (DVec3::splat(size.into()) * direction.signum() - origin) / direction;
    distances.to_array().into_iter().filter(|t| t.is_finite()).fold(f64::MAX, f64::min)
}

#[test]
fn a_closed_cube_stays_closed_without_the_triangles_that_fill_its_edges() {
    let mut random = Random::new(1);
    for size in [1e-3, 1.0, 3e4] {
        let mut cube = cube_with_fillers(&mut random);
        cube.mesh = cube.mesh.scaled(size);
        let WithFillers { mesh, fillers } = &cube;
        assert_eq!((fillers.len(), mesh.indices.len()), (36, 36 + 3 * 12 + 2 * 18));
        for i in 0..mesh.indices.len() as u32 {
            assert_eq!(has_area(mesh.triangle(i as usize)), !fillers.contains(&i), "triangle {i}");
        }
        let rays = rays_from_inside(&cube, &mut random, 40_000);
        for structure in STRUCTURES {
            let (_, mut compiler) = compiled(mesh, structure);
            // 1. The structure holds all faces, and no filler.
            let held: BTreeSet<u32> = compiler.arrays().triangles.iter().map(|triangle| triangle.primitive).collect();
            let faces: BTreeSet<u32> = (0..mesh.indices.len() as u32).filter(|i| !fillers.contains(i)).collect();
            assert_eq!(held, faces, "{structure:?}");
            // 2. Every ray hits a face where it leaves the cube.
            for tracer in &mut tracers() {
                tracer.upload(compiler.arrays_mut()).unwrap();
                let hits = tracer.closest_hits(compiler.arrays(), &rays, 1).unwrap();
                assert_eq!(hits.len(), rays.len());
                for (ray, hit) in rays.iter().zip(&hits) {
                    let (name, expected) = (&tracer.device().name, exit(ray, size));
                    let is_there = hit.instance != NONE && (f64::from(hit.t) - expected).abs() <= 1e-5 * expected;
                    assert!(is_there, "{name}, {structure:?}: {ray:?} leaves at {expected}, not {hit:?}");
                    assert!(!fillers.contains(&hit.primitive), "{name}, {structure:?}: {ray:?} hits a filler, {hit:?}");
                }
            }
        }
    }
}

#[test]
fn exact_queries_do_not_leave_the_cube() {
    let mut random = Random::new(2);
    let cube = cube_with_fillers(&mut random);
    let rays = rays_from_inside(&cube, &mut random, 20_000);
    let WithFillers { mesh, fillers } = &cube;
    for structure in STRUCTURES {
        let (mut scene, mut compiler) = compiled(mesh, structure);
        let queries = Queries::new(&mut compiler, &mut scene).unwrap();
        let mut fillers_hit = 0;
        for ray in &rays {
            let [origin, direction] = [ray.origin, ray.direction].map(|v| DVec3::from_array(v.map(f64::from)));
            let hit = queries.closest_hit(&Ray::new(origin, direction)).unwrap();
            let hit = hit.unwrap_or_else(|| panic!("{structure:?}: {ray:?} escapes"));
            assert!((hit.distance - exit(ray, 1.0)).abs() <= 1e-9 * hit.distance, "{structure:?}: {ray:?} {hit:?}");
            fillers_hit += usize::from(fillers.contains(&hit.triangle));
        }
        assert_eq!(fillers_hit, 0, "{structure:?}");
    }
}

/// Corners on one line, at x = 10, and a triangle with an area far from it.
fn line_and_triangle() -> Mesh {
    let line = [Vec3::new(10.0, -1.0, -1.0), Vec3::new(10.0, 0.0, 0.0), Vec3::new(10.0, 2.0, 2.0)];
    let positions = line.into_iter().chain([Vec3::ZERO, Vec3::Y, Vec3::Z]).collect();
    Mesh { positions, indices: vec![[0, 1, 2], [3, 4, 5], [2, 0, 1], [1, 1, 2]] }
}

#[test]
fn nothing_finds_a_triangle_without_area() {
    for structure in STRUCTURES {
        let (mut scene, mut compiler) = compiled(&line_and_triangle(), structure);
        let aimed = |target: Vec3| {
            let origin = Vec3::new(14.0, -1.0, 0.5);
            let direction = (target - origin).to_array();
            RayRecord { origin: origin.to_array(), t_min: 0.0, direction, t_max: 1.5 }
        };
        let rays: Vec<RayRecord> =
            (0..=300).map(|i| aimed(Vec3::new(10.0, i as f32 / 100.0 - 1.0, i as f32 / 100.0 - 1.0))).collect();
        for tracer in &mut tracers() {
            tracer.upload(compiler.arrays_mut()).unwrap();
            let hits = tracer.closest_hits(compiler.arrays(), &rays, 1).unwrap();
            assert!(hits.iter().all(|hit| hit.instance == NONE), "{structure:?}");
            let blocked = tracer.any_hits(compiler.arrays(), &rays, 1).unwrap();
            assert!(blocked.iter().all(|&blocked| !blocked), "{structure:?}");
        }
        let queries = Queries::new(&mut compiler, &mut scene).unwrap();
        let nearest = queries.nearest(DVec3::new(10.0, 0.0, 0.0), f64::INFINITY).unwrap().unwrap();
        assert_eq!((nearest.triangle, nearest.distance), (1, 10.0), "{structure:?}");
        let around = |x: f64| Bounds { min: DVec3::new(x - 0.5, -3.0, -3.0), max: DVec3::new(x + 0.5, 3.0, 3.0) };
        let found = |x: f64, overlap| queries.overlapping(&Region::new_box(&around(x)).unwrap(), overlap).len();
        assert_eq!([found(10.0, Overlap::Touching), found(10.0, Overlap::Inside)], [0, 0], "{structure:?}");
        assert_eq!([found(0.0, Overlap::Touching), found(0.0, Overlap::Inside)], [1, 1], "{structure:?}");
    }
}

#[test]
fn a_geometry_without_any_area_is_an_empty_structure() {
    let Mesh { positions, .. } = line_and_triangle();
    let line = Mesh { positions, indices: vec![[0, 1, 2], [2, 0, 1], [1, 1, 2]] };
    for structure in STRUCTURES {
        let (mut scene, mut compiler) = compiled(&line, structure);
        assert_eq!((compiler.arrays().triangles.len(), compiler.arrays().blas_nodes.len()), (0, 0), "{structure:?}");
        let queries = Queries::new(&mut compiler, &mut scene).unwrap();
        assert_eq!(queries.nearest(DVec3::ZERO, f64::INFINITY).unwrap(), None);
    }
}
