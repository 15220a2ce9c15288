//! What the ways through the two levels have in common. They are `rope` and `wide`; the queries of `traverse` do not know which.

use glam::Vec3;

use super::KernelScene;
use super::intersect::{ShearRay, SlabRay, slab_ray};
use super::math::{transform_point, transform_vector};
use crate::device::layout::{InstanceRecord, NONE, Node, PrimitiveRange, RayRecord};
use crate::trace::TraversalCounts;

/// A way through the two levels, from leaf of triangles to leaf of triangles.
pub(super) trait LeafTraversal {
    /// Goes on to the next leaf of triangles whose box the ray meets up to `t_max`.
    fn next_leaf(&mut self, scene: &KernelScene<'_>, t_max: f32) -> Option<PrimitiveRange>;

    /// Where the ray is.
    fn ray(&self) -> &TraversalRay;

    /// Notes that triangles are tested.
    fn count_triangles(&mut self, count: u32);
}

/// The ray and the instance that it is in.
pub(crate) struct TraversalRay {
    /// The ray in world space.
    pub world_ray: SlabRay,
    /// The ray in the space of the level that it is in.
    pub level_ray: SlabRay,
    /// The ray in the space of the instance that it is in, if any.
    pub local_shear: ShearRay,
    pub direction: Vec3,
    pub t_min: f32,
    pub ray_mask: u32,
    /// [`NONE`] in the top level.
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

    /// Enters an instance, and returns the ray's origin and direction in its space. `None` where its mask hides it.
    pub(crate) fn enter_instance<'a>(
        &mut self,
        scene: &KernelScene<'a>,
        index: u32,
    ) -> Option<(&'a InstanceRecord, Vec3, Vec3)> {
        let instance = &scene.instances[index as usize];
        if instance.mask & self.ray_mask == 0 {
            return None;
        }
        let origin = transform_point(&instance.local_from_world, self.world_ray.origin);
        let direction = transform_vector(&instance.local_from_world, self.direction);
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

/// The first node of the top level, or [`NONE`]: a hierarchy of nothing is absent or zero, and no escape index leads back to
/// node 0.
pub(super) fn tlas_root(tlas_nodes: &[Node]) -> u32 {
    let is_empty = tlas_nodes.first().is_none_or(Node::is_empty_root);
    if is_empty { NONE } else { 0 }
}

/// Keeps count of what is read, or, as `()`, does not.
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
