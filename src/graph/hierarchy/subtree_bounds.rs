//! World bounds of subtrees: a 16-ary segment tree over the entries; updating one entry recomputes one path (O(log n)).

use std::ops::Range;

use super::{Hierarchy, SceneStores};
use crate::graph::bit_set::BitSet;
use crate::math::Bounds;

/// How many boxes of one level a box of the next level encloses.
const FAN_OUT: usize = 16;

/// Level 0 has one box per 16 entries, each next level one per 16 boxes of the level below. About 3.2 bytes per entry.
#[derive(Debug, Default)]
pub(super) struct SubtreeBounds {
    levels: Vec<Vec<Bounds>>,
    /// Blocks of level 0 that must be recomputed.
    dirty: BitSet,
}

impl SubtreeBounds {
    pub(super) fn mark_entry(&mut self, entry: usize) {
        self.dirty.insert(entry / FAN_OUT);
    }

    pub(super) fn mark_range(&mut self, range: Range<usize>) {
        (range.start / FAN_OUT..range.end.div_ceil(FAN_OUT)).for_each(|block| self.dirty.insert(block));
    }

    /// Recomputes the dirty blocks and those that enclose them. O(dirty blocks).
    fn update(&mut self, entry_count: usize, entry_box: impl Fn(usize) -> Bounds) {
        // 1. Resize the levels to the number of entries.
        let (mut len, mut level) = (entry_count, 0);
        while len > 1 || level == 0 {
            len = len.div_ceil(FAN_OUT);
            if level == self.levels.len() {
                self.levels.push(Vec::new());
            }
            self.levels[level].resize(len, Bounds::EMPTY);
            level += 1;
        }
        // 2. Recompute the dirty blocks level by level; each makes the block that encloses it dirty.
        let mut dirty = std::mem::take(&mut self.dirty);
        for level in 0..self.levels.len() {
            let mut above = BitSet::default();
            for block in dirty.drain() {
                let children = block * FAN_OUT..(block + 1) * FAN_OUT;
                let bounds = match level.checked_sub(1) {
                    None => union(children.start..children.end.min(entry_count), &entry_box),
                    Some(below) => {
                        let below = &self.levels[below];
                        union(children.start..children.end.min(below.len()), |i| below[i])
                    }
                };
                self.levels[level][block] = bounds;
                above.insert(block / FAN_OUT);
            }
            dirty = above;
        }
    }

    /// The box around a range of entries. O(log n).
    fn range(&self, range: Range<usize>, entry_box: impl Fn(usize) -> Bounds) -> Bounds {
        let (mut range, mut bounds) = (range, Bounds::EMPTY);
        let mut box_at: &dyn Fn(usize) -> Bounds = &entry_box;
        let mut of_level;
        // On each level, add the boxes at both ends that no whole block covers, and go on with the blocks between them
        // one level up.
        for level in &self.levels {
            // The blocks that lie wholly in the range.
            let inner = range.start.div_ceil(FAN_OUT)..range.end / FAN_OUT;
            if inner.is_empty() {
                break;
            }
            bounds = bounds.union(union(range.start..inner.start * FAN_OUT, box_at));
            bounds = bounds.union(union(inner.end * FAN_OUT..range.end, box_at));
            range = inner;
            of_level = |i: usize| level[i];
            box_at = &of_level;
        }
        bounds.union(union(range, box_at))
    }
}

fn union(range: Range<usize>, box_at: impl Fn(usize) -> Bounds) -> Bounds {
    range.fold(Bounds::EMPTY, |bounds, i| bounds.union(box_at(i)))
}

impl Hierarchy {
    /// The box around the boxes of all geometry at and below an entry, including hidden geometry. O(entries changed
    /// since the last call + log n); O(n) the first time.
    pub(in crate::graph) fn world_bounds(&mut self, tree: SceneStores<'_>, entry: usize) -> Bounds {
        // Take the bounds out while they are updated, since the closures borrow the hierarchy; the first time all
        // blocks are dirty.
        let mut boxes = self.subtree_bounds.take().unwrap_or_else(|| {
            let mut boxes = SubtreeBounds::default();
            boxes.mark_range(0..self.nodes.len());
            boxes
        });
        boxes.update(self.nodes.len(), |entry| self.entry_bounds(tree, entry));
        // Unite the boxes of the entry's own range and of the ranges appended below it.
        let entry_box = |entry| self.entry_bounds(tree, entry);
        let ranges = self.subtree(entry).into_iter();
        let bounds = ranges.map(|range| boxes.range(range, entry_box)).fold(Bounds::EMPTY, Bounds::union);
        self.subtree_bounds = Some(boxes);
        bounds
    }

    /// Notifies that the bounds of a node's geometry changed.
    pub(in crate::graph) fn geometry_bounds_changed(&mut self, node: crate::graph::NodeKey) {
        if let Some(mut boxes) = self.subtree_bounds.take() {
            self.entries(node).for_each(|entry| boxes.mark_entry(entry));
            self.subtree_bounds = Some(boxes);
        }
    }

    fn entry_bounds(&self, tree: SceneStores<'_>, entry: usize) -> Bounds {
        // Removed entries and nodes without geometry have an empty box.
        let node = tree.nodes.get(self.nodes[entry]);
        let geometry = node.and_then(|node| tree.cores[node.core].core.geometry());
        geometry.map_or(Bounds::EMPTY, |geometry| {
            tree.geometries[geometry].value.bounds.transformed(&self.resolved[entry].world_from_local)
        })
    }
}
