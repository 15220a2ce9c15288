//! The `recursive` executor: BVHs of heap-allocated nodes, traversed recursively, one ray at a time (the paper's
//! "CPU").

use std::collections::HashMap;

use glam::Vec3;

use super::frame_buffer::FrameBuffer;
use super::kernel::{
    AnyQuery, ClosestQuery, Continuation, KernelScene, Query, RayQueries, SlabRay, TransmittanceQuery,
    TraversalCounter, TraversalRay, camera_ray, intersect_leaf, intersects_box, max_component, render_pixel, shear_ray,
};
use super::{DeviceInfo, FrameRequest, Tracer, TraversalCounts, trace_rays};
use crate::device::DeviceArrays;
use crate::device::layout::{HitRecord, Node, PrimitiveRange, RayRecord, Triangle};
use crate::image::Image;
use crate::{Cancel, Result};

/// A textbook recursive BVH traversal: heap nodes with child pointers, children visited in storage order. It is a
/// baseline for benchmarks and an independent check of the other executors' traversals (the triangle test and the hit
/// rules are theirs); too slow for rendering. [`upload`](Tracer::upload) rebuilds all trees from the device arrays
/// whenever TLAS nodes, BLAS nodes or triangles have changed.
#[derive(Debug)]
pub struct Recursive {
    device: DeviceInfo,
    /// `None` before the first upload.
    trees: Option<PointerTrees>,
    frame: FrameBuffer,
    cancel: Cancel,
}

/// The pointer trees of both levels.
#[derive(Debug, Default)]
struct PointerTrees {
    /// The TLAS; its leaves refer to instances. `None` for an empty one.
    tlas: Option<TreeNode>,
    /// The BLASes, by the instances' `first_node`.
    blas_by_first_node: HashMap<u32, TreeNode>,
}

#[derive(Debug)]
struct TreeNode {
    node: Node,
    /// Empty for a leaf.
    #[expect(clippy::vec_box, reason = "this executor measures pointer chasing, so each child is its own allocation")]
    children: Vec<Box<TreeNode>>,
    /// The triangles of a BLAS leaf; empty for TLAS nodes and inner nodes.
    triangles: Box<[Triangle]>,
}

impl Recursive {
    /// The traversal cost of [`closest_hits`](Tracer::closest_hits) for these rays. The arrays must have been uploaded.
    pub fn count_closest_hits(&self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> TraversalCounts {
        self.count(arrays, rays, ray_mask, ClosestQuery::new)
    }

    /// The traversal cost of [`any_hits`](Tracer::any_hits) for these rays. The arrays must have been uploaded.
    pub fn count_any_hits(&self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> TraversalCounts {
        self.count(arrays, rays, ray_mask, AnyQuery::new)
    }

    /// Traversal cost of one query per ray; `query` makes its state from `t_max`.
    fn count<Q: Query>(
        &self,
        arrays: &DeviceArrays,
        rays: &[RayRecord],
        ray_mask: u32,
        query: fn(f32) -> Q,
    ) -> TraversalCounts {
        let scene = KernelScene::new(arrays);
        let tracer = TreeQueries { scene: &scene, trees: self.trees.as_ref() };
        let mut counts = TraversalCounts::default();
        for ray in rays {
            tracer.run_query(ray, ray_mask, query(ray.t_max), &mut counts);
        }
        counts
    }
}

impl Default for Recursive {
    fn default() -> Self {
        let device = DeviceInfo { executor: "recursive", name: "1 thread".to_owned() };
        Self { device, trees: None, frame: FrameBuffer::default(), cancel: Cancel::default() }
    }
}

impl Tracer for Recursive {
    fn device(&self) -> &DeviceInfo {
        &self.device
    }

    fn set_cancel(&mut self, cancel: Option<Cancel>) {
        self.cancel = cancel.unwrap_or_default();
    }

    fn upload(&mut self, arrays: &mut DeviceArrays) -> Result<u64> {
        let changed = [
            !arrays.tlas_nodes.take_dirty().is_empty(),
            !arrays.blas_nodes.take_dirty().is_empty(),
            !arrays.triangles.take_dirty().is_empty(),
        ];
        // An array that became shorter has nothing dirty.
        if changed.contains(&true) || arrays.tlas_nodes.is_empty() || self.trees.is_none() {
            self.trees = Some(PointerTrees::new(arrays));
        }
        arrays.clear_dirty();
        Ok(0)
    }

    fn render(&mut self, arrays: &DeviceArrays, request: &FrameRequest) -> Result<()> {
        let scene = KernelScene::new(arrays);
        let mut rays = TreeQueries { scene: &scene, trees: self.trees.as_ref() };
        let params = &request.params;
        self.frame = FrameBuffer::default();
        let mut frame = FrameBuffer::new(params.width, params.height, request.aovs)?;
        for y in 0..params.height {
            self.cancel.check()?;
            for x in 0..params.width {
                let primary = camera_ray(params, x, y);
                frame.push(&render_pixel(&mut rays, params, &primary));
            }
        }
        self.frame = frame;
        Ok(())
    }

    fn limited_pixels(&self) -> Result<u64> {
        Ok(self.frame.limited_pixels)
    }

    fn read_image(&self) -> Result<Image> {
        Ok(self.frame.clone().into_image())
    }

    fn closest_hits(&mut self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<HitRecord>> {
        let scene = KernelScene::new(arrays);
        let tracer = TreeQueries { scene: &scene, trees: self.trees.as_ref() };
        trace_rays(rays, &self.cancel, |ray| tracer.next_hit(ray, Continuation::START, ray_mask))
    }

    fn any_hits(&mut self, arrays: &DeviceArrays, rays: &[RayRecord], ray_mask: u32) -> Result<Vec<bool>> {
        let scene = KernelScene::new(arrays);
        let tracer = TreeQueries { scene: &scene, trees: self.trees.as_ref() };
        trace_rays(rays, &self.cancel, |ray| tracer.any_hit(ray, ray_mask))
    }
}

impl PointerTrees {
    fn new(arrays: &DeviceArrays) -> Self {
        let is_empty = arrays.tlas_nodes.first().is_none_or(Node::is_empty_root);
        if is_empty {
            return Self::default();
        }
        // Copy the TLAS.
        let tlas = build_subtree(&arrays.tlas_nodes, 0, &|_| Box::default());
        // Copy each BLAS once.
        let mut blas_by_first_node = HashMap::new();
        for leaf in arrays.tlas_nodes.iter().filter(|node| node.is_leaf()) {
            let instance = &arrays.instances[leaf.primitives.first_primitive() as usize];
            blas_by_first_node.entry(instance.first_node).or_insert_with(|| {
                let triangles = &arrays.triangles[instance.first_triangle as usize..];
                let of = |leaf: PrimitiveRange| {
                    triangles[leaf.first_primitive() as usize..][..leaf.primitive_count() as usize].into()
                };
                build_subtree(&arrays.blas_nodes[instance.first_node as usize..], 0, &of)
            });
        }
        Self { tlas: Some(tlas), blas_by_first_node }
    }
}

/// Builds the pointer tree of the subtree whose root is `nodes[index]`. Recursion is as deep as the tree: builders
/// bound that.
fn build_subtree(nodes: &[Node], index: usize, triangles: &impl Fn(PrimitiveRange) -> Box<[Triangle]>) -> TreeNode {
    let node = nodes[index];
    // Leaf.
    if node.is_leaf() {
        return TreeNode { node, children: Vec::new(), triangles: triangles(node.primitives) };
    }
    // Children along escape indices, without empty ones.
    let mut children = Vec::new();
    let mut child = index as u32 + 1;
    while child != node.escape_index && (child as usize) < nodes.len() {
        let next = nodes[child as usize].escape_index;
        if !nodes[child as usize].is_empty() {
            children.push(Box::new(build_subtree(nodes, child as usize, triangles)));
        }
        child = next;
    }
    TreeNode { node, children, triangles: Box::default() }
}

/// Queries over the pointer trees of one scene.
struct TreeQueries<'a> {
    scene: &'a KernelScene<'a>,
    trees: Option<&'a PointerTrees>,
}

impl TreeQueries<'_> {
    fn next_hit(&self, ray: &RayRecord, start: Continuation, ray_mask: u32) -> HitRecord {
        self.run_query(ray, ray_mask, ClosestQuery::behind(ray.t_max, start), &mut ()).hit
    }

    fn any_hit(&self, ray: &RayRecord, ray_mask: u32) -> bool {
        self.run_query(ray, ray_mask, AnyQuery::new(ray.t_max), &mut ()).is_hit
    }

    fn transmittance(&self, ray: &RayRecord, ray_mask: u32) -> Vec3 {
        let query = self.run_query(ray, ray_mask, TransmittanceQuery::new(ray.t_max), &mut ());
        query.with_layers(self.scene, ray, ray_mask)
    }

    /// Offers the hits in all leaves that a ray enters to a query; returns its final state.
    fn run_query<Q: Query, C: TraversalCounter>(
        &self,
        ray: &RayRecord,
        ray_mask: u32,
        mut query: Q,
        counter: &mut C,
    ) -> Q {
        let mut ray = TraversalRay::new(ray, ray_mask);
        if let Some(tlas) = self.trees.and_then(|trees| trees.tlas.as_ref()) {
            let (world_ray, t_min) = (ray.world_ray, ray.t_min);
            traverse(tlas, &world_ray, t_min, query.t_max(), counter, &mut |leaf, counter| {
                let instance = leaf.node.primitives.first_primitive();
                self.intersect_instance(instance, &mut ray, &mut query, counter);
                query.t_max()
            });
        }
        query
    }

    fn intersect_instance<C: TraversalCounter>(
        &self,
        index: u32,
        ray: &mut TraversalRay,
        query: &mut impl Query,
        counter: &mut C,
    ) {
        let first_node = self.scene.instances[index as usize].first_node;
        let Some(root) = self.trees.and_then(|trees| trees.blas_by_first_node.get(&first_node)) else { return };
        // Hidden by the ray mask?
        let Some((instance, origin, direction)) = ray.enter_instance(self.scene, index) else { return };
        counter.instance();
        counter.read(instance);
        // Prepare the triangle test.
        let [min, max] = [root.node.min, root.node.max].map(|corner| Vec3::from_array(corner).abs());
        ray.local_shear = shear_ray(&ray.level_ray, direction, max_component(min.max(max).max(origin.abs())));
        // Descend, and test the triangles of each leaf.
        traverse(root, &ray.level_ray, ray.t_min, query.t_max(), counter, &mut |leaf, counter| {
            if !query.skips_instance(ray.flags) {
                counter.triangles(leaf.node.primitives.primitive_count());
                let first = ray.first_triangle + leaf.node.primitives.first_primitive();
                intersect_leaf(self.scene, ray, first, &leaf.triangles, query);
            }
            query.t_max()
        });
        ray.leave_instance();
    }
}

/// Calls `visit` for each leaf whose box the ray enters at or before `t_max`; `visit` returns the `t_max` for the rest
/// of the traversal. Recursion is as deep as the tree.
fn traverse<C: TraversalCounter>(
    tree_node: &TreeNode,
    ray: &SlabRay,
    t_min: f32,
    mut t_max: f32,
    counter: &mut C,
    visit: &mut dyn FnMut(&TreeNode, &mut C) -> f32,
) -> f32 {
    // Box test.
    counter.node();
    counter.read(&tree_node.node);
    counter.boxes(1);
    if !intersects_box(ray, t_min, t_max, &tree_node.node) {
        return t_max;
    }
    // Leaf.
    if tree_node.node.is_leaf() {
        return visit(tree_node, counter);
    }
    // Children in storage order.
    for child in &tree_node.children {
        t_max = traverse(child, ray, t_min, t_max, counter, visit);
    }
    t_max
}

impl<'a> RayQueries<'a> for TreeQueries<'a> {
    fn scene(&self) -> &'a KernelScene<'a> {
        self.scene
    }

    fn next_hit(&mut self, ray: &RayRecord, start: Continuation, ray_mask: u32) -> HitRecord {
        TreeQueries::next_hit(self, ray, start, ray_mask)
    }

    fn transmittance(&mut self, ray: &RayRecord, ray_mask: u32) -> Vec3 {
        TreeQueries::transmittance(self, ray, ray_mask)
    }
}
