//! On which side of an edge a ray passes, and where it crosses a plane, without error.
//!
//! Signs are computed in f64 first. Where the result is not beyond the proven bound of its rounding errors, they are
//! computed by integers: of 128 bits where the numbers fit, of any length else. (The crate `robust` asks for points;
//! the end of a ray, origin plus direction, is no point that f64 has.)
//!
//! The bound holds where nothing underflows: numbers are 0, or multiples of 2^-300 below 2^300. All f32 are.

use glam::DVec3;
use num_bigint::BigInt;
use num_traits::{Float as _, Num, Signed, ToPrimitive as _};

/// The relative error of one operation of f64.
const U: f64 = 1.0 / (1_u64 << 53) as f64;
/// A triple product has at most seven roundings along one path: two differences, their product, a sum, a product, two
/// more sums. So 7 u / (1 - 7 u) of the sum of all magnitudes bounds its error. The sum itself is computed up to as
/// much, which the eighth u covers.
const TRIPLE_PRODUCT_ERROR: f64 = 8.0 * U;
/// A height is a triple product of three differences: one rounding more.
const HEIGHT_ERROR: f64 = 9.0 * U;
/// A quotient is computed by f64 if numerator and denominator are known this well.
const QUOTIENT_ERROR: f64 = 1.0 / (1_u64 << 40) as f64;
/// Numbers of this many bits may enter a determinant of 128 bits: three differences of 41 bits make 123, and the six
/// products of a sum three more.
const SMALL: u32 = 40;

/// The sign of `d . ((b - o) x (c - o))`: on which side of the edge from `b` to `c` the line through `o` along `d`
/// passes. 0 if it meets the edge's line, or is parallel to it.
pub(super) fn side([o, d]: [DVec3; 2], b: DVec3, c: DVec3) -> i32 {
    let (value, magnitude) = triple_product(d, b - o, c - o);
    if value.abs() > TRIPLE_PRODUCT_ERROR * magnitude {
        return if value > 0.0 { 1 } else { -1 };
    }
    let (points, direction) = ([o, b, c], [d]);
    match (small(&points), small(&direction)) {
        (Some((_, [o, b, c])), Some((_, [d]))) => sign(&triple_integer(&d, &minus(&b, &o), &minus(&c, &o))),
        _ => {
            let (_, [o, b, c]) = big(&points);
            let (_, [d]) = big(&direction);
            sign(&triple_integer(&d, &minus(&b, &o), &minus(&c, &o)))
        }
    }
}

/// Where the line crosses the plane of a triangle, in units of `d`, to 2^-38 of itself; `None` if it is parallel to the
/// plane or lies in it, and for a triangle whose corners lie on one line, which has no plane.
pub(super) fn crossing([o, d]: [DVec3; 2], [a, b, c]: [DVec3; 3]) -> Option<f64> {
    let (height, height_magnitude) = triple_product(a - o, b - a, c - a);
    let (slope, slope_magnitude) = triple_product(d, b - a, c - a);
    let is_known = |value: f64, magnitude: f64| HEIGHT_ERROR * magnitude <= QUOTIENT_ERROR * value.abs();
    if is_known(slope, slope_magnitude) && slope != 0.0 && is_known(height, height_magnitude) {
        return Some(height / slope);
    }
    let (points, direction) = ([o, a, b, c], [d]);
    if let (Some((e, [o, a, b, c])), Some((f, [d]))) = (small(&points), small(&direction)) {
        let [ab, ac] = [minus(&b, &a), minus(&c, &a)];
        let (height, slope) = (triple_integer(&minus(&a, &o), &ab, &ac), triple_integer(&d, &ab, &ac));
        return (slope != 0).then(|| height as f64 / slope as f64 * power_of_two(e - f));
    }
    let (e, [o, a, b, c]) = big(&points);
    let (f, [d]) = big(&direction);
    let [ab, ac] = [minus(&b, &a), minus(&c, &a)];
    let (height, slope) = (triple_integer(&minus(&a, &o), &ab, &ac), triple_integer(&d, &ab, &ac));
    (sign(&slope) != 0).then(|| {
        let [(height, by), (slope, over)] = [height, slope].map(leading_bits);
        height / slope * power_of_two(e - f + by - over)
    })
}

/// `a . (b x c)`, and the same with all products positive.
fn triple_product(a: DVec3, b: DVec3, c: DVec3) -> (f64, f64) {
    let [p, q] = [DVec3::new(b.y * c.z, b.z * c.x, b.x * c.y), DVec3::new(b.z * c.y, b.x * c.z, b.y * c.x)];
    (a.dot(p - q), a.abs().dot(p.abs() + q.abs()))
}

fn sign<T: Signed>(value: &T) -> i32 {
    i32::from(value.is_positive()) - i32::from(value.is_negative())
}

fn minus<T: Num + Clone>(a: &[T; 3], b: &[T; 3]) -> [T; 3] {
    std::array::from_fn(|i| a[i].clone() - b[i].clone())
}

fn triple_integer<T: Num + Clone>(a: &[T; 3], b: &[T; 3], c: &[T; 3]) -> T {
    let minor = |i: usize, j: usize| b[i].clone() * c[j].clone() - b[j].clone() * c[i].clone();
    a[0].clone() * minor(1, 2) + a[1].clone() * minor(2, 0) + a[2].clone() * minor(0, 1)
}

/// A number as an odd integer and a power of two; the integer of 0 is 0.
fn odd_part(value: f64) -> (i64, i32) {
    let (mantissa, exponent, sign) = value.integer_decode();
    if mantissa == 0 {
        return (0, 0);
    }
    let zeros = mantissa.trailing_zeros();
    ((mantissa >> zeros) as i64 * i64::from(sign), i32::from(exponent) + zeros as i32)
}

/// The exponent of the greatest power of two of which all the numbers are multiples.
fn common_exponent(points: &[DVec3]) -> i32 {
    let parts = points.iter().flat_map(|point| point.to_array()).map(odd_part);
    parts.filter(|(odd, _)| *odd != 0).map(|(_, exponent)| exponent).min().unwrap_or(0)
}

/// The points as integers, in units of a power of two, of which the exponent is returned; `None` if they have more than
/// [`SMALL`] bits.
fn small<const N: usize>(points: &[DVec3; N]) -> Option<(i32, [[i128; 3]; N])> {
    let unit = common_exponent(points);
    let mut integers = [[0; 3]; N];
    for (integers, point) in integers.iter_mut().zip(points) {
        for (integer, value) in integers.iter_mut().zip(point.to_array()) {
            let (odd, exponent) = odd_part(value);
            let shift = if odd == 0 { 0 } else { (exponent - unit) as u32 };
            if u64::BITS - odd.unsigned_abs().leading_zeros() + shift > SMALL {
                return None;
            }
            *integer = i128::from(odd) << shift;
        }
    }
    Some((unit, integers))
}

/// As [`small`], of any number of bits.
fn big<const N: usize>(points: &[DVec3; N]) -> (i32, [[BigInt; 3]; N]) {
    let unit = common_exponent(points);
    let integer = |value: f64| {
        let (odd, exponent) = odd_part(value);
        BigInt::from(odd) << if odd == 0 { 0 } else { (exponent - unit) as u32 }
    };
    (unit, points.map(|point| point.to_array().map(integer)))
}

/// An integer to 2^-53 of itself, as a number and a power of two.
fn leading_bits(value: BigInt) -> (f64, i32) {
    let shift = value.bits().saturating_sub(64);
    ((value >> shift).to_f64().unwrap_or(0.0), shift as i32)
}

fn power_of_two(exponent: i32) -> f64 {
    2.0_f64.powi(exponent)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_three_ways_to_compute_a_sign_agree() {
        let mut random = fastrand::Rng::with_seed(3);
        let mut zeros = 0;
        for round in 0..2000 {
            // Small integers meet edges often; a shift by a large one makes numbers of many bits.
            let shift = if round % 2 == 0 { 0.0 } else { 2f64.powi(60) };
            let mut point =
                |shift| DVec3::from_array([0; 3].map(|_| f64::from(random.i32(-3..=3)) * 2f64.powi(8) + shift));
            let (o, b, c, d) = (point(shift), point(shift), point(shift), point(0.0));
            let expected = sign(&triple_integer(&[d].map(exact)[0], &exact(b - o), &exact(c - o)));
            assert_eq!(side([o, d], b, c), expected, "{o} {d} {b} {c}");
            zeros += usize::from(expected == 0);
        }
        assert!(zeros > 100 && zeros < 1900, "{zeros}");
    }

    fn exact(v: DVec3) -> [i128; 3] {
        v.to_array().map(|x| x as i128)
    }

    #[test]
    fn a_crossing_is_exact_where_its_terms_cancel() {
        // A plane far away that is nearly parallel to the ray: the height is the difference of large products.
        let [a, b, c] =
            [[1e6, 0.0, 1.0], [1e6 + 1.0, 1.0, 1.0], [1e6, 1.0, 1.0 + 2f64.powi(-20)]].map(DVec3::from_array);
        let t = crossing([DVec3::ZERO, DVec3::X], [a, b, c]).unwrap();
        // z = 1 + (y - (x - 1e6)) * 2^-20 = 0 at y = 0.
        assert_eq!(t, 1e6 + 2f64.powi(20));
        assert_eq!(crossing([DVec3::ZERO, DVec3::X], [DVec3::Y, DVec3::Y * 2.0, DVec3::Y * 3.0]), None);
        assert_eq!(crossing([DVec3::ZERO, DVec3::X], [DVec3::X, DVec3::Y, DVec3::ONE - DVec3::Z]), None);
    }
}
