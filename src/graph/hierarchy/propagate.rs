//! What entries inherit: world transforms, masks, visibility, materials, from the top down.

use std::ops::Range;

use glam::DAffine3;
use rayon::prelude::*;

use super::{Hierarchy, Own, Placed};

/// Ranges of fewer entries are computed by one thread: waking others costs more.
const PARALLEL_MINIMUM: usize = 1 << 14;

impl Placed {
    /// What the root inherits.
    pub(super) const NOWHERE: Self = Self { world: DAffine3::IDENTITY, material: None, mask: u32::MAX, visible: true };

    /// Where an entry is whose parent is here.
    #[inline]
    fn place(&self, own: &Own) -> Self {
        Self {
            world: if own.has_transform { self.world * own.local } else { self.world },
            // The outermost material counts.
            material: self.material.or(own.material),
            mask: self.mask & own.mask,
            visible: self.visible && own.visible && own.chosen,
        }
    }
}

impl Hierarchy {
    /// Computes the subtrees of all dirty entries, each entry once.
    pub(super) fn propagate_dirty(&mut self) {
        let (mut start, mut done) = (0, 0);
        while let Some(entry) = self.pending.dirty.pop_from(start) {
            start = entry + 1;
            if entry < done {
                continue;
            }
            let range = entry..self.ends[entry] as usize;
            done = range.end;
            self.propagate(range.clone());
            if !self.grafts.is_empty() {
                let grafts: Vec<usize> = self.grafts_below(range.clone()).collect();
                // They lie ahead: grafts stand behind what they are grafted to.
                grafts.into_iter().for_each(|graft| self.pending.dirty.insert(graft));
            }
            if let Some(boxes) = &mut self.boxes {
                boxes.range_changed(range);
            }
        }
    }

    /// Computes a range whose entries have their parents in it or before it, where they are right.
    fn propagate(&mut self, range: Range<usize>) {
        if range.len() < PARALLEL_MINIMUM {
            for entry in range {
                self.placed[entry] = self.inherited(entry).place(&self.own[entry]);
            }
        } else {
            self.propagate_parallel(range);
        }
    }

    fn inherited(&self, entry: usize) -> Placed {
        match self.parents[entry] {
            Self::NO_PARENT => Placed::NOWHERE,
            parent => self.placed[parent as usize],
        }
    }

    /// The large subtrees' tops here, the small subtrees in runs, side by side.
    fn propagate_parallel(&mut self, range: Range<usize>) {
        let run_length = range.len() / (8 * rayon::current_num_threads()) + 1;
        let mut runs: Vec<Range<usize>> = Vec::new();
        // Those that runs may refer to, in ascending order.
        let mut tops: Vec<(u32, Placed)> = Vec::new();
        if self.parents[range.start] != Self::NO_PARENT {
            tops.push((self.parents[range.start], self.inherited(range.start)));
        }
        let mut entry = range.start;
        while entry < range.end {
            let end = self.ends[entry] as usize;
            if end - entry > run_length {
                self.placed[entry] = self.inherited(entry).place(&self.own[entry]);
                tops.push((entry as u32, self.placed[entry]));
                entry += 1;
                continue;
            }
            match runs.last_mut() {
                Some(run) if run.end == entry && end - run.start <= run_length => run.end = end,
                _ => runs.push(entry..end),
            }
            entry = end;
        }

        let mut rest = &mut self.placed[..];
        let mut rest_start = 0;
        let mut jobs = Vec::with_capacity(runs.len());
        for run in runs {
            let (_, from_run) = rest.split_at_mut(run.start - rest_start);
            let (placed, after) = from_run.split_at_mut(run.len());
            (rest, rest_start) = (after, run.end);
            jobs.push((run, placed));
        }
        let (own, parents) = (&self.own, &self.parents);
        jobs.into_par_iter().for_each(|(run, placed)| {
            let mut above = (Self::NO_PARENT, Placed::NOWHERE);
            for (entry, i) in run.clone().zip(0..) {
                let parent = parents[entry];
                let inherited = if parent as usize >= run.start && parent != Self::NO_PARENT {
                    placed[parent as usize - run.start]
                } else {
                    if parent != above.0
                        && let Ok(top) = tops.binary_search_by_key(&parent, |top| top.0)
                    {
                        above = tops[top];
                    }
                    above.1
                };
                placed[i] = inherited.place(&own[entry]);
            }
        });
    }
}
