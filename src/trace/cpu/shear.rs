//! The shear of the triangle test: which axes it permutes, and its coefficients.
//!
//! The triangle test looks along the ray (Woop et al. 2013). It permutes coordinates so that the dominant axis of the
//! ray's direction, the one with the largest component, comes last, and shears them so that the ray lies on that axis.
//! The row of [`SHEAR_AXES`] that a ray uses also tells its dominant axis and sign, by which packets are found to be
//! coherent.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, mask32x16, u32x16};

use super::simd::{LANES, abs};

/// Permutations (x, y, t) of the axes by dominant axis and sign: +x, -x, +y, -y, +z, -z. x and y are swapped for
/// negative directions so that the winding is preserved (Woop et al. 2013).
pub(super) const SHEAR_AXES: [[usize; 3]; 6] = [[1, 2, 0], [2, 1, 0], [2, 0, 1], [0, 2, 1], [0, 1, 2], [1, 0, 2]];

/// The inverse permutation of a row of [`SHEAR_AXES`]: where x, y and z stand in that row.
#[inline(always)]
pub(super) fn inverse_shear_axes(row: usize) -> [usize; 3] {
    static INVERSES: [[usize; 3]; SHEAR_AXES.len()] = {
        let mut inverses = [[0; 3]; SHEAR_AXES.len()];
        let mut i = 0;
        while i < SHEAR_AXES.len() * 3 {
            inverses[i / 3][SHEAR_AXES[i / 3][i % 3]] = i % 3;
            i += 1;
        }
        inverses
    };
    INVERSES[row % INVERSES.len()]
}

/// The dominant axis and sign of each lane's direction.
pub(super) struct DominantAxes<S: Simd> {
    is_x: mask32x16<S>,
    /// Meaningful in lanes whose dominant axis is not x.
    is_y: mask32x16<S>,
    is_negative: mask32x16<S>,
}

impl<S: Simd> DominantAxes<S> {
    /// Those of `directions`; ties go to the first of x, y and z.
    #[inline(always)]
    pub(super) fn new(directions: [f32x16<S>; 3]) -> Self {
        let [x, y, z] = abs(directions);
        let is_x = x.simd_ge(y) & x.simd_ge(z);
        let is_y = y.simd_ge(z);
        let dominant = is_x.select(directions[0], is_y.select(directions[1], directions[2]));
        Self { is_x, is_y, is_negative: dominant.simd_lt(0.0) }
    }

    /// Those of lanes that use these rows of [`SHEAR_AXES`].
    #[inline(always)]
    pub(super) fn from_rows(simd: S, rows: [u32; LANES]) -> Self {
        let rows = u32x16::simd_from(simd, rows);
        // Rows 0 and 1 have the dominant axis x, rows 2 and 3 y, rows 4 and 5 z.
        Self { is_x: rows.simd_lt(2), is_y: rows.simd_lt(4), is_negative: (rows & 1).simd_eq(1) }
    }

    /// The row of [`SHEAR_AXES`] that each lane uses.
    #[inline(always)]
    pub(super) fn rows(&self, simd: S) -> u32x16<S> {
        let [zero, one] = [u32x16::splat(simd, 0), u32x16::splat(simd, 1)];
        let first_row = self.is_x.select(zero, self.is_y.select(u32x16::splat(simd, 2), u32x16::splat(simd, 4)));
        first_row + self.is_negative.select(one, zero)
    }

    /// Permutes coordinates to the shear axes of each lane.
    #[inline(always)]
    pub(super) fn permute(&self, [x, y, z]: [f32x16<S>; 3]) -> [f32x16<S>; 3] {
        let t = self.is_x.select(x, self.is_y.select(y, z));
        let i = self.is_x.select(y, self.is_y.select(z, x));
        let j = self.is_x.select(z, self.is_y.select(x, y));
        [self.is_negative.select(j, i), self.is_negative.select(i, j), t]
    }
}

/// The shear of [`ShearRay`](crate::trace::kernel::ShearRay) in compact form: each of its rows has one slope and one
/// scale.
#[derive(Clone, Copy)]
pub(super) struct Shear<V> {
    /// Scale of x and y, negated because the operands are origin - vertex.
    pub(super) minus_scale: V,
    /// Slopes of x and y against the dominant axis, negated, times the scale.
    pub(super) slopes: [V; 2],
    /// Scale of t: the reciprocal of the direction's component along the dominant axis.
    pub(super) t_scale: V,
}

impl<V: Copy> Shear<V> {
    /// Shears a vertex, given (origin - vertex).xy and (vertex - origin).t in shear axes. A fused multiply-add rounds
    /// as the kernel's separate operations do, as the scale is a power of two.
    #[inline(always)]
    pub(super) fn apply<S: Simd>(&self, [x, y]: [V; 2], t: V) -> [V; 3]
    where
        V: SimdFloat<S>,
    {
        let [slope_x, slope_y] = self.slopes;
        [x.mul_add(self.minus_scale, t * slope_x), y.mul_add(self.minus_scale, t * slope_y), t * self.t_scale]
    }
}
