//! Crates: `obvhs`, `bvh`, `parry3d`. None of them has packets.

use glam::Vec3;
use obvhs::BvhBuildParams;
use ropewalk::device::layout::RayRecord;
use ropewalk_bench::peers::{Bvh, Obvhs, Parry};
use ropewalk_bench::rays::{RayKind, any_answer};
use ropewalk_bench::runner::Runner;

use crate::peer::{Entry, Peer, RayByRay, Role};

fn entry<'a>(name: &str, runner: impl Runner + 'a) -> Entry<'a> {
    Entry { name: name.to_owned(), role: Role::Other, runner: Box::new(runner) }
}

/// The distance of a hit; infinity for a miss.
fn closest_answer(hit: Option<(u32, f32)>) -> f32 {
    hit.map_or(f32::INFINITY, |(_, t)| t)
}

/// `obvhs` with two of its presets.
pub struct ObvhsPresets([(&'static str, Obvhs); 2]);

impl ObvhsPresets {
    pub fn build(triangles: &[[Vec3; 3]]) -> Self {
        let presets =
            [("obvhs, medium", BvhBuildParams::medium_build()), ("obvhs, slow", BvhBuildParams::slow_build())];
        Self(presets.map(|(name, params)| (name, Obvhs::build_with(triangles, params))))
    }
}

impl Peer for ObvhsPresets {
    fn entries<'a>(&'a self, rays: &'a [RayRecord], kind: RayKind) -> Vec<Entry<'a>> {
        let entries = self.0.iter().map(|(name, obvhs)| {
            let trace = move |ray: &obvhs::ray::Ray| {
                if kind.is_any_hit() { any_answer(obvhs.any(ray)) } else { closest_answer(obvhs.closest(ray)) }
            };
            entry(name, RayByRay::new(rays.iter().map(Obvhs::ray).collect(), trace))
        });
        entries.collect()
    }
}

impl Peer for Bvh {
    fn entries<'a>(&'a self, rays: &'a [RayRecord], kind: RayKind) -> Vec<Entry<'a>> {
        let trace = move |(ray, own): &(RayRecord, bvh::ray::Ray<f32, 3>)| {
            if kind.is_any_hit() { any_answer(self.any(ray, own)) } else { closest_answer(self.closest(ray, own)) }
        };
        vec![entry("bvh", RayByRay::new(rays.iter().map(|ray| (*ray, Self::ray(ray))).collect(), trace))]
    }
}

impl Peer for Parry {
    fn entries<'a>(&'a self, rays: &'a [RayRecord], kind: RayKind) -> Vec<Entry<'a>> {
        let trace = move |(ray, t_max): &(parry3d::query::Ray, f32)| {
            let hit = self.closest(ray, *t_max);
            if kind.is_any_hit() { any_answer(hit.is_some()) } else { closest_answer(hit) }
        };
        vec![entry("parry3d", RayByRay::new(rays.iter().map(|ray| (Self::ray(ray), ray.t_max)).collect(), trace))]
    }
}
