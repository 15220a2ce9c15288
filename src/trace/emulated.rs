//! The `emulated` executor: the GPU kernel in Rust, one ray after the other (the paper's "Emulated").

use super::kernel::{KernelScene, any_hit, closest_hit, render_pixel};
use super::planes::Planes;
use super::{DeviceInfo, FrameRequest, Tracer};
use crate::Result;
use crate::device::DeviceArrays;
use crate::device::layout::{Hit, Ray};
use crate::image::Image;

/// Runs the kernel on the calling thread: to debug it, and to compare others with. Reads the arrays in place.
#[derive(Debug)]
pub struct Emulated {
    device: DeviceInfo,
    frame: Planes,
}

impl Default for Emulated {
    fn default() -> Self {
        let device = DeviceInfo { executor: "emulated", name: "1 thread".to_owned() };
        Self { device, frame: Planes::default() }
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
        let scene = KernelScene::new(arrays);
        let params = &request.params;
        let mut frame = Planes::new(params.width, params.height, request.aovs)?;
        for y in 0..params.height {
            for x in 0..params.width {
                frame.push(&render_pixel(&scene, params, x, y));
            }
        }
        self.frame = frame;
        Ok(())
    }

    fn read(&self) -> Result<Image> {
        Ok(self.frame.clone().into_image())
    }

    fn closest_hits(&mut self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Result<Vec<Hit>> {
        let scene = KernelScene::new(arrays);
        Ok(rays.iter().map(|ray| closest_hit(&scene, ray, ray_mask)).collect())
    }

    fn any_hits(&mut self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Result<Vec<bool>> {
        let scene = KernelScene::new(arrays);
        Ok(rays.iter().map(|ray| any_hit(&scene, ray, ray_mask)).collect())
    }
}
