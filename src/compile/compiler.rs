//! The compiler: reads what changed in a scene and brings the device arrays up to date with the smallest update.

use std::ops::Range;
use std::time::Instant;

use glam::DVec3;
use slotmap::SecondaryMap;

use super::geometry_cache::GeometryCache;
use super::instance_table::{InstanceSource, InstanceTable, Member, Sources};
use super::material_table::MaterialTable;
use super::report::{CompileReport, RebuildReason, TlasUpdate};
use super::{Needs, pack};
use crate::Result;
use crate::device::DeviceArrays;
use crate::graph::{Change, Changes, Core, Cursor, Hierarchy, NodeKey, Object, Scene};
use crate::math::{Aabb, Bounds};

/// Turns one scene after another, or one scene edit by edit, into [`DeviceArrays`].
///
/// The arrays after any sequence of edits equal those of the same scene compiled from nothing, but for the places at
/// which instances, geometries and materials lie.
#[derive(Debug)]
pub struct Compiler {
    /// The scene that the arrays hold, and how much of its log they reflect.
    cursor: Cursor,
    arrays: DeviceArrays,
    geometries: GeometryCache,
    materials: MaterialTable,
    instances: InstanceTable,
    /// Nodes with a light core that are visible, as preorder indices.
    light_nodes: Vec<u32>,
    /// Where the device's world has its origin, in the scene's world.
    origin: DVec3,
    /// The report of a compile that finds nothing changed.
    unchanged: CompileReport,
}

/// What changed since the last compile, from the log.
#[derive(Debug, Default)]
struct Dirty {
    /// All of it: the scene is new to the compiler.
    everything: bool,
    /// The set of visible geometry or light nodes, their masks, geometries or materials.
    structure: bool,
    /// Lights, other than by transform.
    lights: bool,
    /// Nodes whose local transform changed.
    moved: Vec<NodeKey>,
}

/// Which instance records must be written.
enum Stale {
    All,
    /// Ranges of the instance table's members.
    Ranges(Vec<Range<usize>>),
}

impl Dirty {
    fn is_empty(&self) -> bool {
        !(self.structure || self.lights) && self.moved.is_empty()
    }
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
            cursor: Cursor::default(),
            arrays: DeviceArrays::default(),
            geometries: GeometryCache::new(),
            materials: MaterialTable::new(),
            instances: InstanceTable::default(),
            light_nodes: Vec::new(),
            origin: DVec3::ZERO,
            unchanged: CompileReport::default(),
        }
    }

    /// Brings the arrays up to date with `scene`, to be seen from `eye` (world space).
    ///
    /// Costs nothing for an unchanged scene, a top-level build for moved nodes, a walk over the visible nodes for other
    /// edits, and a bottom-level build for each new or changed geometry.
    ///
    /// # Errors
    /// [`Error::Limit`](crate::Error::Limit) if an array would pass what its indices can address. The compiler then
    /// starts from nothing with its next scene.
    pub fn compile(&mut self, scene: &mut Scene, eye: DVec3) -> Result<CompileReport> {
        let result = self.try_compile(scene, eye);
        if result.is_err() {
            *self = Self::new();
        }
        result
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

    /// What stands at a place in the `instances` array; `None` where nothing does. O(1).
    pub fn instance(&self, slot: u32) -> Option<InstanceSource> {
        self.instances.source(slot)
    }

    fn try_compile(&mut self, scene: &mut Scene, eye: DVec3) -> Result<CompileReport> {
        let start = Instant::now();
        let mut report = self.unchanged.clone();
        let dirty = self.read_changes(scene);
        if dirty.everything {
            self.origin = eye;
        }
        if !dirty.is_empty() || self.is_far(eye) {
            let (scene, hierarchy) = scene.with_hierarchy();
            self.update(scene, hierarchy, &dirty, &mut report)?;
            if self.is_far(eye) {
                self.origin = eye;
                self.write(scene, hierarchy, &Stale::All, RebuildReason::Rebased, &mut report)?;
            }
            self.count(&mut report);
            self.unchanged = report.as_unchanged();
        }
        report.update_time = start.elapsed().saturating_sub(report.blas_time + report.tlas_time);
        Ok(report)
    }

    /// Brings the arrays up to date with what changed.
    fn update(
        &mut self,
        scene: &Scene,
        hierarchy: &Hierarchy,
        dirty: &Dirty,
        report: &mut CompileReport,
    ) -> Result<()> {
        if dirty.structure {
            self.collect(scene, hierarchy)?;
            self.update_assets(scene, report)?;
            let reason = if dirty.everything { RebuildReason::NewScene } else { RebuildReason::Structure };
            return self.write(scene, hierarchy, &Stale::All, reason, report);
        }
        let mut moved: Vec<u32> = dirty.moved.iter().filter_map(|&node| Some(hierarchy.index(node)? as u32)).collect();
        let moved: Vec<Range<usize>> =
            hierarchy.outermost_subtrees(&mut moved).map(|subtree| self.instances.members_in(subtree)).collect();
        let instances = moved.iter().map(ExactSizeIterator::len).sum();
        self.write(scene, hierarchy, &Stale::Ranges(moved), RebuildReason::Moved { instances }, report)
    }

    /// Writes stale instance records and the lights, then the top level if a box changed, for the reason given.
    fn write(
        &mut self,
        scene: &Scene,
        hierarchy: &Hierarchy,
        stale: &Stale,
        reason: RebuildReason,
        report: &mut CompileReport,
    ) -> Result<()> {
        let sources =
            Sources { hierarchy, geometries: &self.geometries, materials: &self.materials, origin: self.origin };
        match stale {
            Stale::All => self.instances.write(0..self.instances.members().len(), &sources, &mut self.arrays),
            Stale::Ranges(ranges) => {
                for range in ranges {
                    self.instances.write(range.clone(), &sources, &mut self.arrays);
                }
            }
        }
        self.write_lights(scene, hierarchy)?;

        let start = Instant::now();
        if self.instances.update_tlas(&mut self.arrays) {
            report.tlas_time += start.elapsed();
            report.tlas = TlasUpdate::Rebuilt(reason);
        }
        Ok(())
    }

    /// Reads the log. O(changes).
    fn read_changes(&mut self, scene: &mut Scene) -> Dirty {
        let mut dirty = Dirty::default();
        let changes = match scene.changes_since(&mut self.cursor) {
            Changes::Everything => {
                // Keys of different scenes may be equal: nothing of the old one may stay.
                *self = Self { cursor: std::mem::take(&mut self.cursor), ..Self::new() };
                return Dirty { everything: true, structure: true, ..dirty };
            }
            Changes::Since(changes) => changes,
        };
        for (object, change) in changes {
            match object {
                // A name is no part of the image.
                Object::Node(_) => dirty.structure |= change != Change::NAME,
                Object::Core(_) if change.intersects(Change::ADDED | Change::REMOVED) => {}
                Object::Core(key) => {
                    if change.contains(Change::TRANSFORM) {
                        dirty.moved.extend(scene.users(key).into_iter().flatten());
                    }
                    dirty.structure |= change.contains(Change::KIND);
                    if change.contains(Change::DATA) {
                        match scene.core_of(key) {
                            Ok(Core::Camera(_)) => {}
                            Ok(Core::Light(_)) => dirty.lights = true,
                            _ => dirty.structure = true,
                        }
                    }
                }
                // One that is new or gone is seen by the cores that use it.
                Object::Geometry(_) | Object::Material(_) | Object::Texture(_) => {
                    dirty.structure |= change.contains(Change::DATA);
                }
            }
        }
        dirty
    }

    /// Whether the eye is so far from the render origin that the origin must follow it. Positions near the eye then have
    /// the full resolution of f32, while a camera that moves a little changes nothing on the device.
    ///
    /// "Far" is relative: f32 resolves 2^-24 of the distance to the origin. Inside the scene the limit is 1/256 of its
    /// radius, so that positions are known to 2.3e-10 of that; outside it is 16 times the distance to the scene, 1e-6 of
    /// which is the most that a position is off: far less than a pixel.
    fn is_far(&self, eye: DVec3) -> bool {
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

    /// Finds the visible geometry and light nodes. O(nodes).
    fn collect(&mut self, scene: &Scene, hierarchy: &Hierarchy) -> Result<()> {
        let mut members = Vec::new();
        self.light_nodes.clear();
        for (preorder, &node) in hierarchy.nodes().iter().enumerate().filter(|&(i, _)| hierarchy.visible()[i]) {
            let preorder = preorder as u32;
            match *scene.core(node)? {
                Core::Geometry { geometry, material } => members.push(Member { preorder, node, geometry, material }),
                Core::Light(_) => self.light_nodes.push(preorder),
                Core::Group | Core::Transform(_) | Core::Camera(_) => {}
            }
        }
        self.instances.set_members(members, &mut self.arrays)
    }

    /// Frees the geometries and materials that no member uses and makes those that one misses.
    fn update_assets(&mut self, scene: &Scene, report: &mut CompileReport) -> Result<()> {
        let (mut geometries, mut materials) = (SecondaryMap::new(), SecondaryMap::new());
        for member in self.instances.members() {
            geometries.insert(member.geometry, ());
            materials.insert(member.material, ());
        }
        self.materials.update(scene, &materials, &mut self.arrays)?;
        let start = Instant::now();
        let update = self.geometries.update(scene, &geometries, &mut self.arrays)?;
        report.blas_built = update.built;
        report.blas_built_triangles = update.built_triangles;
        report.blas_freed = update.freed;
        report.blas_time = start.elapsed();
        Ok(())
    }

    /// O(visible lights).
    fn write_lights(&mut self, scene: &Scene, hierarchy: &Hierarchy) -> Result<()> {
        let mut lights = Vec::with_capacity(self.light_nodes.len());
        for &preorder in &self.light_nodes {
            let preorder = preorder as usize;
            if let Core::Light(light) = scene.core(hierarchy.nodes()[preorder])? {
                lights.extend(pack::light(light, &hierarchy.worlds()[preorder], self.origin));
            }
        }
        self.arrays.lights.replace(&lights);
        Ok(())
    }

    /// The totals of the report.
    fn count(&self, report: &mut CompileReport) {
        let totals = self.instances.totals(&self.geometries);
        report.blas_count = self.geometries.len();
        report.instances = totals.instances;
        report.singular_instances = totals.singular_instances;
        report.triangles = self.geometries.triangle_count();
        report.scene_triangles = totals.triangles;
        report.materials = self.materials.len();
        report.textures = self.materials.texture_count();
        report.lights = self.arrays.lights.len();
        report.needs = self.materials.needs();
        report.needs.set(Needs::LIGHTS, !self.arrays.lights.is_empty());
        report.needs.set(Needs::COLORS, !self.arrays.colors.is_empty());
        report.device_bytes = self.arrays.byte_count();
    }
}
