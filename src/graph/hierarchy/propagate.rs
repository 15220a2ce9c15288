//! What entries inherit: world transforms, masks, visibility, materials, from the top down.

use std::ops::Range;

use glam::DAffine3;
use rayon::prelude::*;

use super::{EntryProperties, Hierarchy, ResolvedEntry};

/// Less work is done by one thread: waking others costs more.
const PARALLEL_THRESHOLD: usize = 1 << 13;

/// A range costs as much as so many entries: none of its lines is in a cache.
const RANGE_COST: usize = 8;

impl ResolvedEntry {
    /// What the root inherits.
    pub(super) const ROOT_INHERITANCE: Self =
        Self { world_from_local: DAffine3::IDENTITY, material: None, mask: u32::MAX, visible: true };

    /// Where an entry is whose parent is here.
    #[inline(always)]
    fn place(&self, own: &EntryProperties) -> Self {
        Self {
            world_from_local: if own.has_transform { self.world_from_local * own.local } else { self.world_from_local },
            // The outermost material counts.
            material: self.material.or(own.material),
            mask: self.mask & own.mask,
            visible: self.visible && own.visible && own.selected,
        }
    }
}

impl Hierarchy {
    /// Computes the subtrees of all dirty entries, each entry once.
    pub(super) fn propagate_dirty(&mut self) {
        let mut dirty = std::mem::take(&mut self.pending.dirty);
        let ranges = self.subtrees_from(dirty.drain());
        self.pending.dirty = dirty;
        if let Some(boxes) = &mut self.subtree_bounds {
            ranges.iter().for_each(|range| boxes.mark_range(range.clone()));
        }
        let mut rest = &ranges[..];
        while !rest.is_empty() {
            let (batch, after) = rest.split_at(self.independent_prefix(rest));
            self.propagate(batch);
            rest = after;
        }
    }

    /// How many of these ranges, from the first on, have no parents in another of them. Only grafts have.
    fn independent_prefix(&self, ranges: &[Range<usize>]) -> usize {
        if self.appended_subtrees.is_empty() {
            return ranges.len();
        }
        let is_in = |parent: usize, before: &[Range<usize>]| {
            let following = before.partition_point(|range| range.end <= parent);
            before.get(following).is_some_and(|range| range.start <= parent)
        };
        let depends = |&i: &usize| is_in(self.parents[ranges[i].start] as usize, &ranges[..i]);
        (1..ranges.len()).find(depends).unwrap_or(ranges.len())
    }

    /// Computes ranges, ascending and disjoint, whose entries have their parents in the same range or in none.
    fn propagate(&mut self, ranges: &[Range<usize>]) {
        let work = ranges.iter().map(ExactSizeIterator::len).sum::<usize>() + RANGE_COST * ranges.len();
        if work < PARALLEL_THRESHOLD {
            let mut all = self.all_entries();
            ranges.iter().for_each(|range| all.place(range.clone(), |_| ResolvedEntry::ROOT_INHERITANCE));
        } else {
            self.propagate_parallel(ranges, work / (8 * rayon::current_num_threads()) + 1);
        }
    }

    /// All entries.
    fn all_entries(&mut self) -> EntrySlice<'_> {
        EntrySlice { first: 0, own: &self.properties, parents: &self.parents, placed: &mut self.placed }
    }

    /// Large subtrees' tops here, the small subtrees in jobs of about so much work, side by side.
    fn propagate_parallel(&mut self, ranges: &[Range<usize>], job_work: usize) {
        let mut jobs: Vec<PropagationJob> = Vec::new();
        for range in ranges {
            let mut start = range.start;
            while start < range.end {
                let is_large = |entry: &usize| self.subtree_ends[*entry] as usize - entry > job_work;
                let tops = start..start + (start..range.end).take_while(is_large).count();
                start = tops.end;
                self.all_entries().place(tops, |_| ResolvedEntry::ROOT_INHERITANCE);
                if jobs.last().is_none_or(|job| job.work >= job_work) {
                    jobs.push(PropagationJob::new(start));
                }
                if let Some(job) = jobs.last_mut() {
                    start = job.take_subtrees(start..range.end, job_work, self);
                }
            }
        }

        let mut rest = &mut self.placed[..];
        let mut rest_start = 0;
        let mut slices = Vec::with_capacity(jobs.len());
        for job in &jobs {
            let first = job.first;
            let end = job.ranges.last().map_or(first, |range| range.end);
            let (_, from_first) = rest.split_at_mut(first - rest_start);
            let (placed, after) = from_first.split_at_mut(end - first);
            (rest, rest_start) = (after, end);
            slices.push(EntrySlice { first, own: &self.properties, parents: &self.parents, placed });
        }
        jobs.into_par_iter().zip(slices).with_max_len(1).for_each(|(job, mut slice)| {
            let mut above = job.parent_values.into_iter();
            let mut last = (Self::NO_PARENT, ResolvedEntry::ROOT_INHERITANCE);
            for range in job.ranges {
                slice.place(range, |parent| {
                    if parent != last.0 {
                        last = (parent, above.next().unwrap_or(ResolvedEntry::ROOT_INHERITANCE));
                    }
                    last.1
                });
            }
        });
    }
}

/// Some of the subtrees to compute, next to each other.
struct PropagationJob {
    /// The first entry.
    first: usize,
    ranges: Vec<Range<usize>>,
    work: usize,
    /// The parents before the first entry, in the order in which the ranges refer to them.
    parent_values: Vec<ResolvedEntry>,
    last_inherited_parent: u32,
}

impl PropagationJob {
    fn new(first: usize) -> Self {
        Self {
            first,
            ranges: Vec::new(),
            work: 0,
            parent_values: Vec::new(),
            last_inherited_parent: Hierarchy::NO_PARENT,
        }
    }

    /// Takes on subtrees from the start of a range, until that ends, a large one follows, or it is work enough. Returns the
    /// start of what is left.
    fn take_subtrees(&mut self, range: Range<usize>, job_work: usize, hierarchy: &Hierarchy) -> usize {
        let mut end = range.start;
        while end < range.end && self.work + (end - range.start) < job_work {
            let next = hierarchy.subtree_ends[end] as usize;
            if next - end > job_work {
                break;
            }
            let parent = hierarchy.parents[end];
            if parent != self.last_inherited_parent && (parent as usize) < self.first {
                self.last_inherited_parent = parent;
                self.parent_values.push(hierarchy.placed[parent as usize]);
            }
            end = next;
        }
        self.work += end - range.start + RANGE_COST;
        self.ranges.push(range.start..end);
        end
    }
}

/// Entries from `first` on, of all of which the own values are known.
struct EntrySlice<'a> {
    first: usize,
    own: &'a [EntryProperties],
    parents: &'a [u32],
    placed: &'a mut [ResolvedEntry],
}

impl EntrySlice<'_> {
    /// Computes a range of them. `above` tells what is inherited from a parent that is not among them, and for the root.
    fn place(&mut self, range: Range<usize>, mut above: impl FnMut(u32) -> ResolvedEntry) {
        let mut last = (Hierarchy::NO_PARENT, ResolvedEntry::ROOT_INHERITANCE);
        for entry in range {
            let parent = self.parents[entry];
            // In a chain, what was just computed is still in registers.
            let inherited = if parent == last.0 {
                last.1
            } else {
                let known = (parent as usize).checked_sub(self.first).and_then(|i| self.placed.get(i));
                known.copied().unwrap_or_else(|| above(parent))
            };
            last = (entry as u32, inherited.place(&self.own[entry]));
            self.placed[entry - self.first] = last.1;
        }
    }
}
