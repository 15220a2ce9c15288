//! The `emulated` executor: the GPU kernel in Rust, one ray after the other (the paper's "Emulated").

use glam::Vec3;
use rayon::prelude::*;

use super::kernel::{
    KernelScene, Pixel, Traverse, any_hit, camera_ray, closest_hit, count_any, count_closest, count_transmittance,
    render_pixel, transmittance,
};
use super::planes::Planes;
use super::{Counts, DeviceInfo, FrameCounts, FrameRequest, Layout, Tracer};
use crate::Result;
use crate::device::DeviceArrays;
use crate::device::layout::{Hit, Ray};
use crate::image::Image;

/// Runs the kernel on the calling thread: to debug it, and to compare others with. Reads the arrays in place.
#[derive(Debug)]
pub struct Emulated {
    device: DeviceInfo,
    layout: Layout,
    frame: Planes,
}

impl Emulated {
    /// Walks the arrays in another way than by default: the hits are the same.
    #[must_use]
    pub fn with_layout(self, layout: Layout) -> Self {
        Self { layout, ..self }
    }

    /// What [`closest_hits`](Tracer::closest_hits) reads and tests.
    pub fn count_closest_hits(&self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Counts {
        let scene = KernelScene::with_layout(arrays, self.layout);
        sum(rays.iter().map(|ray| count_closest(&scene, ray, ray_mask)))
    }

    /// What [`any_hits`](Tracer::any_hits) reads and tests.
    pub fn count_any_hits(&self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Counts {
        let scene = KernelScene::with_layout(arrays, self.layout);
        sum(rays.iter().map(|ray| count_any(&scene, ray, ray_mask)))
    }

    /// What [`render`](Tracer::render) traces, and what that costs, by all threads. Of translucent instances whose triangles may be
    /// in several leaves, what shadow rays cost is left out.
    pub fn count_frame(&self, arrays: &DeviceArrays, request: &FrameRequest) -> FrameCounts {
        let scene = KernelScene::with_layout(arrays, self.layout);
        let params = &request.params;
        let rows = (0..params.height).into_par_iter().map(|y| {
            let mut rays = Counting { scene: &scene, counts: FrameCounts::default() };
            for x in 0..params.width {
                let primary = camera_ray(params, x, y);
                let pixel = render_pixel(&mut rays, params, &primary);
                rays.counts.first_hits += u64::from(pixel.ids != Pixel::NOTHING.ids);
            }
            rays.counts
        });
        rows.reduce(FrameCounts::default, |mut sum, counts| {
            sum += counts;
            sum
        })
    }
}

/// The kernel's rays, counted.
struct Counting<'a> {
    scene: &'a KernelScene<'a>,
    counts: FrameCounts,
}

impl<'a> Traverse<'a> for Counting<'a> {
    fn scene(&self) -> &'a KernelScene<'a> {
        self.scene
    }

    fn closest_hit(&mut self, ray: &Ray, ray_mask: u32) -> Hit {
        self.counts.rays += 1;
        self.counts.work += count_closest(self.scene, ray, ray_mask);
        closest_hit(self.scene, ray, ray_mask)
    }

    fn transmittance(&mut self, ray: &Ray, ray_mask: u32) -> Vec3 {
        self.counts.shadow_rays += 1;
        self.counts.work += count_transmittance(self.scene, ray, ray_mask);
        transmittance(self.scene, ray, ray_mask)
    }
}

fn sum(counts: impl Iterator<Item = Counts>) -> Counts {
    counts.fold(Counts::default(), |mut sum, counts| {
        sum += counts;
        sum
    })
}

impl Default for Emulated {
    fn default() -> Self {
        let device = DeviceInfo { executor: "emulated", name: "1 thread".to_owned() };
        Self { device, layout: Layout::default(), frame: Planes::default() }
    }
}

impl Tracer for Emulated {
    fn device(&self) -> &DeviceInfo {
        &self.device
    }

    fn upload(&mut self, arrays: &mut DeviceArrays) -> Result<u64> {
        arrays.forget_dirty();
        Ok(0)
    }

    fn render(&mut self, arrays: &DeviceArrays, request: &FrameRequest) -> Result<()> {
        let scene = KernelScene::with_layout(arrays, self.layout);
        let params = &request.params;
        let mut frame = Planes::new(params.width, params.height, request.aovs)?;
        for y in 0..params.height {
            for x in 0..params.width {
                let primary = camera_ray(params, x, y);
                frame.push(&render_pixel(&mut &scene, params, &primary));
            }
        }
        self.frame = frame;
        Ok(())
    }

    fn read(&self) -> Result<Image> {
        Ok(self.frame.clone().into_image())
    }

    fn closest_hits(&mut self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Result<Vec<Hit>> {
        let scene = KernelScene::with_layout(arrays, self.layout);
        Ok(rays.iter().map(|ray| closest_hit(&scene, ray, ray_mask)).collect())
    }

    fn any_hits(&mut self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Result<Vec<bool>> {
        let scene = KernelScene::with_layout(arrays, self.layout);
        Ok(rays.iter().map(|ray| any_hit(&scene, ray, ray_mask)).collect())
    }
}
