//! The `cpu` executor: the kernel on all cores, a tile of pixels at a time.

use rayon::prelude::*;

use super::kernel::{KernelScene, Pixel, any_hit, closest_hit, render_pixel};
use super::planes::Planes;
use super::{DeviceInfo, FrameRequest, Tracer};
use crate::Result;
use crate::device::DeviceArrays;
use crate::device::layout::{FrameParams, Hit, Ray};
use crate::image::Image;

/// Runs the kernel on rayon's current thread pool. Reads the arrays in place.
#[derive(Debug)]
pub struct Cpu {
    device: DeviceInfo,
    /// Tile after tile, each row by row; tiles at the right and lower edges are full, their pixels outside left out.
    pixels: Vec<Pixel>,
    width: u32,
    height: u32,
    aovs: bool,
}

/// Pixels along a tile's side: rays of a tile visit much the same nodes, and there are enough tiles to keep all cores busy.
const TILE: u32 = 16;
const TILE_PIXELS: usize = (TILE * TILE) as usize;
/// Rays that one task traces at least.
const RAYS_A_TASK: usize = 256;

impl Default for Cpu {
    fn default() -> Self {
        let name = format!("{} threads", rayon::current_num_threads());
        let device = DeviceInfo { executor: "cpu", name };
        Self { device, pixels: Vec::new(), width: 0, height: 0, aovs: false }
    }
}

impl Tracer for Cpu {
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
        Planes::check_size(params.width, params.height)?;
        (self.width, self.height, self.aovs) = (params.width, params.height, request.aovs);

        let tiles = tiles_a_row(self.width) as usize * self.height.div_ceil(TILE) as usize;
        self.pixels.resize(tiles * TILE_PIXELS, Pixel::NOTHING);
        self.pixels.par_chunks_exact_mut(TILE_PIXELS).enumerate().for_each(|(tile, pixels)| {
            render_tile(&scene, params, tile as u32, pixels);
        });
        Ok(())
    }

    fn read(&self) -> Result<Image> {
        let mut frame = Planes::new(self.width, self.height, self.aovs)?;
        for y in 0..self.height {
            for x in 0..self.width {
                frame.push(&self.pixels[pixel_index(self.width, x, y)]);
            }
        }
        Ok(frame.into_image())
    }

    fn closest_hits(&mut self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Result<Vec<Hit>> {
        let scene = KernelScene::new(arrays);
        Ok(rays.par_iter().with_min_len(RAYS_A_TASK).map(|ray| closest_hit(&scene, ray, ray_mask)).collect())
    }

    fn any_hits(&mut self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Result<Vec<bool>> {
        let scene = KernelScene::new(arrays);
        Ok(rays.par_iter().with_min_len(RAYS_A_TASK).map(|ray| any_hit(&scene, ray, ray_mask)).collect())
    }
}

fn tiles_a_row(width: u32) -> u32 {
    width.div_ceil(TILE)
}

fn pixel_index(width: u32, x: u32, y: u32) -> usize {
    let tile = (y / TILE) as usize * tiles_a_row(width) as usize + (x / TILE) as usize;
    tile * TILE_PIXELS + (y % TILE * TILE + x % TILE) as usize
}

fn render_tile(scene: &KernelScene<'_>, params: &FrameParams, tile: u32, pixels: &mut [Pixel]) {
    let (left, top) = (tile % tiles_a_row(params.width) * TILE, tile / tiles_a_row(params.width) * TILE);
    for (i, pixel) in (0..).zip(pixels) {
        let (x, y) = (left + i % TILE, top + i / TILE);
        if x < params.width && y < params.height {
            *pixel = render_pixel(scene, params, x, y);
        }
    }
}
