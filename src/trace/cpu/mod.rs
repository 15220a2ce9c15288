//! The `cpu` executor: SIMD traversal of the wide nodes on all cores.
//!
//! A ray's way from dispatch to hit:
//!
//! 1. [`Cpu`] (this file) spreads tiles of a frame, or slices of a batch of rays, over rayon's threads. In a frame,
//!    `tile` gathers the next ray of every unfinished pixel, then the shadow rays to each light.
//! 2. `dispatch` splits the rays into packets of 16 and calls the code compiled for AVX-512, AVX2 or NEON. Without any
//!    of these, or without wide nodes, the kernel traces one ray at a time instead.
//! 3. `hybrid` loads a packet (`ray_packet`) and decides how it is traversed. `tlas_traversal` finds the instances that
//!    its rays enter; for each, the packet is transformed to local space.
//! 4. In an instance the loop of `blas_traversal` visits the BLAS's wide nodes front to back. It has two visitors:
//!    `packet_traversal` for the packet as a whole, `single_traversal` for one of its rays.
//! 5. Boxes: a packet is tested by `node_test`, in a coherent or an incoherent form; a single ray in
//!    `single_traversal`. Both decode nodes by `wide_node`.
//! 6. Triangles: `triangle_test`, with the permutation and shear of `shear`: one triangle against 16 rays, or four
//!    triangles against one ray. `packet_queries` accepts or rejects each hit and holds the results.
//!
//! When rays diverge: a packet whose rays differ in direction octant or dominant axis is *incoherent*, and each box is
//! tested against all its rays, so that each child is visited by just the rays that hit it. Where at most two rays of
//! any packet remain active, in the TLAS, at an instance, at a node or at a leaf, they leave the packet and continue as
//! single rays (`hybrid`). Wavefronts of a frame are compacted, so that later packets are full again (`tile`).

#![allow(
    clippy::redundant_closure,
    clippy::redundant_closure_for_method_calls,
    reason = "a function passed by name is not inlined, a closure marked `#[inline(always)]` is; a call would spill \
              the SIMD registers"
)]

mod blas_traversal;
mod dispatch;
mod hybrid;
mod node_test;
mod packet_queries;
mod packet_traversal;
mod ray_packet;
mod shear;
mod simd;
mod single_traversal;
mod tile;
mod tlas_traversal;
mod triangle_test;
mod wide_node;

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use rayon::prelude::*;

use self::dispatch::PacketTracer;
use self::tile::TileTracer;
use super::frame_buffer::FrameBuffer;
use super::kernel::{KernelScene, Pixel};
use super::{DeviceInfo, FrameRequest, Tracer, Traversal};
use crate::device::DeviceArrays;
use crate::device::layout::{HitRecord, RayRecord};
use crate::image::Image;
use crate::{Cancel, Result};

/// Traces rays on all threads of rayon's current pool, 16 at a time in the lanes of AVX-512, AVX2 or NEON where the
/// processor has one of these, else one by one. Borrows the arrays; [`upload`](Tracer::upload) copies nothing.
///
/// Of the errors of [`Tracer`] only [`Error::Limit`](crate::Error::Limit) occurs, for a frame with too many pixels, and
/// [`Error::Cancelled`](crate::Error::Cancelled). A frame takes memory for its pixels; batches of rays take a fixed
/// amount per thread.
#[derive(Debug)]
pub struct Cpu {
    device: DeviceInfo,
    /// Pixels in tile order, row by row within each tile. Tiles at the right and lower edges are cut to the image.
    pixels: Vec<Pixel>,
    width: u32,
    height: u32,
    aovs: bool,
    limited_pixels: u64,
    cancel: Cancel,
}

/// Side of a tile in pixels: small enough that its ray trees and surfaces stay in the first-level cache (600 bytes a
/// pixel; with 16 a frame took a tenth longer), large enough for four full packets.
const TILE_SIDE: u32 = 8;
/// Rays per rayon task in batch queries.
const RAYS_PER_TASK: usize = 512;

impl Default for Cpu {
    fn default() -> Self {
        let name = format!("{} threads", rayon::current_num_threads());
        let device = DeviceInfo { executor: "cpu", name };
        let (pixels, limited_pixels, cancel) = (Vec::new(), 0, Cancel::default());
        Self { device, pixels, width: 0, height: 0, aovs: false, limited_pixels, cancel }
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

    fn set_cancel(&mut self, cancel: Option<Cancel>) {
        self.cancel = cancel.unwrap_or_default();
    }

    fn render(&mut self, arrays: &DeviceArrays, request: &FrameRequest) -> Result<()> {
        let scene = KernelScene::with_traversal(arrays, Traversal::Wide);
        let params = &request.params;
        let count = FrameBuffer::check_size(params.width, params.height)?;
        // Fit the array of pixels to the frame.
        (self.width, self.height, self.aovs) = (params.width, params.height, request.aovs);
        resize(&mut self.pixels, count);
        self.limited_pixels = 0;
        if count == 0 {
            return Ok(());
        }
        // Render rows of tiles in parallel.
        let limited_pixels = AtomicU64::new(0);
        let rows_of_tiles = self.pixels.par_chunks_mut(TILE_SIDE as usize * self.width as usize);
        let rows_of_tiles = rows_of_tiles.zip((0..self.height).into_par_iter().step_by(TILE_SIDE as usize));
        let traced = rows_of_tiles.try_for_each(|(row, top)| {
            // Render the tiles of a row in parallel; scratch memory is per task.
            let tiles = row.par_chunks_mut((TILE_SIDE * rows_of_tile(self.height, top)) as usize);
            let tiles = tiles.zip((0..self.width).into_par_iter().step_by(TILE_SIDE as usize));
            tiles.try_for_each_init(
                || TileTracer::new(&scene),
                |tracer, (pixels, left)| {
                    self.cancel.check()?;
                    tracer.render(params, [left, top], columns_of_tile(self.width, left), pixels);
                    let limited = pixels.iter().filter(|pixel| pixel.is_limited).count();
                    limited_pixels.fetch_add(limited as u64, Relaxed);
                    Ok(())
                },
            )
        });
        self.limited_pixels = limited_pixels.into_inner();
        // A frame that was cancelled is dropped, since its pixels are of two frames.
        if traced.is_err() {
            (self.width, self.height) = (0, 0);
        }
        traced
    }

    fn limited_pixels(&self) -> Result<u64> {
        Ok(self.limited_pixels)
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
        self.closest_hits_into(arrays, rays, ray_mask, &mut hits)?;
        Ok(hits)
    }

    fn any_hits(&mut self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<bool>> {
        let mut hits = vec![false; rays.len()];
        self.any_hits_into(arrays, rays, ray_mask, &mut hits)?;
        Ok(hits)
    }
}

impl Cpu {
    /// As [`closest_hits`](Tracer::closest_hits), but writes the hits into `hits`, so that a caller can reuse its
    /// allocation (page-faulting new memory can cost more than tracing).
    ///
    /// Each 16 consecutive rays form a packet, which is traversed as one while its rays visit the same nodes. Order
    /// rays so that neighbours in the slice have similar origins and directions.
    ///
    /// # Errors
    /// As [`RayRecord::validate`]; [`Error::Cancelled`](crate::Error::Cancelled): some of the hits are then written.
    ///
    /// # Panics
    /// If `hits` and `rays` differ in length.
    pub fn closest_hits_into(
        &self,
        arrays: &DeviceArrays,
        rays: &[RayRecord],
        ray_mask: u32,
        hits: &mut [HitRecord],
    ) -> Result<()> {
        assert_eq!(rays.len(), hits.len(), "`hits` and `rays` must have the same length");
        rays.iter().try_for_each(RayRecord::validate)?;
        let scene = KernelScene::with_traversal(arrays, Traversal::Wide);
        let tasks = rays.par_chunks(RAYS_PER_TASK).zip(hits.par_chunks_mut(RAYS_PER_TASK));
        tasks.try_for_each_init(
            || PacketTracer::new(&scene),
            |tracer, (rays, hits)| {
                self.cancel.check()?;
                tracer.closest_hits(rays, ray_mask, hits);
                Ok(())
            },
        )
    }

    /// As [`any_hits`](Tracer::any_hits), but writes the results into `hits`, so that a caller can reuse its
    /// allocation. Order rays as for [`closest_hits_into`](Self::closest_hits_into).
    ///
    /// # Errors
    /// As [`RayRecord::validate`]; [`Error::Cancelled`](crate::Error::Cancelled): some of the results are then written.
    ///
    /// # Panics
    /// If `hits` and `rays` differ in length.
    pub fn any_hits_into(
        &self,
        arrays: &DeviceArrays,
        rays: &[RayRecord],
        ray_mask: u32,
        hits: &mut [bool],
    ) -> Result<()> {
        assert_eq!(rays.len(), hits.len(), "`hits` and `rays` must have the same length");
        rays.iter().try_for_each(RayRecord::validate)?;
        let scene = KernelScene::with_traversal(arrays, Traversal::Wide);
        let tasks = rays.par_chunks(RAYS_PER_TASK).zip(hits.par_chunks_mut(RAYS_PER_TASK));
        tasks.try_for_each_init(
            || PacketTracer::new(&scene),
            |tracer, (rays, hits)| {
                self.cancel.check()?;
                tracer.any_hits(rays, ray_mask, hits);
                Ok(())
            },
        )
    }
}

/// Resizes to `count` pixels, and frees memory after a much larger frame.
fn resize(pixels: &mut Vec<Pixel>, count: usize) {
    pixels.resize(count, Pixel::MISS);
    if pixels.capacity() / 4 > count {
        pixels.shrink_to_fit();
    }
}

/// Number of rows of a tile whose first row is `top`.
fn rows_of_tile(height: u32, top: u32) -> u32 {
    TILE_SIDE.min(height - top)
}

/// Number of columns of a tile whose first column is `left`.
fn columns_of_tile(width: u32, left: u32) -> u32 {
    TILE_SIDE.min(width - left)
}

/// Index in [`Cpu::pixels`] of the pixel in column `x` and row `y`.
fn pixel_index([width, height]: [u32; 2], x: u32, y: u32) -> usize {
    let [left, top] = [x, y].map(|x| x / TILE_SIDE * TILE_SIDE);
    // Tiles are stored one after another: count the rows of tiles above, then the tiles to the left.
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

    /// Every pixel has its own index and no index is unused, so that `MAX_PIXELS` bounds memory for every aspect ratio.
    #[test]
    fn pixel_indices_are_a_permutation() {
        for (width, height) in [(1, 1), (16, 16), (15, 17), (33, 50), (1, 100), (100, 1), (64, 31)] {
            let mut indices: Vec<usize> =
                (0..height).flat_map(|y| (0..width).map(move |x| pixel_index([width, height], x, y))).collect();
            indices.sort_unstable();
            assert!(indices.into_iter().eq(0..(width * height) as usize), "{width} x {height}");
        }
        let long = 1 << 28;
        assert_eq!(pixel_index([1, long], 0, long - 1), long as usize - 1);
        assert_eq!(pixel_index([long, 1], long - 1, 0), long as usize - 1);
    }

    #[test]
    fn memory_is_freed_after_a_much_larger_frame() {
        let mut cpu = Cpu::default();
        let mut pixels_held = |width, height| {
            let params = FrameParams { width, height, ..FrameParams::zeroed() };
            let request = FrameRequest { params, needs: Needs::empty(), aovs: false };
            cpu.render(&DeviceArrays::default(), &request).unwrap();
            cpu.pixels.capacity()
        };
        assert!(pixels_held(200, 200) >= 40_000);
        // A slightly smaller frame keeps the memory.
        assert!(pixels_held(150, 150) >= 40_000);
        assert!(pixels_held(10, 10) < 1000);
        assert_eq!(pixels_held(0, 10), 0);
    }
}
