//! The rules by which hits count: masks, culling, flags, nothing to hit, weights, cameras.

use fastrand::Rng;
use glam::{DAffine3, DVec3, Vec3, Vec4};
use ropewalk::device::layout::{HitRecord, NONE, RayRecord};
use ropewalk::graph::AlphaMode;
use ropewalk::trace::{Cpu, Emulated, Recursive, Tracer, Traversal};
use ropewalk::{Camera, Core, DeviceChoice, Material, Renderer, RendererOptions, Scene, View};
use ropewalk_bench::Result;
use ropewalk_bench::columns::Placed;
use ropewalk_bench::exact::{Ends, Oracle, widened};

use crate::row::{Goal, Recipe, Row};
use crate::world::World;
use ropewalk_bench::aim::{any, at_all_parts, direction, inside, point, quantised, ray};
use ropewalk_bench::meshes::{bumpy, grid, moved, round};

pub const ROWS: [Recipe; 13] = [
    Recipe { name: "embree: ray_masks", goal: Goal::Zero, make: |rays| masks(rays, 1) },
    Recipe { name: "vulkan: ray_cull_mask", goal: Goal::Zero, make: |rays| masks(rays, 1 << 31) },
    Recipe { name: "embree: backface_culling", goal: Goal::Zero, make: |rays| culled(rays, DVec3::ONE) },
    Recipe {
        name: "vulkan: instance_triangle_culling",
        goal: Goal::Zero,
        make: |rays| culled(rays, DVec3::new(2.0, 2.0, 2.0)),
    },
    Recipe {
        name: "vulkan: preserve_flip_facing",
        goal: Goal::Zero,
        make: |rays| culled(rays, DVec3::new(-1.0, 1.0, 1.0)),
    },
    Recipe { name: "vulkan: ray_flags, any hit of what is opaque", goal: Goal::Zero, make: any_hits },
    Recipe { name: "vulkan: ray_flags, no hit of what is not", goal: Goal::Zero, make: no_opaque },
    Recipe { name: "vulkan: empty no_geometries", goal: Goal::Zero, make: |rays| nothing(rays, Nothing::NoGeometries) },
    Recipe { name: "vulkan: empty no_primitives", goal: Goal::Zero, make: |rays| nothing(rays, Nothing::NoPrimitives) },
    Recipe {
        name: "vulkan: empty inactive_triangles",
        goal: Goal::Zero,
        make: |rays| nothing(rays, Nothing::WithoutArea),
    },
    Recipe { name: "vulkan: empty inactive_instances", goal: Goal::Zero, make: |rays| nothing(rays, Nothing::Hidden) },
    Recipe { name: "vulkan: barycentric_coordinates", goal: Goal::NoLeaks, make: barycentrics },
    Recipe { name: "camera on a surface", goal: Goal::Zero, make: camera_on_a_surface },
];

/// From within two spheres, of which a ray sees the outer one only.
fn masks(rays: usize, mask: u32) -> Result<Row> {
    let mut world = World::default();
    let triangles = round();
    let hidden = world.add(&triangles, DAffine3::IDENTITY)?;
    world.scene.set_mask(hidden, !mask)?;
    world.hide_all();
    let seen = world.add(&triangles, DAffine3::from_scale(DVec3::splat(2.0)))?;
    world.scene.set_mask(seen, mask)?;
    let rays = from_within(rays, &triangles);
    let (placed, triangles) = world.compile(DVec3::ZERO)?;
    Ok(Row::of_scene(placed.with_ray_mask(mask), triangles, rays))
}

/// From within a single-sided sphere, whose back is not seen, in a larger one that is turned inside out. Under a matrix
/// that mirrors, the outside stays the front.
fn culled(rays: usize, scale: DVec3) -> Result<Row> {
    let mut world = World::default();
    let single_sided = || Material { double_sided: false, ..Material::default() };
    let triangles = round();
    let place = DAffine3::from_scale(scale);
    let core = world.core(&triangles, single_sided())?;
    let root = world.scene.root();
    let parent = world.scene.add(root, ropewalk::Transform::Matrix(place))?;
    world.place(parent, core, &place)?;
    world.hide_all();
    let outer: Vec<[Vec3; 3]> = triangles.iter().map(|&[a, b, c]| [b * 4.0, a * 4.0, c * 4.0]).collect();
    let core = world.core(&outer, single_sided())?;
    world.place(root, core, &DAffine3::IDENTITY)?;
    let rays = from_within(rays, &triangles);
    world.row(rays)
}

fn from_within(rays: usize, triangles: &[[Vec3; 3]]) -> Vec<RayRecord> {
    at_all_parts(&mut Rng::with_seed(160), rays, triangles, |random| quantised(point(random) * 0.5))
}

/// The executors that answer any-hit queries.
fn tracers() -> [(&'static str, Box<dyn Tracer>); 4] {
    [
        ("cpu", Box::new(Cpu::default())),
        ("rope", Box::new(Emulated::default().with_traversal(Traversal::Rope))),
        ("wide", Box::new(Emulated::default().with_traversal(Traversal::Wide))),
        ("recursive", Box::new(Recursive::default())),
    ]
}

/// Within and around a surface: an any-hit query says what the closest hit says.
fn any_hits(rays: usize) -> Result<Row> {
    let mut random = Rng::with_seed(161);
    let triangles = bumpy();
    let rays: Vec<RayRecord> =
        (0..rays / 10).map(|_| ray(quantised(point(&mut random) * 2.0), direction(&mut random))).collect();
    let oracle = Oracle::new(widened(&triangles), Ends::Open);
    let truths = oracle.truths(&rays);
    let placed = Placed::of_triangles(&triangles, None)?;
    let mut faults = Vec::new();
    for (name, mut tracer) in tracers() {
        let (closest, any) = (placed.records(tracer.as_mut(), &rays)?, placed.any_hits(tracer.as_mut(), &rays)?);
        let is_wrong = |((any, hit), must_hit): ((&bool, &HitRecord), bool)| {
            (must_hit && !any) || (*any != (hit.instance != NONE))
        };
        let pairs = any.iter().zip(&closest).zip(truths.iter().map(|truth| truth.must_hit.is_some()));
        faults.push((name, pairs.filter(|&pair| is_wrong(pair)).count() as u64));
    }
    Ok(Row::counted(faults, rays.len()))
}

/// Any-hit queries pass what blends.
fn no_opaque(rays: usize) -> Result<Row> {
    let mut world = World::default();
    let triangles = round();
    let blended =
        Material { base_color: Vec4::new(1.0, 1.0, 1.0, 0.5), alpha_mode: AlphaMode::Blend, ..Material::default() };
    let core = world.core(&triangles, blended)?;
    let root = world.scene.root();
    world.place(root, core, &DAffine3::IDENTITY)?;
    let rays = from_within(rays / 10, &triangles);
    let (placed, _) = world.compile(DVec3::ZERO)?;
    let mut faults = Vec::new();
    for (name, mut tracer) in tracers() {
        let any = placed.any_hits(tracer.as_mut(), &rays)?;
        faults.push((name, any.iter().filter(|&&any| any).count() as u64));
    }
    Ok(Row::counted(faults, rays.len()))
}

enum Nothing {
    NoGeometries,
    NoPrimitives,
    WithoutArea,
    Hidden,
}

/// A scene in which there is nothing to hit.
fn nothing(rays: usize, nothing: Nothing) -> Result<Row> {
    let mut world = World::default();
    let triangles = round();
    match nothing {
        Nothing::NoGeometries => {}
        Nothing::NoPrimitives => {
            world.add(&[], DAffine3::IDENTITY)?;
        }
        Nothing::WithoutArea => {
            world.add(&moved(&triangles, |p| Vec3::new(p.x, 0.0, 0.0)), DAffine3::IDENTITY)?;
        }
        Nothing::Hidden => {
            let node = world.add(&triangles, DAffine3::IDENTITY)?;
            world.scene.set_visible(node, false)?;
            let node = world.add(&triangles, DAffine3::from_scale(DVec3::splat(2.0)))?;
            world.scene.set_mask(node, 0)?;
            world.hide_all();
        }
    }
    world.row(from_within(rays, &triangles))
}

/// The point that the weights of a hit give is that of t, to 2^-18 of the size of the scene.
fn barycentrics(rays: usize) -> Result<Row> {
    let mut random = Rng::with_seed(163);
    let triangles = bumpy();
    let rays = at_all_parts(&mut random, rays / 10, &triangles, |random| quantised(point(random) * 0.4));
    let placed = Placed::of_triangles(&triangles, None)?;
    let is_off = |(ray, hit): &(&RayRecord, &HitRecord)| {
        let Some(&[a, b, c]) = triangles.get(hit.primitive as usize) else { return true };
        let [a, b, c, origin, direction] =
            [a, b, c, ray.origin.into(), ray.direction.into()].map(|v: Vec3| v.as_dvec3());
        let (u, v) = (f64::from(hit.u), f64::from(hit.v));
        let by_weights = a + (b - a) * u + (c - a) * v;
        let by_t = origin + direction * f64::from(hit.t);
        u < 0.0 || v < 0.0 || u + v > 1.0 + 1e-6 || by_weights.distance(by_t) > 1.0 / f64::from(1 << 18)
    };
    let mut faults = Vec::new();
    for (name, mut tracer) in tracers() {
        let hits = placed.records(tracer.as_mut(), &rays)?;
        faults.push((name, rays.iter().zip(&hits).filter(is_off).count() as u64));
    }
    Ok(Row::counted(faults, rays.len()))
}

/// A camera exactly on a floor that looks away from it, at places of the floor at random: no pixel shows the floor.
fn camera_on_a_surface(rays: usize) -> Result<Row> {
    const SIDE: u32 = 10;
    let mut random = Rng::with_seed(164);
    let floor = grid(8, |_, _| 0.0);
    let views: Vec<DVec3> = (0..rays.div_ceil(10_000).max(10))
        .map(|_| {
            let corners = any(&mut random, &floor);
            inside(&mut random, corners).as_dvec3()
        })
        .collect();
    let mut faults = Vec::new();
    for (name, device) in [("cpu", DeviceChoice::Cpu), ("wide", DeviceChoice::Emulated)] {
        let mut renderer = Renderer::new(&RendererOptions::default().with_device(device))?;
        let mut scene = Scene::new();
        let geometry = scene.add_geometry(ropewalk_bench::columns::soup(&floor))?;
        let material = scene.add_material(Material::default())?;
        let root = scene.root();
        scene.add(root, Core::Geometry { geometry, material })?;
        let mut count = 0;
        for &eye in &views {
            let view = View::look_at(eye, eye + DVec3::Z, DVec3::Y, Camera::default(), SIDE, SIDE);
            let image = renderer.render(&mut scene, &View { aovs: true, ..view })?.image()?;
            count += image.aovs.iter().flat_map(|aovs| &aovs.triangle).filter(|&&triangle| triangle != NONE).count();
        }
        faults.push((name, count as u64));
    }
    Ok(Row::counted(faults, views.len() * (SIDE * SIDE) as usize))
}
