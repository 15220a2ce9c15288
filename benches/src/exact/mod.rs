//! What a ray hits, decided without error, and what a tracer's answer is worth.
//!
//! **Exact hit.** A ray meets a triangle if its line meets the closed triangle, edges and corners included, at a t
//! within `[t_min, t_max]`, both ends included. Which side of an edge the line passes is decided without error from the
//! numbers as they are given; t is known to 2^-38 of itself. A line that is parallel to a triangle's plane, or lies in
//! it, does not meet the triangle; nothing meets a triangle whose corners lie on one line.
//!
//! **Tolerances** are the same for all tracers. No tracer that computes in f32 decides exactly, and ours states how far
//! its edges reach. With q the vector from the ray's origin to a corner and |d| the length of the direction:
//!
//! - *of an edge*, [`EDGE_TOLERANCE`]: 2^-19 of the largest |q| of the triangle. A triangle is *near* the ray if the
//!   square around the ray with this half side meets it, seen along the ray;
//! - *of t*, [`T_TOLERANCE`]: 2^-20 of the greater of |t| and the smallest |q| / |d| of the triangle: a ray that starts
//!   beside a corner cannot know that distance better than the corner itself.
//!
//! **Verdicts**, for what a tracer reports about a ray:
//!
//! - *A hit must be reported*, or one before it, if it is clearly inside the range, farther from both ends than the
//!   tolerance of t, and the surface is *crossed* there: the ray meets the inside of a triangle, or edges and corners
//!   whose triangles lie on all sides of it. At a rim, where rays just beside it pass, a surface is only touched:
//!   tracers have different conventions there, and both answers are right. (Rows about the ends of ranges count the
//!   ends as inside, see [`Ends`].)
//! - *False miss*: a hit must be reported, and the tracer reports none.
//! - *False hit*: it reports a triangle that the exact ray neither meets nor comes near within the range, and no hit
//!   must be reported.
//! - *Wrong triangle*: a hit must be reported, and the tracer reports a triangle that lies behind it by more than the
//!   tolerance of t, or before the range, or that the ray neither meets nor is near.
//! - *Right* is everything else. A right hit is one *by tolerance* if the exact ray does not meet the triangle, but is
//!   near it, and the triangle's plane is not behind the ray's start.
//!
//! **Error of t**: the difference between the t reported and the exact t of the reported triangle, in units of the
//! greater of that t and the smallest |q| / |d|. Hits by tolerance have no exact t, and none of this.

mod near;
mod predicates;
mod rim;
mod tree;

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use ropewalk::device::layout::{NONE, RayRecord};

use rim::Wedge;
pub use tree::{Tree, TreeNode};

use crate::columns::Hit;

/// See the module.
pub const EDGE_TOLERANCE: f64 = 1.0 / (1 << 19) as f64;
/// See the module.
pub const T_TOLERANCE: f64 = 1.0 / (1 << 20) as f64;
/// Boxes are widened by this share of their coordinates and the ray's: far more than f64 rounds.
const BOX_SLACK: f64 = 1e-12;

/// Whether a hit exactly at an end of a ray's range must be reported.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ends {
    /// A hit within the tolerance of t of an end may be reported or not.
    #[default]
    Open,
    /// All hits from `t_min` to `t_max` must be reported, for rays whose t are numbers that f32 has.
    Closed,
}

/// What of a triangle is met.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Its inside.
    Interior,
    /// An edge, but no corner.
    Edge,
    /// A corner.
    Corner,
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Meeting {
    /// The triangle's index.
    pub triangle: u32,
    /// In units of the direction.
    pub t: f64,
    /// What of it is met.
    pub place: Place,
}

/// What a ray hits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// The nearest hit within the range. Of several at one t, any of them.
    pub nearest: Option<Meeting>,
    /// The t of the first hit that must be reported, or one before it.
    pub must_hit: Option<f64>,
}

/// What a report about a ray is worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// There is nothing to hit, or nothing that must be.
    RightMiss,
    /// The error of t, relatively.
    Right(f64),
    /// The triangle is not met, but near the ray.
    RightByTolerance,
    /// See the module.
    FalseMiss,
    /// See the module.
    FalseHit,
    /// See the module.
    WrongTriangle,
}

/// What a traversal has found of a ray.
struct Found {
    nearest: Option<Meeting>,
    /// The least t at which the inside of a triangle is met.
    crossing: f64,
    /// Triangles met at edges and corners.
    wedges: Vec<Wedge>,
}

/// A ray in f64.
#[derive(Clone, Copy)]
struct ExactRay {
    line: [DVec3; 2],
    range: [f64; 2],
}

impl From<&RayRecord> for ExactRay {
    fn from(ray: &RayRecord) -> Self {
        let line = [ray.origin, ray.direction].map(|v| Vec3::from_array(v).as_dvec3());
        Self { line, range: [ray.t_min, ray.t_max].map(f64::from) }
    }
}

/// Triangles, and what rays hit of them.
#[derive(Clone, Debug)]
pub struct Oracle {
    triangles: Vec<[DVec3; 3]>,
    tree: Tree,
    ends: Ends,
}

impl Oracle {
    /// Of triangles whose corners are taken as exact.
    pub fn new(triangles: Vec<[DVec3; 3]>, ends: Ends) -> Self {
        Self { tree: Tree::new(&triangles), triangles, ends }
    }

    /// The corners of a triangle.
    pub fn corners(&self, triangle: u32) -> Option<&[DVec3; 3]> {
        self.triangles.get(triangle as usize)
    }

    /// What each ray hits.
    pub fn truths(&self, rays: &[RayRecord]) -> Vec<Truth> {
        rays.par_iter().map(|ray| self.truth(ray)).collect()
    }

    /// What the ray hits. Of a ray with a number that is not finite: nothing.
    pub fn truth(&self, ray: &RayRecord) -> Truth {
        let ray = ExactRay::from(ray);
        let is_ray = ray.line.iter().all(|v| v.is_finite()) && ray.line[1] != DVec3::ZERO;
        if !is_ray {
            return Truth::default();
        }
        let mut found = Found { nearest: None, crossing: f64::INFINITY, wedges: Vec::new() };
        // Nothing behind a hit that must be reported is of interest.
        let enters = |found: &Found, node: &TreeNode| ray.meets(node, found.crossing);
        self.tree.visit(&mut found, enters, |found, triangle| {
            let Some((meeting, sides)) = self.meeting(&ray, triangle) else { return };
            let [t_min, t_max] = ray.range;
            if !(t_min..=t_max).contains(&meeting.t) {
                return;
            }
            if found.nearest.is_none_or(|nearest| meeting.t < nearest.t) {
                found.nearest = Some(meeting);
            }
            let slack = match self.ends {
                Ends::Open => self.t_tolerance(&ray, triangle, meeting.t),
                Ends::Closed => 0.0,
            };
            let is_clear = (t_min + slack..=t_max - slack).contains(&meeting.t);
            if is_clear && meeting.place == Place::Interior {
                found.crossing = found.crossing.min(meeting.t);
            } else if is_clear {
                found.wedges.push(Wedge::new(ray.line, self.triangles[triangle as usize], sides, meeting.t));
            }
        });
        let at_edges = rim::first_crossing(found.wedges).unwrap_or(f64::INFINITY);
        let must_hit = Some(found.crossing.min(at_edges)).filter(|t| t.is_finite());
        Truth { nearest: found.nearest, must_hit }
    }

    /// Where the whole line of a ray meets a triangle, and on which side of each edge it passes.
    fn meeting(&self, ray: &ExactRay, triangle: u32) -> Option<(Meeting, [i32; 3])> {
        let [a, b, c] = *self.triangles.get(triangle as usize)?;
        let sides = [(b, c), (c, a), (a, b)].map(|(from, to)| predicates::side(ray.line, from, to));
        if sides.contains(&1) && sides.contains(&-1) {
            return None;
        }
        let t = predicates::crossing(ray.line, [a, b, c])?;
        let place = match sides.iter().filter(|&&side| side == 0).count() {
            0 => Place::Interior,
            1 => Place::Edge,
            _ => Place::Corner,
        };
        Some((Meeting { triangle, t, place }, sides))
    }

    /// The least t of which a tracer can know a share: see the module.
    fn t_unit(&self, ray: &ExactRay, triangle: u32, t: f64) -> f64 {
        let to_corner = self.triangles[triangle as usize].map(|corner| corner.distance(ray.line[0]));
        t.abs().max(to_corner.into_iter().fold(f64::INFINITY, f64::min) / ray.line[1].length())
    }

    fn t_tolerance(&self, ray: &ExactRay, triangle: u32, t: f64) -> f64 {
        T_TOLERANCE * self.t_unit(ray, triangle, t)
    }

    /// What a report about a ray is worth, of which the truth is known.
    pub fn judge(&self, ray: &RayRecord, truth: &Truth, hit: &Hit) -> Verdict {
        if hit.primitive == NONE {
            return if truth.must_hit.is_some() { Verdict::FalseMiss } else { Verdict::RightMiss };
        }
        let wrong = if truth.must_hit.is_some() { Verdict::WrongTriangle } else { Verdict::FalseHit };
        if hit.primitive as usize >= self.triangles.len() {
            return wrong;
        }
        let ray = ExactRay::from(ray);
        let [t_min, t_max] = ray.range;
        let last = truth.must_hit.unwrap_or(t_max);
        let is_in_range = |[least, most]: [f64; 2]| {
            let tolerance = |t| self.t_tolerance(&ray, hit.primitive, t);
            most >= t_min - tolerance(most) && least <= last + tolerance(last)
        };
        if let Some((Meeting { t, .. }, _)) = self.meeting(&ray, hit.primitive) {
            let error = (hit.t - t).abs() / self.t_unit(&ray, hit.primitive, t);
            return if is_in_range([t, t]) { Verdict::Right(error) } else { wrong };
        }
        let corners = self.triangles[hit.primitive as usize];
        let Some(t_plane) = predicates::crossing(ray.line, corners) else { return wrong };
        let is_before_start = t_plane < t_min - self.t_tolerance(&ray, hit.primitive, t_plane);
        match near::range_near(ray.line, corners, EDGE_TOLERANCE) {
            Some(range) if is_in_range(range) && !is_before_start => Verdict::RightByTolerance,
            _ => wrong,
        }
    }
}

impl ExactRay {
    /// Slab test that admits too much rather than too little.
    fn meets(&self, node: &TreeNode, t_max: f64) -> bool {
        let [origin, direction] = self.line;
        let slack = BOX_SLACK * node.min.abs().max(node.max.abs()).max(origin.abs()).max_element() + f64::MIN_POSITIVE;
        let (a, b) = ((node.min - slack - origin) / direction, (node.max + slack - origin) / direction);
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        near <= far && far >= self.range[0] && near <= self.range[1].min(t_max)
    }
}

/// The corners as f64 has them.
pub fn widened(triangles: &[[Vec3; 3]]) -> Vec<[DVec3; 3]> {
    triangles.iter().map(|corners| corners.map(|corner| corner.as_dvec3())).collect()
}

#[cfg(test)]
mod tests;
