//! Executors and peers that trace the same rays repeatedly.

use std::time::Duration;

use rayon::ThreadPool;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{HitRecord, NONE, RayRecord};
use ropewalk::trace::Tracer;

use crate::rays::{RayKind, any_answer, closest_answer};
use crate::time;

/// Traces a set of rays.
pub trait Runner {
    /// Traces all of them once and says how long it took.
    fn run(&mut self) -> Duration;

    /// What the last run found, as [`closest_answer`] and [`any_answer`] have it.
    fn answers(&self) -> Vec<f32>;
}

/// An executor, in a thread pool.
pub struct Traced<'a> {
    tracer: Box<dyn Tracer + Send>,
    pool: &'a ThreadPool,
    arrays: &'a DeviceArrays,
    rays: &'a [RayRecord],
    kind: RayKind,
    closest: Vec<HitRecord>,
    any: Vec<bool>,
}

impl<'a> Traced<'a> {
    /// The arrays must have been uploaded.
    pub fn new(
        tracer: impl Tracer + Send + 'static,
        pool: &'a ThreadPool,
        arrays: &'a DeviceArrays,
        rays: &'a [RayRecord],
        kind: RayKind,
    ) -> Self {
        Self { tracer: Box::new(tracer), pool, arrays, rays, kind, closest: Vec::new(), any: Vec::new() }
    }
}

impl Runner for Traced<'_> {
    fn run(&mut self) -> Duration {
        let Self { tracer, pool, arrays, rays, kind, closest, any } = self;
        // The result of the last run is dropped before the clock starts.
        (*closest, *any) = (Vec::new(), Vec::new());
        if kind.is_any_hit() {
            pool.install(|| time(|| *any = tracer.any_hits(arrays, rays, NONE).unwrap_or_default()))
        } else {
            pool.install(|| time(|| *closest = tracer.closest_hits(arrays, rays, NONE).unwrap_or_default()))
        }
    }

    fn answers(&self) -> Vec<f32> {
        if self.kind.is_any_hit() {
            return self.any.iter().copied().map(any_answer).collect();
        }
        self.closest.iter().map(closest_answer).collect()
    }
}
