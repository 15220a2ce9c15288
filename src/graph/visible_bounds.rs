//! The box around what is seen of a subtree, and the side from which it is seen.

use glam::DAffine3;
use rayon::prelude::*;

use super::{Core, Geometry, GeometryKey, Hierarchy, MaterialKey, NodeKey, Scene};
use crate::Result;
use crate::math::Bounds;

/// Triangles whose vertices one task transforms.
const TRIANGLES_PER_TASK: usize = 1 << 13;

/// One visible appearance of a geometry.
struct Shown<'h> {
    geometry: GeometryKey,
    material: MaterialKey,
    world_from_local: &'h DAffine3,
    /// The box around its transformed local box.
    bounds: Bounds,
}

/// Bounds of what is visible.
impl Scene {
    /// The smallest world-space box around all visible geometry at and below the node: around the vertices of its
    /// triangles, however they are turned. Hidden nodes, children that a switch does not choose, nodes with a mask of 0
    /// and what has a matrix that is not finite do not count; levels of detail all count, since which one is chosen
    /// depends on the viewpoint, and billboards as if they were not turned. Empty if nothing is visible.
    ///
    /// Nothing is kept between calls. O(entries) for their boxes, as in [`world_bounds`](Self::world_bounds), and
    /// O(triangles) of those appearances whose box reaches out of what was found before, on all cores: most often the
    /// few at the border.
    ///
    /// ```
    /// use glam::{DQuat, DVec3, Vec3};
    /// use ropewalk::{Core, Geometry, Material, Scene, Transform};
    ///
    /// // A diamond that is turned into a square.
    /// let mut scene = Scene::new();
    /// let corners = [Vec3::X, Vec3::Y, Vec3::NEG_X, Vec3::NEG_Y];
    /// let geometry = scene.add_geometry(Geometry::new(corners, [[0, 1, 2], [0, 2, 3]]))?;
    /// let material = scene.add_material(Material::default())?;
    /// let turn = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_4);
    /// let turned = Transform::Trs { translation: DVec3::ZERO, rotation: turn, scale: DVec3::ONE };
    /// let turned = scene.add(scene.root(), turned)?;
    /// let square = scene.add(turned, Core::Geometry { geometry, material })?;
    ///
    /// let tight = scene.visible_bounds(turned)?;
    /// assert!((tight.max.x - 0.5f64.sqrt()).abs() < 1e-12);
    /// // The box of the turned box is twice as wide.
    /// assert!((scene.world_bounds(turned)?.max.x - 2.0 * tight.max.x).abs() < 1e-12);
    /// scene.set_visible(square, false)?;
    /// assert!(scene.visible_bounds(turned)?.is_empty());
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`world_bounds`](Self::world_bounds).
    pub fn visible_bounds(&mut self, node: NodeKey) -> Result<Bounds> {
        self.node(node)?;
        let (scene, hierarchy) = self.with_hierarchy()?;
        let shown = scene.shown(hierarchy, node);
        // 1. Begin with the appearances that reach farthest along each axis: they make most others superfluous.
        let extreme = |axis: usize| {
            let reach = |i: &usize| [-shown[*i].bounds.min[axis], shown[*i].bounds.max[axis]];
            [0, 1].map(|side| (0..shown.len()).max_by(|a, b| reach(a)[side].total_cmp(&reach(b)[side])))
        };
        let extremes = (0..3).flat_map(extreme).flatten();
        // 2. Then the others, where their box reaches farther.
        let (mut bounds, mut is_done) = (Bounds::EMPTY, vec![false; shown.len()]);
        for i in extremes.chain(0..shown.len()) {
            if !std::mem::replace(&mut is_done[i], true) {
                scene.extend_bounds(&mut bounds, &shown[i]);
            }
        }
        Ok(bounds)
    }

    /// The area of all that is visible from one side only, seen along a world axis: positive if more of it faces to
    /// the positive side than to the negative one. O(visible triangles).
    pub(crate) fn net_area_facing(&mut self, axis: usize) -> Result<f64> {
        let root = self.root;
        let (scene, hierarchy) = self.with_hierarchy()?;
        let single_sided = |shown: &Shown<'_>| {
            let material = &scene.materials[shown.material].value;
            !material.double_sided && material.transmission == 0.0
        };
        let area = |shown: Shown<'_>| {
            let (matrix, geometry) = (shown.world_from_local.matrix3, scene.geometry_of(&shown));
            // The front is where triangles wind counter-clockwise in local space, under mirroring transforms too.
            let side = matrix.determinant().signum();
            let area = |triangle: &[u32; 3]| {
                let [a, b, c] = triangle.map(|vertex| matrix * geometry.positions[vertex as usize].as_dvec3());
                side * 0.5 * (b - a).cross(c - a)[axis]
            };
            let tasks = geometry.indices.par_chunks(TRIANGLES_PER_TASK);
            tasks.map(|triangles| triangles.iter().map(area).sum::<f64>()).sum::<f64>()
        };
        Ok(scene.shown(hierarchy, root).into_iter().filter(single_sided).map(area).sum())
    }

    /// The visible appearances of geometry at and below a node.
    fn shown<'h>(&self, hierarchy: &'h Hierarchy, node: NodeKey) -> Vec<Shown<'h>> {
        let ranges = hierarchy.entry(node).map_or_else(Vec::new, |entry| hierarchy.subtree(entry));
        let shown = ranges.into_iter().flatten().filter(|&entry| !hierarchy.is_removed(entry)).filter_map(|entry| {
            let resolved = &hierarchy.resolved()[entry];
            let Core::Geometry { geometry, material } = *self.node_core(hierarchy.nodes()[entry]).ok()? else {
                return None;
            };
            let bounds = self.geometries[geometry].value.bounds.transformed(&resolved.world_from_local);
            let is_shown = resolved.visible && resolved.mask != 0 && !bounds.is_empty();
            let is_finite = bounds.min.is_finite() && bounds.max.is_finite();
            (is_shown && is_finite).then(|| Shown {
                geometry,
                material: resolved.material.unwrap_or(material),
                world_from_local: &resolved.world_from_local,
                bounds,
            })
        });
        shown.collect()
    }

    fn geometry_of(&self, shown: &Shown<'_>) -> &Geometry {
        &self.geometries[shown.geometry].value.geometry
    }

    /// Extends `bounds` by the vertices of an appearance, unless its box lies within them.
    fn extend_bounds(&self, bounds: &mut Bounds, shown: &Shown<'_>) {
        if bounds.contains(&shown.bounds) {
            return;
        }
        let geometry = self.geometry_of(shown);
        let of_vertex = |vertex: &u32| {
            let position = geometry.positions[*vertex as usize].as_dvec3();
            let vertex = shown.world_from_local.transform_point3(position);
            Bounds { min: vertex, max: vertex }
        };
        let tasks = geometry.indices.par_chunks(TRIANGLES_PER_TASK);
        let exact = tasks
            .map(|triangles| triangles.as_flattened().iter().map(of_vertex).fold(Bounds::EMPTY, Bounds::union))
            .reduce(|| Bounds::EMPTY, Bounds::union);
        *bounds = bounds.union(exact);
    }
}
