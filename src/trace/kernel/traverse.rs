//! The three queries, whichever [`Layout`] is walked. Twin of `shaders/shared/traverse.wgsl`.

use glam::Vec3;

use super::KernelScene;
use super::intersect::{Crossing, cross_triangle, max_component};
use super::material::{is_hole, passes};
use super::math::max;
use super::rope::Rope;
use super::walk::Walk;
use super::wide::Wide;
use crate::device::layout::{Hit, Instance, InstanceFlags, NONE, Ray, Triangle};
use crate::trace::{Counts, Layout};

/// What traces the rays of a pixel.
pub(crate) trait Traverse<'a> {
    fn scene(&self) -> &'a KernelScene<'a>;

    /// See [`closest_hit`].
    fn closest_hit(&mut self, ray: &Ray, ray_mask: u32) -> Hit;

    /// See [`transmittance`].
    fn transmittance(&mut self, ray: &Ray, ray_mask: u32) -> Vec3;
}

impl<'a> Traverse<'a> for &'a KernelScene<'a> {
    fn scene(&self) -> &'a KernelScene<'a> {
        self
    }

    fn closest_hit(&mut self, ray: &Ray, ray_mask: u32) -> Hit {
        closest_hit(self, ray, ray_mask)
    }

    fn transmittance(&mut self, ray: &Ray, ray_mask: u32) -> Vec3 {
        transmittance(self, ray, ray_mask)
    }
}

/// The closest hit in `t_min..=t_max`; of hits at equal t the one of the lower instance, then the lower primitive.
pub(crate) fn closest_hit(scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32) -> Hit {
    match scene.layout {
        Layout::Rope => closest(scene, &mut Rope::<()>::new(scene, ray, ray_mask), ray),
        Layout::Wide => closest(scene, &mut Wide::<()>::new(scene, ray, ray_mask, true), ray),
    }
}

/// How much light gets through between `t_min` and `t_max`.
pub(crate) fn transmittance(scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32) -> Vec3 {
    let (light, has_layers) = match scene.layout {
        Layout::Rope => light_through(scene, &mut Rope::<()>::new(scene, ray, ray_mask), ray),
        Layout::Wide => light_through(scene, &mut Wide::<()>::new(scene, ray, ray_mask, false), ray),
    };
    if has_layers { light * light_through_layers(scene, ray, ray_mask) } else { light }
}

/// How much light gets through [layered](is_layered) instances: one crossing after the other.
pub(crate) fn light_through_layers(scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32) -> Vec3 {
    let mut light = Vec3::ONE;
    let mut layer = Hit { t: -1.0, ..Hit::MISS };
    loop {
        let rest = Ray { t_min: max(ray.t_min, layer.t), ..*ray };
        layer = match scene.layout {
            Layout::Rope => next_layer(scene, &mut Rope::<()>::new(scene, &rest, ray_mask), &rest, &layer),
            Layout::Wide => next_layer(scene, &mut Wide::<()>::new(scene, &rest, ray_mask, true), &rest, &layer),
        };
        if layer.instance == NONE {
            return light;
        }
        let instance = &scene.instances[layer.instance as usize];
        light *= passes(scene, instance, &scene.triangles[layer.triangle as usize], layer.u, layer.v);
        if max_component(light) <= 0.0 {
            return Vec3::ZERO;
        }
    }
}

/// Whether anything that lets no light through lies between `t_min` and `t_max`.
pub(crate) fn any_hit(scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32) -> bool {
    match scene.layout {
        Layout::Rope => any(scene, &mut Rope::<()>::new(scene, ray, ray_mask), ray),
        Layout::Wide => any(scene, &mut Wide::<()>::new(scene, ray, ray_mask, false), ray),
    }
}

/// What [`closest_hit`] costs.
pub(crate) fn count_closest(scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32) -> Counts {
    match scene.layout {
        Layout::Rope => {
            let mut walk = Rope::<Counts>::new(scene, ray, ray_mask);
            closest(scene, &mut walk, ray);
            walk.counter
        }
        Layout::Wide => {
            let mut walk = Wide::<Counts>::new(scene, ray, ray_mask, true);
            closest(scene, &mut walk, ray);
            walk.counter
        }
    }
}

/// What [`any_hit`] costs.
pub(crate) fn count_any(scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32) -> Counts {
    match scene.layout {
        Layout::Rope => {
            let mut walk = Rope::<Counts>::new(scene, ray, ray_mask);
            any(scene, &mut walk, ray);
            walk.counter
        }
        Layout::Wide => {
            let mut walk = Wide::<Counts>::new(scene, ray, ray_mask, false);
            any(scene, &mut walk, ray);
            walk.counter
        }
    }
}

/// What [`transmittance`] costs, [layered](is_layered) instances left out.
pub(crate) fn count_transmittance(scene: &KernelScene<'_>, ray: &Ray, ray_mask: u32) -> Counts {
    match scene.layout {
        Layout::Rope => {
            let mut walk = Rope::<Counts>::new(scene, ray, ray_mask);
            light_through(scene, &mut walk, ray);
            walk.counter
        }
        Layout::Wide => {
            let mut walk = Wide::<Counts>::new(scene, ray, ray_mask, false);
            light_through(scene, &mut walk, ray);
            walk.counter
        }
    }
}

#[inline]
fn closest(scene: &KernelScene<'_>, walk: &mut impl Walk, ray: &Ray) -> Hit {
    let mut hit = Hit { t: ray.t_max, ..Hit::MISS };
    while let Some(leaf) = walk.next_leaf(scene, hit.t) {
        walk.count_triangles(leaf.count());
        let place = walk.place();
        let first = place.first_triangle + leaf.first();
        for (i, triangle) in (first..).zip(&scene.triangles[first as usize..][..leaf.count() as usize]) {
            let Some(crossing) = cross_triangle(&place.shear, triangle) else { continue };
            if crossing.t >= ray.t_min {
                let (primitive, instance, back) = (triangle.primitive, place.instance, u32::from(crossing.back));
                let (t, u, v) = (crossing.t, crossing.u, crossing.v);
                let crossed = Hit { t, u, v, instance, primitive, triangle: i, back, ..Hit::MISS };
                take_closer(scene, &mut hit, crossed, place.flags);
            }
        }
    }
    if hit.instance == NONE { Hit::MISS } else { hit }
}

/// Takes what was crossed for the closest hit, if it is closer and there to be hit. `flags` are its instance's.
#[inline(always)]
pub(crate) fn take_closer(scene: &KernelScene<'_>, hit: &mut Hit, crossed: Hit, flags: u32) {
    if !is_closer(crossed.t, crossed.instance, crossed.primitive, hit) {
        return;
    }
    let flags = InstanceFlags::from_bits_retain(flags);
    if crossed.back != 0 && flags.contains(InstanceFlags::CULL_BACK) {
        return;
    }
    if flags.contains(InstanceFlags::ALPHA_MASK) {
        let instance = &scene.instances[crossed.instance as usize];
        if is_hole(scene, instance, &scene.triangles[crossed.triangle as usize], crossed.u, crossed.v) {
            return;
        }
    }
    *hit = crossed;
}

pub(crate) fn is_closer(t: f32, instance: u32, primitive: u32, hit: &Hit) -> bool {
    if t != hit.t {
        return t < hit.t;
    }
    (instance, primitive) < (hit.instance, hit.primitive)
}

/// How much light gets through all instances but those that are [layered](is_layered), and whether there are any of these.
#[inline]
fn light_through(scene: &KernelScene<'_>, walk: &mut impl Walk, ray: &Ray) -> (Vec3, bool) {
    let mut light = Vec3::ONE;
    let mut has_layers = false;
    while let Some(leaf) = walk.next_leaf(scene, ray.t_max) {
        if is_layered(walk.place().flags) {
            has_layers = true;
            continue;
        }
        walk.count_triangles(leaf.count());
        let place = walk.place();
        let first = (place.first_triangle + leaf.first()) as usize;
        for triangle in &scene.triangles[first..][..leaf.count() as usize] {
            let Some(crossing) = cross_triangle(&place.shear, triangle) else { continue };
            if crossing.t >= ray.t_min && crossing.t <= ray.t_max {
                light *= passes_crossing(scene, place.instance, triangle, &crossing);
                if max_component(light) <= 0.0 {
                    return (Vec3::ZERO, false);
                }
            }
        }
    }
    (light, has_layers)
}

/// Whether what is crossed is to be taken layer by layer: it may be met more than once, but counts once.
pub(crate) fn is_layered(flags: u32) -> bool {
    InstanceFlags::from_bits_retain(flags).contains(InstanceFlags::TRANSLUCENT | InstanceFlags::REPEATS)
}

/// The first crossing of a [layered](is_layered) instance after `last`, in the order of t, instance and primitive.
#[inline]
fn next_layer(scene: &KernelScene<'_>, walk: &mut impl Walk, ray: &Ray, last: &Hit) -> Hit {
    let mut hit = Hit { t: ray.t_max, ..Hit::MISS };
    while let Some(leaf) = walk.next_leaf(scene, hit.t) {
        let place = walk.place();
        if !is_layered(place.flags) {
            continue;
        }
        let first = place.first_triangle + leaf.first();
        for (i, triangle) in (first..).zip(&scene.triangles[first as usize..][..leaf.count() as usize]) {
            let Some(crossing) = cross_triangle(&place.shear, triangle) else { continue };
            let (t, instance, primitive) = (crossing.t, place.instance, triangle.primitive);
            if t >= ray.t_min && is_farther(t, instance, primitive, last) && is_closer(t, instance, primitive, &hit) {
                hit = Hit { t, u: crossing.u, v: crossing.v, instance, primitive, triangle: i, ..Hit::MISS };
            }
        }
    }
    hit
}

fn is_farther(t: f32, instance: u32, primitive: u32, hit: &Hit) -> bool {
    if t != hit.t {
        return t > hit.t;
    }
    (instance, primitive) > (hit.instance, hit.primitive)
}

#[inline]
fn any(scene: &KernelScene<'_>, walk: &mut impl Walk, ray: &Ray) -> bool {
    while let Some(leaf) = walk.next_leaf(scene, ray.t_max) {
        walk.count_triangles(leaf.count());
        let place = walk.place();
        let first = (place.first_triangle + leaf.first()) as usize;
        for triangle in &scene.triangles[first..][..leaf.count() as usize] {
            let Some(crossing) = cross_triangle(&place.shear, triangle) else { continue };
            if crossing.t >= ray.t_min
                && crossing.t <= ray.t_max
                && max_component(passes_crossing(scene, place.instance, triangle, &crossing)) <= 0.0
            {
                return true;
            }
        }
    }
    false
}

fn passes_crossing(scene: &KernelScene<'_>, instance: u32, triangle: &Triangle, crossing: &Crossing) -> Vec3 {
    passes_at(scene, &scene.instances[instance as usize], triangle, crossing.u, crossing.v)
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
    use crate::device::layout::{Material, MaterialFlags, Node, PrimitiveRange, Streams};

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
    fn what_is_met_more_than_once_counts_once() {
        // The same triangles in two leaves and more, as a kd-tree has them, and two that cross at one place.
        let flags = InstanceFlags::TRANSLUCENT | InstanceFlags::REPEATS;
        let mut arrays = layers(5, blended(0.5), flags);
        let mut triangles = arrays.triangles.to_vec();
        triangles[4] = Triangle { primitive: 4, ..triangles[3] };
        triangles.extend_from_within(1..4);
        arrays.triangles.replace(&triangles);
        let leaf = arrays.blas_nodes[0];
        let root = Node { primitives: PrimitiveRange::INNER, ..leaf };
        let first = Node { escape_index: 2, ..leaf };
        let second = Node { primitives: PrimitiveRange::leaf(4, 4), ..leaf };
        arrays.blas_nodes.replace(&[root, first, second]);
        let scene = KernelScene::new(&arrays);
        for (t_min, t_max, layers) in [(0.0, 0.9, 0), (0.0, 1.0, 1), (1.0, 1.0, 1), (0.0, 9.0, 5), (1.5, 4.0, 4)] {
            let part = 0.5f32.powi(layers);
            assert_eq!(transmittance(&scene, &ray(t_min, t_max), 2), Vec3::splat(part), "{t_min} to {t_max}");
        }
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
