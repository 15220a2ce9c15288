//! The door to the SIMD code: rays of any kind, one at a time or sixteen, with the lanes that this processor has.

use fearless_simd::{Level, Simd};
use glam::Vec3;

use super::ask::{ask, ask_packet};
use super::packet::LANES;
use super::single::Stack;
use crate::device::layout::{Hit, Ray};
use crate::trace::Layout;
use crate::trace::kernel::{KernelScene, Traverse, any_hit, closest_hit, transmittance};
use crate::trace::queries::{Any, Closest, Query, Transmittance};

/// What a task traces rays with.
pub(super) struct Rays<'a> {
    scene: &'a KernelScene<'a>,
    lanes: Option<Level>,
    stack: Stack,
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
        Self { scene, lanes, stack: Stack::default() }
    }

    /// Sixteen that follow one another best go much the same way.
    pub(super) fn closest_hits(&mut self, rays: &[Ray], ray_mask: u32, hits: &mut [Hit]) {
        match self.lanes {
            Some(level) => self.ask_packets(level, rays, ray_mask, hits, |query: &Closest| query.0),
            None => hits.iter_mut().zip(rays).for_each(|(hit, ray)| *hit = closest_hit(self.scene, ray, ray_mask)),
        }
    }

    /// Sixteen that follow one another best go much the same way.
    pub(super) fn any_hits(&mut self, rays: &[Ray], ray_mask: u32, hits: &mut [bool]) {
        match self.lanes {
            Some(level) => self.ask_packets(level, rays, ray_mask, hits, |query: &Any| query.is_hit),
            None => hits.iter_mut().zip(rays).for_each(|(hit, ray)| *hit = any_hit(self.scene, ray, ray_mask)),
        }
    }

    fn ask_packets<Q: Query, T>(
        &mut self,
        level: Level,
        rays: &[Ray],
        ray_mask: u32,
        answers: &mut [T],
        answer: impl Fn(&Q) -> T,
    ) {
        let mut queries = [Q::start(0.0); LANES];
        for (rays, answers) in rays.chunks(LANES).zip(answers.chunks_mut(LANES)) {
            let padded;
            let rays: &[Ray; LANES] = match rays.try_into() {
                Ok(rays) => rays,
                Err(_) => {
                    let nothing = Ray { t_max: f32::NEG_INFINITY, ..rays[0] };
                    padded = std::array::from_fn(|lane| rays.get(lane).copied().unwrap_or(nothing));
                    &padded
                }
            };
            let (scene, stack) = (self.scene, &mut self.stack);
            with_lanes!(level, simd => ask_packet(simd, scene, stack, rays, ray_mask, &mut queries));
            for (target, query) in answers.iter_mut().zip(&queries) {
                *target = answer(query);
            }
        }
    }

    fn ask<Q: Query>(&mut self, level: Level, ray: &Ray, ray_mask: u32) -> Q {
        let (scene, stack) = (self.scene, &mut self.stack);
        with_lanes!(level, simd => ask(simd, scene, stack, ray, ray_mask))
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
