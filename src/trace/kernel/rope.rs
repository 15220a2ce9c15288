//! Stackless two-level traversal along escape indices, in depth-first order (paper, section 3). Twin of
//! `shaders/shared/rope.wgsl`.
//!
//! A node's escape index is the next node to visit when its box is missed or its leaf is done. At a TLAS leaf the ray
//! is transformed into the instance's space, but not normalised, so that t means the same on both levels; the world ray
//! and the leaf's escape index stay in registers, and are restored at the end of the BLAS.

use glam::Vec3;

use super::KernelScene;
use super::intersect::{intersects_box, max_component, shear_ray};
use super::math::max;
use super::traversal_state::{LeafTraversal, TraversalCounter, TraversalRay, tlas_root};
use crate::device::layout::{NONE, PrimitiveRange, RayRecord};

pub(super) struct RopeTraversal<C> {
    ray: TraversalRay,
    /// Next node of the current level, relative to its first, or [`NONE`] at the end of the level.
    node_index: u32,
    /// TLAS node to continue at after the current instance.
    tlas_resume_index: u32,
    first_node: u32,
    pub(super) counter: C,
}

impl<C: TraversalCounter> RopeTraversal<C> {
    pub(super) fn new(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> Self {
        Self {
            ray: TraversalRay::new(ray, ray_mask),
            node_index: tlas_root(scene.tlas_nodes),
            tlas_resume_index: NONE,
            first_node: 0,
            counter: C::default(),
        }
    }

    fn enter_instance(&mut self, scene: &KernelScene<'_>, index: u32) {
        // Transform the ray, unless the instance is hidden by its mask.
        let Some((instance, origin, direction)) = self.ray.enter_instance(scene, index) else { return };
        self.counter.instance();
        self.counter.read(instance);
        // Save where the TLAS continues, and start at the BLAS root.
        self.first_node = instance.first_node;
        self.tlas_resume_index = self.node_index;
        self.node_index = 0;
        // Prepare the triangle test.
        let root = &scene.blas_nodes[self.first_node as usize];
        let root_extent = max(max_abs(root.min), max_abs(root.max));
        self.ray.local_shear = shear_ray(&self.ray.level_ray, direction, max(root_extent, max_component(origin.abs())));
    }
}

impl<C: TraversalCounter> LeafTraversal for RopeTraversal<C> {
    #[inline]
    fn next_leaf(&mut self, scene: &KernelScene<'_>, t_max: f32) -> Option<PrimitiveRange> {
        loop {
            // End of the level: return to the TLAS, or finish.
            let in_instance = self.ray.instance != NONE;
            if self.node_index == NONE {
                if !in_instance {
                    return None;
                }
                self.ray.leave_instance();
                self.node_index = self.tlas_resume_index;
                continue;
            }
            // Fetch the node of the current level.
            let node = if in_instance {
                &scene.blas_nodes[(self.first_node + self.node_index) as usize]
            } else {
                &scene.tlas_nodes[self.node_index as usize]
            };
            self.counter.node();
            self.counter.read(node);
            self.counter.boxes(1);
            // Miss: follow the escape index. Inner node: its first child follows. Leaf: continue behind it.
            if !intersects_box(&self.ray.level_ray, self.ray.t_min, t_max, node) {
                self.node_index = node.escape_index;
            } else if !node.is_leaf() {
                self.node_index += 1;
            } else {
                self.node_index = node.escape_index;
                // Return the triangles of a BLAS leaf; enter the instance of a TLAS leaf.
                if in_instance {
                    return Some(node.primitives);
                }
                self.enter_instance(scene, node.primitives.first_primitive());
            }
        }
    }

    fn ray(&self) -> &TraversalRay {
        &self.ray
    }

    fn count_triangles(&mut self, count: u32) {
        self.counter.triangles(count);
    }
}

fn max_abs(v: [f32; 3]) -> f32 {
    max_component(Vec3::from_array(v).abs())
}
