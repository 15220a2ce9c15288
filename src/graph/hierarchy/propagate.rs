//! Inheritance from the top down: world matrices, masks, visibility, materials.

use std::ops::Range;

use glam::DAffine3;
use rayon::prelude::*;

use super::{EntryProperties, Hierarchy, ResolvedEntry};

/// Below this many entries, one thread is faster than a parallel dispatch.
const PARALLEL_THRESHOLD: usize = 1 << 13;

/// Fixed cost of a range in units of entries: its first access misses the cache.
const RANGE_COST: usize = 8;

impl ResolvedEntry {
    /// The values that the root inherits.
    pub(super) const ROOT_INHERITANCE: Self =
        Self { world_from_local: DAffine3::IDENTITY, material: None, mask: u32::MAX, visible: true };

    /// The resolved values of a child entry with these own values.
    #[inline(always)]
    fn inherit(&self, own: &EntryProperties) -> Self {
        Self {
            world_from_local: if own.has_transform { self.world_from_local * own.local } else { self.world_from_local },
            // The outermost material wins.
            material: self.material.or(own.material),
            mask: self.mask & own.mask,
            visible: self.visible && own.visible && own.selected,
        }
    }
}

impl Hierarchy {
    /// Recomputes the inherited values of the subtrees of all dirty entries, each entry once.
    pub(super) fn propagate_dirty(&mut self) {
        // Collect the subtrees below the dirty entries as ascending, disjoint ranges.
        let mut dirty = std::mem::take(&mut self.pending.dirty);
        let ranges = self.subtrees_from(dirty.drain());
        self.pending.dirty = dirty;
        // World matrices in these ranges may change, and bounds with them.
        if let Some(boxes) = &mut self.subtree_bounds {
            ranges.iter().for_each(|range| boxes.mark_range(range.clone()));
        }
        // Resolve the ranges in batches: a range whose parent lies in an earlier one waits for the next batch.
        let mut rest = &ranges[..];
        while !rest.is_empty() {
            let (batch, after) = rest.split_at(self.independent_prefix(rest));
            self.propagate(batch);
            rest = after;
        }
    }

    /// Length of the longest prefix of ranges whose parents lie in none of the others; only appended ranges can depend
    /// on another range.
    fn independent_prefix(&self, ranges: &[Range<usize>]) -> usize {
        if self.appended_subtrees.is_empty() {
            return ranges.len();
        }
        // Binary search: the ranges are ascending and disjoint.
        let is_in = |parent: usize, before: &[Range<usize>]| {
            let following = before.partition_point(|range| range.end <= parent);
            before.get(following).is_some_and(|range| range.start <= parent)
        };
        let depends = |&i: &usize| is_in(self.parents[ranges[i].start] as usize, &ranges[..i]);
        (1..ranges.len()).find(depends).unwrap_or(ranges.len())
    }

    /// Resolves ranges, ascending and disjoint, whose entries have their parents in the same range or in none of them.
    fn propagate(&mut self, ranges: &[Range<usize>]) {
        let work = ranges.iter().map(ExactSizeIterator::len).sum::<usize>() + RANGE_COST * ranges.len();
        if work < PARALLEL_THRESHOLD {
            let mut all = self.all_entries();
            ranges.iter().for_each(|range| all.resolve(range.clone(), |_| ResolvedEntry::ROOT_INHERITANCE));
        } else {
            // About 8 jobs per thread, for load balance.
            self.propagate_parallel(ranges, work / (8 * rayon::current_num_threads()) + 1);
        }
    }

    /// All entries.
    fn all_entries(&mut self) -> EntrySlice<'_> {
        EntrySlice { first: 0, own: &self.properties, parents: &self.parents, resolved: &mut self.resolved }
    }

    /// Resolves the tops of large subtrees on this thread, and packs the remaining small subtrees into jobs of about
    /// `job_work` entries that run in parallel.
    fn propagate_parallel(&mut self, ranges: &[Range<usize>], job_work: usize) {
        // 1. Split the ranges: resolve each entry whose subtree is larger than a job here, in order, so that its values
        //    are known to the jobs; collect the subtrees between them in jobs.
        let mut jobs: Vec<PropagationJob> = Vec::new();
        for range in ranges {
            let mut start = range.start;
            while start < range.end {
                let is_large = |entry: &usize| self.subtree_ends[*entry] as usize - entry > job_work;
                let tops = start..start + (start..range.end).take_while(is_large).count();
                start = tops.end;
                self.all_entries().resolve(tops, |_| ResolvedEntry::ROOT_INHERITANCE);
                if jobs.last().is_none_or(|job| job.work >= job_work) {
                    jobs.push(PropagationJob::new(start));
                }
                if let Some(job) = jobs.last_mut() {
                    start = job.take_subtrees(start..range.end, job_work, self);
                }
            }
        }

        // 2. Give each job the slice of the resolved values from its first to its last entry; these are disjoint.
        let mut rest = &mut self.resolved[..];
        let mut rest_start = 0;
        let mut slices = Vec::with_capacity(jobs.len());
        for job in &jobs {
            let first = job.first;
            let end = job.ranges.last().map_or(first, |range| range.end);
            let (_, from_first) = rest.split_at_mut(first - rest_start);
            let (resolved, after) = from_first.split_at_mut(end - first);
            (rest, rest_start) = (after, end);
            slices.push(EntrySlice { first, own: &self.properties, parents: &self.parents, resolved });
        }
        // 3. Resolve the jobs in parallel. A parent outside the slice has its values in the job.
        jobs.into_par_iter().zip(slices).with_max_len(1).for_each(|(job, mut slice)| {
            let mut parent_values = job.parent_values.into_iter();
            let mut last = (Self::NO_PARENT, ResolvedEntry::ROOT_INHERITANCE);
            for range in job.ranges {
                slice.resolve(range, |parent| {
                    if parent != last.0 {
                        last = (parent, parent_values.next().unwrap_or(ResolvedEntry::ROOT_INHERITANCE));
                    }
                    last.1
                });
            }
        });
    }
}

/// Some of the subtrees to resolve, in ascending order.
struct PropagationJob {
    /// The first entry.
    first: usize,
    ranges: Vec<Range<usize>>,
    /// Entries and costs of ranges, in units of entries.
    work: usize,
    /// Resolved values of parents before the first entry, in order of first use.
    parent_values: Vec<ResolvedEntry>,
    /// The parent of the last of `parent_values`.
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

    /// Adds whole subtrees from the start of `range` until the range ends, the next subtree is larger than a job, or
    /// the job has `job_work` entries. Returns the start of the rest of the range.
    fn take_subtrees(&mut self, range: Range<usize>, job_work: usize, hierarchy: &Hierarchy) -> usize {
        let mut end = range.start;
        while end < range.end && self.work + (end - range.start) < job_work {
            let next = hierarchy.subtree_ends[end] as usize;
            if next - end > job_work {
                break;
            }
            // Copy the values of a parent before the job's first entry, once for the subtrees in a row that share it.
            let parent = hierarchy.parents[end];
            if parent != self.last_inherited_parent && (parent as usize) < self.first {
                self.last_inherited_parent = parent;
                self.parent_values.push(hierarchy.resolved[parent as usize]);
            }
            end = next;
        }
        self.work += end - range.start + RANGE_COST;
        self.ranges.push(range.start..end);
        end
    }
}

/// The entries of a slice of the arrays, which begins with entry `first`; own values and parents are those of all
/// entries.
struct EntrySlice<'a> {
    first: usize,
    own: &'a [EntryProperties],
    parents: &'a [u32],
    resolved: &'a mut [ResolvedEntry],
}

impl EntrySlice<'_> {
    /// Resolves a range of them. `inherited_from` gives the values of a parent that is not among them, and of
    /// [`NO_PARENT`](Hierarchy::NO_PARENT).
    fn resolve(&mut self, range: Range<usize>, mut inherited_from: impl FnMut(u32) -> ResolvedEntry) {
        let mut last = (Hierarchy::NO_PARENT, ResolvedEntry::ROOT_INHERITANCE);
        for entry in range {
            let parent = self.parents[entry];
            // Fast path for a chain: the parent is the entry just computed.
            let inherited = if parent == last.0 {
                last.1
            } else {
                // Look the parent up in the slice; ask the caller for one outside it.
                let known = (parent as usize).checked_sub(self.first).and_then(|i| self.resolved.get(i));
                known.copied().unwrap_or_else(|| inherited_from(parent))
            };
            last = (entry as u32, inherited.inherit(&self.own[entry]));
            self.resolved[entry - self.first] = last.1;
        }
    }
}
