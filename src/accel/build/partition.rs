//! Stable partition of references by an object split.

use glam::Vec4;
use rayon::prelude::*;

use super::object_bins::{CHUNK_SIZE, ObjectBins, ObjectSplit};
use crate::accel::tree::{PrimitiveReference, SimdAabb};

/// Moves the references to `target`, the left side first, each side in its old order (stable). Returns the boxes around
/// the centres of both sides.
pub(super) fn partition(
    source: &[PrimitiveReference],
    target: &mut [PrimitiveReference],
    split: &ObjectSplit,
) -> [SimdAabb; 2] {
    let (left, right) = target.split_at_mut(split.left_count);
    scatter(source, left, right, split)
}

/// [`partition`] in parallel: the bins of each chunk give how many of its references go to either side, and so where it
/// writes.
pub(super) fn partition_parallel(
    source: &[PrimitiveReference],
    target: &mut [PrimitiveReference],
    split: &ObjectSplit,
    chunks: &[ObjectBins],
) -> [SimdAabb; 2] {
    // 1. Divide the target into the pieces that each chunk writes.
    let (mut left, mut right) = target.split_at_mut(split.left_count);
    let mut pieces = Vec::with_capacity(chunks.len());
    for (source, bins) in source.chunks(CHUNK_SIZE).zip(chunks) {
        let left_count = bins.left_count(split);
        let left_piece = left.split_off_mut(..left_count).unwrap_or_default();
        let right_piece = right.split_off_mut(..source.len() - left_count).unwrap_or_default();
        pieces.push((source, left_piece, right_piece));
    }
    // 2. Scatter all chunks in parallel.
    pieces
        .into_par_iter()
        .map(|(source, left, right)| scatter(source, left, right, split))
        .reduce(|| [SimdAabb::EMPTY; 2], |a, b| [a[0].union(b[0]), a[1].union(b[1])])
}

/// Moves each reference to its side, and bounds the centres of both sides. Branch-free, because the side of a reference
/// is unpredictable: about half of all branches would be mispredicted.
fn scatter(
    source: &[PrimitiveReference],
    left: &mut [PrimitiveReference],
    right: &mut [PrimitiveReference],
    split: &ObjectSplit,
) -> [SimdAabb; 2] {
    let [mut left_centers, mut right_centers] = [SimdAabb::EMPTY; 2];
    let mut next = [0; 2];
    let targets = [left, right];
    // For each reference: find its side, grow that side's bounds of centres, and append it there.
    for reference in source {
        let center = reference.doubled_center();
        let side = usize::from(split.is_right(center));
        // Infinite for the side that the reference does not go to, so that min and max leave that side's bounds
        // unchanged.
        let excluding = Vec4::splat([f32::NEG_INFINITY, f32::INFINITY][side]);
        left_centers.min = left_centers.min.min(center.max(excluding));
        left_centers.max = left_centers.max.max(center.min(-excluding));
        right_centers.min = right_centers.min.min(center.max(-excluding));
        right_centers.max = right_centers.max.max(center.min(excluding));
        targets[side][next[side]] = *reference;
        next[side] += 1;
    }
    [left_centers, right_centers]
}
