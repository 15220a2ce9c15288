//! Ropewalk as columns: its executors, its batches and its queries over one scene.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use ropewalk::compile::Compiler;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{HitRecord, NONE, RayRecord};
use ropewalk::graph::BlasKind;
use ropewalk::query::Queries;
use ropewalk::render::RayMask;
#[cfg(feature = "gpu")]
use ropewalk::trace::gpu::GpuTracer;
use ropewalk::trace::{Cpu, Emulated, Recursive, Tracer, Traversal};
use ropewalk::{Core, DeviceChoice, Geometry, Material, NodeKey, Ray, Renderer, RendererOptions, Scene};

use super::{Column, Hit};
use crate::Result;

/// Rays that one task traces.
const CHUNK: usize = 1 << 12;

/// A compiled scene, and the point that rays are relative to.
pub struct Placed {
    inner: Mutex<(Scene, Compiler)>,
    /// Of each node with a geometry, the index of its first triangle among all.
    first_triangles: HashMap<NodeKey, u32>,
    /// The same for each element of the array of instances; `NONE` for an unused one.
    first_of_instances: Vec<u32>,
    /// Rays are relative to this point.
    origin: DVec3,
    mask: u32,
}

impl Placed {
    /// A scene of nodes with geometries, and the index of the first triangle of each, compiled for an eye. Rays are
    /// relative to [`origin`](Self::origin), a point near it.
    ///
    /// # Errors
    /// As [`Compiler::compile`].
    pub fn new(mut scene: Scene, first_triangles: &[(NodeKey, u32)], eye: DVec3) -> Result<Self> {
        let mut compiler = Compiler::new();
        compiler.compile(&mut scene, eye)?;
        let origin = compiler.origin();
        Self::compiled(scene, compiler, first_triangles, origin)
    }

    /// What rays are relative to.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// The same, compiled as if nobody had ever looked at it: for batches and queries, of rays relative to `origin`.
    ///
    /// # Errors
    /// As [`Compiler::compile`].
    pub fn without_view(mut scene: Scene, first_triangles: &[(NodeKey, u32)], origin: DVec3) -> Result<Self> {
        let mut compiler = Compiler::new();
        compiler.compile_from_last_viewpoint(&mut scene)?;
        Self::compiled(scene, compiler, first_triangles, origin)
    }

    fn compiled(
        mut scene: Scene,
        compiler: Compiler,
        first_triangles: &[(NodeKey, u32)],
        origin: DVec3,
    ) -> Result<Self> {
        let first_triangles = HashMap::from_iter(first_triangles.iter().copied());
        let mut placed =
            Self { inner: Mutex::default(), first_triangles, first_of_instances: Vec::new(), origin, mask: NONE };
        placed.index_instances(&mut scene, &compiler)?;
        placed.inner = Mutex::new((scene, compiler));
        Ok(placed)
    }

    /// One geometry of these triangles, opaque and two-sided, at the world's origin.
    ///
    /// # Errors
    /// As [`Scene::add_geometry`] and [`Compiler::compile`].
    pub fn of_triangles(triangles: &[[Vec3; 3]], kind: impl Into<Option<BlasKind>>) -> Result<Self> {
        let mut scene = Scene::new();
        let root = scene.root();
        let geometry = scene.add_geometry(soup(triangles).with_blas_kind(kind))?;
        let material = scene.add_material(Material::default())?;
        let node = scene.add(root, Core::Geometry { geometry, material })?;
        Self::new(scene, &[(node, 0)], DVec3::ZERO)
    }

    /// Rays see only nodes with a bit of this mask.
    #[must_use]
    pub fn with_ray_mask(self, mask: u32) -> Self {
        Self { mask, ..self }
    }

    /// Edits the scene and compiles it again.
    ///
    /// # Errors
    /// As the edits and [`Compiler::compile`].
    pub fn edit(&mut self, edit: impl FnOnce(&mut Scene) -> Result<()>) -> Result<()> {
        let (mut scene, mut compiler) = std::mem::take(&mut *self.lock());
        edit(&mut scene)?;
        compiler.compile_from_last_viewpoint(&mut scene)?;
        self.index_instances(&mut scene, &compiler)?;
        *self.lock() = (scene, compiler);
        Ok(())
    }

    /// What a tracer finds, as it says it.
    ///
    /// # Errors
    /// As [`Tracer::closest_hits`].
    pub fn records(&self, tracer: &mut dyn Tracer, rays: &[RayRecord]) -> Result<Vec<HitRecord>> {
        let mut inner = self.lock();
        tracer.upload(inner.1.arrays_mut())?;
        Ok(tracer.closest_hits(inner.1.arrays(), rays, self.mask)?)
    }

    /// Whether each ray hits something opaque, as a tracer says it.
    ///
    /// # Errors
    /// As [`Tracer::any_hits`].
    pub fn any_hits(&self, tracer: &mut dyn Tracer, rays: &[RayRecord]) -> Result<Vec<bool>> {
        let mut inner = self.lock();
        tracer.upload(inner.1.arrays_mut())?;
        Ok(tracer.any_hits(inner.1.arrays(), rays, self.mask)?)
    }

    fn index_instances(&mut self, scene: &mut Scene, compiler: &Compiler) -> Result<()> {
        let hierarchy = scene.hierarchy()?;
        let first = |instance| {
            let source = compiler.instance_source(instance, hierarchy)?;
            self.first_triangles.get(&source.path.node).copied()
        };
        self.first_of_instances =
            (0..compiler.arrays().instances.len() as u32).map(|instance| first(instance).unwrap_or(NONE)).collect();
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, (Scene, Compiler)> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn hit(&self, hit: &HitRecord) -> Hit {
        let first = self.first_of_instances.get(hit.instance as usize).copied().unwrap_or(NONE);
        if hit.instance == NONE {
            Hit::MISS
        } else {
            Hit { primitive: first.wrapping_add(hit.primitive), t: hit.t.into() }
        }
    }

    fn world_hit(&self, hit: &ropewalk::Hit) -> Hit {
        let first = self.first_triangles.get(&hit.path.node).copied().unwrap_or(NONE);
        Hit { primitive: first.wrapping_add(hit.triangle), t: hit.distance }
    }

    fn world_ray(&self, ray: &RayRecord) -> Ray {
        let [origin, direction] = [ray.origin, ray.direction].map(|v| Vec3::from_array(v).as_dvec3());
        Ray { origin: self.origin + origin, direction, t_min: ray.t_min.into(), t_max: ray.t_max.into() }
    }
}

/// A geometry of triangles that share no corners by index.
pub fn soup(triangles: &[[Vec3; 3]]) -> Geometry {
    let positions: Vec<Vec3> = triangles.iter().flatten().copied().collect();
    let indices: Vec<[u32; 3]> = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Geometry::new(positions, indices)
}

/// How rays are traced through a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Executor {
    /// SIMD packets.
    Cpu,
    /// The kernel's twin along escape indices.
    EmulatedRope,
    /// The kernel's twin with a stack.
    EmulatedWide,
    /// The pointer trees.
    Recursive,
    /// `Renderer::closest_hits`, which takes rays in f64 and moves them to the scene: by the executor `cpu`, and before
    /// any frame was rendered.
    Batches,
    /// `Queries::closest_hit`, in f64.
    Queries,
}

/// An executor over a scene.
pub struct Traced<'a>(pub Executor, pub &'a Placed);

impl Column for Traced<'_> {
    fn closest(&self, rays: &[RayRecord]) -> Result<Vec<Hit>> {
        // Executors refuse a batch with a ray that is not valid; such a ray hits nothing.
        let valid: Vec<RayRecord> = rays.iter().filter(|ray| ray.validate().is_ok()).copied().collect();
        if valid.len() < rays.len() {
            let mut hits = self.closest(&valid)?.into_iter();
            let hit = |ray: &RayRecord| ray.validate().ok().and_then(|()| hits.next());
            return Ok(rays.iter().map(hit).map(|hit| hit.unwrap_or(Hit::MISS)).collect());
        }
        let Self(executor, placed) = self;
        let mut guard = placed.lock();
        let (scene, compiler) = &mut *guard;
        let records = match executor {
            Executor::Cpu => Cpu::default().closest_hits(compiler.arrays(), rays, placed.mask)?,
            Executor::EmulatedRope => emulated(Traversal::Rope, compiler.arrays(), rays, placed.mask)?,
            Executor::EmulatedWide => emulated(Traversal::Wide, compiler.arrays(), rays, placed.mask)?,
            Executor::Recursive => recursive(compiler.arrays_mut(), rays, placed.mask)?,
            Executor::Batches => return batch(placed, scene, rays),
            Executor::Queries => {
                let queries = Queries::new(compiler, scene)?.with_ray_mask(placed.mask);
                // A ray that is refused hits nothing.
                let closest = |ray| queries.closest_hit(&placed.world_ray(ray)).ok().flatten();
                return Ok(rays
                    .par_iter()
                    .map(|ray| closest(ray).map_or(Hit::MISS, |hit| placed.world_hit(&hit)))
                    .collect());
            }
        };
        Ok(records.iter().map(|hit| placed.hit(hit)).collect())
    }
}

fn emulated(traversal: Traversal, arrays: &DeviceArrays, rays: &[RayRecord], mask: u32) -> Result<Vec<HitRecord>> {
    let trace = |rays| Emulated::default().with_traversal(traversal).closest_hits(arrays, rays, mask);
    Ok(rays.par_chunks(CHUNK).map(trace).collect::<ropewalk::Result<Vec<_>>>()?.concat())
}

fn recursive(arrays: &mut DeviceArrays, rays: &[RayRecord], mask: u32) -> Result<Vec<HitRecord>> {
    // Each thread has trees of its own.
    let threads = rayon::current_num_threads();
    let mut tracers: Vec<Recursive> = (0..threads).map(|_| Recursive::default()).collect();
    for tracer in &mut tracers {
        tracer.upload(arrays)?;
    }
    let parts = rays.par_chunks(rays.len().div_ceil(threads).max(1));
    let traced = parts.zip(&mut tracers).map(|(rays, tracer)| tracer.closest_hits(arrays, rays, mask));
    Ok(traced.collect::<ropewalk::Result<Vec<_>>>()?.concat())
}

fn batch(placed: &Placed, scene: &mut Scene, rays: &[RayRecord]) -> Result<Vec<Hit>> {
    let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu))?;
    let rays: Vec<Ray> = rays.iter().map(|ray| placed.world_ray(ray)).collect();
    let hits = renderer.closest_hits(scene, &rays, RayMask(placed.mask))?;
    Ok(hits.iter().map(|hit| hit.map_or(Hit::MISS, |hit| placed.world_hit(&hit))).collect())
}

/// The executor `gpu` over a scene.
#[cfg(feature = "gpu")]
pub struct TracedByGpu<'a> {
    tracer: Mutex<GpuTracer>,
    placed: &'a Placed,
}

#[cfg(feature = "gpu")]
impl<'a> TracedByGpu<'a> {
    /// A tracer that has seen no scene yet.
    pub fn new(tracer: GpuTracer, placed: &'a Placed) -> Self {
        Self { tracer: Mutex::new(tracer), placed }
    }
}

#[cfg(feature = "gpu")]
impl Column for TracedByGpu<'_> {
    fn closest(&self, rays: &[RayRecord]) -> Result<Vec<Hit>> {
        let mut tracer = self.tracer.lock().unwrap_or_else(PoisonError::into_inner);
        let records = self.placed.records(&mut *tracer, rays)?;
        Ok(records.iter().map(|hit| self.placed.hit(hit)).collect())
    }
}
