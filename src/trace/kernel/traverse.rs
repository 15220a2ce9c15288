//! The two-level traversal (paper, section 3) and its three queries. Twin of `shaders/shared/traverse.wgsl`.
//!
//! Both levels are walked by one loop without a stack: an escape index says where to go on when a box is missed or a
//! leaf done. At a leaf of the top level the ray is transformed into the instance's space, but not normalised, so that t
//! means the same on both levels; the world ray and the leaf's escape index stay in registers, and are restored at the
//! end of the bottom level.

use glam::Vec3;

use super::KernelScene;
use super::intersect::{Crossing, ShearRay, SlabRay, cross_triangle, max_component, meets_box, shear_ray, slab_ray};
use super::material::{is_hole, passes};
use super::math::{max, transform_point, transform_vector};
use crate::device::layout::{Hit, Instance, InstanceFlags, NONE, PrimitiveRange, Ray, Triangle};

/// Where a ray is on its way through the two levels.
struct Traversal {
    /// The ray in world space.
    world: SlabRay,
    /// The ray in the space of the level that it is in.
    level: SlabRay,
    /// The ray in the space of the instance that it is in, if any.
    shear: ShearRay,
    direction: Vec3,
    t_min: f32,
    ray_mask: u32,
    /// Next node of the level, relative to its first, or [`NONE`] at its end.
    index: u32,
    /// [`NONE`] in the top level.
    instance: u32,
    /// Where to go on in the top level after the instance.
    resume: u32,
    first_node: u32,
    first_triangle: u32,
    flags: u32,
}

impl Traversal {
    fn new(scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32) -> Self {
        let world = slab_ray(Vec3::from_array(ray.origin), Vec3::from_array(ray.direction));
        // A hierarchy of nothing is absent or zero, and no escape index leads back to node 0.
        let is_empty = scene.tlas_nodes.first().is_none_or(|node| node.escape_index == 0);
        Self {
            world,
            level: world,
            shear: ShearRay::default(),
            direction: Vec3::from_array(ray.direction),
            t_min: ray.t_min,
            ray_mask,
            index: if is_empty { NONE } else { 0 },
            instance: NONE,
            resume: NONE,
            first_node: 0,
            first_triangle: 0,
            flags: 0,
        }
    }

    /// Goes on to the next leaf of triangles whose box the ray meets up to `t_max`.
    #[inline]
    fn next_leaf(&mut self, scene: &KernelScene<'_>, t_max: f32) -> Option<PrimitiveRange> {
        loop {
            if self.index == NONE {
                if self.instance == NONE {
                    return None;
                }
                self.leave_instance();
                continue;
            }
            let in_instance = self.instance != NONE;
            let node = if in_instance {
                &scene.blas_nodes[(self.first_node + self.index) as usize]
            } else {
                &scene.tlas_nodes[self.index as usize]
            };
            if !meets_box(&self.level, self.t_min, t_max, node) {
                self.index = node.escape_index;
            } else if node.primitives == PrimitiveRange::INNER {
                self.index += 1;
            } else {
                self.index = node.escape_index;
                if in_instance {
                    return Some(node.primitives);
                }
                self.enter_instance(scene, node.primitives.first());
            }
        }
    }

    fn enter_instance(&mut self, scene: &KernelScene<'_>, index: u32) {
        let instance = &scene.instances[index as usize];
        if instance.mask & self.ray_mask == 0 {
            return;
        }
        let origin = transform_point(&instance.local_from_world, self.world.origin);
        let direction = transform_vector(&instance.local_from_world, self.direction);
        self.first_node = instance.first_node;
        self.first_triangle = instance.first_triangle;
        self.flags = instance.flags;
        self.resume = self.index;
        self.instance = index;
        self.index = 0;
        self.level = slab_ray(origin, direction);
        let root = &scene.blas_nodes[self.first_node as usize];
        let corners = max(max_abs(root.min), max_abs(root.max));
        self.shear = shear_ray(origin, direction, max(corners, max_component(origin.abs())));
    }

    fn leave_instance(&mut self) {
        self.level = self.world;
        self.index = self.resume;
        self.instance = NONE;
    }
}

fn max_abs(v: [f32; 3]) -> f32 {
    max_component(Vec3::from_array(v).abs())
}

/// The closest hit in `t_min..=t_max`; of hits at equal t the one of the lower instance, then the lower primitive.
pub(crate) fn closest_hit(scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32) -> Hit {
    let mut hit = Hit { t: ray.t_max, ..Hit::MISS };
    let mut traversal = Traversal::new(scene, ray, ray_mask);
    while let Some(leaf) = traversal.next_leaf(scene, hit.t) {
        let first = traversal.first_triangle + leaf.first();
        for (i, triangle) in (first..).zip(&scene.triangles[first as usize..][..leaf.count() as usize]) {
            let Some(crossing) = cross_triangle(&traversal.shear, triangle) else { continue };
            if crossing.t < ray.t_min || !is_closer(crossing.t, traversal.instance, triangle.primitive, &hit) {
                continue;
            }
            let flags = InstanceFlags::from_bits_retain(traversal.flags);
            if crossing.back && flags.contains(InstanceFlags::CULL_BACK) {
                continue;
            }
            if flags.contains(InstanceFlags::ALPHA_MASK) {
                let instance = &scene.instances[traversal.instance as usize];
                if is_hole(scene, instance, triangle, crossing.u, crossing.v) {
                    continue;
                }
            }
            hit = Hit {
                t: crossing.t,
                u: crossing.u,
                v: crossing.v,
                instance: traversal.instance,
                primitive: triangle.primitive,
                triangle: i,
                back: u32::from(crossing.back),
                _pad: 0,
            };
        }
    }
    if hit.instance == NONE { Hit::MISS } else { hit }
}

pub(crate) fn is_closer(t: f32, instance: u32, primitive: u32, hit: &Hit) -> bool {
    if t != hit.t {
        return t < hit.t;
    }
    (instance, primitive) < (hit.instance, hit.primitive)
}

/// How much light gets through between `t_min` and `t_max`.
pub(crate) fn transmittance(scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32) -> Vec3 {
    let mut light = Vec3::ONE;
    let mut traversal = Traversal::new(scene, ray, ray_mask);
    while let Some(leaf) = traversal.next_leaf(scene, ray.t_max) {
        let first = (traversal.first_triangle + leaf.first()) as usize;
        for triangle in &scene.triangles[first..][..leaf.count() as usize] {
            let Some(crossing) = cross_triangle(&traversal.shear, triangle) else { continue };
            if crossing.t >= ray.t_min && crossing.t <= ray.t_max {
                light *= passes_crossing(scene, &traversal, triangle, &crossing);
                if max_component(light) <= 0.0 {
                    return Vec3::ZERO;
                }
            }
        }
    }
    light
}

/// Whether anything that lets no light through lies between `t_min` and `t_max`.
pub(crate) fn any_hit(scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32) -> bool {
    let mut traversal = Traversal::new(scene, ray, ray_mask);
    while let Some(leaf) = traversal.next_leaf(scene, ray.t_max) {
        let first = (traversal.first_triangle + leaf.first()) as usize;
        for triangle in &scene.triangles[first..][..leaf.count() as usize] {
            let Some(crossing) = cross_triangle(&traversal.shear, triangle) else { continue };
            if crossing.t >= ray.t_min
                && crossing.t <= ray.t_max
                && max_component(passes_crossing(scene, &traversal, triangle, &crossing)) <= 0.0
            {
                return true;
            }
        }
    }
    false
}

fn passes_crossing(scene: &KernelScene<'_>, traversal: &Traversal, triangle: &Triangle, crossing: &Crossing) -> Vec3 {
    passes_at(scene, &scene.instances[traversal.instance as usize], triangle, crossing.u, crossing.v)
}

/// How much light a triangle lets through at a point.
pub(crate) fn passes_at(scene: &KernelScene<'_>, instance: &Instance, triangle: &Triangle, u: f32, v: f32) -> Vec3 {
    if !InstanceFlags::from_bits_retain(instance.flags).contains(InstanceFlags::TRANSLUCENT) {
        return Vec3::ZERO;
    }
    passes(scene, instance, triangle, u, v)
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;

    use super::*;
    use crate::device::DeviceArrays;
    use crate::device::layout::{Instance, Material, MaterialFlags, Node, Streams};

    /// Triangles one behind the other at z = 0, 1, 2, ..., in one leaf of one instance.
    fn layers(count: u32, material: Material, flags: InstanceFlags) -> DeviceArrays {
        let mut arrays = DeviceArrays::default();
        let (min, max) = ([-2.0, -2.0, -1.0], [4.0, 4.0, count as f32]);
        let node = |primitives| Node { min, escape_index: NONE, max, primitives };
        arrays.tlas_nodes.replace(&[node(PrimitiveRange::leaf(0, 1))]);
        arrays.blas_nodes.replace(&[node(PrimitiveRange::leaf(0, count))]);
        let at = |z: f32| {
            let [v0, v1, v2] = [[-1.0, -1.0, z], [3.0, -1.0, z], [-1.0, 3.0, z]];
            Triangle { v0, primitive: z as u32, v1, _pad0: 0, v2, _pad1: 0 }
        };
        arrays.triangles.replace(&(0..count).map(|i| at(i as f32)).collect::<Vec<_>>());
        let identity = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        let instance = Instance { mask: 2, flags: flags.bits(), ..Instance::zeroed() };
        arrays.instances.replace(&[Instance { local_from_world: identity, world_from_local: identity, ..instance }]);
        let none = Streams { first_index: NONE, first_normal: NONE, first_tex_coord_0: NONE, ..Streams::zeroed() };
        arrays.geometries.replace(&[Streams { first_tex_coord_1: NONE, first_color: NONE, ..none }]);
        arrays.materials.replace(&[material]);
        arrays
    }

    fn blended(alpha: f32) -> Material {
        let flags = MaterialFlags::BLEND.bits();
        let base_color_texture = NONE;
        Material { base_color: [1.0, 1.0, 1.0, alpha], flags, base_color_texture, ..Material::zeroed() }
    }

    fn ray(t_min: f32, t_max: f32) -> Ray {
        Ray { origin: [0.0, 0.0, -1.0], t_min, direction: [0.0, 0.0, 1.0], t_max }
    }

    #[test]
    fn each_layer_lets_its_part_through() {
        let arrays = layers(5, blended(0.5), InstanceFlags::TRANSLUCENT);
        let scene = KernelScene::new(&arrays);
        // From t = 1 on there is a layer at each whole number; both ends count.
        for (t_min, t_max, layers) in [(0.0, 0.9, 0), (0.0, 1.0, 1), (1.0, 1.0, 1), (0.0, 9.0, 5), (1.5, 4.0, 3)] {
            let part = 0.5f32.powi(layers);
            assert_eq!(transmittance(&scene, &ray(t_min, t_max), 2), Vec3::splat(part), "{t_min} to {t_max}");
            assert!(!any_hit(&scene, &ray(t_min, t_max), 2));
        }
        assert_eq!(transmittance(&scene, &ray(0.0, 9.0), 1), Vec3::ONE, "the mask hides them");
    }

    #[test]
    fn what_is_opaque_lets_nothing_through() {
        for (alpha, flags) in [(1.0, InstanceFlags::TRANSLUCENT), (0.5, InstanceFlags::empty())] {
            let arrays = layers(5, blended(alpha), flags);
            let scene = KernelScene::new(&arrays);
            assert_eq!(transmittance(&scene, &ray(0.0, 9.0), 2), Vec3::ZERO);
            assert!(any_hit(&scene, &ray(5.0, 5.0), 2));
            assert!(!any_hit(&scene, &ray(5.1, 9.0), 2));
            assert_eq!(transmittance(&scene, &ray(5.1, 9.0), 2), Vec3::ONE);
        }
    }

    #[test]
    fn nothing_is_hit_where_there_is_nothing() {
        let mut arrays = DeviceArrays::default();
        for nodes in [&[][..], &[Node::zeroed(); 3]] {
            arrays.tlas_nodes.replace(nodes);
            let scene = KernelScene::new(&arrays);
            assert_eq!(closest_hit(&scene, &ray(0.0, f32::MAX), 2), Hit::MISS);
            assert!(!any_hit(&scene, &ray(0.0, f32::MAX), 2));
        }
    }
}
