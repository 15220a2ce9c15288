//! Ray, region and point queries on the CPU.
//!
//! They traverse the binary nodes of the device arrays, both levels by escape indices, without a stack. Triangles are
//! tested in f64, in the local space of each instance, by the matrices that the scene has: what is found depends on the
//! scene and the question alone, not on the render origin. What is left is the rounding of f64, 2^-52 of the distance
//! to the render origin. (Frames and batches use matrices that are rounded to f32 relative to the render origin, which
//! displaces what they show by up to 2^-22 of its distance to that.)

mod containment;
mod hit;
mod intersect;
mod nearest;
mod placed_instance;
mod ray;
mod region;
mod region_query;
mod stackless_traversal;

use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;

pub use hit::Hit;
pub use ray::Ray;
pub use region::{HalfSpace, Region};
pub use region_query::Overlap;

use placed_instance::PlacedInstance;
use stackless_traversal::StacklessTraversal;

use crate::Result;
use crate::compile::Compiler;
use crate::device::layout::{InstanceRecord, Node, PrimitiveRange, Triangle};
use crate::error::require;
use crate::graph::{Hierarchy, NodePath, Scene};
use crate::math::{Aabb, Bounds};

/// Queries on a compiled scene, in world space. It borrows the scene, so results are never out of date.
///
/// Only visible geometry is found: that of nodes which are visible, selected by switches and levels of detail, with a
/// mask that has a bit in common with that of the [queries](Self::with_ray_mask), and an invertible matrix. Triangles
/// without area are not found: [`Blas::build`](crate::accel::Blas::build) leaves them out. Ray queries apply the rules
/// of camera rays (back-face culling, alpha masks); other queries treat all triangles as two-sided and solid.
///
/// ```
/// use ropewalk::glam::{DVec3, Vec3};
/// use ropewalk::math::Bounds;
/// use ropewalk::{Core, DeviceChoice, Geometry, Material, Renderer, RendererOptions, Scene, Transform};
/// use ropewalk::query::{Overlap, Ray, Region};
///
/// // A triangle at z = -5.
/// let mut scene = Scene::new();
/// let geometry = scene.add_geometry(Geometry::new([Vec3::NEG_X, Vec3::X, Vec3::Y], [[0, 1, 2]]))?;
/// let material = scene.add_material(Material::default())?;
/// let place = scene.add(scene.root(), Transform::from_translation(DVec3::new(0.0, 0.0, -5.0)))?;
/// let triangle = scene.add(place, Core::Geometry { geometry, material })?;
///
/// let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu))?;
/// let queries = renderer.queries(&mut scene)?;
///
/// let hit = queries.closest_hit(&Ray::new(DVec3::new(0.0, 0.5, 0.0), DVec3::NEG_Z))?.unwrap();
/// assert_eq!((hit.path.node, hit.triangle, hit.distance), (triangle, 0, 5.0));
/// assert_eq!((hit.position, hit.back_face), (DVec3::new(0.0, 0.5, -5.0), false));
///
/// let above = Region::new_box(&Bounds { min: DVec3::new(-1.0, 0.5, -6.0), max: DVec3::new(1.0, 2.0, 0.0) })?;
/// assert_eq!(queries.overlapping(&above, Overlap::Touching).len(), 1);
/// assert_eq!(queries.overlapping(&above, Overlap::Inside).len(), 0);
///
/// let nearest = queries.nearest(DVec3::new(0.0, 3.0, -5.0), f64::INFINITY)?.unwrap();
/// assert_eq!((nearest.distance, nearest.position), (2.0, DVec3::new(0.0, 1.0, -5.0)));
/// # Ok::<(), ropewalk::Error>(())
/// ```
#[derive(Debug)]
pub struct Queries<'a> {
    scene: &'a Scene,
    hierarchy: &'a Hierarchy,
    compiler: &'a Compiler,
    mask: u32,
    visited: AtomicU64,
}

impl<'a> Queries<'a> {
    /// Compiles the scene if needed. Costs what [`Compiler::compile_from_last_viewpoint`] costs: O(1) for an unchanged
    /// scene.
    ///
    /// Levels of detail and billboards are evaluated for the last viewpoint compiled for, or for the scene's centre if
    /// there is none.
    ///
    /// # Errors
    /// As [`Compiler::compile`].
    pub fn new(compiler: &'a mut Compiler, scene: &'a mut Scene) -> Result<Self> {
        compiler.compile_from_last_viewpoint(scene)?;
        Self::of_compiled_scene(compiler, scene)
    }

    /// Queries on a scene that has just been compiled.
    pub(crate) fn of_compiled_scene(compiler: &'a Compiler, scene: &'a mut Scene) -> Result<Self> {
        let (scene, hierarchy) = scene.with_hierarchy()?;
        Ok(Self { scene, hierarchy, compiler, mask: u32::MAX, visited: AtomicU64::new(0) })
    }

    /// The scene, which can be read, but not edited, while the queries exist.
    pub fn scene(&self) -> &'a Scene {
        self.scene
    }

    /// Restricts the queries to nodes whose inherited mask has a bit in common with `mask` (default: all bits).
    #[must_use]
    pub fn with_ray_mask(self, mask: u32) -> Self {
        Self { mask, ..self }
    }

    /// World bounds of the compiled scene, slightly enlarged for rounding; empty for a scene without geometry. O(1).
    pub fn bounds(&self) -> Bounds {
        let Some(root) = self.compiler.arrays().tlas_nodes.first().filter(|root| !root.is_empty()) else {
            return Bounds::EMPTY;
        };
        let relative = Bounds::from(Aabb { min: root.min.into(), max: root.max.into() });
        Bounds { min: relative.min + self.compiler.origin(), max: relative.max + self.compiler.origin() }
    }

    /// The number of nodes of both levels that all queries so far have visited: a machine-independent measure of cost.
    pub fn visited_nodes(&self) -> u64 {
        self.visited.load(Ordering::Relaxed)
    }

    /// A world position relative to the render origin.
    fn relative(&self, point: DVec3) -> DVec3 {
        point - self.compiler.origin()
    }

    /// A traversal of the TLAS.
    fn traverse_tlas(&self) -> StacklessTraversal<'_> {
        StacklessTraversal::new(&self.compiler.arrays().tlas_nodes, &self.visited)
    }

    /// A traversal of the instance's BLAS.
    fn traverse_blas(&self, placement: &PlacedInstance<'_>) -> StacklessTraversal<'_> {
        StacklessTraversal::new(
            &self.compiler.arrays().blas_nodes[placement.instance.first_node as usize..],
            &self.visited,
        )
    }

    /// The instance of a leaf of the TLAS, with its index, unless the mask excludes it.
    fn instance(&self, leaf: &Node) -> Option<(u32, &InstanceRecord)> {
        let instance_index = leaf.primitives.first_primitive();
        let instance = &self.compiler.arrays().instances[instance_index as usize];
        (instance.mask & self.mask != 0).then_some((instance_index, instance))
    }

    /// As [`instance`](Self::instance), with its matrices.
    fn placement(&self, leaf: &Node) -> Option<PlacedInstance<'_>> {
        self.instance(leaf).and_then(|(instance_index, instance)| self.placed(instance_index, instance))
    }

    /// An instance with its matrices.
    fn placed<'b>(&self, instance_index: u32, instance: &'b InstanceRecord) -> Option<PlacedInstance<'b>> {
        let world_from_local = self.compiler.world_from_local(instance_index, self.hierarchy)?;
        Some(PlacedInstance::new(instance_index, instance, world_from_local))
    }

    /// The triangles of a leaf of a BLAS, with the index of the first.
    fn triangles(&self, placement: &PlacedInstance<'_>, range: PrimitiveRange) -> (u32, &[Triangle]) {
        let first = placement.instance.first_triangle + range.first_primitive();
        (first, &self.compiler.arrays().triangles[first as usize..][..range.primitive_count() as usize])
    }

    /// The paths of the nodes of these instances and of those that coincide with them, by ascending index.
    fn paths(&self, instances: Vec<u32>) -> Vec<NodePath> {
        let mut instances: Vec<u32> =
            instances.into_iter().flat_map(|index| self.compiler.coincident_instances(index)).collect();
        instances.sort_unstable();
        let source = |index| self.compiler.instance_source(index, self.hierarchy);
        instances.into_iter().filter_map(|index| Some(source(index)?.path)).collect()
    }
}

/// Widens a position in the device arrays to f64.
fn to_dvec3(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}
