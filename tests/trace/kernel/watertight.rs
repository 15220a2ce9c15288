//! Watertightness: no ray passes between triangles that share an edge or a vertex, and none misses a box that it
//! touches.

#![allow(clippy::panic, clippy::unwrap_used, reason = "a test fails by panicking")]

use glam::{DAffine3, DQuat, DVec3, Vec3};
use ropewalk::device::layout::{NONE, RayRecord};
use ropewalk::trace::{Cpu, Emulated, Tracer, Traversal};
use ropewalk_testkit::{Builder, Mesh, Placed, Random, arrays_by, tracers};

/// Rays into each mesh at each scale: half of them with scaled geometry, half with a scaled instance of it.
const RAYS: usize = 500_000;
/// Rays traced at once.
const BATCH: usize = 1 << 16;

fn ray(origin: Vec3, direction: Vec3) -> RayRecord {
    RayRecord { origin: origin.to_array(), t_min: 0.0, direction: direction.to_array(), t_max: f32::MAX }
}

/// The origin, near the centre of a mesh, and the direction of a ray at a vertex, at a point of an edge, or at a point
/// within a triangle.
fn ray_from_inside(random: &mut Random, mesh: &Mesh, radius: f32) -> (Vec3, Vec3) {
    let [a, b, c] = mesh.triangle(random.index(mesh.indices.len()));
    let (s, t) = (random.unsigned(), random.unsigned());
    let target = match random.index(3) {
        0 => a,
        1 => a + (b - a) * s,
        _ => a + ((b - a) * s + (c - a) * (1.0 - s) * t),
    };
    // Half of the rays start exactly at the centre, so that those at vertices lie exactly in many planes of boxes and
    // edges.
    let origin = if random.index(2) == 0 { Vec3::ZERO } else { random.in_cube() * radius * 0.3 };
    (origin, target - origin)
}

/// Traces `RAYS / 2` rays from inside a closed mesh, and panics if any of them misses it.
fn none_escapes(tracer: &mut dyn Tracer, builder: Builder, mesh: &Mesh, radius: f32, world_from_local: DAffine3) {
    let mut arrays = arrays_by(builder, std::slice::from_ref(mesh), &[Placed::new(0, world_from_local)]);
    tracer.upload(&mut arrays).unwrap();
    let mut random = Random::new(radius.to_bits().into());
    let world = world_from_local.as_affine3a();
    let mut traced = 0;
    while traced < RAYS / 2 {
        let rays: Vec<RayRecord> = (0..BATCH)
            .map(|_| ray_from_inside(&mut random, mesh, radius))
            .map(|(origin, direction)| ray(world.transform_point3(origin), world.transform_vector3(direction)))
            .collect();
        let hits = tracer.closest_hits(&arrays, &rays, 1).unwrap();
        assert_eq!(hits.len(), rays.len());
        let escaped: Vec<&RayRecord> =
            rays.iter().zip(&hits).filter(|(_, h)| h.instance == NONE).map(|(r, _)| r).collect();
        let device = tracer.device().executor;
        assert!(escaped.is_empty(), "{device}: {} of {BATCH} rays escape, as {:?}", escaped.len(), escaped[0]);
        traced += rays.len();
    }
}

/// Two closed meshes of 81,920 triangles, as geometry of three sizes and under transforms of three sizes.
fn no_ray_escapes_closed_meshes(tracer: &mut dyn Tracer) {
    for mesh in [Mesh::icosphere(6), Mesh::displaced_icosphere(6)] {
        for scale in [1e-6, 1.0, 1e6] {
            none_escapes(tracer, Builder::Product, &mesh.clone().scaled(scale), scale, DAffine3::IDENTITY);
            let rotation = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.0);
            let size = DVec3::splat(scale.into());
            let translation = size * DVec3::new(0.3, -2.0, 1.0);
            let world_from_local = DAffine3::from_scale_rotation_translation(size, rotation, translation);
            none_escapes(tracer, Builder::Product, &mesh, 1.0, world_from_local);
        }
    }
}

#[test]
fn no_ray_escapes_closed_meshes_emulated() {
    no_ray_escapes_closed_meshes(&mut Emulated::default().with_traversal(Traversal::Rope));
}

#[test]
fn no_ray_escapes_closed_meshes_emulated_wide() {
    no_ray_escapes_closed_meshes(&mut Emulated::default().with_traversal(Traversal::Wide));
}

#[test]
fn no_ray_escapes_closed_meshes_cpu() {
    no_ray_escapes_closed_meshes(&mut Cpu::default());
}

#[cfg(feature = "gpu")]
#[test]
fn no_ray_escapes_closed_meshes_gpu() {
    if let Some(gpu) = ropewalk_testkit::gpu::tracer() {
        no_ray_escapes_closed_meshes(&mut gpu.with_traversal(Traversal::Rope));
    }
}

#[cfg(feature = "gpu")]
#[test]
fn no_ray_escapes_closed_meshes_gpu_wide() {
    if let Some(gpu) = ropewalk_testkit::gpu::tracer() {
        no_ray_escapes_closed_meshes(&mut gpu.with_traversal(Traversal::Wide));
    }
}

/// Traces rays that must all hit the mesh, at a t that `is_right` accepts.
fn all_hit(mesh: &Mesh, rays: &[RayRecord], is_right: impl Fn(f32) -> bool) {
    assert!(!rays.is_empty());
    for builder in Builder::BOTH {
        let mut arrays = arrays_by(builder, std::slice::from_ref(mesh), &[Placed::new(0, DAffine3::IDENTITY)]);
        for tracer in &mut tracers() {
            tracer.upload(&mut arrays).unwrap();
            let hits = tracer.closest_hits(&arrays, rays, 1).unwrap();
            let blocked = tracer.any_hits(&arrays, rays, 1).unwrap();
            for ((ray, hit), blocked) in rays.iter().zip(&hits).zip(blocked) {
                let device = tracer.device().executor;
                assert!(hit.instance != NONE && is_right(hit.t), "{device}, {builder:?}: {ray:?} hits {hit:?}");
                assert!(blocked, "{device}, {builder:?}: {ray:?} meets nothing");
            }
        }
    }
}

/// Vectors whose components are a sign on one axis and, on the others, every mixture of 0 and -0.
fn axis_directions() -> Vec<(usize, Vec3)> {
    let mut directions = Vec::new();
    for axis in 0..3 {
        for bits in 0..8 {
            let signs = Vec3::from_array([0, 1, 2].map(|i| if bits >> i & 1 == 0 { 1.0 } else { -1.0 }));
            let mut direction = Vec3::ZERO * signs;
            direction[axis] = signs[axis];
            directions.push((axis, direction));
        }
    }
    directions
}

const CUBE_SIZES: [f32; 5] = [1e-20, 1e-3, 1.0, 3e4, 1e20];

#[test]
fn rays_along_an_axis_hit_a_box_whose_face_plane_they_lie_in() {
    for size in CUBE_SIZES {
        let mut rays = Vec::new();
        for (axis, direction) in axis_directions() {
            for (u, v) in [(1.0, 0.25), (-1.0, 0.5), (0.0, 1.0), (-0.0, -1.0), (1.0, -1.0), (0.25, 0.5), (0.0, -0.0)] {
                let mut origin = -3.0 * direction;
                origin[(axis + 1) % 3] = u;
                origin[(axis + 2) % 3] = v;
                rays.push(ray(origin * size, direction * size));
            }
        }
        all_hit(&Mesh::cube().scaled(size), &rays, |t| (t - 2.0).abs() < 4.0 * f32::EPSILON);
    }
}

#[test]
fn rays_that_start_on_a_box_face_hit_the_box() {
    for size in CUBE_SIZES {
        let mut rays = Vec::new();
        for (axis, direction) in axis_directions() {
            for face in [1.0, -1.0] {
                // A point on the face through which the ray leaves, and one on a face that the ray lies in.
                let mut origin = Vec3::splat(0.25);
                origin[axis] = face;
                rays.push(ray(origin * size, direction * size));
                let mut origin = Vec3::splat(0.25);
                origin[axis] = 0.0;
                origin[(axis + 1) % 3] = face;
                rays.push(ray(origin * size, direction * size));
            }
        }
        all_hit(&Mesh::cube().scaled(size), &rays, |t| t == 0.0 || (t - 1.0).abs() < 2.0 * f32::EPSILON);
    }
}

#[test]
fn rays_through_the_grid_lines_of_a_flat_mesh_hit_it() {
    // A square of flat boxes whose faces lie on whole numbers, in each of the three coordinate planes.
    const SIDE: u32 = 33;
    for axis in 0..3 {
        let point = |u: f32, v: f32, w: f32| {
            let mut p = Vec3::ZERO;
            (p[(axis + 1) % 3], p[(axis + 2) % 3], p[axis]) = (u, v, w);
            p
        };
        let corner = |i: u32| point((i % SIDE) as f32, (i / SIDE) as f32, 0.0);
        let cells = (0..SIDE - 1).flat_map(|y| (0..SIDE - 1).map(move |x| y * SIDE + x));
        let indices = cells.flat_map(|i| [[i, i + 1, i + SIDE], [i + 1, i + SIDE + 1, i + SIDE]]).collect();
        let mesh = Mesh { positions: (0..SIDE * SIDE).map(corner).collect(), indices };

        let last = 2 * (SIDE - 1);
        let halves = (0..=last).flat_map(|y| (0..=last).map(move |x| (x as f32 * 0.5, y as f32 * 0.5)));
        let rays: Vec<RayRecord> = halves
            .flat_map(|(u, v)| {
                let down = ray(point(u, v, 8.0), point(0.0, 0.0, -2.0));
                let up = ray(point(u, v, -8.0), point(-0.0, 0.0, 2.0));
                let slanted = ray(point(u, 16.0, 4.0), point(0.0, v - 16.0, -4.0) * 0.25);
                [down, up, slanted]
            })
            .collect();
        all_hit(&mesh, &rays, |t| (t - 4.0).abs() < 8.0 * f32::EPSILON);
    }
}
