//! Tracers with their options, over the same triangles: who is compared with whom in the charts about rays.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use ropewalk::accel::{Blas, BlasBuildParams};
use ropewalk::compile::Compiler;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{HitRecord, NONE, Node, PrimitiveRange, RayRecord};
use ropewalk::graph::BlasKind;
use ropewalk::query::Queries;
use ropewalk::render::{BatchOptions, Precision};
use ropewalk::trace::{Cpu, Emulated, Tracer as _, Traversal};
use ropewalk::{Core, DeviceChoice, Material, Ray, Renderer, RendererOptions, Scene};
use ropewalk_bench::Result;
use ropewalk_bench::columns::{Column, Hit, PEERS, peer, soup};
use ropewalk_bench::embree::Embree;
use ropewalk_bench::rays::meet;

use crate::chart::Point;

/// What finds hits, and how long that takes.
pub trait Tracing: Sync {
    /// What each ray hits first, and the time from rays to hits, without any structure's.
    ///
    /// # Errors
    /// Those of the tracer.
    fn trace(&self, rays: &[RayRecord]) -> Result<(Vec<Hit>, Duration)>;
}

/// A tracer as a point of a chart.
pub struct Contender<'a> {
    pub curve: &'static str,
    pub label: String,
    pub is_default: bool,
    pub tracing: Box<dyn Tracing + 'a>,
}

impl<'a> Contender<'a> {
    pub fn new(curve: &'static str, label: impl Into<String>, tracing: impl Tracing + 'a) -> Self {
        Self { curve, label: label.into(), is_default: false, tracing: Box::new(tracing) }
    }

    /// A point of the chart, nowhere yet.
    pub fn point(&self) -> Point {
        Point { label: self.label.clone(), is_default: self.is_default, ..Point::default() }
    }

    pub fn with_default(self, is_default: bool) -> Self {
        Self { is_default, ..self }
    }
}

/// All peers that there are here. Embree is one that was opened, or why there is none.
pub fn peers<'a>(triangles: &[[Vec3; 3]], embree: std::result::Result<&'a Embree, &str>) -> Result<Vec<Contender<'a>>> {
    let names = PEERS.iter().filter(|name| embree.is_ok() || !name.starts_with("Embree"));
    let contender = |&name: &&'static str| Ok(Contender::new("peers", name, Peer(peer(name, triangles, embree)?)));
    names.map(contender).collect()
}

/// What a peer needs to lay out a ray its own way is on the clock.
struct Peer<'a>(Box<dyn Column + 'a>);

impl Tracing for Peer<'_> {
    fn trace(&self, rays: &[RayRecord]) -> Result<(Vec<Hit>, Duration)> {
        timed(|| self.0.closest(rays))
    }
}

fn timed(trace: impl FnOnce() -> Result<Vec<Hit>>) -> Result<(Vec<Hit>, Duration)> {
    let start = Instant::now();
    let hits = trace()?;
    Ok((hits, start.elapsed()))
}

/// How rays go through device arrays.
#[derive(Clone, Copy)]
pub enum Executor {
    Cpu,
    Emulated(Traversal),
    /// Along the escape indices, with the triangle test of a textbook.
    MoellerTrumbore,
}

/// An executor over one geometry.
pub struct OverArrays {
    compiler: Compiler,
    executor: Executor,
}

impl OverArrays {
    /// Over triangles with a structure that is built with these parameters.
    pub fn new(triangles: &[[Vec3; 3]], params: &BlasBuildParams, executor: Executor) -> Result<Self> {
        let (mut scene, mut compiler) = (scene_of(triangles, params.structure)?, Compiler::new());
        compiler.compile(&mut scene, DVec3::ZERO)?;
        let blas = Blas::build(&soup(triangles), params)?;
        let arrays = compiler.arrays_mut();
        arrays.blas_nodes.replace(&blas.nodes);
        arrays.wide_nodes.replace(&blas.wide_nodes);
        arrays.triangles.replace(&blas.triangles);
        Ok(Self { compiler, executor })
    }
}

impl OverArrays {
    fn closest(&self, rays: &[RayRecord]) -> Result<Vec<Hit>> {
        let arrays = self.compiler.arrays();
        let records = match self.executor {
            Executor::Cpu => Cpu::default().closest_hits(arrays, rays, NONE)?,
            Executor::Emulated(traversal) => {
                Emulated::default().with_traversal(traversal).closest_hits(arrays, rays, NONE)?
            }
            Executor::MoellerTrumbore => return Ok(rays.iter().map(|ray| moeller_trumbore(arrays, ray)).collect()),
        };
        let hit = |record: &HitRecord| match record.instance {
            NONE => Hit::MISS,
            _ => Hit { primitive: record.primitive, t: record.t.into() },
        };
        Ok(records.iter().map(hit).collect())
    }
}

impl Tracing for OverArrays {
    fn trace(&self, rays: &[RayRecord]) -> Result<(Vec<Hit>, Duration)> {
        timed(|| self.closest(rays))
    }
}

/// Along the escape indices of the only geometry.
fn moeller_trumbore(arrays: &DeviceArrays, ray: &RayRecord) -> Hit {
    let (origin, reciprocal) = (Vec3::from_array(ray.origin), Vec3::from_array(ray.direction).recip());
    let is_met = |node: &Node, t_max: f32| {
        let [a, b] = [node.min, node.max].map(|corner| (Vec3::from_array(corner) - origin) * reciprocal);
        a.min(b).max_element().max(ray.t_min) <= a.max(b).min_element().min(t_max)
    };
    let (mut hit, mut t_max, mut index) = (Hit::MISS, ray.t_max, 0);
    while let Some(node) = arrays.blas_nodes.get(index as usize) {
        let is_met = is_met(node, t_max);
        index = if is_met && node.primitives == PrimitiveRange::INNER { index + 1 } else { node.escape_index };
        let count = if is_met { node.primitives.primitive_count() as usize } else { 0 };
        let first = node.primitives.first_primitive() as usize;
        for triangle in arrays.triangles.get(first..first + count).unwrap_or_default() {
            let corners = [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from_array);
            if let Some(t) = meet(ray, &corners, t_max) {
                (hit, t_max) = (Hit { primitive: triangle.primitive, t: t.into() }, t);
            }
        }
    }
    hit
}

/// `Renderer::closest_hits`.
pub struct Batches {
    pub triangles: Vec<[Vec3; 3]>,
    pub precision: Precision,
}

impl Tracing for Batches {
    fn trace(&self, rays: &[RayRecord]) -> Result<(Vec<Hit>, Duration)> {
        // A renderer stays in its thread.
        let mut scene = scene_of(&self.triangles, None)?;
        let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu))?;
        renderer.prepare(&mut scene)?;
        let options = BatchOptions::default().with_precision(self.precision);
        timed(|| {
            let rays: Vec<Ray> = rays.iter().map(in_f64).collect();
            let hits = renderer.closest_hits(&mut scene, &rays, options)?;
            let found = |hit: ropewalk::Hit| Hit { primitive: hit.triangle, t: hit.distance };
            Ok(hits.iter().map(|hit| hit.map_or(Hit::MISS, found)).collect())
        })
    }
}

/// `Queries::closest_hit`, ray by ray.
pub struct Exact(Mutex<(Compiler, Scene)>);

impl Exact {
    pub fn new(triangles: &[[Vec3; 3]]) -> Result<Self> {
        Ok(Self(Mutex::new((Compiler::new(), scene_of(triangles, None)?))))
    }
}

impl Tracing for Exact {
    fn trace(&self, rays: &[RayRecord]) -> Result<(Vec<Hit>, Duration)> {
        let mut inner = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (compiler, scene) = &mut *inner;
        let queries = Queries::new(compiler, scene)?;
        let closest = |ray: &RayRecord| {
            let hit = queries.closest_hit(&in_f64(ray))?;
            Ok(hit.map_or(Hit::MISS, |hit| Hit { primitive: hit.triangle, t: hit.distance }))
        };
        timed(|| rays.par_iter().map(closest).collect::<ropewalk::Result<_>>().map_err(Into::into))
    }
}

/// One geometry of these triangles, opaque and two-sided, at the world's origin.
fn scene_of(triangles: &[[Vec3; 3]], structure: impl Into<Option<BlasKind>>) -> Result<Scene> {
    let mut scene = Scene::new();
    let geometry = scene.add_geometry(soup(triangles).with_blas_kind(structure))?;
    let material = scene.add_material(Material { double_sided: true, ..Material::default() })?;
    scene.add(scene.root(), Core::Geometry { geometry, material })?;
    Ok(scene)
}

fn in_f64(ray: &RayRecord) -> Ray {
    let [origin, direction] = [ray.origin, ray.direction].map(|v| Vec3::from_array(v).as_dvec3());
    Ray { origin, direction, t_min: ray.t_min.into(), t_max: ray.t_max.into() }
}
