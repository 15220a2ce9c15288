//! The bottom-level structures and vertex streams of all geometries in use, kept up to date as geometries change.

use std::ops::Range;
use std::sync::OnceLock;

use rayon::prelude::*;
use slotmap::SecondaryMap;

use super::buffer_allocator::{BufferAllocator, disjoint_mut};
use super::deformation::{BlasAction, BlasBuildReasons, BuildReason, ChangeHistory, choose_action};
use super::users::SlotsByKey;
use super::vertex_streams::{StreamRanges, VertexStreamTable};
use crate::accel::{Blas, BlasBuildParams, MergedTriangles, RefitReport, SupportFunction, refit};
use crate::device::DeviceArrays;
use crate::graph::{BlasKind, Enclosure, Geometry, GeometryKey, Scene};
use crate::{Cancel, Result};

/// The bottom-level structures and vertex streams on the device, by geometry key.
#[derive(Debug)]
pub(super) struct GeometryTable {
    entries: SecondaryMap<GeometryKey, GeometryEntry>,
    /// The structures that an update had built when it was cancelled, for the next one; empty after any other.
    finished_builds: SecondaryMap<GeometryKey, FinishedBuild>,
    /// Triangles of all entries.
    triangle_count: usize,
    nodes: BufferAllocator,
    wide_nodes: BufferAllocator,
    triangles: BufferAllocator,
    streams: VertexStreamTable,
    /// See [`RebuildLimits`](super::RebuildLimits).
    max_cost_ratio: f64,
}

/// The state of one geometry: what was written for it, and where.
#[derive(Debug)]
pub(super) struct GeometryEntry {
    /// The scene's version of the geometry that the entry was last updated for, or is to be updated for.
    version: u64,
    /// What must be done before the entry is that of `version`: `None` but during an update, and after one that was
    /// cancelled.
    pending: Option<BlasAction>,
    history: ChangeHistory,
    /// The structure that was built.
    structure: BlasKind,
    /// The SAH cost right after the last build; known from the first refit on, which measures it.
    built_cost: Option<f64>,
    /// The range in `blas_nodes`; empty if no triangle can be hit.
    pub(super) nodes: Range<u32>,
    /// The range in `wide_nodes`.
    wide_nodes: Range<u32>,
    /// The range in `triangles`.
    pub(super) triangles: Range<u32>,
    pub(super) streams: StreamRanges,
    /// Its support function, for world boxes; local space.
    pub(super) support: SupportFunction,
    /// Whether some triangle is in several leaves.
    pub(super) has_duplicates: bool,
    /// The triangles that are left out of the structure because they coincide with others.
    merged: MergedTriangles,
    /// The geometry as last written; its arrays are shared with the scene (`Arc`).
    geometry: Geometry,
    /// Whether `geometry` encloses a volume, once that was asked for.
    is_solid: OnceLock<bool>,
}

impl GeometryEntry {
    /// Triangles of the geometry, including degenerate ones that `triangles` leaves out.
    pub(super) fn triangle_count(&self) -> usize {
        self.geometry.indices.len()
    }

    /// Whether the geometry encloses a volume. Computed on first use: only transmissive materials ask.
    pub(super) fn is_solid(&self) -> bool {
        *self.is_solid.get_or_init(|| Enclosure::of(&self.geometry).is_solid())
    }
}

/// What [`GeometryTable::update`] did.
#[derive(Clone, Debug, Default)]
pub(super) struct GeometryUpdate {
    /// The geometries whose entry changed.
    pub(super) changed: Vec<GeometryKey>,
    pub(super) builds: BlasBuildReasons,
    pub(super) built: BlasTotals,
    pub(super) refitted: BlasTotals,
    pub(super) freed: usize,
}

/// A number of structures, and the triangles in them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BlasTotals {
    pub(super) structures: usize,
    pub(super) triangles: usize,
}

impl BlasTotals {
    fn add(&mut self, geometry: &Geometry) {
        self.structures += 1;
        self.triangles += geometry.indices.len();
    }
}

/// A structure that was built and not yet written to the device arrays.
#[derive(Debug)]
struct FinishedBuild {
    /// The version of the geometry that it was built for.
    version: u64,
    structure: BlasKind,
    support: SupportFunction,
    blas: Blas,
}

/// A geometry to refit or build: its key and its current value.
type GeometryJob<'a> = (GeometryKey, &'a Geometry);

impl GeometryTable {
    pub(super) fn new() -> Self {
        Self {
            entries: SecondaryMap::new(),
            finished_builds: SecondaryMap::new(),
            triangle_count: 0,
            nodes: BufferAllocator::new("the bottom-level nodes array"),
            wide_nodes: BufferAllocator::new("the wide nodes array"),
            triangles: BufferAllocator::new("the triangles array"),
            streams: VertexStreamTable::new(),
            max_cost_ratio: f64::INFINITY,
        }
    }

    /// Sets the multiple of its cost after the last build at which a refitted structure is rebuilt.
    pub(super) fn set_max_cost_ratio(&mut self, max_cost_ratio: f64) {
        self.max_cost_ratio = max_cost_ratio;
    }

    /// Makes the table hold exactly the geometries in `used`: frees the others, refits those that deformed, and builds
    /// those that are missing or changed otherwise, in parallel. `compile_index` is the number of this compile.
    ///
    /// After [`Error::Cancelled`](crate::Error::Cancelled) the next update does what is left; the device arrays must
    /// not be used before that. It reports all that either of the two has changed.
    pub(super) fn update(
        &mut self,
        scene: &Scene,
        used: &SlotsByKey<GeometryKey>,
        compile_index: u64,
        arrays: &mut DeviceArrays,
        cancel: &Cancel,
    ) -> Result<GeometryUpdate> {
        cancel.check()?;
        let mut update = GeometryUpdate::default();
        // 1. Free the geometries that no instance uses.
        let unused: Vec<GeometryKey> = self.entries.keys().filter(|&key| !used.has(key)).collect();
        update.freed = unused.len();
        unused.into_iter().for_each(|key| self.free(key, arrays));
        // 2. Decide for each changed geometry: keep, refit or build.
        let (mut to_refit, mut to_build) = (Vec::new(), Vec::new());
        for key in used.keys() {
            let (geometry, version) = (scene.geometry(key)?, scene.geometry_version(key)?);
            match self.entries.get_mut(key) {
                Some(entry) if entry.version == version => {}
                Some(entry) => entry.note_version(geometry, version, compile_index),
                None => drop(self.entries.insert(key, GeometryEntry::empty(version, compile_index))),
            }
            let Some(action) = self.entries[key].pending else { continue };
            match action {
                BlasAction::Keep => {}
                BlasAction::Refit => to_refit.push((key, geometry)),
                BlasAction::Build(reason) => to_build.push(((key, geometry), reason)),
            }
            update.changed.push(key);
        }
        // 3. Refit in place. A refit that fails or makes the structure too costly is queued for a build.
        self.refit(&to_refit, arrays, &mut update, &mut to_build);
        // 4. Build.
        self.build(to_build, arrays, &mut update, cancel)?;
        // 5. Write the vertex streams.
        for &key in &update.changed {
            let (geometry, entry) = (scene.geometry(key)?, &mut self.entries[key]);
            self.streams.write(&mut entry.streams, &entry.geometry, geometry, &entry.wide_nodes, arrays)?;
            self.triangle_count = self.triangle_count - entry.triangle_count() + geometry.indices.len();
            entry.geometry = geometry.clone();
            entry.is_solid = OnceLock::new();
            entry.pending = None;
        }
        Ok(update)
    }

    /// The entry of a geometry that was in `used` at the last update.
    pub(super) fn get(&self, key: GeometryKey) -> Option<&GeometryEntry> {
        self.entries.get(key)
    }

    /// Triangles of all geometries, each counted once.
    pub(super) fn triangle_count(&self) -> usize {
        self.triangle_count
    }

    /// How many geometries there are.
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    /// Refits the structures of these geometries, and appends to `to_build` those that need a build after all.
    fn refit<'a>(
        &mut self,
        jobs: &[GeometryJob<'a>],
        arrays: &mut DeviceArrays,
        update: &mut GeometryUpdate,
        to_build: &mut Vec<(GeometryJob<'a>, BuildReason)>,
    ) {
        let ranges = |range: fn(&GeometryEntry) -> &Range<u32>| -> Vec<Range<usize>> {
            let ranges = jobs.iter().map(|&(key, _)| range(&self.entries[key]));
            ranges.map(|range| range.start as usize..range.end as usize).collect()
        };
        let (node_ranges, triangle_ranges) = (ranges(|entry| &entry.nodes), ranges(|entry| &entry.triangles));
        let wide_ranges = ranges(|entry| &entry.wide_nodes);
        // 1. Refit all geometries in parallel, each in its own ranges of the device arrays.
        let nodes = disjoint_mut(arrays.blas_nodes.as_mut_slice_without_marking(), &node_ranges);
        let wide_nodes = disjoint_mut(arrays.wide_nodes.as_mut_slice_without_marking(), &wide_ranges);
        let triangles = disjoint_mut(arrays.triangles.as_mut_slice_without_marking(), &triangle_ranges);
        let refitted: Vec<Option<(RefitReport, SupportFunction)>> = (jobs.par_iter(), nodes, wide_nodes, triangles)
            .into_par_iter()
            .map(|(&(key, geometry), nodes, wide_nodes, triangles)| {
                let merged = self.entries[key].merged.count();
                let triangle_cost = BlasBuildParams::default().triangle_cost;
                let refitted = refit(nodes, wide_nodes, triangles, geometry, merged, triangle_cost)?;
                let support = SupportFunction::coarse(nodes, triangles, refitted.bounds);
                Some((refitted, support))
            })
            .collect();
        // 2. Mark what changed, and queue a build where the refit failed or the cost grew too much.
        let ranges = node_ranges.into_iter().zip(wide_ranges).zip(triangle_ranges);
        for ((job, refitted), ((nodes, wide_nodes), triangles)) in jobs.iter().zip(refitted).zip(ranges) {
            let Some((refitted, support)) = refitted else {
                // The failed refit may have written some elements: mark all ranges.
                arrays.blas_nodes.mark_dirty(nodes);
                arrays.wide_nodes.mark_dirty(wide_nodes);
                arrays.triangles.mark_dirty(triangles);
                self.build_after_refit(*job, BuildReason::TrianglesChanged, to_build);
                continue;
            };
            let within = |range: Range<usize>, of: &Range<usize>| of.start + range.start..of.start + range.end;
            refitted.changed_nodes.into_iter().for_each(|range| arrays.blas_nodes.mark_dirty(within(range, &nodes)));
            refitted
                .changed_wide_nodes
                .into_iter()
                .for_each(|range| arrays.wide_nodes.mark_dirty(within(range, &wide_nodes)));
            refitted
                .changed_triangles
                .into_iter()
                .for_each(|range| arrays.triangles.mark_dirty(within(range, &triangles)));
            let entry = &mut self.entries[job.0];
            entry.support = support;
            let built_cost = *entry.built_cost.get_or_insert(refitted.old_cost);
            if refitted.cost > built_cost * self.max_cost_ratio {
                self.build_after_refit(*job, BuildReason::CostGrown, to_build);
            } else {
                update.refitted.add(job.1);
            }
        }
    }

    /// Queues a build of a structure whose refit did not suffice. It is built even if the geometry changes again before
    /// that, since a refit that failed has left the structure in pieces.
    fn build_after_refit<'a>(
        &mut self,
        job: GeometryJob<'a>,
        reason: BuildReason,
        to_build: &mut Vec<(GeometryJob<'a>, BuildReason)>,
    ) {
        self.entries[job.0].pending = Some(BlasAction::Build(reason));
        to_build.push((job, reason));
    }

    /// Builds the structures of these geometries and writes them to the device arrays.
    fn build(
        &mut self,
        jobs: Vec<(GeometryJob<'_>, BuildReason)>,
        arrays: &mut DeviceArrays,
        update: &mut GeometryUpdate,
        cancel: &Cancel,
    ) -> Result<()> {
        // 1. Build all in parallel, but those that a cancelled update has built.
        let build = |&(key, geometry): &GeometryJob<'_>| {
            let GeometryEntry { version, history, .. } = &self.entries[key];
            let structure = history.structure(geometry);
            let blas = Blas::build_with_cancel(geometry, &BlasBuildParams::new(structure), cancel)?;
            Ok((key, FinishedBuild { version: *version, structure, support: SupportFunction::new(&blas), blas }))
        };
        self.finished_builds.retain(|key, build| self.entries.get(key).is_some_and(|e| e.version == build.version));
        let missing: Vec<GeometryJob<'_>> =
            jobs.iter().map(|&(job, _)| job).filter(|&(key, _)| !self.finished_builds.contains_key(key)).collect();
        let built: Vec<Result<(GeometryKey, FinishedBuild)>> = missing.par_iter().map(build).collect();
        // 2. Keep what was built, should the others be cancelled.
        let mut result = Ok(());
        for built in built {
            match built {
                Ok((key, build)) => drop(self.finished_builds.insert(key, build)),
                Err(error) => result = Err(error),
            }
        }
        result?;
        // 3. Copy them into the device arrays, in order, in the place of those that they replace.
        for ((key, geometry), reason) in jobs {
            let Some(FinishedBuild { structure, support, blas, .. }) = self.finished_builds.remove(key) else {
                continue;
            };
            update.builds.count(reason);
            update.built.add(geometry);
            let entry = &mut self.entries[key];
            self.nodes.replace(&mut arrays.blas_nodes, &mut entry.nodes, &blas.nodes)?;
            self.wide_nodes.replace(&mut arrays.wide_nodes, &mut entry.wide_nodes, &blas.wide_nodes)?;
            self.triangles.replace(&mut arrays.triangles, &mut entry.triangles, &blas.triangles)?;
            (entry.structure, entry.built_cost, entry.support) = (structure, None, support);
            entry.has_duplicates = blas.has_duplicates;
            entry.merged = blas.merged().clone();
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

impl GeometryEntry {
    /// An entry of a new geometry, before anything is built for it.
    fn empty(version: u64, compile_index: u64) -> Self {
        Self {
            version,
            pending: Some(BlasAction::Build(BuildReason::New)),
            history: ChangeHistory::new(compile_index),
            structure: BlasKind::default(),
            built_cost: None,
            nodes: 0..0,
            wide_nodes: 0..0,
            triangles: 0..0,
            streams: StreamRanges::default(),
            support: SupportFunction::default(),
            has_duplicates: false,
            merged: MergedTriangles::default(),
            geometry: Geometry::default(),
            is_solid: OnceLock::new(),
        }
    }

    /// Records a new version of the geometry, and what has to be done for it.
    fn note_version(&mut self, geometry: &Geometry, version: u64, compile_index: u64) {
        self.version = version;
        self.history.record_change(compile_index);
        let action = match choose_action(self.structure, &self.geometry, geometry) {
            BlasAction::Build(reason) => BlasAction::Build(reason),
            // A triangle that was left out no longer coincides with the one that stands for it.
            _ if !self.merged.still_coincide(geometry) => BlasAction::Build(BuildReason::TrianglesChanged),
            action => action,
        };
        // What was pending for an earlier version is still needed: a refit may have been done, and is to be undone.
        self.pending = Some(match (self.pending, action) {
            (Some(pending @ BlasAction::Build(_)), _) | (Some(pending @ BlasAction::Refit), BlasAction::Keep) => {
                pending
            }
            _ => action,
        });
    }
}
