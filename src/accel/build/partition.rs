//! References to either side of a split between bins.

use glam::Vec4;
use rayon::prelude::*;

use super::object_bins::{CHUNK_SIZE, ObjectBins, ObjectSplit};
use crate::accel::tree::{PrimitiveReference, SimdAabb};

/// Moves the references to `target`, those left of the split first, both sides in their old order. Returns the boxes of
/// both sides' centres.
pub(super) fn partition(
    source: &[PrimitiveReference],
    target: &mut [PrimitiveReference],
    split: &ObjectSplit,
) -> [SimdAabb; 2] {
    let (left, right) = target.split_at_mut(split.left_count);
    scatter(source, left, right, split)
}

/// The same by several threads: the bins of each chunk say how many references it sends to either side.
pub(super) fn partition_parallel(
    source: &[PrimitiveReference],
    target: &mut [PrimitiveReference],
    split: &ObjectSplit,
    chunks: &[ObjectBins],
) -> [SimdAabb; 2] {
    let (mut left, mut right) = target.split_at_mut(split.left_count);
    let mut pieces = Vec::with_capacity(chunks.len());
    for (source, bins) in source.chunks(CHUNK_SIZE).zip(chunks) {
        let left_count = bins.left_count(split);
        let left_piece = left.split_off_mut(..left_count).unwrap_or_default();
        let right_piece = right.split_off_mut(..source.len() - left_count).unwrap_or_default();
        pieces.push((source, left_piece, right_piece));
    }
    pieces
        .into_par_iter()
        .map(|(source, left, right)| scatter(source, left, right, split))
        .reduce(|| [SimdAabb::EMPTY; 2], |a, b| [a[0].union(b[0]), a[1].union(b[1])])
}

/// Without a branch: which side a reference goes to is a coin toss that no processor predicts.
fn scatter(
    source: &[PrimitiveReference],
    left: &mut [PrimitiveReference],
    right: &mut [PrimitiveReference],
    split: &ObjectSplit,
) -> [SimdAabb; 2] {
    let [mut left_centers, mut right_centers] = [SimdAabb::EMPTY; 2];
    let mut next = [0; 2];
    let targets = [left, right];
    for reference in source {
        let center = reference.doubled_center();
        let side = usize::from(split.is_right(center));
        // Clamped to infinity for the side that the reference does not go to, so that it leaves those bounds as they are.
        let away = Vec4::splat([f32::NEG_INFINITY, f32::INFINITY][side]);
        left_centers.min = left_centers.min.min(center.max(away));
        left_centers.max = left_centers.max.max(center.min(-away));
        right_centers.min = right_centers.min.min(center.max(-away));
        right_centers.max = right_centers.max.max(center.min(away));
        targets[side][next[side]] = *reference;
        next[side] += 1;
    }
    [left_centers, right_centers]
}
