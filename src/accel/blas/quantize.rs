//! Quantised boxes of wide nodes (H. Ylitie, T. Karras, S. Laine, *Efficient Incoherent Ray Traversal on GPUs Through
//! Compressed Wide BVHs*, 2017): 8-bit planes on a grid over the node, whose step along each axis is a power of two.
//!
//! **Rounding.** A child's quantised planes lie outside its padded box by at least [`QUANTIZATION_MARGIN`] steps. The
//! traversal computes the distance to a plane as `(plane * step + (origin - ray.origin)) * reciprocal`; `plane * step`
//! is exact. Let v = 2^-23 be the relative error of one operation, and D = |origin - ray.origin|. Then the difference
//! is off by at most v D, and D is at most the plane's distance plus 255 steps. The first share, like the rounding of
//! the sum and the product, is relative to the result and covered by `BOX_ENTRY_SCALE` (`trace::kernel::intersect`);
//! the second is below 2^-15 steps and covered by the margin.
//!
//! Incoherent packets compute `plane * (step * reciprocal) + (origin - ray.origin) * reciprocal` with a fused
//! multiply-add: each product has at most two roundings and |plane * step| is at most 255 steps, so the error that is
//! not relative to the result is below 2^-13 steps.

use glam::{DVec3, Vec3};

use crate::device::layout::{WideChild, WideNode};

/// Children of a wide node.
pub(super) const WIDE_CHILD_COUNT: usize = 8;

/// By how much a quantised plane lies outside the child's box, in steps; see "Rounding" above.
const QUANTIZATION_MARGIN: f64 = 1.0 / (1 << 10) as f64;

/// A wide node with quantised child boxes, but without its children. `own` and `slots` are the least and greatest
/// corners of the padded boxes of the node and of the child in each slot.
pub(super) fn quantize_node(own: [Vec3; 2], slots: &[Option<[Vec3; 2]>; WIDE_CHILD_COUNT]) -> WideNode {
    // 1. Fit the grid to the node's box.
    let [min, max] = own.map(Vec3::as_dvec3);
    let grid = QuantizationGrid::around(min, max);
    let mut wide = WideNode {
        origin: grid.origin.as_vec3().to_array(),
        exponents: [0; 4],
        planes: [[[u8::MAX; WIDE_CHILD_COUNT], [0; WIDE_CHILD_COUNT]]; 3],
        children: [WideChild::UNUSED; WIDE_CHILD_COUNT],
    };
    wide.exponents[..3].copy_from_slice(&grid.exponents);
    // 2. For each child: mark its slot as used, and round its lower planes down and its upper planes up.
    for (slot, child) in slots.iter().enumerate() {
        let Some(child) = child else { continue };
        wide.exponents[3] |= 1 << slot;
        let [min, max] = child.map(Vec3::as_dvec3);
        for axis in 0..3 {
            // The reciprocal of a power of two is exact.
            let steps_per_unit = step_length(grid.exponents[axis]).recip();
            let in_steps = |plane: f64| (plane - grid.origin[axis]) * steps_per_unit;
            // Truncation and a comparison instead of `ceil`, which is a function call on targets without a rounding
            // instruction.
            let upper = in_steps(max[axis]) + QUANTIZATION_MARGIN;
            let truncated = upper as u8;
            wide.planes[axis][0][slot] = (in_steps(min[axis]) - QUANTIZATION_MARGIN) as u8;
            wide.planes[axis][1][slot] = truncated + u8::from(f64::from(truncated) < upper);
        }
    }
    wide
}

/// The quantisation grid of a wide node: its least corner, and the biased exponents of the step along each axis.
struct QuantizationGrid {
    origin: DVec3,
    exponents: [u8; 3],
}

impl QuantizationGrid {
    fn around(min: DVec3, max: DVec3) -> Self {
        let mut grid = Self { origin: DVec3::ZERO, exponents: [0; 3] };
        for axis in 0..3 {
            // Start with a step of at least 1/255 of the box and double it until the margins fit too, since the origin
            // moves outward with the margin.
            let min_step = ((max[axis] - min[axis]) / 255.0).max(f64::from(f32::MIN_POSITIVE)) as f32;
            let mut exponent = (min_step.to_bits() >> 23) as u8;
            loop {
                let step = step_length(exponent);
                let origin = f64::from(((min[axis] - QUANTIZATION_MARGIN * step) as f32).next_down().max(f32::MIN));
                if (max[axis] - origin) / step + QUANTIZATION_MARGIN <= 255.0 {
                    grid.origin[axis] = origin;
                    grid.exponents[axis] = exponent;
                    break;
                }
                exponent += 1;
            }
        }
        grid
    }
}

/// The step of a biased exponent: 2^(exponent - 127).
fn step_length(exponent: u8) -> f64 {
    f64::from(f32::from_bits(u32::from(exponent) << 23))
}
