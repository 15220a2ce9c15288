//! Renders a tile in wavefronts: the next closest-hit ray of each pixel's ray tree, then for each light the shadow rays
//! of all surfaces hit.

use glam::Vec3;

use super::dispatch::PacketTracer;
use crate::device::layout::{FrameParams, HitRecord, LightRecord, RayRecord};
use crate::trace::kernel::{
    Continuation, KernelScene, LightSample, Pixel, RayTree, SurfaceHit, active_lights, camera_ray,
};

/// Side in pixels of the block whose primary rays form one packet (4 x 4 = 16); blocks at the image's edges are
/// smaller.
const BLOCK_SIDE: usize = 4;

/// Renders tile after tile. Rays of unfinished pixels are compacted before each wavefront, so that packets stay full.
pub(super) struct TileTracer<'a> {
    tracer: PacketTracer<'a>,
    paths: Vec<RayTree>,
    /// The wavefront's rays, and for each the index of its path (closest hit) or surface (shadow).
    rays: Vec<RayRecord>,
    ray_owners: Vec<usize>,
    /// Where rays of the wavefront go on: the index of each that does, ascending.
    starts: Vec<(usize, Continuation)>,
    hits: Vec<HitRecord>,
    surfaces: Vec<PendingSurface>,
    light_samples: Vec<LightSample>,
    transmittances: Vec<Vec3>,
}

/// A surface hit that is shaded once all lights have been sampled.
struct PendingSurface {
    path: usize,
    hit: SurfaceHit,
    /// Radiance reflected along the ray, summed over the lights sampled so far.
    radiance: Vec3,
}

impl<'a> TileTracer<'a> {
    pub(super) fn new(scene: &'a KernelScene<'a>) -> Self {
        Self {
            tracer: PacketTracer::new(scene),
            paths: Vec::new(),
            rays: Vec::new(),
            ray_owners: Vec::new(),
            starts: Vec::new(),
            hits: Vec::new(),
            surfaces: Vec::new(),
            light_samples: Vec::new(),
            transmittances: Vec::new(),
        }
    }

    /// Renders the pixels of the tile whose first pixel is `[left, top]`. `pixels` are stored row by row.
    pub(super) fn render(&mut self, params: &FrameParams, [left, top]: [u32; 2], columns: u32, pixels: &mut [Pixel]) {
        // 1. Order pixels by blocks of 4 x 4, one packet of primary rays each.
        let rows = pixels.len() as u32 / columns;
        let blocks = (0..rows).step_by(BLOCK_SIDE).flat_map(|y| (0..columns).step_by(BLOCK_SIDE).map(move |x| [x, y]));
        let pixel_positions = blocks.flat_map(|[x, y]| {
            let ends = [x + BLOCK_SIDE as u32, y + BLOCK_SIDE as u32];
            (y..ends[1].min(rows)).flat_map(move |y| (x..ends[0].min(columns)).map(move |x| [x, y]))
        });
        // 2. Start a primary ray per pixel. Paths are large, so the memory of the last tile's is used again.
        self.paths.resize_with(pixels.len(), RayTree::default);
        for ([x, y], path) in pixel_positions.clone().zip(&mut self.paths) {
            path.reset(&camera_ray(params, left + x, top + y));
        }
        // 3. For each wavefront: trace the next rays, sample all lights, shade the surfaces hit.
        while self.trace_next_rays(params) {
            for light in active_lights(self.tracer.scene, params) {
                self.add_light(params, light);
            }
            for PendingSurface { path, hit, radiance } in &self.surfaces {
                self.paths[*path].shade(params, hit, *radiance);
            }
        }
        // 4. Write the pixels.
        for ([x, y], path) in pixel_positions.zip(&mut self.paths) {
            pixels[(y * columns + x) as usize] = path.finish();
        }
    }

    /// Traces the next ray of each unfinished path; returns whether there was any.
    fn trace_next_rays(&mut self, params: &FrameParams) -> bool {
        // Gather the next rays.
        self.rays.clear();
        self.ray_owners.clear();
        self.starts.clear();
        for (index, path) in self.paths.iter_mut().enumerate() {
            if let Some((ray, start)) = path.next_ray(params) {
                self.starts.extend(start.map(|start| (self.rays.len(), start)));
                self.rays.push(ray);
                self.ray_owners.push(index);
            }
        }
        // Trace them.
        self.hits.resize(self.rays.len(), HitRecord::MISS);
        self.tracer.next_hits(&self.rays, &self.starts, params.ray_mask, &mut self.hits);
        // Record the hits, and collect the surfaces.
        self.surfaces.clear();
        for (&path, hit) in self.ray_owners.iter().zip(&self.hits) {
            if let Some(hit) = self.paths[path].record_hit(self.tracer.scene, params, hit) {
                self.surfaces.push(PendingSurface { path, hit, radiance: Vec3::ZERO });
            }
        }
        !self.rays.is_empty()
    }

    /// Traces the shadow rays to one light and adds the radiance it contributes to each surface.
    fn add_light(&mut self, params: &FrameParams, light: &LightRecord) {
        // Gather a shadow ray for each surface to which the light contributes.
        self.rays.clear();
        self.ray_owners.clear();
        self.light_samples.clear();
        for (index, surface) in self.surfaces.iter().enumerate() {
            if let Some(sample) = self.paths[surface.path].light_sample(&surface.hit, light) {
                self.rays.push(sample.ray);
                self.ray_owners.push(index);
                self.light_samples.push(sample);
            }
        }
        // Trace their transmittances.
        self.transmittances.resize(self.rays.len(), Vec3::ONE);
        self.tracer.transmittances(&self.rays, params.ray_mask, &mut self.transmittances);
        // Accumulate the light that arrives.
        for ((&surface, sample), &transmittance) in
            self.ray_owners.iter().zip(&self.light_samples).zip(&self.transmittances)
        {
            self.surfaces[surface].radiance += sample.radiance(transmittance);
        }
    }
}
