//! The door to the SIMD code: rays of any kind, one at a time or sixteen, with the lanes that this processor has.

use fearless_simd::{Level, dispatch};
use glam::Vec3;

use super::packet::LANES;
use super::queries::{Any, Closest, Query, Transmittance, ask, ask_packet};
use super::single::Stack;
use crate::device::layout::{Hit, Ray};
use crate::trace::Layout;
use crate::trace::kernel::{KernelScene, Traverse, any_hit, closest_hit, transmittance};

/// What a task traces rays with.
pub(super) struct Rays<'a> {
    scene: &'a KernelScene<'a>,
    level: Level,
    stack: Stack,
}

impl<'a> Rays<'a> {
    pub(super) fn new(scene: &'a KernelScene<'a>) -> Self {
        Self { scene, level: Level::new(), stack: Stack::default() }
    }

    /// Of at most sixteen rays; best if they go much the same way.
    pub(super) fn closest_hits(&mut self, rays: &[Ray], ray_mask: u32) -> [Hit; LANES] {
        match self.scene.layout {
            Layout::Wide => self.ask_packet::<Closest>(rays, ray_mask).map(|query| query.0),
            Layout::Rope => each_ray(rays, Hit::MISS, |ray| closest_hit(self.scene, ray, ray_mask)),
        }
    }

    /// Of at most sixteen rays; best if they go much the same way.
    pub(super) fn any_hits(&mut self, rays: &[Ray], ray_mask: u32) -> [bool; LANES] {
        match self.scene.layout {
            Layout::Wide => self.ask_packet::<Any>(rays, ray_mask).map(|query| query.is_hit),
            Layout::Rope => each_ray(rays, false, |ray| any_hit(self.scene, ray, ray_mask)),
        }
    }

    fn ask<Q: Query>(&mut self, ray: &Ray, ray_mask: u32) -> Q {
        dispatch!(self.level, simd => ask(simd, self.scene, &mut self.stack, ray, ray_mask))
    }

    fn ask_packet<Q: Query>(&mut self, rays: &[Ray], ray_mask: u32) -> [Q; LANES] {
        dispatch!(self.level, simd => ask_packet(simd, self.scene, &mut self.stack, rays, ray_mask))
    }
}

/// Arrays made by hand may have no wide nodes: they are walked along escape indices.
fn each_ray<T: Copy>(rays: &[Ray], nothing: T, trace: impl Fn(&Ray) -> T) -> [T; LANES] {
    let mut results = [nothing; LANES];
    for (result, ray) in results.iter_mut().zip(rays) {
        *result = trace(ray);
    }
    results
}

impl<'a> Traverse<'a> for Rays<'a> {
    fn scene(&self) -> &'a KernelScene<'a> {
        self.scene
    }

    fn closest_hit(&mut self, ray: &Ray, ray_mask: u32) -> Hit {
        match self.scene.layout {
            Layout::Wide => self.ask::<Closest>(ray, ray_mask).0,
            Layout::Rope => closest_hit(self.scene, ray, ray_mask),
        }
    }

    fn transmittance(&mut self, ray: &Ray, ray_mask: u32) -> Vec3 {
        match self.scene.layout {
            Layout::Wide => self.ask::<Transmittance>(ray, ray_mask).light,
            Layout::Rope => transmittance(self.scene, ray, ray_mask),
        }
    }
}
