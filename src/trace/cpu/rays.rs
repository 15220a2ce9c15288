//! The door to the SIMD code: rays of any kind, one at a time or sixteen, with the lanes that this processor has.

use fearless_simd::{Level, Simd};
use glam::Vec3;

use super::ask::{Memory, any_hits, ask_one, closest_hits};
use super::lanes::LANES;
use crate::device::layout::{Hit, Ray};
use crate::trace::Layout;
use crate::trace::kernel::{KernelScene, Traverse, any_hit, closest_hit, transmittance};
use crate::trace::queries::{Closest, Query, Transmittance};

/// What a task traces rays with.
pub(super) struct Rays<'a> {
    scene: &'a KernelScene<'a>,
    lanes: Option<Level>,
    memory: Memory,
}

/// Calls a function with the widest lanes of this processor. What is compiled is compiled once for each of these, which takes its time: so
/// there are no more than users have.
macro_rules! with_lanes {
    ($level:expr, $simd:ident => $call:expr) => {
        match $level {
            #[cfg(target_arch = "x86_64")]
            Level::Avx512($simd) => $simd.vectorize(
                #[inline(always)]
                || $call,
            ),
            #[cfg(target_arch = "x86_64")]
            Level::Avx2($simd) => $simd.vectorize(
                #[inline(always)]
                || $call,
            ),
            #[cfg(target_arch = "aarch64")]
            Level::Neon($simd) => $simd.vectorize(
                #[inline(always)]
                || $call,
            ),
            _ => unreachable!("`lanes` says which there are"),
        }
    };
}

/// The processor's lanes, if it has those that the walks are compiled for.
fn lanes() -> Option<Level> {
    let level = Level::new();
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx512(_) | Level::Avx2(_) => Some(level),
        #[cfg(target_arch = "aarch64")]
        Level::Neon(_) => Some(level),
        _ => None,
    }
}

impl<'a> Rays<'a> {
    pub(super) fn new(scene: &'a KernelScene<'a>) -> Self {
        // Arrays made by hand may have no wide nodes: they are walked along escape indices, a ray at a time.
        let lanes = if scene.layout == Layout::Wide { lanes() } else { None };
        Self { scene, lanes, memory: Memory::default() }
    }

    /// Sixteen that follow one another best go much the same way.
    pub(super) fn closest_hits(&mut self, rays: &[Ray], ray_mask: u32, hits: &mut [Hit]) {
        let (scene, memory) = (self.scene, &mut self.memory);
        match self.lanes {
            Some(level) => by_packets(
                rays,
                hits,
                Hit::MISS,
                |rays, hits| with_lanes!(level, simd => closest_hits(simd, scene, memory, rays, ray_mask, hits)),
            ),
            None => hits.iter_mut().zip(rays).for_each(|(hit, ray)| *hit = closest_hit(scene, ray, ray_mask)),
        }
    }

    /// Sixteen that follow one another best go much the same way.
    pub(super) fn any_hits(&mut self, rays: &[Ray], ray_mask: u32, hits: &mut [bool]) {
        let (scene, memory) = (self.scene, &mut self.memory);
        match self.lanes {
            Some(level) => by_packets(
                rays,
                hits,
                false,
                |rays, hits| with_lanes!(level, simd => any_hits(simd, scene, memory, rays, ray_mask, hits)),
            ),
            None => hits.iter_mut().zip(rays).for_each(|(hit, ray)| *hit = any_hit(scene, ray, ray_mask)),
        }
    }

    fn ask<Q: Query>(&mut self, level: Level, ray: &Ray, ray_mask: u32) -> Q {
        let (scene, memory) = (self.scene, &mut self.memory);
        with_lanes!(level, simd => ask_one(simd, scene, memory, ray, ray_mask))
    }
}

/// Calls `trace` with whole packets; where rays are left over, with one more that has rays which meet nothing.
fn by_packets<T: Copy>(
    rays: &[Ray],
    hits: &mut [T],
    miss: T,
    mut trace: impl FnMut(&[[Ray; LANES]], &mut [[T; LANES]]),
) {
    let (packets, rest) = rays.as_chunks();
    let (hits, hits_of_rest) = hits.as_chunks_mut();
    trace(packets, hits);
    if let Some(first) = rest.first() {
        let mut packet = [Ray { t_max: f32::NEG_INFINITY, ..*first }; LANES];
        packet[..rest.len()].copy_from_slice(rest);
        let mut hits = [miss; LANES];
        trace(&[packet], std::array::from_mut(&mut hits));
        hits_of_rest.copy_from_slice(&hits[..rest.len()]);
    }
}

impl<'a> Traverse<'a> for Rays<'a> {
    fn scene(&self) -> &'a KernelScene<'a> {
        self.scene
    }

    fn closest_hit(&mut self, ray: &Ray, ray_mask: u32) -> Hit {
        match self.lanes {
            Some(level) => self.ask::<Closest>(level, ray, ray_mask).0,
            None => closest_hit(self.scene, ray, ray_mask),
        }
    }

    fn transmittance(&mut self, ray: &Ray, ray_mask: u32) -> Vec3 {
        match self.lanes {
            Some(level) => self.ask::<Transmittance>(level, ray, ray_mask).light(self.scene, ray, ray_mask),
            None => transmittance(self.scene, ray, ray_mask),
        }
    }
}
