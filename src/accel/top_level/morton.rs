//! Instances in the order of a space-filling curve (G. Morton, 1966): what is near in the order is mostly near in space.

use glam::{UVec4, Vec4};
use rayon::prelude::*;

use super::leaves::finite;
use super::ploc::{CHUNK, Cluster};
use crate::accel::tree::LaneBox;
use crate::math::Aabb;

/// The slots with a box, along the curve; those at the same place of it by slot. O(n).
pub(super) fn sorted(boxes: &[Aabb]) -> Vec<Cluster> {
    // A key holds the place on the curve in its upper bits and the slot in its lower ones.
    let slot_bits = usize::BITS - boxes.len().leading_zeros();
    let axis_bits = ((u64::BITS - slot_bits) / 3).min(21);
    let centers = centers(boxes);
    let curve = Curve::new(&centers, axis_bits);
    let chunks = boxes.par_chunks(CHUNK).enumerate();
    let key = |slot: u32, bounds: &Aabb| curve.place(center(bounds)) << slot_bits | u64::from(slot);
    let mut keys: Vec<u64> = chunks
        .flat_map_iter(|(chunk, boxes)| {
            let slots = (chunk * CHUNK) as u32..;
            slots.zip(boxes).filter(|(_, b)| !b.is_empty()).map(move |(slot, b)| key(slot, b))
        })
        .collect();
    keys.par_sort_unstable();
    let slot_mask = (1 << slot_bits) - 1;
    keys.par_iter()
        .enumerate()
        .with_min_len(CHUNK)
        .map(|(place, key)| {
            let slot = (key & slot_mask) as u32;
            Cluster::leaf(&finite(boxes, slot).unwrap_or(Aabb::EMPTY), slot, place as u32)
        })
        .collect()
}

/// A quarter of the sum of the corners: nothing overflows, not even the difference of two. The fourth lane is 0.
fn center(bounds: &Aabb) -> Vec4 {
    let farthest = Vec4::splat(f32::MAX);
    let [min, max] = [bounds.min, bounds.max].map(|corner| corner.extend(0.0).clamp(-farthest, farthest));
    min * 0.25 + max * 0.25
}

/// The box around all centres.
fn centers(boxes: &[Aabb]) -> LaneBox {
    let of_chunk = |boxes: &[Aabb]| {
        let used = boxes.iter().filter(|b| !b.is_empty());
        used.fold(LaneBox::EMPTY, |sum, b| sum.with_point(center(b)))
    };
    boxes.par_chunks(CHUNK).map(of_chunk).reduce(|| LaneBox::EMPTY, LaneBox::union)
}

/// A curve through a box.
struct Curve {
    origin: Vec4,
    /// Cells per unit; 0 on an axis along which all centres coincide.
    scale: Vec4,
}

impl Curve {
    fn new(centers: &LaneBox, axis_bits: u32) -> Self {
        let axis_scale = |width: f32| {
            let scale = ((1_u32 << axis_bits) - 1) as f32 / width;
            if scale.is_finite() { scale.max(0.0) } else { 0.0 }
        };
        let width = centers.max - centers.min;
        Self { origin: centers.min, scale: Vec4::from_array(width.to_array().map(axis_scale)) }
    }

    /// The cell of a centre, as the number that the curve gives it: the bits of the three coordinates, interleaved.
    fn place(&self, center: Vec4) -> u64 {
        let cell: UVec4 = ((center - self.origin) * self.scale).as_uvec4();
        spread(cell.x) | spread(cell.y) << 1 | spread(cell.z) << 2
    }
}

/// Two zeros before each of the lower 21 bits.
fn spread(bits: u32) -> u64 {
    let mut x = u64::from(bits);
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}
