//! Meshes that deform in every frame: the time of refits and of rebuilds, and the cost of rays after many refits.
//!
//! First the time to follow a mesh whose vertices have all moved, in turns with the crate `obvhs`. Then frames of a
//! motion, in which a structure is refitted until its cost has grown by some factor and then built anew: how often that
//! happens, and how many nodes and triangles rays meet, in units of a structure that is built for each frame.

use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use glam::{DVec3, Quat, Vec3};
use obvhs::BvhBuildParams;
use obvhs::bvh2::builder::build_bvh2;
use ropewalk::accel::{Blas, BlasBuildParams};
use ropewalk::compile::Compiler;
use ropewalk::device::layout::NONE;
use ropewalk::graph::{BlasKind, Quality};
use ropewalk::{Core, Geometry, Material, Scene, gltf};
use ropewalk_bench::scenes::scenes_folder;
use ropewalk_bench::{Contender, Options, Report, Target, medians, milliseconds, time};

/// The factors by which the cost may grow since the last build before a rebuild.
const LIMITS: [f64; 6] = [1.0, 1.1, 1.25, 1.5, 2.0, f64::INFINITY];
const FRAMES: u32 = 60;
const RAYS: usize = 4000;

fn main() -> ExitCode {
    let options = Options::parse();
    let mut report =
        Report::new(&["mesh", "triangles", "what", "ms", "Mtriangles/s", "times refit", "rebuilds", "ray cost"]);
    let mut meshes: Vec<Mesh> = vec![("wave", sheet(316), wave)];
    for (name, file) in [("twist: bunny", "stanford-bunny"), ("twist: dragon", "stanford-dragon")] {
        match import(file) {
            Ok(geometry) => meshes.push((name, geometry, twist)),
            Err(error) => eprintln!("{error} (set ROPEWALK_SCENES)"),
        }
    }
    for mesh in &meshes {
        times(mesh, if options.quick { 5 } else { 15 }, &mut report);
    }
    for mesh in meshes.iter().take(if options.quick { 1 } else { 2 }) {
        rebuild_limits(mesh, &mut report);
    }
    report.finish(&options)
}

/// Its name, its rest pose, and how it moves: the positions at a time in seconds.
type Mesh = (&'static str, Geometry, fn(&Geometry, f32) -> Vec<Vec3>);

/// A flat sheet of 2 * `cells` * `cells` triangles.
fn sheet(cells: u32) -> Geometry {
    let place =
        |i: u32| Vec3::new((i % (cells + 1)) as f32, 0.0, (i / (cells + 1)) as f32) * (2.0 / cells as f32) - 1.0;
    let corners = (0..cells * cells).map(|i| i + i / cells);
    let triangles = corners.flat_map(|a| [[a, a + 1, a + cells + 2], [a, a + cells + 2, a + cells + 1]]);
    Geometry::new((0..(cells + 1).pow(2)).map(place).collect::<Vec<_>>(), triangles.collect::<Vec<_>>())
}

/// Waves from a corner, and a sheet that furls.
fn wave(geometry: &Geometry, time: f32) -> Vec<Vec3> {
    let roll = |p: &Vec3| {
        let height = 0.15 * ((p.x * 5.0 + p.z * 3.0) - 4.0 * time).sin();
        Quat::from_rotation_z(0.4 * time * p.z) * Vec3::new(p.x, height, p.z)
    };
    geometry.positions.iter().map(roll).collect()
}

/// Twisted about the vertical axis, back and forth.
fn twist(geometry: &Geometry, time: f32) -> Vec<Vec3> {
    let (low, high) = geometry.positions.iter().fold((f32::MAX, f32::MIN), |(l, h), p| (l.min(p.y), h.max(p.y)));
    let turn = |p: &Vec3| Quat::from_rotation_y((time * 1.5).sin() * 3.0 * (p.y - low) / (high - low)) * *p;
    geometry.positions.iter().map(turn).collect()
}

fn import(file: &str) -> ropewalk::Result<Geometry> {
    let scenes = scenes_folder();
    let mut scene = Scene::new();
    let root = scene.root();
    gltf::import(scenes.join(format!("meshes/{file}.glb")), &mut scene, root)?;
    Ok(scene.geometries().next().map(|(_, geometry)| geometry.clone()).unwrap_or_default())
}

fn at(mesh: &Mesh, time: f32) -> Geometry {
    let (_, geometry, motion) = mesh;
    Geometry { positions: motion(geometry, time).into(), normals: None, ..geometry.clone() }
}

fn params(quality: Quality) -> BlasBuildParams {
    BlasBuildParams::new(BlasKind::Bvh(quality))
}

fn build(geometry: &Geometry, quality: Quality) -> Blas {
    Blas::build(geometry, &params(quality)).expect("the mesh is sound")
}

fn times(mesh: &Mesh, samples: usize, report: &mut Report) {
    // Two poses in turn: every triangle moves every time.
    let poses = [at(mesh, 0.5), at(mesh, 0.55)];
    let count = poses[0].indices.len();
    let mut blas = build(&poses[0], Quality::Medium);
    let (mut shown, mut peer) = (Shown::new(&poses[0]), Peer::new(&poses[0]));
    let [mut a, mut b, mut c, mut d, mut e] = [0; 5];
    let turn = |which: &mut usize| {
        *which ^= 1;
        &poses[*which]
    };
    let mut contenders: Vec<(&str, Contender)> = vec![
        ("refit", Box::new(|| time(|| assert!(blas.refit(turn(&mut a)))))),
        ("build, low", Box::new(|| time(|| build(turn(&mut b), Quality::Low)))),
        ("build, medium", Box::new(|| time(|| build(turn(&mut c), Quality::Medium)))),
        ("set_positions and compile", Box::new(|| shown.pose(turn(&mut d)))),
        ("obvhs refit, one thread", Box::new(|| time(|| peer.refit(turn(&mut e))))),
        ("obvhs build, fastest", Box::new(|| time(|| Peer::new(&poses[0])))),
    ];
    let (names, mut contenders): (Vec<&str>, Vec<Contender>) = contenders.drain(..).unzip();
    let times = medians(samples, &mut contenders);
    for (name, took) in names.iter().zip(&times) {
        report.row([
            mesh.0.into(),
            count.to_string(),
            (*name).into(),
            milliseconds(*took),
            format!("{:.1}", count as f64 / took.as_secs_f64() * 1e-6),
            format!("{:.2}", took.as_secs_f64() / times[0].as_secs_f64()),
            String::new(),
            String::new(),
        ]);
    }
    let ratio = |other: usize| times[other].as_secs_f64() / times[0].as_secs_f64();
    report.goal(format!("refit_{}_against_fast_build", mesh.0), ratio(1), Target::AtLeast(3.0), "x");
    report.goal(format!("refit_{}_against_obvhs", mesh.0), ratio(4), Target::AtLeast(1.0), "x");
}

/// A scene with one geometry, and its compiler.
struct Shown {
    scene: Scene,
    compiler: Compiler,
    key: ropewalk::GeometryKey,
}

impl Shown {
    fn new(geometry: &Geometry) -> Self {
        let (mut scene, mut compiler) = (Scene::new(), Compiler::new());
        let material = scene.add_material(Material::default()).expect("it is sound");
        let key = scene.add_geometry(geometry.clone()).expect("the mesh is sound");
        scene.add(scene.root(), Core::Geometry { geometry: key, material }).expect("the root is there");
        compiler.compile(&mut scene, DVec3::Z).expect("it fits");
        Self { scene, compiler, key }
    }

    /// The time from new positions to changed device arrays.
    fn pose(&mut self, geometry: &Geometry) -> Duration {
        time(|| {
            self.scene.set_positions(self.key, geometry.positions.clone(), None).expect("as many as before");
            let report = self.compiler.compile(&mut self.scene, DVec3::Z).expect("it fits");
            self.compiler.arrays_mut().clear_dirty();
            report
        })
    }
}

/// A structure of `obvhs`, with one triangle a leaf, and the triangles.
struct Peer {
    bvh: obvhs::bvh2::Bvh2,
    triangles: Vec<obvhs::triangle::Triangle>,
}

impl Peer {
    fn new(geometry: &Geometry) -> Self {
        let triangles: Vec<_> = (0..geometry.indices.len()).map(|i| Self::triangle(geometry, i)).collect();
        let boxes: Vec<_> = triangles.iter().map(obvhs::triangle::Triangle::aabb).collect();
        let mut bvh = build_bvh2(&boxes, BvhBuildParams::fastest_build(), &mut Duration::default());
        bvh.init_primitives_to_nodes_if_uninit();
        Self { bvh, triangles }
    }

    fn triangle(geometry: &Geometry, i: usize) -> obvhs::triangle::Triangle {
        let [v0, v1, v2] = geometry.indices[i].map(|v| geometry.positions[v as usize].into());
        obvhs::triangle::Triangle { v0, v1, v2 }
    }

    fn refit(&mut self, geometry: &Geometry) {
        for (i, triangle) in self.triangles.iter_mut().enumerate() {
            *triangle = Self::triangle(geometry, i);
            self.bvh.nodes[self.bvh.primitives_to_nodes[i] as usize].set_aabb(triangle.aabb());
        }
        self.bvh.refit_all();
    }
}

/// Frames of two seconds or more of a motion, with each limit.
fn rebuild_limits(mesh: &Mesh, report: &mut Report) {
    let frames: Vec<Geometry> = (0..FRAMES).map(|frame| at(mesh, frame as f32 / 30.0)).collect();
    let fresh: Vec<f64> = frames.iter().map(|geometry| ray_cost(&build(geometry, Quality::Medium))).collect();
    for limit in LIMITS {
        let mut blas = build(&frames[0], Quality::Medium);
        let (mut built_cost, mut rebuilds, mut costs) = (blas.stats().sah_cost, 0, Vec::new());
        for (geometry, fresh) in frames.iter().zip(&fresh) {
            if !blas.refit(geometry) || blas.stats().sah_cost > built_cost * limit {
                blas = build(geometry, Quality::Medium);
                built_cost = blas.stats().sah_cost;
                rebuilds += 1;
            }
            costs.push(ray_cost(&blas) / fresh);
        }
        let mean = costs.iter().sum::<f64>() / costs.len() as f64;
        let most = costs.iter().copied().fold(0.0, f64::max);
        report.row([
            mesh.0.into(),
            mesh.1.indices.len().to_string(),
            format!("limit {limit}"),
            String::new(),
            String::new(),
            String::new(),
            format!("{rebuilds} of {FRAMES}"),
            format!("{mean:.3} (at most {most:.3})"),
        ]);
    }
}

/// Nodes fetched and, at their cost, triangles tested, by rays from all around to random triangles, up to the first
/// hit.
fn ray_cost(blas: &Blas) -> f64 {
    let mut random = fastrand::Rng::with_seed(1);
    let mut signed = || random.f32() * 2.0 - 1.0;
    let (center, size) = (blas.bounds.center(), (blas.bounds.max - blas.bounds.min).length());
    let step = blas.triangles.len() / RAYS;
    let triangle_cost = f64::from(BlasBuildParams::default().triangle_cost);
    let mut cost = 0.0;
    // The rays' targets must not depend on the structure.
    let mut by_primitive: Vec<usize> = (0..blas.triangles.len()).collect();
    by_primitive.sort_unstable_by_key(|&i| blas.triangles[i].primitive);
    for ray in 0..RAYS {
        let aim = &blas.triangles[by_primitive[ray * step]];
        let target = (Vec3::from(aim.v0) + Vec3::from(aim.v1) + Vec3::from(aim.v2)) / 3.0;
        let origin = center + Vec3::new(signed(), signed(), signed()).normalize_or(Vec3::X) * size;
        let direction = target - origin;
        let inverse = direction.recip();
        let (mut index, mut t_max) = (0, f32::INFINITY);
        while let Some(node) = blas.nodes.get(index as usize) {
            cost += 1.0;
            let [a, b] = [node.min, node.max].map(|corner| (Vec3::from(corner) - origin) * inverse);
            let (near, far) = (a.min(b).max_element().max(0.0), a.max(b).min_element().min(t_max));
            let is_met = near <= far * 1.00001;
            let count = if is_met { node.primitives.primitive_count() as usize } else { 0 };
            let first = node.primitives.first_primitive() as usize;
            for triangle in blas.triangles.get(first..first + count).unwrap_or_default() {
                cost += triangle_cost;
                let corners = [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from);
                t_max = t_max.min(distance(origin, direction, corners));
            }
            index = if is_met && node.primitives.primitive_count() == 0 { index + 1 } else { node.escape_index };
            if index == NONE {
                break;
            }
        }
    }
    cost / RAYS as f64
}

/// Möller and Trumbore 1997; infinite for a miss.
fn distance(origin: Vec3, direction: Vec3, [v0, v1, v2]: [Vec3; 3]) -> f32 {
    let (e1, e2) = (v1 - v0, v2 - v0);
    let p = direction.cross(e2);
    let inverse = e1.dot(p).recip();
    let s = origin - v0;
    let u = s.dot(p) * inverse;
    let q = s.cross(e1);
    let (v, t) = (direction.dot(q) * inverse, e2.dot(q) * inverse);
    if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 { t } else { f32::INFINITY }
}
