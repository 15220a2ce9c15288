//! Both levels along escape indices, in one fixed order, without a stack (paper, section 3). Twin of
//! `shaders/shared/rope.wgsl`.
//!
//! An escape index says where to go on when a box is missed or a leaf done. At a leaf of the top level the ray is transformed
//! into the instance's space, but not normalised, so that t means the same on both levels; the world ray and the leaf's
//! escape index stay in registers, and are restored at the end of the bottom level.

use glam::Vec3;

use super::KernelScene;
use super::intersect::{intersects_box, max_component, shear_ray};
use super::math::max;
use super::traversal_state::{LeafTraversal, TraversalCounter, TraversalRay, tlas_root};
use crate::device::layout::{NONE, PrimitiveRange, RayRecord};

pub(super) struct RopeTraversal<C> {
    place: TraversalRay,
    /// Next node of the level, relative to its first, or [`NONE`] at its end.
    node_index: u32,
    /// Where to go on in the top level after the instance.
    tlas_resume_index: u32,
    first_node: u32,
    pub(super) counter: C,
}

impl<C: TraversalCounter> RopeTraversal<C> {
    pub(super) fn new(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> Self {
        let index = tlas_root(scene.tlas_nodes);
        Self {
            place: TraversalRay::new(ray, ray_mask),
            node_index: index,
            tlas_resume_index: NONE,
            first_node: 0,
            counter: C::default(),
        }
    }

    fn enter_instance(&mut self, scene: &KernelScene<'_>, index: u32) {
        let Some((instance, origin, direction)) = self.place.enter_instance(scene, index) else { return };
        self.counter.instance();
        self.counter.read(instance);
        self.first_node = instance.first_node;
        self.tlas_resume_index = self.node_index;
        self.node_index = 0;
        let root = &scene.blas_nodes[self.first_node as usize];
        let corners = max(max_abs(root.min), max_abs(root.max));
        self.place.local_shear = shear_ray(origin, direction, max(corners, max_component(origin.abs())));
    }
}

impl<C: TraversalCounter> LeafTraversal for RopeTraversal<C> {
    #[inline]
    fn next_leaf(&mut self, scene: &KernelScene<'_>, t_max: f32) -> Option<PrimitiveRange> {
        loop {
            let in_instance = self.place.instance != NONE;
            if self.node_index == NONE {
                if !in_instance {
                    return None;
                }
                self.place.leave_instance();
                self.node_index = self.tlas_resume_index;
                continue;
            }
            let node = if in_instance {
                &scene.blas_nodes[(self.first_node + self.node_index) as usize]
            } else {
                &scene.tlas_nodes[self.node_index as usize]
            };
            self.counter.node();
            self.counter.read(node);
            self.counter.boxes(1);
            if !intersects_box(&self.place.level_ray, self.place.t_min, t_max, node) {
                self.node_index = node.escape_index;
            } else if !node.is_leaf() {
                self.node_index += 1;
            } else {
                self.node_index = node.escape_index;
                if in_instance {
                    return Some(node.primitives);
                }
                self.enter_instance(scene, node.primitives.first_primitive());
            }
        }
    }

    fn ray(&self) -> &TraversalRay {
        &self.place
    }

    fn count_triangles(&mut self, count: u32) {
        self.counter.triangles(count);
    }
}

fn max_abs(v: [f32; 3]) -> f32 {
    max_component(Vec3::from_array(v).abs())
}
