//! The part of a triangle that is near a ray.

use glam::{DVec2, DVec3};

/// A corner of a part of a triangle, seen along the ray: its place across the ray, and its t.
#[derive(Clone, Copy)]
struct Seen {
    across: DVec2,
    t: f64,
}

/// The least and the greatest t of the part of a triangle that the square around a line meets, `tolerance` times the
/// largest distance of a corner from the line's origin to each side; `None` if there is no such part.
pub(super) fn range_near([origin, direction]: [DVec3; 2], corners: [DVec3; 3], tolerance: f64) -> Option<[f64; 2]> {
    let length = direction.length();
    let along = direction / length;
    let (x, y) = along.any_orthonormal_pair();
    let half_side = tolerance * corners.iter().map(|corner| corner.distance(origin)).fold(0.0, f64::max);
    let seen = corners.map(|corner| {
        let q = corner - origin;
        Seen { across: DVec2::new(q.dot(x), q.dot(y)), t: q.dot(along) / length }
    });
    let mut part = Vec::from(seen);
    // Cut it at the four sides of the square (Sutherland, Hodgman).
    for side in [DVec2::X, DVec2::NEG_X, DVec2::Y, DVec2::NEG_Y] {
        part = cut(&part, |seen| half_side - seen.across.dot(side));
    }
    let least = part.iter().map(|seen| seen.t).reduce(f64::min)?;
    let greatest = part.iter().map(|seen| seen.t).reduce(f64::max)?;
    Some([least, greatest])
}

/// The part of a polygon that is inside, where a linear function is not negative.
fn cut(polygon: &[Seen], inside: impl Fn(&Seen) -> f64) -> Vec<Seen> {
    let mut part = Vec::with_capacity(polygon.len() + 1);
    for (i, from) in polygon.iter().enumerate() {
        let to = &polygon[(i + 1) % polygon.len()];
        let (a, b) = (inside(from), inside(to));
        if a >= 0.0 {
            part.push(*from);
        }
        if (a >= 0.0) != (b >= 0.0) {
            let share = a / (a - b);
            part.push(Seen { across: from.across.lerp(to.across, share), t: from.t + (to.t - from.t) * share });
        }
    }
    part
}
