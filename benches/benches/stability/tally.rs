//! What a column's answers to the rays of a row are worth.

use rayon::prelude::*;
use ropewalk::device::layout::{NONE, RayRecord};
use ropewalk_bench::columns::{Hit, PEERS};
use ropewalk_bench::exact::{Oracle, Truth, Verdict};

/// The header of the report: a line for each cell of the table.
pub const COLUMNS: [&str; 11] = [
    "case",
    "rays",
    "tracer",
    "hits",
    "false misses",
    "false hits",
    "wrong triangles",
    "hits by tolerance",
    "greatest error of t",
    "differs from cpu",
    "remark",
];

/// Counts of verdicts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    pub hits: u64,
    pub false_misses: u64,
    pub false_hits: u64,
    pub wrong_triangles: u64,
    /// Right hits of triangles that are not met exactly.
    pub by_tolerance: u64,
    /// The greatest error of t of a right hit.
    pub worst_t: f64,
    /// Of our executors: rays whose hit is not bit for bit that of `cpu`.
    pub differs: Option<u64>,
}

/// A tracer's answers to a row.
#[derive(Clone, Debug)]
pub struct Cell {
    pub tracer: &'static str,
    pub tally: Tally,
    /// The first faulty ray, what is reported of it, and the corners of the triangles concerned.
    pub first_fault: Option<String>,
    /// Why the tracer could not be asked, or what it refused.
    pub remark: String,
}

impl Tally {
    /// Judges all hits. Rays with a number that is not finite are left out: no tracer says what they hit.
    pub fn of(oracle: &Oracle, rays: &[RayRecord], truths: &[Truth], hits: &[Hit]) -> Self {
        let judged = rays.par_iter().zip(truths).zip(hits).filter(|((ray, _), _)| is_finite(ray));
        let tally = |((ray, truth), hit): ((&RayRecord, &Truth), &Hit)| {
            Self::of_verdict(oracle.judge(ray, truth, hit), hit.primitive != NONE)
        };
        judged.map(tally).reduce(Self::default, Self::plus)
    }

    fn of_verdict(verdict: Verdict, is_hit: bool) -> Self {
        let mut tally = Self { hits: is_hit.into(), ..Self::default() };
        match verdict {
            Verdict::RightMiss => {}
            Verdict::Right(error) => tally.worst_t = error,
            Verdict::RightByTolerance => tally.by_tolerance = 1,
            Verdict::FalseMiss => tally.false_misses = 1,
            Verdict::FalseHit => tally.false_hits = 1,
            Verdict::WrongTriangle => tally.wrong_triangles = 1,
        }
        tally
    }

    fn plus(self, other: Self) -> Self {
        Self {
            hits: self.hits + other.hits,
            false_misses: self.false_misses + other.false_misses,
            false_hits: self.false_hits + other.false_hits,
            wrong_triangles: self.wrong_triangles + other.wrong_triangles,
            by_tolerance: self.by_tolerance + other.by_tolerance,
            worst_t: self.worst_t.max(other.worst_t),
            differs: None,
        }
    }

    /// The first faulty ray in words, with its numbers in full.
    pub fn first_fault(oracle: &Oracle, rays: &[RayRecord], truths: &[Truth], hits: &[Hit]) -> Option<String> {
        let judged = rays.iter().zip(truths).zip(hits).filter(|((ray, _), _)| is_finite(ray));
        let mut faults = judged.filter_map(|((ray, truth), hit)| {
            let verdict = oracle.judge(ray, truth, hit);
            let is_fault = matches!(verdict, Verdict::FalseMiss | Verdict::FalseHit | Verdict::WrongTriangle);
            let corners = |triangle: u32| oracle.corners(triangle);
            is_fault.then(|| {
                let nearest = truth.nearest.map(|nearest| corners(nearest.triangle));
                format!("{verdict:?} {ray:?}\n  {hit:?} of {:?}\n  {truth:?} of {nearest:?}", corners(hit.primitive))
            })
        });
        faults.next()
    }

    pub fn faults(&self) -> u64 {
        self.false_misses + self.false_hits + self.wrong_triangles
    }
}

/// Whether all numbers that say where a ray goes are finite.
pub fn is_finite(ray: &RayRecord) -> bool {
    ray.origin.iter().chain(&ray.direction).all(|x| x.is_finite()) && !ray.t_min.is_nan() && !ray.t_max.is_nan()
}

impl Cell {
    pub fn is_ours(&self) -> bool {
        !PEERS.contains(&self.tracer)
    }

    /// The first fault of the row, as text; empty without one.
    pub fn first_fault(&self, case: &str) -> String {
        let Some(fault) = &self.first_fault else { return String::new() };
        format!("{case}, {}\n{fault}\n", self.tracer)
    }

    /// A line of the report.
    pub fn line(&self, case: &str, rays: usize) -> [String; 11] {
        let Tally { hits, false_misses, false_hits, wrong_triangles, by_tolerance, worst_t, differs } = self.tally;
        [
            case.to_owned(),
            rays.to_string(),
            self.tracer.to_owned(),
            hits.to_string(),
            false_misses.to_string(),
            false_hits.to_string(),
            wrong_triangles.to_string(),
            by_tolerance.to_string(),
            format!("{worst_t:.1e}"),
            differs.map_or(String::new(), |differs| differs.to_string()),
            self.remark.clone(),
        ]
    }
}
