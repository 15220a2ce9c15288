//! What peers have in common.

use std::time::Duration;

use ropewalk::device::layout::RayRecord;
use ropewalk_bench::rays::RayKind;
use ropewalk_bench::runner::Runner;
use ropewalk_bench::time;

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
    /// Those with the flag for coherent rays.
    Embree16Coherent,
    Other,
}

/// Somebody else's structure over a scene.
pub trait Peer {
    /// The ways to trace rays with it.
    fn entries<'a>(&'a self, rays: &'a [RayRecord], kind: RayKind) -> Vec<Entry<'a>>;
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
