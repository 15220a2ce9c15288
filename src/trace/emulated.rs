//! The `emulated` executor: the Rust twin of the GPU kernel (the paper's "Emulated").

use glam::Vec3;
use rayon::prelude::*;

use super::frame_buffer::FrameBuffer;
use super::kernel::{
    AnyQuery, ClosestQuery, Continuation, KernelScene, Pixel, Query, RayQueries, TransmittanceQuery, any_hit,
    camera_ray, closest_hit, render_pixel, run_query,
};
use super::{DeviceInfo, FrameCounts, FrameRequest, Tracer, Traversal, TraversalCounts, trace_rays};
use crate::device::DeviceArrays;
use crate::device::layout::{HitRecord, RayRecord};
use crate::image::Image;
use crate::{Cancel, Result};

/// Runs the Rust twin of the GPU kernel on the calling thread, one ray at a time. For debugging the kernel and as the
/// reference for other executors. Borrows the arrays; [`upload`](Tracer::upload) copies nothing. Only
/// [`count_frame`](Self::count_frame) uses all threads.
#[derive(Debug)]
pub struct Emulated {
    device: DeviceInfo,
    traversal: Traversal,
    frame: FrameBuffer,
    cancel: Cancel,
}

impl Emulated {
    /// Sets the traversal. Hits do not depend on it.
    #[must_use]
    pub fn with_traversal(self, traversal: Traversal) -> Self {
        Self { traversal, ..self }
    }

    /// The traversal cost of [`closest_hits`](Tracer::closest_hits) for these rays.
    pub fn count_closest_hits(&self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> TraversalCounts {
        let scene = KernelScene::with_traversal(arrays, self.traversal);
        count(&scene, rays, ray_mask, ClosestQuery::new)
    }

    /// The traversal cost of [`any_hits`](Tracer::any_hits) for these rays.
    pub fn count_any_hits(&self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> TraversalCounts {
        let scene = KernelScene::with_traversal(arrays, self.traversal);
        count(&scene, rays, ray_mask, AnyQuery::new)
    }

    /// Ray counts and traversal cost of [`render`](Tracer::render), computed on all threads. Not counted: the further
    /// passes of shadow rays over layered instances (translucent, with triangles in more than one leaf).
    pub fn count_frame(&self, arrays: &DeviceArrays, request: &FrameRequest) -> FrameCounts {
        let scene = KernelScene::with_traversal(arrays, self.traversal);
        let params = &request.params;
        let rows = (0..params.height).into_par_iter().map(|y| {
            let mut rays = CountingQueries { scene: &scene, counts: FrameCounts::default() };
            for x in 0..params.width {
                let primary = camera_ray(params, x, y);
                let pixel = render_pixel(&mut rays, params, &primary);
                rays.counts.primary_hits += u64::from(pixel.ids != Pixel::MISS.ids);
            }
            rays.counts
        });
        rows.reduce(FrameCounts::default, |mut sum, counts| {
            sum += counts;
            sum
        })
    }
}

/// Traces the kernel's rays and adds up their cost.
struct CountingQueries<'a> {
    scene: &'a KernelScene<'a>,
    counts: FrameCounts,
}

impl<'a> RayQueries<'a> for CountingQueries<'a> {
    fn scene(&self) -> &'a KernelScene<'a> {
        self.scene
    }

    fn next_hit(&mut self, ray: &RayRecord, start: Continuation, ray_mask: u32) -> HitRecord {
        self.counts.radiance_rays += 1;
        self.run_query(ray, ray_mask, ClosestQuery::behind(ray.t_max, start)).hit
    }

    fn transmittance(&mut self, ray: &RayRecord, ray_mask: u32) -> Vec3 {
        self.counts.shadow_rays += 1;
        let query = self.run_query(ray, ray_mask, TransmittanceQuery::new(ray.t_max));
        query.with_layers(self.scene, ray, ray_mask)
    }
}

impl CountingQueries<'_> {
    /// Runs a query and adds its traversal cost to that of the frame.
    fn run_query<Q: Query>(&mut self, ray: &RayRecord, ray_mask: u32, query: Q) -> Q {
        let (query, cost): (Q, TraversalCounts) = run_query(self.scene, ray, ray_mask, query);
        self.counts.cost += cost;
        query
    }
}

/// Traversal cost of one query per ray; `query` makes its state from `t_max`.
fn count<Q: Query>(scene: &KernelScene<'_>, rays: &[RayRecord], ray_mask: u32, query: fn(f32) -> Q) -> TraversalCounts {
    rays.iter().fold(TraversalCounts::default(), |mut sum, ray| {
        let (_, cost): (Q, TraversalCounts) = run_query(scene, ray, ray_mask, query(ray.t_max));
        sum += cost;
        sum
    })
}

impl Default for Emulated {
    fn default() -> Self {
        let device = DeviceInfo { executor: "emulated", name: "1 thread".to_owned() };
        Self { device, traversal: Traversal::default(), frame: FrameBuffer::default(), cancel: Cancel::default() }
    }
}

impl Tracer for Emulated {
    fn device(&self) -> &DeviceInfo {
        &self.device
    }

    fn set_cancel(&mut self, cancel: Option<Cancel>) {
        self.cancel = cancel.unwrap_or_default();
    }

    fn upload(&mut self, arrays: &mut DeviceArrays) -> Result<u64> {
        arrays.clear_dirty();
        Ok(0)
    }

    fn render(&mut self, arrays: &DeviceArrays, request: &FrameRequest) -> Result<()> {
        let scene = KernelScene::with_traversal(arrays, self.traversal);
        let params = &request.params;
        self.frame = FrameBuffer::default();
        let mut frame = FrameBuffer::new(params.width, params.height, request.aovs)?;
        for y in 0..params.height {
            self.cancel.check()?;
            for x in 0..params.width {
                let primary = camera_ray(params, x, y);
                frame.push(&render_pixel(&mut &scene, params, &primary));
            }
        }
        self.frame = frame;
        Ok(())
    }

    fn limited_pixels(&self) -> Result<u64> {
        Ok(self.frame.limited_pixels)
    }

    fn read_image(&self) -> Result<Image> {
        Ok(self.frame.clone().into_image())
    }

    fn closest_hits(&mut self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<HitRecord>> {
        let scene = KernelScene::with_traversal(arrays, self.traversal);
        trace_rays(rays, &self.cancel, |ray| closest_hit(&scene, ray, ray_mask))
    }

    fn any_hits(&mut self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<bool>> {
        let scene = KernelScene::with_traversal(arrays, self.traversal);
        trace_rays(rays, &self.cancel, |ray| any_hit(&scene, ray, ray_mask))
    }
}
