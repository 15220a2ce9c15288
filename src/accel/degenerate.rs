//! Triangles without area: exactly those that no structure holds.
//!
//! Every ray misses a triangle whose corners lie on one line, but the tolerances of the triangle test would accept many
//! that pass it nearby. So builders leave such triangles out, and a refit gives up when a triangle becomes or ceases to
//! be one. Both ask [`is_degenerate`]. It decides exactly: a triangle with any area is part of the surface, however
//! narrow, and leaving it out would open a gap.

use glam::{DVec3, Vec3};
use robust::{Coord, orient2d};

/// Whether the three corners, which must be finite, lie on one line; two equal corners always do. Exact for all
/// coordinates. (With a coordinate that is not finite the result is unspecified.)
#[inline]
pub(super) fn is_degenerate(corners: [Vec3; 3]) -> bool {
    !clearly_has_area(corners) && is_exactly_collinear(corners)
}

/// A bound of the rounding error of a component of the cross product of two edges, relative to the sum of the
/// magnitudes of its two products. Each product has three roundings (two differences of coordinates, the product), and
/// their difference has one: four halves of an epsilon. The bound is twice that, which covers its own rounding, too.
const CROSS_ERROR_BOUND: f64 = 4.0 * f64::EPSILON;

/// Whether the cross product of two edges differs from zero by more than its rounding error. True for nearly all
/// triangles that have an area. In f64, in which no product of f32 overflows or underflows.
#[inline]
fn clearly_has_area(corners: [Vec3; 3]) -> bool {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    let (u, v) = (b - a, c - a);
    let p = DVec3::new(u.y * v.z, u.z * v.x, u.x * v.y);
    let q = DVec3::new(u.z * v.y, u.x * v.z, u.y * v.x);
    (p - q).abs().cmpgt((p.abs() + q.abs()) * CROSS_ERROR_BOUND).any()
}

/// Whether the projections of the triangle along all three axes have no area, by exact predicates (J. R. Shewchuk,
/// *Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates*, 1997).
#[cold]
fn is_exactly_collinear(corners: [Vec3; 3]) -> bool {
    // Two equal corners, the most frequent case, need no arithmetic.
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    if a == b || b == c || c == a {
        return true;
    }
    (0..3).all(|axis| {
        let [a, b, c] = [a, b, c].map(|v| Coord { x: v[(axis + 1) % 3], y: v[(axis + 2) % 3] });
        orient2d(a, b, c) == 0.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether the corners are degenerate; panics unless that is so in every order of them.
    fn in_any_order([a, b, c]: [Vec3; 3]) -> bool {
        let orders = [[a, b, c], [b, c, a], [c, a, b], [a, c, b], [c, b, a], [b, a, c]];
        let results = orders.map(is_degenerate);
        assert!(results.iter().all(|&result| result == results[0]), "{a} {b} {c}: {results:?}");
        results[0]
    }

    /// The vector with one component moved by one ulp.
    fn nudged(mut v: Vec3, axis: usize) -> Vec3 {
        v[axis] = v[axis].next_up();
        v
    }

    #[test]
    fn three_corners_on_a_line_are_degenerate_at_any_scale_and_one_ulp_beside_it_they_are_not() {
        let mut random = fastrand::Rng::with_seed(1);
        // Points of a line through the origin, at powers of two along it, are exact: from 1e-30 to 1e30 times as far.
        let places = [-100, -99, -40, -1, 0, 1, 2, 30, 99, 100].map(|exponent: i32| 2f32.powi(exponent));
        for _ in 0..3000 {
            let direction = Vec3::from_array([0; 3].map(|_| random.f32() * 2.0 - 1.0));
            let mut place = || places[random.usize(..places.len())] * if random.bool() { -1.0 } else { 1.0 };
            let [a, b, c] = [0; 3].map(|_| direction * place());
            assert!(in_any_order([a, b, c]), "{a} {b} {c}");
            if a != b && b != c && c != a {
                for axis in 0..3 {
                    assert!(!in_any_order([nudged(a, axis), b, c]), "{a} along {axis}, {b}, {c}");
                }
            }
        }
    }

    #[test]
    fn lines_parallel_to_an_axis_or_a_diagonal_take_any_coordinates() {
        let values = [0.0, -0.0, 1e-45, 1e-38, 1e-30, -1e-30, 0.1, -3.0, 1e30, -1e30, f32::MAX, f32::MIN];
        for (i, &a) in values.iter().enumerate() {
            for (j, &b) in values.iter().enumerate() {
                for &c in &values {
                    // Along each axis, at any place across it; and along the diagonal of a plane.
                    for axis in 0..3 {
                        let across = Vec3::new(values[i], values[j], values[(i + j) % values.len()]);
                        let along = [a, b, c]
                            .map(|x| Vec3::from_array([0, 1, 2].map(|k| if k == axis { x } else { across[k] })));
                        assert!(in_any_order(along), "{along:?}");
                        let diagonal =
                            [a, b, c].map(|x| Vec3::from_array([0, 1, 2].map(|k| if k == axis { 0.1 } else { x })));
                        assert!(in_any_order(diagonal), "{diagonal:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn triangles_with_an_area_are_not_degenerate_however_small_or_large() {
        for size in [1e-45, 1e-38, 1e-30, 1.0, 1e30, f32::MAX] {
            assert!(!in_any_order([Vec3::ZERO, Vec3::X * size, Vec3::Y * size]), "{size}");
            assert!(!in_any_order([Vec3::Z * size, Vec3::X * size, Vec3::NEG_Y * size]), "{size}");
            assert!(!in_any_order([Vec3::Z * 1e-45, Vec3::X * 1e-45, Vec3::Y * size]), "{size}");
            assert!(!in_any_order([Vec3::splat(size), Vec3::splat(-size), Vec3::Z * 1e-45]), "{size}");
        }
    }

    /// Corners of whole numbers on or next to lines, compared with integer arithmetic.
    #[test]
    fn the_result_is_that_of_integers() {
        let mut random = fastrand::Rng::with_seed(2);
        let mut counts = [0; 2];
        for i in 0..200_000 {
            let size = [4, 1 << 11, 1 << 19][i % 3];
            let mut vector = || [0; 3].map(|_| random.i64(-size..=size));
            let (a, direction) = (vector(), vector());
            let [first, second] = [0; 2].map(|_| random.i64(-8..=8));
            let beside = if random.bool() { random.usize(..3) } else { 3 };
            let b = [0, 1, 2].map(|k| a[k] + first * direction[k]);
            let c = [0, 1, 2].map(|k| a[k] + second * direction[k] + i64::from(k == beside));
            let (u, v) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
            let expected = [(0, 1), (1, 2), (2, 0)].iter().all(|&(x, y)| u[x] * v[y] == u[y] * v[x]);
            let scale = [-70, 0, 70].map(|exponent| 2f32.powi(exponent))[i / 3 % 3];
            let corners = [a, b, c].map(|corner| Vec3::from_array(corner.map(|x| x as f32)) * scale);
            assert_eq!(in_any_order(corners), expected, "{a:?} {b:?} {c:?}");
            counts[usize::from(expected)] += 1;
        }
        assert!(counts.iter().all(|&count| count > 50_000), "{counts:?}");
    }

    #[test]
    fn the_filter_suffices_for_needles_and_agrees_with_the_exact_test() {
        let mut random = fastrand::Rng::with_seed(3);
        let mut vector = || Vec3::from_array([0; 3].map(|_| random.f32() * 2.0 - 1.0));
        for i in 0..20_000 {
            let (a, b, beside) = (vector(), vector(), [1.0, 1e-3, 1e-6][i % 3]);
            let corners = [a, b, a.lerp(b, 0.3) + vector() * beside];
            assert!(clearly_has_area(corners) && !is_exactly_collinear(corners), "{corners:?}");
        }
    }
}
