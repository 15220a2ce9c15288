//! The `cpu` executor: the kernel on all cores, a tile of pixels at a time.

#![allow(
    clippy::redundant_closure,
    clippy::redundant_closure_for_method_calls,
    reason = "what is passed by its name is called, a closure marked so is not, and a call takes the lanes through memory"
)]

mod blas_traversal;
mod dispatch;
mod hybrid;
mod node_test;
mod packet_queries;
mod packet_traversal;
mod ray_packet;
mod simd;
mod single_traversal;
mod tile;
mod tlas_traversal;
mod triangle_test;

use rayon::prelude::*;

use self::dispatch::PacketTracer;
use self::tile::TileTracer;
use super::frame_buffer::FrameBuffer;
use super::kernel::{KernelScene, Pixel};
use super::{DeviceInfo, FrameRequest, Tracer, Traversal};
use crate::Result;
use crate::device::DeviceArrays;
use crate::device::layout::{HitRecord, RayRecord};
use crate::image::Image;

/// Runs the kernel on rayon's current thread pool. Reads the arrays in place.
#[derive(Debug)]
pub struct Cpu {
    device: DeviceInfo,
    /// Tile after tile, each row by row; tiles at the right and lower edges have no pixels beyond.
    pixels: Vec<Pixel>,
    width: u32,
    height: u32,
    aovs: bool,
}

/// Pixels along a tile's side: rays of a tile visit much the same nodes, and there are enough tiles to keep all cores busy.
const TILE_SIDE: u32 = 16;
/// Rays that one task traces.
const RAYS_PER_TASK: usize = 512;

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
        arrays.clear_dirty();
        Ok(0)
    }

    fn render(&mut self, arrays: &DeviceArrays, request: &FrameRequest) -> Result<()> {
        let scene = KernelScene::with_traversal(arrays, Traversal::Wide);
        let params = &request.params;
        let count = FrameBuffer::check_size(params.width, params.height)?;
        (self.width, self.height, self.aovs) = (params.width, params.height, request.aovs);
        resize(&mut self.pixels, count);
        if count == 0 {
            return Ok(());
        }
        let rows_of_tiles = self.pixels.par_chunks_mut(TILE_SIDE as usize * self.width as usize);
        rows_of_tiles.zip((0..self.height).into_par_iter().step_by(TILE_SIDE as usize)).for_each(|(row, top)| {
            let tiles = row.par_chunks_mut((TILE_SIDE * rows_of_tile(self.height, top)) as usize);
            let tiles = tiles.zip((0..self.width).into_par_iter().step_by(TILE_SIDE as usize));
            tiles.for_each_init(
                || TileTracer::new(&scene),
                |tracer, (pixels, left)| tracer.render(params, [left, top], columns_of_tile(self.width, left), pixels),
            );
        });
        Ok(())
    }

    fn read_image(&self) -> Result<Image> {
        let mut frame = FrameBuffer::new(self.width, self.height, self.aovs)?;
        for y in 0..self.height {
            for x in 0..self.width {
                frame.push(&self.pixels[pixel_index([self.width, self.height], x, y)]);
            }
        }
        Ok(frame.into_image())
    }

    fn closest_hits(&mut self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<HitRecord>> {
        let mut hits = bytemuck::zeroed_vec(rays.len());
        self.closest_hits_into(arrays, rays, ray_mask, &mut hits);
        Ok(hits)
    }

    fn any_hits(&mut self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<bool>> {
        let mut hits = vec![false; rays.len()];
        self.any_hits_into(arrays, rays, ray_mask, &mut hits);
        Ok(hits)
    }
}

impl Cpu {
    /// As [`closest_hits`](Tracer::closest_hits), into memory that the caller keeps: new memory costs more time than many a ray.
    ///
    /// Sixteen rays that follow one another are traced together for as long as they visit the same nodes: so have neighbours stand
    /// beside each other.
    ///
    /// # Panics
    /// If `hits` is not as long as `rays`.
    pub fn closest_hits_into(&self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32, hits: &mut [HitRecord]) {
        assert_eq!(rays.len(), hits.len(), "a hit a ray");
        let scene = KernelScene::with_traversal(arrays, Traversal::Wide);
        let tasks = rays.par_chunks(RAYS_PER_TASK).zip(hits.par_chunks_mut(RAYS_PER_TASK));
        tasks.for_each_init(
            || PacketTracer::new(&scene),
            |tracer, (rays, hits)| tracer.closest_hits(rays, ray_mask, hits),
        );
    }

    /// As [`any_hits`](Tracer::any_hits), into memory that the caller keeps.
    ///
    /// # Panics
    /// If `hits` is not as long as `rays`.
    pub fn any_hits_into(&self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32, hits: &mut [bool]) {
        assert_eq!(rays.len(), hits.len(), "a hit a ray");
        let scene = KernelScene::with_traversal(arrays, Traversal::Wide);
        let tasks = rays.par_chunks(RAYS_PER_TASK).zip(hits.par_chunks_mut(RAYS_PER_TASK));
        tasks.for_each_init(|| PacketTracer::new(&scene), |tracer, (rays, hits)| tracer.any_hits(rays, ray_mask, hits));
    }
}

/// Makes room for that many pixels, and gives memory back after a much larger frame.
fn resize(pixels: &mut Vec<Pixel>, count: usize) {
    pixels.resize(count, Pixel::MISS);
    if pixels.capacity() / 4 > count {
        pixels.shrink_to_fit();
    }
}

/// Rows of a tile whose first row is `top`.
fn rows_of_tile(height: u32, top: u32) -> u32 {
    TILE_SIDE.min(height - top)
}

/// Columns of a tile whose first column is `left`.
fn columns_of_tile(width: u32, left: u32) -> u32 {
    TILE_SIDE.min(width - left)
}

/// Where the pixel in column `x` and row `y` is stored.
fn pixel_index([width, height]: [u32; 2], x: u32, y: u32) -> usize {
    let [left, top] = [x, y].map(|x| x / TILE_SIDE * TILE_SIDE);
    let above = top as usize * width as usize;
    let before = left as usize * rows_of_tile(height, top) as usize;
    above + before + ((y - top) * columns_of_tile(width, left) + x - left) as usize
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;

    use super::*;
    use crate::device::Needs;
    use crate::device::layout::FrameParams;

    /// So that the limit on the pixels of a frame is one on memory, however long and thin the frame.
    #[test]
    fn each_pixel_has_a_place_and_none_is_left_over() {
        for (width, height) in [(1, 1), (16, 16), (15, 17), (33, 50), (1, 100), (100, 1), (64, 31)] {
            let mut found: Vec<usize> =
                (0..height).flat_map(|y| (0..width).map(move |x| pixel_index([width, height], x, y))).collect();
            found.sort_unstable();
            assert!(found.into_iter().eq(0..(width * height) as usize), "{width} x {height}");
        }
        let long = 1 << 28;
        assert_eq!(pixel_index([1, long], 0, long - 1), long as usize - 1);
        assert_eq!(pixel_index([long, 1], long - 1, 0), long as usize - 1);
    }

    #[test]
    fn memory_follows_the_frame_down() {
        let mut cpu = Cpu::default();
        let mut pixels_held = |width, height| {
            let params = FrameParams { width, height, ..FrameParams::zeroed() };
            let request = FrameRequest { params, needs: Needs::empty(), aovs: false };
            cpu.render(&DeviceArrays::default(), &request).unwrap();
            cpu.pixels.capacity()
        };
        assert!(pixels_held(200, 200) >= 40_000);
        // A little smaller: kept, for the next one.
        assert!(pixels_held(150, 150) >= 40_000);
        assert!(pixels_held(10, 10) < 1000);
        assert_eq!(pixels_held(0, 10), 0);
    }
}
