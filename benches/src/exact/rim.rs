//! Whether a surface is crossed where a ray meets edges and corners, or only touched at its rim.
//!
//! Seen along the ray, a triangle that is met at an edge covers one side of the ray, and one that is met at a corner a
//! wedge. If the triangles met at one t cover all directions around the ray, each ray beside it meets one of them too:
//! the surface is crossed. Else some ray beside it passes: the surface is touched.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

/// Directions that are this near to each other are the same.
const ANGLE_TOLERANCE: f64 = 1e-9;
/// Meetings are at one t if these differ by less than this share of them.
const SAME_T: f64 = 1.0 / (1 << 30) as f64;

/// A triangle met at an edge or a corner: where, and which directions around the ray it covers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wedge {
    pub t: f64,
    /// Between 0 and 2 pi.
    start: f64,
    sweep: f64,
}

impl Wedge {
    /// Of a triangle that the line meets where edges of these sides are 0; `sides[i]` is that of the edge opposite to
    /// corner `i`.
    pub(super) fn new([origin, direction]: [DVec3; 2], corners: [DVec3; 3], sides: [i32; 3], t: f64) -> Self {
        let (x, y) = direction.normalize().any_orthonormal_pair();
        let seen = corners.map(|corner| DVec2::new((corner - origin).dot(x), (corner - origin).dot(y)));
        let zeros = sides.iter().filter(|&&side| side == 0).count();
        // An edge: from it towards the third corner. A corner: between the edges that leave it.
        let (from, to) = if zeros == 1 {
            let third = sides.iter().position(|&side| side == 0).unwrap_or(0);
            let (a, b, c) = (seen[(third + 1) % 3], seen[(third + 2) % 3], seen[third]);
            if (b - a).perp_dot(c - a) >= 0.0 { (b - a, a - b) } else { (a - b, b - a) }
        } else {
            let corner = sides.iter().position(|&side| side != 0).unwrap_or(0);
            let (a, b) = (seen[(corner + 1) % 3] - seen[corner], seen[(corner + 2) % 3] - seen[corner]);
            if a.perp_dot(b) >= 0.0 { (a, b) } else { (b, a) }
        };
        let start = from.to_angle().rem_euclid(TAU);
        let sweep = if zeros == 1 { PI } else { from.angle_to(to).abs() };
        Self { t, start, sweep }
    }
}

/// The least t at which all directions are covered.
pub(super) fn first_crossing(mut wedges: Vec<Wedge>) -> Option<f64> {
    wedges.sort_by(|a, b| a.t.total_cmp(&b.t));
    let is_same = |a: &Wedge, b: &Wedge| (b.t - a.t).abs() <= SAME_T * b.t.abs();
    wedges.chunk_by_mut(is_same).find_map(|group| covers_all(group).then(|| group[0].t))
}

fn covers_all(wedges: &mut [Wedge]) -> bool {
    wedges.sort_by(|a, b| a.start.total_cmp(&b.start));
    let Some(first) = wedges.first() else { return false };
    // Go around from the first start, as far as it is covered.
    let mut end = first.start;
    let again = wedges.iter().map(|wedge| (wedge.start + TAU, wedge.sweep));
    for (start, sweep) in wedges.iter().map(|wedge| (wedge.start, wedge.sweep)).chain(again) {
        if start > end + ANGLE_TOLERANCE {
            return false;
        }
        end = end.max(start + sweep);
        if end >= first.start + TAU - ANGLE_TOLERANCE {
            return true;
        }
    }
    false
}
