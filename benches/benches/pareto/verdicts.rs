//! What tracers' answers to rays are worth, and how fast they are given.

use glam::Vec3;
use rayon::ThreadPool;
use rayon::prelude::*;
use ropewalk::device::layout::RayRecord;
use ropewalk_bench::exact::{Ends, Oracle, Truth, Verdict, widened};
use ropewalk_bench::{Result, median};

use crate::tracers::{Contender, Tracing};

/// Triangles, and rays with what they hit.
pub struct Case {
    pub triangles: Vec<[Vec3; 3]>,
    pub rays: Vec<RayRecord>,
    oracle: Oracle,
    truths: Vec<Truth>,
}

/// The verdicts about some answers.
#[derive(Clone, Default)]
pub struct Tally {
    pub rays: usize,
    /// Rays that miss what they must hit.
    pub leaks: usize,
    /// Rays that hit what is not there, or something behind what they must hit.
    pub wrong_hits: usize,
    /// The relative error of t of each right hit.
    pub errors: Vec<f64>,
}

impl Tally {
    fn add(&mut self, verdict: Verdict) {
        self.rays += 1;
        match verdict {
            Verdict::RightMiss | Verdict::RightByTolerance => {}
            Verdict::Right(error) => self.errors.push(error),
            Verdict::FalseMiss => self.leaks += 1,
            Verdict::FalseHit | Verdict::WrongTriangle => self.wrong_hits += 1,
        }
    }

    pub fn faults_per_million(&self) -> f64 {
        (self.leaks + self.wrong_hits) as f64 * 1e6 / self.rays.max(1) as f64
    }

    pub fn worst_error(&self) -> f64 {
        self.errors.iter().copied().fold(0.0, f64::max)
    }

    pub fn median_error(&self) -> f64 {
        let mut errors = self.errors.clone();
        errors.sort_by(f64::total_cmp);
        errors.get(errors.len() / 2).copied().unwrap_or_default()
    }

    pub fn plus(mut self, other: Self) -> Self {
        self.rays += other.rays;
        self.leaks += other.leaks;
        self.wrong_hits += other.wrong_hits;
        self.errors.extend(other.errors);
        self
    }
}

impl Case {
    pub fn new(triangles: Vec<[Vec3; 3]>, rays: Vec<RayRecord>) -> Self {
        let oracle = Oracle::new(widened(&triangles), Ends::Open);
        let truths = oracle.truths(&rays);
        Self { triangles, rays, oracle, truths }
    }

    /// Judges a tracer's answers to all rays.
    ///
    /// # Errors
    /// Those of the tracer.
    pub fn judge(&self, tracing: &dyn Tracing) -> Result<Tally> {
        let (hits, _) = tracing.trace(&self.rays)?;
        let judged = self.rays.par_iter().zip(&self.truths).zip(&hits);
        let verdicts: Vec<Verdict> = judged.map(|((ray, truth), hit)| self.oracle.judge(ray, truth, hit)).collect();
        let mut tally = Tally::default();
        verdicts.into_iter().for_each(|verdict| tally.add(verdict));
        Ok(tally)
    }

    /// Seconds that each contender takes for the first so many rays, in a pool of one thread: medians of samples that
    /// are taken in turns.
    ///
    /// # Errors
    /// Those of the tracers.
    pub fn seconds(
        &self,
        pool: &ThreadPool,
        contenders: &[Contender<'_>],
        rays: usize,
        samples: usize,
    ) -> Result<Vec<f64>> {
        let rays = &self.rays[..rays.min(self.rays.len())];
        let mut times = vec![Vec::new(); contenders.len()];
        for sample in 0..=samples {
            for (contender, times) in contenders.iter().zip(&mut times) {
                let time = || contender.tracing.trace(rays).map(|(_, time)| time).map_err(|error| error.to_string());
                let time = pool.install(time)?;
                // The first sample does not count.
                if sample > 0 {
                    times.push(time);
                }
            }
        }
        Ok(times.into_iter().map(|times| median(times).as_secs_f64()).collect())
    }
}
