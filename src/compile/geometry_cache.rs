//! One bottom-level structure a geometry, kept while some visible node uses the geometry, and kept up with what it becomes.

use std::ops::Range;
use std::sync::OnceLock;

use rayon::prelude::*;
use slotmap::SecondaryMap;

use super::arena::{Arena, disjoint_mut};
use super::deformation::{BlasBuilds, BuildReason, History, MAX_DECAY, Step, step};
use super::enclosure::encloses;
use super::instance_table::Users;
use super::vertex_streams::{StreamRanges, VertexStreams};
use crate::Result;
use crate::accel::{Blas, BuildParams, Refitted, Support, refit};
use crate::device::DeviceArrays;
use crate::graph::{Geometry, GeometryKey, Scene, Structure};

/// The bottom-level structures and vertex streams on the device, by geometry key.
#[derive(Debug)]
pub(super) struct GeometryCache {
    entries: SecondaryMap<GeometryKey, Entry>,
    /// Of all entries.
    triangle_count: usize,
    nodes: Arena,
    wide_nodes: Arena,
    triangles: Arena,
    streams: VertexStreams,
}

/// What is kept of one geometry.
#[derive(Debug)]
pub(super) struct Entry {
    version: u64,
    history: History,
    /// What was built for it.
    structure: Structure,
    /// The SAH cost of that, from the first refit on.
    built_cost: Option<f64>,
    /// In `blas_nodes`; empty for a geometry that nothing can hit.
    pub(super) nodes: Range<u32>,
    wide_nodes: Range<u32>,
    /// In `triangles`.
    pub(super) triangles: Range<u32>,
    pub(super) streams: StreamRanges,
    /// How far its triangles reach, local space.
    pub(super) support: Support,
    /// Whether some triangle is in several leaves.
    pub(super) repeats: bool,
    /// The geometry itself: its streams are shared with the scene.
    source: Geometry,
    encloses: OnceLock<bool>,
}

impl Entry {
    /// Triangles of the geometry; more than `triangles` where some cannot be hit.
    pub(super) fn triangle_count(&self) -> usize {
        self.source.indices.len()
    }

    /// Whether the geometry encloses a solid. Found out when first asked for: only transmissive materials do.
    pub(super) fn encloses(&self) -> bool {
        *self.encloses.get_or_init(|| encloses(&self.source))
    }
}

/// What [`GeometryCache::update`] did.
#[derive(Clone, Debug, Default)]
pub(super) struct GeometryUpdate {
    /// The geometries that are not what they were.
    pub(super) changed: Vec<GeometryKey>,
    pub(super) builds: BlasBuilds,
    pub(super) built: Amount,
    pub(super) refitted: Amount,
    pub(super) freed: usize,
}

/// So many structures, with so many triangles.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Amount {
    pub(super) structures: usize,
    pub(super) triangles: usize,
}

impl Amount {
    fn add(&mut self, geometry: &Geometry) {
        self.structures += 1;
        self.triangles += geometry.indices.len();
    }
}

/// A geometry to follow, and what stands for it in the scene.
type Job<'a> = (GeometryKey, &'a Geometry);

impl GeometryCache {
    pub(super) fn new() -> Self {
        Self {
            entries: SecondaryMap::new(),
            triangle_count: 0,
            nodes: Arena::new("the bottom-level nodes array"),
            wide_nodes: Arena::new("the wide nodes array"),
            triangles: Arena::new("the triangles array"),
            streams: VertexStreams::new(),
        }
    }

    /// Makes the cache hold exactly the geometries in `used`, as they are: frees the others, refits what has deformed, and builds
    /// what is missing or has changed otherwise; all at once on all cores. `now` counts compiles.
    pub(super) fn update(
        &mut self,
        scene: &Scene,
        used: &Users<GeometryKey>,
        now: u64,
        arrays: &mut DeviceArrays,
    ) -> Result<GeometryUpdate> {
        let mut update = GeometryUpdate::default();
        // 1. What nobody uses any more.
        let unused: Vec<GeometryKey> = self.entries.keys().filter(|&key| !used.has(key)).collect();
        update.freed = unused.len();
        unused.into_iter().for_each(|key| self.free(key, arrays));
        // 2. What changed, and what that takes.
        let (mut to_refit, mut to_build) = (Vec::new(), Vec::new());
        for key in used.keys() {
            let (geometry, version) = (scene.geometry(key)?, scene.geometry_version(key)?);
            let step = match self.entries.get_mut(key) {
                Some(entry) if entry.version == version => continue,
                Some(entry) => entry.follow(geometry, version, now),
                None => {
                    self.entries.insert(key, Entry::empty(version, now));
                    Step::Build(BuildReason::New)
                }
            };
            match step {
                Step::Keep => {}
                Step::Refit => to_refit.push((key, geometry)),
                Step::Build(reason) => to_build.push(((key, geometry), reason)),
            }
            update.changed.push(key);
        }
        // 3. Refit, in place; some turn out to need more than that.
        self.refit(&to_refit, arrays, &mut update, &mut to_build);
        // 4. Build.
        self.build(to_build, arrays, &mut update)?;
        // 5. Streams.
        for &key in &update.changed {
            let (geometry, entry) = (scene.geometry(key)?, &mut self.entries[key]);
            self.streams.write(&mut entry.streams, &entry.source, geometry, &entry.wide_nodes, arrays)?;
            self.triangle_count = self.triangle_count - entry.triangle_count() + geometry.indices.len();
            entry.source = geometry.clone();
            entry.encloses = OnceLock::new();
        }
        Ok(update)
    }

    /// The entry of a geometry that was in `used` at the last update.
    pub(super) fn get(&self, key: GeometryKey) -> Option<&Entry> {
        self.entries.get(key)
    }

    /// Triangles of all geometries, each counted once.
    pub(super) fn triangle_count(&self) -> usize {
        self.triangle_count
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    fn refit<'a>(
        &mut self,
        jobs: &[Job<'a>],
        arrays: &mut DeviceArrays,
        update: &mut GeometryUpdate,
        to_build: &mut Vec<(Job<'a>, BuildReason)>,
    ) {
        let ranges = |range: fn(&Entry) -> &Range<u32>| -> Vec<Range<usize>> {
            let ranges = jobs.iter().map(|&(key, _)| range(&self.entries[key]));
            ranges.map(|range| range.start as usize..range.end as usize).collect()
        };
        let (node_ranges, triangle_ranges) = (ranges(|entry| &entry.nodes), ranges(|entry| &entry.triangles));
        let wide_ranges = ranges(|entry| &entry.wide_nodes);
        // 1. All at once.
        let nodes = disjoint_mut(arrays.blas_nodes.unmarked_mut(), &node_ranges);
        let wide_nodes = disjoint_mut(arrays.wide_nodes.unmarked_mut(), &wide_ranges);
        let triangles = disjoint_mut(arrays.triangles.unmarked_mut(), &triangle_ranges);
        let refitted: Vec<Option<(Refitted, Support)>> = (jobs.par_iter(), nodes, wide_nodes, triangles)
            .into_par_iter()
            .map(|(&(_, geometry), nodes, wide_nodes, triangles)| {
                let refitted = refit(nodes, wide_nodes, triangles, geometry, BuildParams::default().triangle_cost)?;
                let support = Support::coarse(nodes, triangles, refitted.bounds);
                Some((refitted, support))
            })
            .collect();
        // 2. What came of it.
        let ranges = node_ranges.into_iter().zip(wide_ranges).zip(triangle_ranges);
        for ((job, refitted), ((nodes, wide_nodes), triangles)) in jobs.iter().zip(refitted).zip(ranges) {
            let Some((refitted, support)) = refitted else {
                // Some of it may have been written.
                arrays.blas_nodes.mark(nodes);
                arrays.wide_nodes.mark(wide_nodes);
                arrays.triangles.mark(triangles);
                to_build.push((*job, BuildReason::Triangles));
                continue;
            };
            let within = |range: Range<usize>, of: &Range<usize>| of.start + range.start..of.start + range.end;
            refitted.changed_nodes.into_iter().for_each(|range| arrays.blas_nodes.mark(within(range, &nodes)));
            refitted
                .changed_wide_nodes
                .into_iter()
                .for_each(|range| arrays.wide_nodes.mark(within(range, &wide_nodes)));
            refitted.changed_triangles.into_iter().for_each(|range| arrays.triangles.mark(within(range, &triangles)));
            let entry = &mut self.entries[job.0];
            entry.support = support;
            let built_cost = *entry.built_cost.get_or_insert(refitted.old_cost);
            if refitted.cost > built_cost * MAX_DECAY {
                to_build.push((*job, BuildReason::Decay));
            } else {
                update.refitted.add(job.1);
            }
        }
    }

    fn build(
        &mut self,
        jobs: Vec<(Job<'_>, BuildReason)>,
        arrays: &mut DeviceArrays,
        update: &mut GeometryUpdate,
    ) -> Result<()> {
        let build = |&((key, geometry), _): &(Job<'_>, BuildReason)| {
            let structure = self.entries[key].history.structure(geometry);
            let blas = Blas::build(geometry, &BuildParams::new(structure))?;
            Ok((structure, Support::new(&blas), blas))
        };
        let built: Vec<(Structure, Support, Blas)> = jobs.par_iter().map(build).collect::<Result<_>>()?;
        for (((key, geometry), reason), (structure, support, blas)) in jobs.into_iter().zip(built) {
            update.builds.count(reason);
            update.built.add(geometry);
            let entry = &mut self.entries[key];
            self.nodes.replace(&mut arrays.blas_nodes, &mut entry.nodes, &blas.nodes)?;
            self.wide_nodes.replace(&mut arrays.wide_nodes, &mut entry.wide_nodes, &blas.wide_nodes)?;
            self.triangles.replace(&mut arrays.triangles, &mut entry.triangles, &blas.triangles)?;
            (entry.structure, entry.built_cost, entry.support) = (structure, None, support);
            entry.repeats = blas.repeats;
        }
        Ok(())
    }

    fn free(&mut self, key: GeometryKey, arrays: &mut DeviceArrays) {
        let Some(entry) = self.entries.remove(key) else { return };
        self.triangle_count -= entry.triangle_count();
        self.nodes.release(&mut arrays.blas_nodes, entry.nodes);
        self.wide_nodes.release(&mut arrays.wide_nodes, entry.wide_nodes);
        self.triangles.release(&mut arrays.triangles, entry.triangles);
        self.streams.release(entry.streams, arrays);
    }
}

impl Entry {
    /// Of a geometry that nothing was done for yet.
    fn empty(version: u64, now: u64) -> Self {
        Self {
            version,
            history: History::new(now),
            structure: Structure::default(),
            built_cost: None,
            nodes: 0..0,
            wide_nodes: 0..0,
            triangles: 0..0,
            streams: StreamRanges::default(),
            support: Support::default(),
            repeats: false,
            source: Geometry::default(),
            encloses: OnceLock::new(),
        }
    }

    /// Takes note of another version of the geometry. What it takes to follow it.
    fn follow(&mut self, geometry: &Geometry, version: u64, now: u64) -> Step {
        self.version = version;
        self.history.change(now);
        step(self.structure, &self.source, geometry)
    }
}
