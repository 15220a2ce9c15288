//! The compiler: runs the phases that bring the device arrays up to date with a scene.

use std::ops::Range;
use std::time::Instant;

use glam::{DAffine3, DVec3};

use super::changes::SceneChanges;
use super::deformation::RebuildLimits;
use super::geometry_table::GeometryTable;
use super::instance_bounds::InstanceBounds;
use super::instance_record::{RecordInputs, instance_record};
use super::instance_table::{InstanceTable, Member};
use super::light_table::LightTable;
use super::material_table::MaterialTable;
use super::pack::relative_to;
use super::render_origin::{Focus, best_origin, has_extent_below, must_rebase};
use super::report::CompileReport;
use super::users::Users;
use super::view_dependent::ViewDependentState;
use super::viewpoint::Viewpoint;
use crate::accel::TlasUpdate;
use crate::device::{DeviceArrays, Needs};
use crate::graph::{ChangeCursor, Changes, Core, GeometryKey, Hierarchy, MaterialKey, NodePath, Scene, SceneId};
use crate::math::Bounds;
use crate::{Cancel, Error, Result};

/// Compiles a scene into [`DeviceArrays`], incrementally after each edit; a different scene is compiled from nothing.
///
/// The arrays after any sequence of edits are equivalent to those of the same scene compiled from nothing: the same
/// instances with the same records, boxes, geometry and material. Elements may lie at other indices, and the shape of
/// the TLAS may differ.
#[derive(Debug)]
pub struct Compiler {
    /// Which scene the arrays hold, and up to which change of its log.
    cursor: ChangeCursor,
    /// Up to which state of the hierarchy.
    hierarchy_cursor: HierarchyCursor,
    arrays: DeviceArrays,
    view: ViewDependentState,
    instances: InstanceTable,
    users: Users,
    geometries: GeometryTable,
    materials: MaterialTable,
    bounds: InstanceBounds,
    lights: LightTable,
    /// The viewpoint of the last compile, and its scene.
    last_viewpoint: Option<(SceneId, Viewpoint)>,
    /// The render origin: the world position that is (0, 0, 0) in device world space.
    origin: DVec3,
    /// The report that a compile without changes returns.
    report_if_unchanged: CompileReport,
    /// How many times this scene has been compiled.
    compile_count: u64,
    /// Whether the last compile was cancelled: what it has read from the log is marked in the tables, but not written.
    is_unfinished: bool,
    cancel: Cancel,
    rebuild_limits: RebuildLimits,
}

/// The most times that the render origin moves in one compile: the error of its choice shrinks by 2^20 each time.
const MAX_REBASES: usize = 3;

/// How far a hierarchy has been read: its generation, and how many entries it had, and how many of them were removed.
#[derive(Clone, Copy, Debug, Default)]
struct HierarchyCursor {
    generation: u64,
    entry_count: usize,
    removed_count: usize,
}

/// What an instance shows: the path of its node (a node below an instance core appears once for each instance), its
/// geometry and its material.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct InstanceSource {
    /// The node with the geometry core.
    pub path: NodePath,
    /// Its geometry.
    pub geometry: GeometryKey,
    /// Its material: that of the outermost material group above it, else that of the node's core.
    pub material: MaterialKey,
}

impl Default for Compiler {
    fn default() -> Self {
        Self::new()
    }
}

impl Compiler {
    /// A compiler that has seen no scene.
    pub fn new() -> Self {
        Self {
            cursor: ChangeCursor::default(),
            hierarchy_cursor: HierarchyCursor::default(),
            arrays: DeviceArrays::default(),
            view: ViewDependentState::default(),
            instances: InstanceTable::default(),
            users: Users::default(),
            geometries: GeometryTable::new(),
            materials: MaterialTable::new(),
            bounds: InstanceBounds::default(),
            lights: LightTable::default(),
            last_viewpoint: None,
            origin: DVec3::ZERO,
            report_if_unchanged: CompileReport::default(),
            compile_count: 0,
            is_unfinished: false,
            cancel: Cancel::default(),
            rebuild_limits: RebuildLimits::default(),
        }
    }

    /// Sets the token that stops [`compile`](Self::compile) from now on; `None`, the default, for none.
    pub fn set_cancel(&mut self, cancel: impl Into<Option<Cancel>>) {
        self.cancel = cancel.into().unwrap_or_default();
    }

    /// Sets when structures are rebuilt from now on.
    pub fn set_rebuild_limits(&mut self, limits: RebuildLimits) {
        self.rebuild_limits = limits;
    }

    /// Forgets the scene, but not what was set.
    fn forget_scene(&mut self) {
        let cancel = std::mem::take(&mut self.cancel);
        *self = Self { cancel, rebuild_limits: self.rebuild_limits, ..Self::new() };
    }

    /// Brings the arrays up to date with `scene` as seen from a viewpoint (an eye position converts to one).
    ///
    /// O(1) for an unchanged scene. Otherwise: an instance record for each instance that moved, came or went and one
    /// update of the TLAS for all of them (patch, refit or rebuild), a BLAS build for each new geometry, and a refit or
    /// a build for each geometry that changed.
    ///
    /// # Errors
    /// [`Error::Limit`](crate::Error::Limit) if an array would exceed what its indices can address, or nested instances
    /// expand to too many. The compiler then forgets the scene, and the next call compiles from nothing.
    /// [`Error::Cancelled`](crate::Error::Cancelled) if the [token](Self::set_cancel) stopped it. The arrays are then
    /// between two states and must not be traced, and the next call goes on where this one has stopped.
    pub fn compile(&mut self, scene: &mut Scene, viewpoint: impl Into<Viewpoint>) -> Result<CompileReport> {
        let viewpoint = viewpoint.into();
        self.compile_for(scene, &viewpoint, &Focus::Eye(viewpoint.eye))
    }

    fn compile_for(&mut self, scene: &mut Scene, viewpoint: &Viewpoint, focus: &Focus) -> Result<CompileReport> {
        let result = self.try_compile(scene, viewpoint, focus);
        match result {
            Ok(_) => self.last_viewpoint = Some((scene.id(), *viewpoint)),
            Err(Error::Cancelled) => {}
            Err(_) => self.forget_scene(),
        }
        result
    }

    /// Brings the arrays up to date for the viewpoint last used with `scene`; without one, for the centre of the scene.
    /// The render origin stays where it is.
    ///
    /// # Errors
    /// As [`compile`](Self::compile).
    pub fn compile_from_last_viewpoint(&mut self, scene: &mut Scene) -> Result<CompileReport> {
        match self.last_viewpoint_of(scene) {
            Some(viewpoint) => self.compile_for(scene, &viewpoint, &Focus::Unchanged),
            None => {
                let center = scene.world_bounds(scene.root())?.center();
                self.compile(scene, if center.is_finite() { center } else { DVec3::ZERO })
            }
        }
    }

    /// The same, after a first call of [`compile_from_last_viewpoint`](Self::compile_from_last_viewpoint), with
    /// positions that are precise for rays that start in these bounds: the render origin moves there if it must.
    pub(crate) fn compile_around(&mut self, scene: &mut Scene, starts: &Bounds) -> Result<CompileReport> {
        match self.last_viewpoint_of(scene) {
            Some(viewpoint) => self.compile_for(scene, &viewpoint, &Focus::RayStarts(*starts)),
            None => self.compile_from_last_viewpoint(scene),
        }
    }

    fn last_viewpoint_of(&self, scene: &Scene) -> Option<Viewpoint> {
        self.last_viewpoint.filter(|(id, _)| *id == scene.id()).map(|(_, viewpoint)| viewpoint)
    }

    /// Whether an instance has less than this extent, as seen from within these bounds: its distance and its radius. A
    /// position is exact enough if its error is small beside that.
    pub(crate) fn has_detail_below(&self, bounds: &Bounds, extent: f64) -> bool {
        has_extent_below(&self.arrays.tlas_nodes, &bounds.relative_to(self.origin), extent)
    }

    /// The device arrays of the compiled scene.
    pub fn arrays(&self) -> &DeviceArrays {
        &self.arrays
    }

    /// The device arrays of the compiled scene, for an executor to take the dirty ranges from.
    pub fn arrays_mut(&mut self) -> &mut DeviceArrays {
        &mut self.arrays
    }

    /// The render origin: the world position that is (0, 0, 0) in device world space.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// The node, geometry and material behind an element of the `instances` array; `None` for an unused element.
    /// `hierarchy` must be that of the compiled scene, unchanged since. O(depth).
    pub fn instance_source(&self, instance_index: u32, hierarchy: &Hierarchy) -> Option<InstanceSource> {
        let &Member { entry, geometry, material, .. } = self.instances.member(instance_index)?;
        Some(InstanceSource { path: hierarchy.path(entry as usize), geometry, material })
    }

    /// The matrix of an element of the `instances` array, relative to the render origin, in f64: as the scene has it,
    /// where the record's is rounded to f32. `None` for an unused element. `hierarchy` as for
    /// [`instance_source`](Self::instance_source). O(1).
    pub(crate) fn world_from_local(&self, instance_index: u32, hierarchy: &Hierarchy) -> Option<DAffine3> {
        let entry = self.instances.member(instance_index)?.entry as usize;
        relative_to(&self.view.world_from_local(hierarchy, entry), self.origin)
    }

    /// The elements of the `instances` array that coincide with one, itself included. Ascending: the first stands for
    /// all in the TLAS.
    pub(crate) fn coincident_instances(&self, instance_index: u32) -> impl Iterator<Item = u32> {
        self.bounds.coincident_with(instance_index)
    }

    fn try_compile(&mut self, scene: &mut Scene, viewpoint: &Viewpoint, focus: &Focus) -> Result<CompileReport> {
        self.cancel.check()?;
        let start = Instant::now();
        let mut report = self.report_if_unchanged.clone();
        let changes = self.read_changes(scene);
        self.compile_count += 1;
        if self.last_viewpoint.is_none() {
            // No compile of this scene has been finished: nothing is relative to another origin yet.
            self.origin = best_origin(&Focus::Eye(viewpoint.eye), DVec3::ZERO, &[]);
        } else if !self.is_unfinished
            && !changes.affects_image
            && self.view.is_current(viewpoint)
            && !must_rebase(focus, self.origin, &self.arrays.tlas_nodes)
        {
            report.update_time = start.elapsed();
            return Ok(report);
        }

        let (scene, hierarchy) = scene.with_hierarchy()?;
        let resumes = std::mem::replace(&mut self.is_unfinished, true);
        // 1. Classify changed hierarchy entries as instances or lights.
        self.update_entries(scene, hierarchy, &changes)?;
        // 2. Choose levels of detail and orient billboards for the viewpoint.
        self.update_view(scene, hierarchy, viewpoint)?;
        // 3. Update the geometries and materials in use.
        self.update_assets(scene, &changes, resumes, &mut report)?;
        // 4. Write instance and light records relative to the render origin; again if the origin moves to the focus.
        self.write_records(scene, hierarchy, &mut report)?;
        // The boxes by which the origin is chosen are as coarse as f32 is where they are: the first may not do.
        for _ in 0..MAX_REBASES {
            if !must_rebase(focus, self.origin, &self.arrays.tlas_nodes) {
                break;
            }
            self.origin = best_origin(focus, self.origin, &self.arrays.tlas_nodes);
            self.instances.mark_all();
            self.lights.mark_all();
            self.write_records(scene, hierarchy, &mut report)?;
            report.rebased = true;
        }

        self.is_unfinished = false;
        self.fill_totals(&mut report);
        self.report_if_unchanged = report.as_unchanged();
        report.update_time = start.elapsed().saturating_sub(report.blas_time + report.tlas_time);
        Ok(report)
    }

    /// Reads the log. O(changes).
    fn read_changes(&mut self, scene: &mut Scene) -> SceneChanges {
        match scene.changes_since(&mut self.cursor) {
            Changes::Everything => {
                // Keys of different scenes may coincide: nothing of the old scene may stay.
                let cursor = std::mem::take(&mut self.cursor);
                self.forget_scene();
                self.cursor = cursor;
                SceneChanges::default()
            }
            Changes::Since(changes) => SceneChanges::new(scene, changes),
        }
    }

    /// Classifies the entries that were added, removed or changed, and marks those that moved.
    fn update_entries(&mut self, scene: &Scene, hierarchy: &Hierarchy, changes: &SceneChanges) -> Result<()> {
        if self.hierarchy_cursor.generation != hierarchy.generation() {
            return self.replace_all_entries(scene, hierarchy);
        }
        // 1. Removed entries. One that is newer than the last compile was never classified.
        let (old_entry_count, entry_count) = (self.hierarchy_cursor.entry_count, hierarchy.nodes().len());
        let removed = hierarchy.removed_entries();
        for &entry in &removed[self.hierarchy_cursor.removed_count.min(removed.len())..] {
            self.view.remove_entry(entry);
            self.lights.remove(entry);
            if (entry as usize) < old_entry_count {
                self.instances.set_member(entry as usize, None, &mut self.users)?;
            }
        }
        // 2. Changed subtrees and new entries: classify them.
        self.instances.set_entry_count(entry_count);
        let changed = changes.reclassified_nodes.iter().flat_map(|&node| hierarchy.entries(node));
        let added = old_entry_count..entry_count;
        for range in hierarchy.subtrees(changed).into_iter().chain([added]) {
            range.clone().for_each(|entry| self.view.classify(scene, hierarchy, entry));
            self.update_members(scene, hierarchy, range)?;
        }
        // 3. Moved subtrees: only their records are stale.
        let moved = changes.moved_nodes.iter().flat_map(|&node| hierarchy.entries(node));
        for range in hierarchy.subtrees(moved) {
            self.lights.mark_range(&range);
            range.for_each(|entry| self.instances.mark_entry(entry));
        }
        // 4. Lights whose parameters changed.
        if changes.lights {
            self.lights.mark_all();
        }
        self.hierarchy_cursor = HierarchyCursor { entry_count, removed_count: removed.len(), ..self.hierarchy_cursor };
        Ok(())
    }

    /// Classifies all entries after the hierarchy was rebuilt, which gave them new indices.
    fn replace_all_entries(&mut self, scene: &Scene, hierarchy: &Hierarchy) -> Result<()> {
        let entry_count = hierarchy.nodes().len();
        self.hierarchy_cursor = HierarchyCursor { generation: hierarchy.generation(), entry_count, removed_count: 0 };
        self.lights.clear();
        self.view.clear();
        let mut members = Vec::new();
        for entry in 0..entry_count {
            self.view.classify(scene, hierarchy, entry);
            members.extend(self.classify_entry(scene, hierarchy, entry));
        }
        self.instances.replace_all_members(members.into_iter(), entry_count, &mut self.users)
    }

    /// Chooses levels of detail and orients billboards. What that shows, hides or moves is classified or marked.
    fn update_view(&mut self, scene: &Scene, hierarchy: &Hierarchy, viewpoint: &Viewpoint) -> Result<()> {
        let changes = self.view.choose_for(scene, hierarchy, viewpoint)?;
        for range in changes.visibility_ranges {
            self.update_members(scene, hierarchy, range)?;
        }
        for entry in changes.moved_entries.into_iter().map(|entry| entry as usize) {
            self.lights.mark_range(&(entry..entry + 1));
            self.instances.mark_entry(entry);
        }
        Ok(())
    }

    /// Classifies the entries in a range again: each becomes an instance, a light or neither.
    fn update_members(&mut self, scene: &Scene, hierarchy: &Hierarchy, range: Range<usize>) -> Result<()> {
        for entry in range {
            let member = self.classify_entry(scene, hierarchy, entry);
            self.instances.set_member(entry, member, &mut self.users)?;
        }
        Ok(())
    }

    /// The instance that an entry shows, if it shows one. A visible light is added to the light table, and an entry
    /// that is none is removed from it.
    fn classify_entry(&mut self, scene: &Scene, hierarchy: &Hierarchy, entry: usize) -> Option<Member> {
        let node = hierarchy.nodes()[entry];
        let resolved = &hierarchy.resolved()[entry];
        // A removed entry has no core.
        let core = scene.node_core(node).ok().filter(|_| resolved.visible && self.view.is_shown(entry));
        match core {
            Some(Core::Light(_)) => self.lights.insert(entry as u32),
            _ => self.lights.remove(entry as u32),
        }
        match *core? {
            Core::Geometry { geometry, material } => {
                let material = resolved.material.unwrap_or(material);
                Some(Member { entry: entry as u32, node, geometry, material })
            }
            _ => None,
        }
    }

    /// Frees geometries and materials that are no longer used, and builds or stores those that are newly used or
    /// changed. The records of their instances become stale. `resumes`: whether a cancelled compile has left geometries
    /// to be updated.
    fn update_assets(
        &mut self,
        scene: &Scene,
        changes: &SceneChanges,
        resumes: bool,
        report: &mut CompileReport,
    ) -> Result<()> {
        // 1. Materials and textures.
        if self.users.materials.take_keys_changed() || changes.textures || !changes.materials.is_empty() {
            let stored = self.materials.update(scene, &self.users.materials, &mut self.arrays)?;
            let users = stored.iter().flat_map(|&key| self.users.materials.slots(key));
            users.for_each(|&slot| self.instances.mark_slot(slot));
        }
        // 2. Geometries.
        if self.users.geometries.take_keys_changed() || !changes.geometries.is_empty() || resumes {
            let start = Instant::now();
            let used = &self.users.geometries;
            self.geometries.set_max_cost_ratio(self.rebuild_limits.max_blas_cost_ratio);
            let update = self.geometries.update(scene, used, self.compile_count, &mut self.arrays, &self.cancel)?;
            let users = update.changed.iter().flat_map(|&key| self.users.geometries.slots(key));
            users.for_each(|&slot| self.instances.mark_slot(slot));
            (report.blas_built, report.blas_built_triangles) = (update.built.structures, update.built.triangles);
            (report.blas_refitted, report.blas_refitted_triangles) =
                (update.refitted.structures, update.refitted.triangles);
            report.blas_builds = update.builds;
            report.blas_freed = update.freed;
            report.blas_time = start.elapsed();
        }
        Ok(())
    }

    /// Writes stale instance records, all lights if some are stale, and updates the TLAS.
    fn write_records(&mut self, scene: &Scene, hierarchy: &Hierarchy, report: &mut CompileReport) -> Result<()> {
        // 1. Instances.
        let inputs = RecordInputs {
            hierarchy,
            view: &self.view,
            geometries: &self.geometries,
            materials: &self.materials,
            origin: self.origin,
        };
        let compile = |member: &Member| instance_record(member, &inputs);
        report.instances_written +=
            self.instances.write_stale_records(compile, &mut self.arrays.instances, &mut self.bounds);
        if self.instances.is_empty() {
            self.clear_instances();
        }
        // 2. Lights.
        self.lights.write(scene, hierarchy, &self.view, self.origin, &mut self.arrays.lights)?;
        // 3. The TLAS. Of two updates in one compile the last that changed it is reported.
        let start = Instant::now();
        self.bounds.set_max_cost_ratio(self.rebuild_limits.max_tlas_cost_ratio);
        match self.bounds.update_tlas(&mut self.arrays.tlas_nodes, &self.arrays.instances) {
            TlasUpdate::Kept => {}
            update => {
                report.tlas = update;
                report.tlas_time += start.elapsed();
            }
        }
        Ok(())
    }

    /// Releases all memory for instances when none is left, and restarts from empty tables and an empty TLAS.
    fn clear_instances(&mut self) {
        self.instances.clear_slots();
        self.users = Users::default();
        self.bounds.clear(&mut self.arrays.tlas_nodes);
        self.arrays.instances.truncate(0);
    }

    /// Fills in the totals of the report. O(materials).
    fn fill_totals(&self, report: &mut CompileReport) {
        let totals = self.instances.totals();
        report.blas_count = self.geometries.len();
        report.instances = totals.instances;
        report.coincident_instances = self.bounds.coincident_count();
        report.unhittable_instances = totals.unhittable_instances;
        report.displaced_instances = totals.displaced_instances;
        report.greatest_displacement = self.instances.greatest_displacement();
        report.unique_triangles = self.geometries.triangle_count();
        report.instanced_triangles = totals.triangles;
        report.materials = self.materials.len();
        report.textures = self.materials.texture_count();
        report.lights = self.arrays.lights.len();
        report.needs = self.materials.needs();
        report.needs.set(Needs::LIGHTS, !self.arrays.lights.is_empty());
        report.needs.set(Needs::COLORS, !self.arrays.colors.is_empty());
        report.device_bytes = self.arrays.byte_count();
    }
}
