//! Questions about a scene that its acceleration structure answers: what a ray meets, what a box or a frustum overlaps, what is
//! nearest to a point.
//!
//! All walk the arrays that are traced, both levels along their escape indices, so none has a stack, and none looks at all
//! triangles. All are exact on triangles, in f64, relative to the render origin. What they see is the geometry as it is drawn,
//! which the device's f32 matrices put within 2^-22 of its distance to the render origin of where the scene has it.

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

/// Asks a scene, in world space. Never stale: the scene cannot be edited meanwhile.
///
/// Only what can be seen is found: nodes that are visible, chosen by their switches and levels of detail, with a mask that
/// shares a bit with that of the [queries](Self::with_ray_mask) and a matrix that can be inverted. Rays see what camera rays see;
/// the other queries see both sides of every triangle, and no holes.
///
/// ```
/// use ropewalk::glam::{DVec3, Vec3};
/// use ropewalk::{Bounds, Core, DeviceChoice, Geometry, Material, Renderer, RendererOptions, Scene, Transform};
/// use ropewalk::query::{Overlap, Ray, Region};
///
/// // A triangle at z = -5.
/// let mut scene = Scene::new();
/// let geometry = scene.add_geometry(Geometry::new([Vec3::NEG_X, Vec3::X, Vec3::Y], [[0, 1, 2]]))?;
/// let material = scene.add_material(Material::default())?;
/// let place = scene.add(scene.root(), Transform::from_translation(DVec3::new(0.0, 0.0, -5.0)))?;
/// let triangle = scene.add(place, Core::Geometry { geometry, material })?;
///
/// let mut renderer = Renderer::new(&RendererOptions { device: DeviceChoice::Cpu })?;
/// let queries = renderer.queries(&mut scene)?;
///
/// let hit = queries.closest_hit(&Ray::new(DVec3::new(0.0, 0.5, 0.0), DVec3::NEG_Z))?.unwrap();
/// assert_eq!((hit.path.node, hit.triangle, hit.distance), (triangle, 0, 5.0));
/// assert_eq!((hit.position, hit.back), (DVec3::new(0.0, 0.5, -5.0), false));
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
    /// Catches up with the scene, then asks it. Costs what [`Compiler::compile_from_last_viewpoint`] costs: nothing where nothing changed.
    ///
    /// Levels of detail and billboards are what they are for who looked last; if nobody has, for an eye at the scene's centre.
    ///
    /// # Errors
    /// As [`Compiler::compile`].
    pub fn new(compiler: &'a mut Compiler, scene: &'a mut Scene) -> Result<Self> {
        compiler.compile_from_last_viewpoint(scene)?;
        Self::of_compiled_scene(compiler, scene)
    }

    /// Asks a scene that has just been compiled.
    pub(crate) fn of_compiled_scene(compiler: &'a Compiler, scene: &'a mut Scene) -> Result<Self> {
        let (scene, hierarchy) = scene.with_hierarchy()?;
        Ok(Self { scene, hierarchy, compiler, mask: u32::MAX, visited: AtomicU64::new(0) })
    }

    /// The scene that is asked: it can be read, but not edited, while it is.
    pub fn scene(&self) -> &'a Scene {
        self.scene
    }

    /// The same queries, for nodes only whose mask shares a bit with this one, the masks above them applied. At first all.
    #[must_use]
    pub fn with_ray_mask(self, mask: u32) -> Self {
        Self { mask, ..self }
    }

    /// The world box around all that can be found, a little larger for rounding. Empty where there is nothing. O(1).
    pub fn bounds(&self) -> Bounds {
        let Some(root) = self.compiler.arrays().tlas_nodes.first().filter(|root| !root.is_empty()) else {
            return Bounds::EMPTY;
        };
        let relative = Bounds::from(Aabb { min: root.min.into(), max: root.max.into() });
        Bounds { min: relative.min + self.compiler.origin(), max: relative.max + self.compiler.origin() }
    }

    /// How many nodes of both levels all queries so far have visited: what they cost, whatever the machine.
    pub fn visited_nodes(&self) -> u64 {
        self.visited.load(Ordering::Relaxed)
    }

    /// A point, relative to the render origin.
    fn relative(&self, point: DVec3) -> DVec3 {
        point - self.compiler.origin()
    }

    /// A way through the top level.
    fn traverse_tlas(&self) -> StacklessTraversal<'_> {
        StacklessTraversal::new(&self.compiler.arrays().tlas_nodes, &self.visited)
    }

    /// A way through the bottom level of an instance.
    fn traverse_blas(&self, placement: &PlacedInstance<'_>) -> StacklessTraversal<'_> {
        StacklessTraversal::new(
            &self.compiler.arrays().blas_nodes[placement.instance.first_node as usize..],
            &self.visited,
        )
    }

    /// The instance of a leaf of the top level, unless the mask hides it.
    fn instance(&self, leaf: &Node) -> Option<(u32, &InstanceRecord)> {
        let slot = leaf.primitives.first_primitive();
        let instance = &self.compiler.arrays().instances[slot as usize];
        (instance.mask & self.mask != 0).then_some((slot, instance))
    }

    /// As [`instance`](Self::instance), with its matrices.
    fn placement(&self, leaf: &Node) -> Option<PlacedInstance<'_>> {
        self.instance(leaf).map(|(slot, instance)| PlacedInstance::new(slot, instance))
    }

    /// The triangles of a leaf of a bottom level, with the index of the first.
    fn triangles(&self, placement: &PlacedInstance<'_>, range: PrimitiveRange) -> (u32, &[Triangle]) {
        let first = placement.instance.first_triangle + range.first_primitive();
        (first, &self.compiler.arrays().triangles[first as usize..][..range.primitive_count() as usize])
    }

    /// The nodes of these slots, in the order of the slots.
    fn paths(&self, mut slots: Vec<u32>) -> Vec<NodePath> {
        slots.sort_unstable();
        slots.into_iter().filter_map(|slot| Some(self.compiler.instance(slot, self.hierarchy)?.path)).collect()
    }
}

/// A corner in the arrays.
fn to_dvec3(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}
