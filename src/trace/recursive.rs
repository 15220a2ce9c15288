//! The `recursive` executor: trees of pointers, walked by recursion, one ray after the other (the paper's "CPU").

use std::collections::HashMap;

use glam::Vec3;

use super::kernel::math::{transform_point, transform_vector};
use super::kernel::{
    Counter, KernelScene, SlabRay, Traverse, camera_ray, cross_triangle, max_component, meets_box, render_pixel,
    shear_ray, slab_ray,
};
use super::planes::Planes;
use super::queries::{Any, Candidate, Closest, Query, Transmittance};
use super::{Counts, DeviceInfo, FrameRequest, Tracer};
use crate::Result;
use crate::device::DeviceArrays;
use crate::device::layout::{Hit, Node, PrimitiveRange, Ray, Triangle};
use crate::image::Image;

/// What most ray tracers are: nodes on the heap that point to their children, in a fixed order. A baseline to compare with, and a second
/// opinion on what the others find; nothing to draw with. [`upload`](Tracer::upload) makes all trees anew whenever a hierarchy
/// has changed.
#[derive(Debug)]
pub struct Recursive {
    device: DeviceInfo,
    /// None before the first upload.
    trees: Option<Trees>,
    frame: Planes,
}

/// The hierarchies of both levels.
#[derive(Debug, Default)]
struct Trees {
    /// Its leaves hold instances.
    top: Option<Branch>,
    /// By the instances' `first_node`.
    bottom: HashMap<u32, Branch>,
}

#[derive(Debug)]
struct Branch {
    node: Node,
    /// None for a leaf.
    #[expect(clippy::vec_box, reason = "pointers are the point")]
    children: Vec<Box<Branch>>,
    /// Of a leaf of a bottom level.
    triangles: Box<[Triangle]>,
}

impl Recursive {
    /// What [`closest_hits`](Tracer::closest_hits) reads and tests. The arrays must have been uploaded.
    pub fn count_closest_hits(&self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Counts {
        self.count::<Closest>(arrays, rays, ray_mask)
    }

    /// What [`any_hits`](Tracer::any_hits) reads and tests. The arrays must have been uploaded.
    pub fn count_any_hits(&self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Counts {
        self.count::<Any>(arrays, rays, ray_mask)
    }

    fn count<Q: Query>(&self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Counts {
        let scene = KernelScene::new(arrays);
        let tracer = Rays { scene: &scene, trees: self.trees.as_ref() };
        let mut counts = Counts::default();
        for ray in rays {
            tracer.ask_counted::<Q, _>(ray, ray_mask, &mut counts);
        }
        counts
    }
}

impl Default for Recursive {
    fn default() -> Self {
        let device = DeviceInfo { executor: "recursive", name: "1 thread".to_owned() };
        Self { device, trees: None, frame: Planes::default() }
    }
}

impl Tracer for Recursive {
    fn device(&self) -> &DeviceInfo {
        &self.device
    }

    fn upload(&mut self, arrays: &mut DeviceArrays) -> Result<u64> {
        let changed = [
            !arrays.tlas_nodes.take_dirty().is_empty(),
            !arrays.blas_nodes.take_dirty().is_empty(),
            !arrays.triangles.take_dirty().is_empty(),
        ];
        // An array that became shorter has nothing dirty.
        if changed.contains(&true) || arrays.tlas_nodes.is_empty() || self.trees.is_none() {
            self.trees = Some(Trees::new(arrays));
        }
        arrays.forget_dirty();
        Ok(0)
    }

    fn render(&mut self, arrays: &DeviceArrays, request: &FrameRequest) -> Result<()> {
        let scene = KernelScene::new(arrays);
        let mut rays = Rays { scene: &scene, trees: self.trees.as_ref() };
        let params = &request.params;
        let mut frame = Planes::new(params.width, params.height, request.aovs)?;
        for y in 0..params.height {
            for x in 0..params.width {
                let primary = camera_ray(params, x, y);
                frame.push(&render_pixel(&mut rays, params, &primary));
            }
        }
        self.frame = frame;
        Ok(())
    }

    fn read(&self) -> Result<Image> {
        Ok(self.frame.clone().into_image())
    }

    fn closest_hits(&mut self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Result<Vec<Hit>> {
        let scene = KernelScene::new(arrays);
        let tracer = Rays { scene: &scene, trees: self.trees.as_ref() };
        Ok(rays.iter().map(|ray| tracer.ask::<Closest>(ray, ray_mask).0).collect())
    }

    fn any_hits(&mut self, arrays: &DeviceArrays, rays: &[Ray], ray_mask: u32) -> Result<Vec<bool>> {
        let scene = KernelScene::new(arrays);
        let tracer = Rays { scene: &scene, trees: self.trees.as_ref() };
        Ok(rays.iter().map(|ray| tracer.ask::<Any>(ray, ray_mask).is_hit).collect())
    }
}

impl Trees {
    fn new(arrays: &DeviceArrays) -> Self {
        let is_empty = arrays.tlas_nodes.first().is_none_or(|node| node.escape_index == 0);
        if is_empty {
            return Self::default();
        }
        let top = branch(&arrays.tlas_nodes, 0, &|_| Box::default());
        let mut bottom = HashMap::new();
        for leaf in arrays.tlas_nodes.iter().filter(|node| node.primitives != PrimitiveRange::INNER) {
            let instance = &arrays.instances[leaf.primitives.first() as usize];
            bottom.entry(instance.first_node).or_insert_with(|| {
                let triangles = &arrays.triangles[instance.first_triangle as usize..];
                let of = |leaf: PrimitiveRange| triangles[leaf.first() as usize..][..leaf.count() as usize].into();
                branch(&arrays.blas_nodes[instance.first_node as usize..], 0, &of)
            });
        }
        Self { top: Some(top), bottom }
    }
}

/// The tree that stands in depth-first order from a node on. Recursion is as deep as the tree: builders bound that.
fn branch(nodes: &[Node], index: usize, triangles: &impl Fn(PrimitiveRange) -> Box<[Triangle]>) -> Branch {
    let node = nodes[index];
    if node.primitives != PrimitiveRange::INNER {
        return Branch { node, children: Vec::new(), triangles: triangles(node.primitives) };
    }
    let mut children = Vec::new();
    let mut child = index as u32 + 1;
    while child != node.escape_index && (child as usize) < nodes.len() {
        let next = nodes[child as usize].escape_index;
        if !nodes[child as usize].is_unused() {
            children.push(Box::new(branch(nodes, child as usize, triangles)));
        }
        child = next;
    }
    Branch { node, children, triangles: Box::default() }
}

/// What traces rays.
struct Rays<'a> {
    scene: &'a KernelScene<'a>,
    trees: Option<&'a Trees>,
}

impl Rays<'_> {
    fn ask<Q: Query>(&self, ray: &Ray, ray_mask: u32) -> Q {
        self.ask_counted(ray, ray_mask, &mut ())
    }

    fn ask_counted<Q: Query, C: Counter>(&self, ray: &Ray, ray_mask: u32, counter: &mut C) -> Q {
        let mut query = Q::start(ray.t_max);
        let world = slab_ray(Vec3::from_array(ray.origin), Vec3::from_array(ray.direction));
        if let Some(top) = self.trees.and_then(|trees| trees.top.as_ref()) {
            descend(top, &world, ray.t_min, ray.t_max, counter, &mut |leaf, counter| {
                self.ask_instance(leaf.node.primitives.first(), ray, ray_mask, &mut query, counter);
                query.t_max()
            });
        }
        query.finish();
        query
    }

    fn ask_instance<Q: Query, C: Counter>(&self, index: u32, ray: &Ray, ray_mask: u32, query: &mut Q, counter: &mut C) {
        let instance = &self.scene.instances[index as usize];
        let Some(root) = self.trees.and_then(|trees| trees.bottom.get(&instance.first_node)) else { return };
        if instance.mask & ray_mask == 0 {
            return;
        }
        counter.instance();
        counter.read(instance);
        let origin = transform_point(&instance.local_from_world, Vec3::from_array(ray.origin));
        let direction = transform_vector(&instance.local_from_world, Vec3::from_array(ray.direction));
        let [min, max] = [root.node.min, root.node.max].map(|corner| Vec3::from_array(corner).abs());
        let shear = shear_ray(origin, direction, max_component(min.max(max).max(origin.abs())));
        let slab = slab_ray(origin, direction);
        descend(root, &slab, ray.t_min, query.t_max(), counter, &mut |leaf, counter| {
            counter.triangles(leaf.node.primitives.count());
            let first = instance.first_triangle + leaf.node.primitives.first();
            for (triangle, corners) in (first..).zip(&leaf.triangles) {
                let Some(crossing) = cross_triangle(&shear, corners) else { continue };
                if crossing.t >= ray.t_min && crossing.t <= query.t_max() {
                    let (t, u, v) = (crossing.t, crossing.u, crossing.v);
                    query.cross(self.scene, index, instance, &Candidate { t, u, v, back: crossing.back, triangle });
                }
            }
            query.t_max()
        });
    }
}

/// Shows the leaves whose boxes the ray meets no farther than `t_max`, which `visit` returns anew. Recursion is as deep as the
/// tree.
fn descend<C: Counter>(
    branch: &Branch,
    ray: &SlabRay,
    t_min: f32,
    mut t_max: f32,
    counter: &mut C,
    visit: &mut dyn FnMut(&Branch, &mut C) -> f32,
) -> f32 {
    counter.node();
    counter.read(&branch.node);
    counter.boxes(1);
    if !meets_box(ray, t_min, t_max, &branch.node) {
        return t_max;
    }
    if branch.node.primitives != PrimitiveRange::INNER {
        return visit(branch, counter);
    }
    for child in &branch.children {
        t_max = descend(child, ray, t_min, t_max, counter, visit);
    }
    t_max
}

impl<'a> Traverse<'a> for Rays<'a> {
    fn scene(&self) -> &'a KernelScene<'a> {
        self.scene
    }

    fn closest_hit(&mut self, ray: &Ray, ray_mask: u32) -> Hit {
        self.ask::<Closest>(ray, ray_mask).0
    }

    fn transmittance(&mut self, ray: &Ray, ray_mask: u32) -> Vec3 {
        self.ask::<Transmittance>(ray, ray_mask).light(self.scene, ray, ray_mask)
    }
}
