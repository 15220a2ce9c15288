//! Pixels that are rendered together: the next ray of each path, then the shadow rays to each light.

use glam::Vec3;

use super::dispatch::PacketTracer;
use crate::device::layout::{FrameParams, HitRecord, LightRecord, RayRecord};
use crate::trace::kernel::{KernelScene, LightSample, Pixel, RayTree, SurfaceHit, active_lights, camera_ray};

/// Pixels along the side of a block. Its primary rays are a packet, but at the edges of an image, where blocks are smaller.
const BLOCK_SIDE: usize = 4;

/// Renders tile after tile. Rays of paths that go on stand beside each other, so that packets are full for as long as there are any.
pub(super) struct TileTracer<'a> {
    tracer: PacketTracer<'a>,
    paths: Vec<RayTree>,
    /// The rays that are traced together, and which paths, or surfaces, they belong to.
    rays: Vec<RayRecord>,
    ray_owners: Vec<usize>,
    hits: Vec<HitRecord>,
    surfaces: Vec<PendingSurface>,
    light_samples: Vec<LightSample>,
    transmittances: Vec<Vec3>,
}

/// A surface that the ray of a path has met, and that waits for its light.
struct PendingSurface {
    path: usize,
    met: SurfaceHit,
    /// What goes back along the ray of the lights so far.
    light: Vec3,
}

impl<'a> TileTracer<'a> {
    pub(super) fn new(scene: &'a KernelScene<'a>) -> Self {
        Self {
            tracer: PacketTracer::new(scene),
            paths: Vec::new(),
            rays: Vec::new(),
            ray_owners: Vec::new(),
            hits: Vec::new(),
            surfaces: Vec::new(),
            light_samples: Vec::new(),
            transmittances: Vec::new(),
        }
    }

    /// Renders the pixels of a tile, row by row.
    pub(super) fn render(&mut self, params: &FrameParams, [left, top]: [u32; 2], columns: u32, pixels: &mut [Pixel]) {
        let rows = pixels.len() as u32 / columns;
        let blocks = (0..rows).step_by(BLOCK_SIDE).flat_map(|y| (0..columns).step_by(BLOCK_SIDE).map(move |x| [x, y]));
        let places = blocks.flat_map(|[x, y]| {
            let ends = [x + BLOCK_SIDE as u32, y + BLOCK_SIDE as u32];
            (y..ends[1].min(rows)).flat_map(move |y| (x..ends[0].min(columns)).map(move |x| [x, y]))
        });
        // Paths are large: those of the last tile are used again.
        self.paths.resize_with(pixels.len(), RayTree::default);
        for ([x, y], path) in places.clone().zip(&mut self.paths) {
            path.reset(&camera_ray(params, left + x, top + y));
        }
        while self.trace_next_rays(params) {
            for light in active_lights(self.tracer.scene, params) {
                self.add_light(params, light);
            }
            for PendingSurface { path, met, light } in &self.surfaces {
                self.paths[*path].shade(params, met, *light);
            }
        }
        for ([x, y], path) in places.zip(&mut self.paths) {
            pixels[(y * columns + x) as usize] = path.finish(params);
        }
    }

    /// Traces a ray of each path that has one; says whether there were any.
    fn trace_next_rays(&mut self, params: &FrameParams) -> bool {
        self.rays.clear();
        self.ray_owners.clear();
        for (index, path) in self.paths.iter_mut().enumerate() {
            if let Some(ray) = path.next_ray() {
                self.rays.push(ray);
                self.ray_owners.push(index);
            }
        }
        self.surfaces.clear();
        self.hits.resize(self.rays.len(), HitRecord::MISS);
        self.tracer.closest_hits(&self.rays, params.ray_mask, &mut self.hits);
        for (&path, hit) in self.ray_owners.iter().zip(&self.hits) {
            if let Some(met) = self.paths[path].record_hit(self.tracer.scene, params, hit) {
                self.surfaces.push(PendingSurface { path, met, light: Vec3::ZERO });
            }
        }
        !self.rays.is_empty()
    }

    /// Adds what a light sends to the viewer.
    fn add_light(&mut self, params: &FrameParams, light: &LightRecord) {
        self.rays.clear();
        self.ray_owners.clear();
        self.light_samples.clear();
        for (index, surface) in self.surfaces.iter().enumerate() {
            if let Some(lit) = surface.met.light_sample(light) {
                self.rays.push(lit.ray);
                self.ray_owners.push(index);
                self.light_samples.push(lit);
            }
        }
        self.transmittances.resize(self.rays.len(), Vec3::ONE);
        self.tracer.transmittances(&self.rays, params.ray_mask, &mut self.transmittances);
        for ((&surface, lit), &transmittance) in
            self.ray_owners.iter().zip(&self.light_samples).zip(&self.transmittances)
        {
            self.surfaces[surface].light += lit.radiance(transmittance);
        }
    }
}
