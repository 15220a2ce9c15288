//! The interface of peers.

use std::time::Duration;

use ropewalk::device::layout::RayRecord;
use ropewalk_bench::rays::RayKind;
use ropewalk_bench::runner::Runner;
use ropewalk_bench::time;

/// The group of an executor or peer, for goals.
pub struct Entry<'a> {
    pub name: String,
    pub role: Role,
    pub runner: Box<dyn Runner + 'a>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Role {
    Ours,
    /// Embree with its defaults, single rays.
    Embree1,
    /// The same in packets of 16.
    Embree16,
    /// Packets with the flag for coherent rays.
    Embree16Coherent,
    Other,
}

/// A peer's structure over a scene.
pub trait Peer {
    /// The ways to trace rays with it.
    fn entries<'a>(&'a self, rays: &'a [RayRecord], kind: RayKind) -> Vec<Entry<'a>>;
}

/// A peer that traces single rays.
pub struct RayByRay<T, F> {
    rays: Vec<T>,
    trace: F,
    answers: Vec<f32>,
}

impl<T, F: Fn(&T) -> f32> RayByRay<T, F> {
    /// Rays in the peer's format, and the function that traces one.
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
