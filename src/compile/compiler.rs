//! The compiler: reads what changed in a scene and brings the device arrays up to date with the smallest update.

use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Instant;

use glam::DVec3;

use super::changes::SceneChanges;
use super::geometry_table::GeometryTable;
use super::instance_table::{InstanceSource, InstanceTable, Member, RecordInputs};
use super::material_table::MaterialTable;
use super::pack;
use super::report::CompileReport;
use super::view_dependent::ViewDependentState;
use super::viewpoint::Viewpoint;
use crate::Result;
use crate::accel::TlasUpdate;
use crate::device::{DeviceArrays, Needs};
use crate::graph::{ChangeCursor, Changes, Core, Hierarchy, Scene, SceneId};
use crate::math::{Aabb, Bounds};

/// Turns one scene after another, or one scene edit by edit, into [`DeviceArrays`].
///
/// The arrays after any sequence of edits show what those of the same scene compiled from nothing show: the same
/// instances, each with the same records, boxes, geometry and material. They may lie at other places, and the top level
/// may have another shape.
#[derive(Debug)]
pub struct Compiler {
    /// The scene that the arrays hold, and how much of its log they reflect.
    cursor: ChangeCursor,
    /// How much of the hierarchy they reflect.
    hierarchy_cursor: HierarchyCursor,
    arrays: DeviceArrays,
    geometries: GeometryTable,
    materials: MaterialTable,
    instances: InstanceTable,
    /// Entries with a light core that are shown.
    light_entries: BTreeSet<u32>,
    view: ViewDependentState,
    /// Who looked last, and at which scene.
    observer: Option<(SceneId, Viewpoint)>,
    /// Where the device's world has its origin, in the scene's world.
    origin: DVec3,
    /// The report of a compile that finds nothing changed.
    report_if_unchanged: CompileReport,
    /// Compiles of this scene.
    compile_count: u64,
}

/// How much of a hierarchy has been read.
#[derive(Clone, Copy, Debug, Default)]
struct HierarchyCursor {
    generation: u64,
    entries: usize,
    gap_count: usize,
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
            geometries: GeometryTable::new(),
            materials: MaterialTable::new(),
            instances: InstanceTable::default(),
            light_entries: BTreeSet::new(),
            view: ViewDependentState::default(),
            observer: None,
            origin: DVec3::ZERO,
            report_if_unchanged: CompileReport::default(),
            compile_count: 0,
        }
    }

    /// Brings the arrays up to date with `scene`, to be seen by `observer`, or from an eye at some point in the world.
    ///
    /// Costs nothing for an unchanged scene, else what changed: a record and a patch of the top level for each instance
    /// that moved, came or went, a bottom-level build for each new geometry, and a refit or a build for each
    /// that changed.
    ///
    /// # Errors
    /// [`Error::Limit`](crate::Error::Limit) if an array would pass what its indices can address, or instances of instances
    /// are too many. The compiler then starts from nothing with its next scene.
    pub fn compile(&mut self, scene: &mut Scene, observer: impl Into<Viewpoint>) -> Result<CompileReport> {
        let observer = observer.into();
        let result = self.try_compile(scene, &observer);
        match result {
            Ok(_) => self.observer = Some((scene.id(), observer)),
            Err(_) => *self = Self::new(),
        }
        result
    }

    /// Brings the arrays up to date for the observer who looked at `scene` last; if nobody has, from its centre.
    ///
    /// # Errors
    /// As [`compile`](Self::compile).
    pub fn compile_from_last_viewpoint(&mut self, scene: &mut Scene) -> Result<CompileReport> {
        let last = self.observer.filter(|(id, _)| *id == scene.id());
        let observer = match last {
            Some((_, observer)) => observer,
            None => {
                let center = scene.world_bounds(scene.root())?.center();
                if center.is_finite() { center } else { DVec3::ZERO }.into()
            }
        };
        self.compile(scene, observer)
    }

    /// The compiled scene.
    pub fn arrays(&self) -> &DeviceArrays {
        &self.arrays
    }

    /// The compiled scene, for an executor to take the dirty ranges from.
    pub fn arrays_mut(&mut self) -> &mut DeviceArrays {
        &mut self.arrays
    }

    /// The render origin: the point of the scene's world at which the device's world has its origin.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// What stands at a place in the `instances` array; `None` where nothing does. `hierarchy` is that of the scene that was
    /// compiled, unchanged since. O(depth).
    pub fn instance(&self, slot: u32, hierarchy: &Hierarchy) -> Option<InstanceSource> {
        let &Member { entry, geometry, material, .. } = self.instances.member(slot)?;
        Some(InstanceSource { path: hierarchy.path(entry as usize), geometry, material })
    }

    fn try_compile(&mut self, scene: &mut Scene, observer: &Viewpoint) -> Result<CompileReport> {
        let start = Instant::now();
        let mut report = self.report_if_unchanged.clone();
        let dirty = self.read_changes(scene);
        self.compile_count += 1;
        if dirty.is_new_scene {
            self.origin = observer.eye;
        } else if !dirty.affects_image && self.view.is_current(observer) && !self.must_rebase(observer.eye) {
            report.update_time = start.elapsed();
            return Ok(report);
        }

        let (scene, hierarchy) = scene.with_hierarchy()?;
        // 1. Which entries are instances and lights.
        let mut shine = self.update_entries(scene, hierarchy, &dirty)?;
        // 2. What the observer has to do with it.
        shine |= self.update_view(scene, hierarchy, observer)?;
        // 3. The geometries and materials that they use.
        self.update_assets(scene, &dirty, &mut report)?;
        // 4. Their records, relative to the render origin; and once more where that follows the eye.
        shine |= dirty.lights;
        self.write_records(scene, hierarchy, shine, &mut report)?;
        if self.must_rebase(observer.eye) {
            self.origin = observer.eye;
            self.instances.mark_all();
            self.write_records(scene, hierarchy, true, &mut report)?;
            report.rebased = true;
        }

        self.fill_totals(&mut report);
        self.report_if_unchanged = report.as_unchanged();
        report.update_time = start.elapsed().saturating_sub(report.blas_time + report.tlas_time);
        Ok(report)
    }

    /// Reads the log. O(changes).
    fn read_changes(&mut self, scene: &mut Scene) -> SceneChanges {
        match scene.changes_since(&mut self.cursor) {
            Changes::Everything => {
                // Keys of different scenes may be equal: nothing of the old one may stay.
                *self = Self { cursor: std::mem::take(&mut self.cursor), ..Self::new() };
                SceneChanges { is_new_scene: true, ..SceneChanges::default() }
            }
            Changes::Since(changes) => SceneChanges::new(scene, changes),
        }
    }

    /// Finds the members and lights among the entries that changed. Whether some light did, too.
    fn update_entries(&mut self, scene: &Scene, hierarchy: &Hierarchy, dirty: &SceneChanges) -> Result<bool> {
        let entry_count = hierarchy.nodes().len();
        let lights = self.light_entries.len();
        if self.hierarchy_cursor.generation != hierarchy.generation() {
            self.hierarchy_cursor =
                HierarchyCursor { generation: hierarchy.generation(), entries: entry_count, gap_count: 0 };
            self.light_entries.clear();
            self.view.clear();
            let mut members = Vec::new();
            for entry in 0..entry_count {
                self.view.classify(scene, hierarchy, entry);
                members.extend(self.classify_entry(scene, hierarchy, entry));
            }
            self.instances.replace_all_members(members.into_iter(), entry_count, &mut self.arrays)?;
            return Ok(true);
        }

        for &gap in
            &hierarchy.removed_entries()[self.hierarchy_cursor.gap_count.min(hierarchy.removed_entries().len())..]
        {
            self.view.remove_entry(gap);
            self.light_entries.remove(&gap);
            if (gap as usize) < self.hierarchy_cursor.entries {
                self.instances.set_member(gap as usize, None, &mut self.arrays)?;
            }
        }
        self.instances.set_entry_count(entry_count);
        let new = self.hierarchy_cursor.entries..entry_count;
        let changed = dirty.reclassified_nodes.iter().flat_map(|&node| hierarchy.entries(node));
        let changed = hierarchy.subtrees(changed);
        self.hierarchy_cursor = HierarchyCursor {
            entries: entry_count,
            gap_count: hierarchy.removed_entries().len(),
            ..self.hierarchy_cursor
        };
        let mut shine = self.light_entries.len() != lights;
        for range in changed.into_iter().chain([new]) {
            shine |= self.has_lights(&range);
            range.clone().for_each(|entry| self.view.classify(scene, hierarchy, entry));
            self.settle(scene, hierarchy, range.clone())?;
            shine |= self.has_lights(&range);
        }

        let moved = dirty.moved_nodes.iter().flat_map(|&node| hierarchy.entries(node));
        for range in hierarchy.subtrees(moved) {
            shine |= self.has_lights(&range);
            range.for_each(|entry| self.instances.mark_entry(entry));
        }
        Ok(shine)
    }

    /// Chooses levels of detail and turns billboards. Whether that moved some light.
    fn update_view(&mut self, scene: &Scene, hierarchy: &Hierarchy, observer: &Viewpoint) -> Result<bool> {
        let mut shine = false;
        let choice = self.view.choose_for(scene, hierarchy, observer)?;
        for range in choice.visibility_ranges {
            shine |= self.has_lights(&range);
            self.settle(scene, hierarchy, range.clone())?;
            shine |= self.has_lights(&range);
        }
        for entry in choice.turned {
            shine |= self.light_entries.contains(&entry);
            self.instances.mark_entry(entry as usize);
        }
        Ok(shine)
    }

    /// Makes the entries in a range members, lights, or neither.
    fn settle(&mut self, scene: &Scene, hierarchy: &Hierarchy, range: Range<usize>) -> Result<()> {
        for entry in range {
            let member = self.classify_entry(scene, hierarchy, entry);
            self.instances.set_member(entry, member, &mut self.arrays)?;
        }
        Ok(())
    }

    /// The member that an entry is, if it is one; a light is noted.
    fn classify_entry(&mut self, scene: &Scene, hierarchy: &Hierarchy, entry: usize) -> Option<Member> {
        let node = hierarchy.nodes()[entry];
        let placed = &hierarchy.resolved()[entry];
        // A gap has no core.
        let core = scene.node_core(node).ok().filter(|_| placed.visible && self.view.is_shown(entry));
        match core {
            Some(Core::Light(_)) => drop(self.light_entries.insert(entry as u32)),
            _ => drop(self.light_entries.remove(&(entry as u32))),
        }
        match *core? {
            Core::Geometry { geometry, material } => {
                let material = placed.material.unwrap_or(material);
                Some(Member { entry: entry as u32, node, geometry, material })
            }
            _ => None,
        }
    }

    fn has_lights(&self, range: &Range<usize>) -> bool {
        self.light_entries.range(range.start as u32..range.end as u32).next().is_some()
    }

    /// Frees the geometries and materials that no member uses and makes those that one misses.
    fn update_assets(&mut self, scene: &Scene, dirty: &SceneChanges, report: &mut CompileReport) -> Result<()> {
        if dirty.textures || !dirty.materials.is_empty() || self.instances.materials().changed() {
            let stored = self.materials.update(scene, self.instances.materials(), &mut self.arrays)?;
            self.instances.materials_mut().forget_changes();
            self.instances.mark_users_stale(&[], &stored);
        }
        if !dirty.geometries.is_empty() || self.instances.geometries().changed() {
            let start = Instant::now();
            let used = self.instances.geometries();
            let update = self.geometries.update(scene, used, self.compile_count, &mut self.arrays)?;
            self.instances.geometries_mut().forget_changes();
            self.instances.mark_users_stale(&update.changed, &[]);
            (report.blas_built, report.blas_built_triangles) = (update.built.structures, update.built.triangles);
            (report.blas_refitted, report.blas_refitted_triangles) =
                (update.refitted.structures, update.refitted.triangles);
            report.blas_builds = update.builds;
            report.blas_freed = update.freed;
            report.blas_time = start.elapsed();
        }
        Ok(())
    }

    /// Writes the records that are stale, the lights if some changed, and what that means for the top level.
    fn write_records(
        &mut self,
        scene: &Scene,
        hierarchy: &Hierarchy,
        shine: bool,
        report: &mut CompileReport,
    ) -> Result<()> {
        let sources = RecordInputs {
            hierarchy,
            view: &self.view,
            geometries: &self.geometries,
            materials: &self.materials,
            origin: self.origin,
        };
        report.instances_written += self.instances.write_stale_records(&sources, &mut self.arrays);
        if shine {
            self.write_lights(scene, hierarchy)?;
        }
        let start = Instant::now();
        match self.instances.update_tlas(&mut self.arrays) {
            TlasUpdate::Kept => {}
            update => {
                report.tlas = update;
                report.tlas_time += start.elapsed();
            }
        }
        Ok(())
    }

    /// O(lights).
    fn write_lights(&mut self, scene: &Scene, hierarchy: &Hierarchy) -> Result<()> {
        let mut lights = Vec::with_capacity(self.light_entries.len());
        for &entry in &self.light_entries {
            let entry = entry as usize;
            if let Core::Light(light) = scene.node_core(hierarchy.nodes()[entry])? {
                lights.extend(pack::light_record(light, &self.view.world_from_local(hierarchy, entry), self.origin));
            }
        }
        self.arrays.lights.replace(&lights);
        Ok(())
    }

    /// Whether the eye is so far from the render origin that the origin must follow it. Positions near the eye then have
    /// the full resolution of f32, while a camera that moves a little changes nothing on the device.
    ///
    /// "Far" is relative: f32 resolves 2^-24 of the distance to the origin. Inside the scene the limit is 1/256 of its
    /// radius, so that positions are known to 2.3e-10 of that; outside it is 16 times the distance to the scene, 1e-6 of
    /// which is the most that a position is off: far less than a pixel.
    fn must_rebase(&self, eye: DVec3) -> bool {
        let relative = eye - self.origin;
        let bounds = self.scene_bounds();
        let to_scene = (bounds.min - relative).max(relative - bounds.max).max(DVec3::ZERO).length();
        let limit = if bounds.is_empty() { 0.0 } else { (bounds.radius() / 256.0).max(to_scene * 16.0) };
        relative.length() > limit
    }

    /// The box around all instances as they were last compiled, relative to the render origin.
    fn scene_bounds(&self) -> Bounds {
        match self.arrays.tlas_nodes.first() {
            Some(root) => Aabb { min: root.min.into(), max: root.max.into() }.into(),
            None => Bounds::EMPTY,
        }
    }

    /// The totals of the report. O(materials).
    fn fill_totals(&self, report: &mut CompileReport) {
        let totals = self.instances.totals();
        report.blas_count = self.geometries.len();
        report.instances = totals.instances;
        report.unhittable_instances = totals.singular_instances;
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
