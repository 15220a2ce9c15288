//! Ropewalk and Embree, each tracing the same rays over and over.

use std::time::Duration;

use rayon::ThreadPool;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{Hit, NONE, Ray};
use ropewalk::trace::{Cpu, Tracer as _};
use ropewalk_bench::embree::{self, Batch};
use ropewalk_bench::rays::{RayKind, any_answer, closest_answer};
use ropewalk_bench::time;

/// Traces a set of rays.
pub trait Runner {
    /// Traces all of them once and says how long it took.
    fn run(&mut self) -> Duration;

    /// What the last run found, as [`closest_answer`] and [`any_answer`] have it.
    fn answers(&self) -> Vec<f32>;
}

/// The executor `cpu`, in a thread pool.
pub struct Ropewalk<'a> {
    arrays: &'a DeviceArrays,
    rays: &'a [Ray],
    kind: RayKind,
    pool: &'a ThreadPool,
    cpu: Cpu,
    closest: Vec<Hit>,
    any: Vec<bool>,
}

impl<'a> Ropewalk<'a> {
    pub fn new(arrays: &'a DeviceArrays, rays: &'a [Ray], kind: RayKind, pool: &'a ThreadPool) -> Self {
        Self { arrays, rays, kind, pool, cpu: Cpu::default(), closest: Vec::new(), any: Vec::new() }
    }
}

impl Runner for Ropewalk<'_> {
    fn run(&mut self) -> Duration {
        let Self { arrays, rays, kind, pool, cpu, closest, any } = self;
        // What the last run returned goes before the clock starts.
        (*closest, *any) = (Vec::new(), Vec::new());
        if kind.is_any_hit() {
            pool.install(|| time(|| *any = cpu.any_hits(arrays, rays, NONE).unwrap_or_default()))
        } else {
            pool.install(|| time(|| *closest = cpu.closest_hits(arrays, rays, NONE).unwrap_or_default()))
        }
    }

    fn answers(&self) -> Vec<f32> {
        if self.kind.is_any_hit() {
            return self.any.iter().copied().map(any_answer).collect();
        }
        self.closest.iter().map(closest_answer).collect()
    }
}

/// One of Embree's functions.
pub struct Embree<'a, B> {
    scene: &'a embree::Scene<'a>,
    rays: &'a [Ray],
    is_coherent: bool,
    batch: B,
}

impl<'a, B: Batch + Default> Embree<'a, B> {
    pub fn new(scene: &'a embree::Scene<'a>, rays: &'a [Ray], is_coherent: bool) -> Self {
        Self { scene, rays, is_coherent, batch: B::default() }
    }
}

impl<B: Batch> Runner for Embree<'_, B> {
    fn run(&mut self) -> Duration {
        self.batch.write(self.rays);
        time(|| self.batch.trace(self.scene, self.is_coherent))
    }

    fn answers(&self) -> Vec<f32> {
        self.batch.answers()
    }
}
