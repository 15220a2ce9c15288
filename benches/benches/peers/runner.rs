//! Who traces: Ropewalk, and what peers have in common.

use std::time::Duration;

use rayon::ThreadPool;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{Hit, NONE, Ray};
use ropewalk::trace::{Cpu, Tracer as _};
use ropewalk_bench::rays::{RayKind, any_answer, closest_answer};
use ropewalk_bench::time;

/// Traces a set of rays.
pub trait Runner {
    /// Traces all of them once and says how long it took.
    fn run(&mut self) -> Duration;

    /// What the last run found, as [`closest_answer`] and [`any_answer`] have it.
    fn answers(&self) -> Vec<f32>;
}

/// Who traces, and what a goal compares it as.
pub struct Entry<'a> {
    pub name: String,
    pub role: Role,
    pub runner: Box<dyn Runner + 'a>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Role {
    Ours,
    /// Embree as it comes, a ray at a time.
    Embree1,
    /// The same, 16 at a time.
    Embree16,
    Other,
}

/// Somebody else's structure over a scene.
pub trait Peer {
    /// The ways to trace rays with it.
    fn entries<'a>(&'a self, rays: &'a [Ray], kind: RayKind) -> Vec<Entry<'a>>;
}

/// A peer that is asked for one ray after the other.
pub struct RayByRay<T, F> {
    rays: Vec<T>,
    trace: F,
    answers: Vec<f32>,
}

impl<T, F: Fn(&T) -> f32> RayByRay<T, F> {
    /// Rays as the peer takes them, and how it finds the answer to one.
    pub fn new(rays: Vec<T>, trace: F) -> Self {
        Self { answers: vec![0.0; rays.len()], rays, trace }
    }
}

impl<T, F: Fn(&T) -> f32> Runner for RayByRay<T, F> {
    fn run(&mut self) -> Duration {
        time(|| {
            for (ray, answer) in self.rays.iter().zip(&mut self.answers) {
                *answer = (self.trace)(ray);
            }
        })
    }

    fn answers(&self) -> Vec<f32> {
        self.answers.clone()
    }
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
