//! The render origin: how far the eye may go from it, and where it moves to then.
//!
//! The device's world is f32, relative to the render origin. If that were the eye's very position, an arbitrary f64,
//! every placement would be rounded, an identity matrix too. So it is a point of a grid of a power of two
//! ([`on_grid`]): a translation that is a multiple of the grid's step, within 2^24 steps of the origin, then differs
//! from it by a number that f32 has, and an instance that is not turned or scaled there is placed exactly.

use glam::DVec3;

use crate::device::layout::Node;
use crate::math::{Aabb, Bounds, power_of_two};

/// The free distance by what is near, in units of the [nearest extent](nearest_extent): 2^8, which bounds the error of
/// a position by 2^-16 of the distance or the size of whatever is seen from the eye.
const FREE_EXTENTS: f64 = 256.0;

/// What positions are to be precise for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Focus {
    /// The eye of a frame.
    Eye(DVec3),
    /// Rays that start anywhere in a box.
    RayStarts(Bounds),
    /// Whatever they are precise for.
    Unchanged,
}

/// Whether the render origin must move. `tlas` is relative to it.
///
/// For an eye: it is beyond its [free distance](free_distance), or f32 does not hold the origin, although the scene has
/// become large enough for one that it does hold. Otherwise camera motion changes nothing on the device. Where nothing
/// is placed, the origin follows the eye.
///
/// For rays: as for an eye in the middle of their starts, or positions are not exact enough for what is near any of
/// them; but only if an origin in their middle would be nearer to them than this one.
pub(super) fn must_rebase(focus: &Focus, origin: DVec3, tlas: &[Node]) -> bool {
    match focus {
        Focus::Eye(eye) if used_root(tlas).is_none() => origin != on_grid(*eye, f64::INFINITY),
        Focus::Eye(eye) => {
            is_beyond_free_distance(tlas, *eye - origin)
                || (!fits_f32(origin) && fits_f32(best_origin(focus, origin, tlas)))
        }
        Focus::RayStarts(starts) => {
            let relative = starts.relative_to(origin);
            let farthest = relative.min.abs().max(relative.max.abs()).length();
            relative.center().length() > relative.radius()
                && (is_beyond_free_distance(tlas, relative.center())
                    || has_extent_below(tlas, &relative, farthest / FREE_EXTENTS))
        }
        Focus::Unchanged => false,
    }
}

/// The best render origin. `tlas` is relative to the present one.
pub(super) fn best_origin(focus: &Focus, origin: DVec3, tlas: &[Node]) -> DVec3 {
    match focus {
        Focus::Eye(eye) => on_grid(*eye, free_distance(tlas, *eye - origin)),
        Focus::RayStarts(starts) => {
            let relative = starts.relative_to(origin);
            let free = nearest_extent(tlas, &relative, f64::INFINITY) * FREE_EXTENTS;
            on_grid(starts.center(), free.min(free_distance(tlas, relative.center())))
        }
        Focus::Unchanged => origin,
    }
}

/// How far the eye may be from the render origin before that moves. `tlas` and `eye` are relative to one point.
///
/// f32 resolves 2^-24 of the distance to the origin. With the eye inside the scene the distance is 1/256 of the scene's
/// radius, which bounds the error of a position by 2.3e-10 of that radius. Outside it is 16 times the distance to the
/// scene, which bounds the error by 1e-6 of that distance: far less than a pixel. The larger of the two counts, but no
/// more than [`FREE_EXTENTS`] allow: in a scene as wide as a planet a small thing before the eye is exact too. In an
/// empty scene nothing is placed, and the distance is infinite.
fn free_distance(tlas: &[Node], eye: DVec3) -> f64 {
    let distance = free_distance_of_scene(tlas, eye);
    nearest_extent(tlas, &point(eye), distance / FREE_EXTENTS) * FREE_EXTENTS
}

/// Whether the eye is farther from the point that positions are relative to than its [free distance](free_distance).
/// Costs little: only the nodes near the eye are visited.
fn is_beyond_free_distance(tlas: &[Node], eye: DVec3) -> bool {
    let distance = eye.length();
    distance > free_distance_of_scene(tlas, eye) || has_extent_below(tlas, &point(eye), distance / FREE_EXTENTS)
}

fn free_distance_of_scene(tlas: &[Node], eye: DVec3) -> f64 {
    let Some(root) = used_root(tlas) else { return f64::INFINITY };
    let (to_scene, radius) = distance_and_radius(root, &point(eye));
    (radius / 256.0).max(to_scene * 16.0)
}

/// The least extent of what can be seen from a box of eyes, at most `limit`: of all instances the least sum of the
/// distance from the box and the radius. A position is exact enough if its error is small beside that.
fn nearest_extent(tlas: &[Node], eyes: &Bounds, limit: f64) -> f64 {
    let mut least = limit;
    visit_leaves(tlas, |node| {
        let (distance, radius) = distance_and_radius(node, eyes);
        if node.is_leaf() {
            least = least.min(distance + radius);
        }
        distance < least
    });
    least
}

/// Whether the [nearest extent](nearest_extent) is below `limit`.
pub(super) fn has_extent_below(tlas: &[Node], eyes: &Bounds, limit: f64) -> bool {
    let mut found = false;
    visit_leaves(tlas, |node| {
        let (distance, radius) = distance_and_radius(node, eyes);
        found |= node.is_leaf() && distance + radius < limit;
        !found && distance < limit
    });
    found
}

/// Calls `enter` with nodes along escape indices; it returns whether to visit the node's children.
fn visit_leaves(tlas: &[Node], mut enter: impl FnMut(&Node) -> bool) {
    let mut index = if used_root(tlas).is_some() { 0 } else { tlas.len() };
    while let Some(node) = tlas.get(index) {
        let is_entered = !node.is_empty() && enter(node) && !node.is_leaf();
        // `NONE` is beyond the end of the array and so ends the loop.
        index = if is_entered { index + 1 } else { node.escape_index as usize };
    }
}

fn distance_and_radius(node: &Node, eyes: &Bounds) -> (f64, f64) {
    let bounds = Bounds::from(Aabb { min: node.min.into(), max: node.max.into() });
    let distance = (bounds.min - eyes.max).max(eyes.min - bounds.max).max(DVec3::ZERO).length();
    (distance, bounds.radius())
}

/// The root of a TLAS in which there is an instance.
fn used_root(tlas: &[Node]) -> Option<&Node> {
    tlas.first().filter(|root| !root.is_empty_root())
}

fn point(position: DVec3) -> Bounds {
    Bounds { min: position, max: position }
}

/// The render origin for an eye that may go this far: the grid point beside it, on the side of the world's origin.
///
/// The grid's step is 2^-14 of the eye's greatest coordinate, rounded down to a power of two: f32 holds the origin in
/// 16 of its 24 bits, and is within 2^-13 of the eye's distance from the world's origin. It is not more than 1/8 of the
/// free distance: so in a scene that is far smaller than its distance from the world's origin the step is finer,
/// and the origin has more bits; where those are more than 24, no point in the scene's reach is one that f32 holds.
///
/// Without a scene, the free distance being infinite, the origin depends on the eye alone; so in most scenes it does
/// not depend on what was edited in which order.
fn on_grid(eye: DVec3, free_distance: f64) -> DVec3 {
    let coarsest = (eye.abs().max_element() / f64::from(1 << 14)).min(free_distance / 8.0);
    let step = if coarsest < f64::MIN_POSITIVE { 0.0 } else { power_of_two(coarsest) };
    let snap = |x: f64| {
        // A number of 2^52 steps or more is a multiple of the step already.
        let steps = (x / step).trunc();
        if steps.abs() < f64::from(1 << 26) * f64::from(1 << 26) { steps * step } else { x }
    };
    DVec3::from_array(eye.to_array().map(snap))
}

/// Whether f32 has the point: with it as render origin identity placements are exact.
fn fits_f32(point: DVec3) -> bool {
    point.as_vec3().as_dvec3() == point
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Random numbers of any magnitude between 10 to the power of the two exponents.
    fn random(rng: &mut fastrand::Rng, [least, greatest]: [f64; 2]) -> f64 {
        let magnitude = 10f64.powf(least + (greatest - least) * rng.f64());
        if rng.bool() { magnitude } else { -magnitude }
    }

    #[test]
    fn an_origin_is_near_the_eye_and_exact_where_f32_can_be() {
        let mut rng = fastrand::Rng::with_seed(8);
        let mut exact = 0;
        for _ in 0..100_000 {
            let eye = DVec3::from_array([0; 3].map(|_| random(&mut rng, [-9.0, 9.0])));
            let free = random(&mut rng, [-9.0, 9.0]).abs();
            let origin = on_grid(eye, free);
            assert!(origin.distance(eye) <= free / 4.0, "{eye} {free}: {origin}");
            // f32 has it unless the rounding of f32 at the eye exceeds an eighth of the free distance.
            let rounding = power_of_two(eye.abs().max_element()) / f64::from(1 << 23);
            if rounding <= power_of_two(free / 8.0) {
                assert!(fits_f32(origin), "{eye} {free}: {origin}");
                exact += 1;
            }
        }
        assert!(exact > 50_000 && exact < 99_000, "{exact}");
    }

    #[test]
    fn an_origin_is_finite_for_any_eye() {
        for eye in [DVec3::new(0.1, -1e300, 1e-300), DVec3::splat(f64::MIN_POSITIVE), DVec3::ZERO, DVec3::MAX] {
            for free in [free_distance(&[], eye), 0.0, 1e-310, 1e-30, 1.0, f64::MAX] {
                let origin = on_grid(eye, free);
                assert!(
                    origin.is_finite() && (origin - eye).abs().max_element() <= free / 4.0,
                    "{eye} {free}: {origin}"
                );
            }
        }
    }
}
