//! State and interface common to the rope and the wide traversal; the queries are generic over it.

use glam::Vec3;

use super::KernelScene;
use super::intersect::{ShearRay, SlabRay, slab_ray};
use super::math::{transform_point, transform_vector};
use crate::device::layout::{InstanceRecord, NONE, Node, PrimitiveRange, RayRecord};
use crate::trace::TraversalCounts;

/// A two-level traversal as an iterator over BLAS leaves.
pub(super) trait LeafTraversal {
    /// Advances to the next BLAS leaf whose box the ray intersects within [`t_min`, `t_max`]; `None` at the end.
    fn next_leaf(&mut self, scene: &KernelScene<'_>, t_max: f32) -> Option<PrimitiveRange>;

    /// The ray and its current instance.
    fn ray(&self) -> &TraversalRay;

    /// Adds `count` triangle tests to the counter.
    fn count_triangles(&mut self, count: u32);
}

/// The ray in world space and in the space of the level being traversed, with the current instance.
pub(crate) struct TraversalRay {
    /// Slab-test operands in world space.
    pub world_ray: SlabRay,
    /// Slab-test operands in the current space: world in the TLAS, local in an instance.
    pub level_ray: SlabRay,
    /// Triangle-test operands in the instance's local space; unset in the TLAS.
    pub local_shear: ShearRay,
    pub direction: Vec3,
    pub t_min: f32,
    pub ray_mask: u32,
    /// The current instance, or [`NONE`] in the TLAS.
    pub instance: u32,
    pub first_triangle: u32,
    pub flags: u32,
}

impl TraversalRay {
    pub(crate) fn new(ray: &RayRecord, ray_mask: u32) -> Self {
        let world = slab_ray(Vec3::from_array(ray.origin), Vec3::from_array(ray.direction));
        Self {
            world_ray: world,
            level_ray: world,
            local_shear: ShearRay::default(),
            direction: Vec3::from_array(ray.direction),
            t_min: ray.t_min,
            ray_mask,
            instance: NONE,
            first_triangle: 0,
            flags: 0,
        }
    }

    /// Enters an instance, and returns the ray's origin and direction in its space. `None` if the instance's mask and
    /// the ray mask share no bit.
    pub(crate) fn enter_instance<'a>(
        &mut self,
        scene: &KernelScene<'a>,
        index: u32,
    ) -> Option<(&'a InstanceRecord, Vec3, Vec3)> {
        // Skip an instance that the mask hides.
        let instance = &scene.instances[index as usize];
        if instance.mask & self.ray_mask == 0 {
            return None;
        }
        // Transform the ray to local space. Its direction is not normalised, so that t means the same in both spaces.
        let origin = transform_point(&instance.local_from_world, self.world_ray.origin);
        let direction = transform_vector(&instance.local_from_world, self.direction);
        // Remember the instance; boxes are tested in its space from here on.
        self.instance = index;
        self.first_triangle = instance.first_triangle;
        self.flags = instance.flags;
        self.level_ray = slab_ray(origin, direction);
        Some((instance, origin, direction))
    }

    pub(crate) fn leave_instance(&mut self) {
        self.level_ray = self.world_ray;
        self.instance = NONE;
    }
}

/// Index of the TLAS root, or [`NONE`] for an empty TLAS: no nodes, or a zeroed root (escape index 0, which no valid
/// node has).
pub(super) fn tlas_root(tlas_nodes: &[Node]) -> u32 {
    let is_empty = tlas_nodes.first().is_none_or(Node::is_empty_root);
    if is_empty { NONE } else { 0 }
}

/// Traversal statistics; the implementation for `()` compiles to nothing.
pub(crate) trait TraversalCounter: Default {
    /// An element was read.
    fn read<T>(&mut self, _: &T) {}
    /// Boxes were tested.
    fn boxes(&mut self, _: u32) {}
    /// A node was read.
    fn node(&mut self) {}
    /// An instance was entered.
    fn instance(&mut self) {}
    /// Triangles were read.
    fn triangles(&mut self, _: u32) {}
}

impl TraversalCounter for () {}

impl TraversalCounter for TraversalCounts {
    fn read<T>(&mut self, element: &T) {
        self.bytes += size_of_val(element) as u64;
    }

    fn boxes(&mut self, count: u32) {
        self.boxes += u64::from(count);
    }

    fn node(&mut self) {
        self.nodes += 1;
    }

    fn instance(&mut self) {
        self.instances += 1;
    }

    fn triangles(&mut self, count: u32) {
        self.triangles += u64::from(count);
        self.bytes += u64::from(count) * size_of::<crate::device::layout::Triangle>() as u64;
    }
}
