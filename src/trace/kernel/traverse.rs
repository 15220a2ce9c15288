//! The three queries, whichever [`Traversal`] is walked. Twin of `shaders/shared/traverse.wgsl`.

use glam::Vec3;

use super::KernelScene;
use super::intersect::{TriangleHit, intersect_triangle, max_component};
use super::material::{fails_alpha_test, surface_transmittance};
use super::math::max;
use super::rope::RopeTraversal;
use super::traversal_state::LeafTraversal;
use super::wide::WideTraversal;
use crate::device::layout::{HitRecord, InstanceFlags, InstanceRecord, NONE, RayRecord, Triangle};
use crate::trace::{Traversal, TraversalCounts};

/// What traces the rays of a pixel.
pub(crate) trait RayQueries<'a> {
    fn scene(&self) -> &'a KernelScene<'a>;

    /// See [`closest_hit`].
    fn closest_hit(&mut self, ray: &RayRecord, ray_mask: u32) -> HitRecord;

    /// See [`transmittance`].
    fn transmittance(&mut self, ray: &RayRecord, ray_mask: u32) -> Vec3;
}

impl<'a> RayQueries<'a> for &'a KernelScene<'a> {
    fn scene(&self) -> &'a KernelScene<'a> {
        self
    }

    fn closest_hit(&mut self, ray: &RayRecord, ray_mask: u32) -> HitRecord {
        closest_hit(self, ray, ray_mask)
    }

    fn transmittance(&mut self, ray: &RayRecord, ray_mask: u32) -> Vec3 {
        transmittance(self, ray, ray_mask)
    }
}

/// The closest hit in `t_min..=t_max`; of hits at equal t the one of the lower instance, then the lower primitive.
pub(crate) fn closest_hit(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> HitRecord {
    match scene.layout {
        Traversal::Rope => find_closest(scene, &mut RopeTraversal::<()>::new(scene, ray, ray_mask), ray),
        Traversal::Wide => find_closest(scene, &mut WideTraversal::<()>::new(scene, ray, ray_mask, true), ray),
    }
}

/// How much light gets through between `t_min` and `t_max`.
pub(crate) fn transmittance(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> Vec3 {
    let (light, has_layers) = match scene.layout {
        Traversal::Rope => {
            transmittance_without_layers(scene, &mut RopeTraversal::<()>::new(scene, ray, ray_mask), ray)
        }
        Traversal::Wide => {
            transmittance_without_layers(scene, &mut WideTraversal::<()>::new(scene, ray, ray_mask, false), ray)
        }
    };
    if has_layers { light * transmittance_of_layers(scene, ray, ray_mask) } else { light }
}

/// How much light gets through [layered](is_layered) instances: one crossing after the other.
pub(crate) fn transmittance_of_layers(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> Vec3 {
    let mut light = Vec3::ONE;
    let mut layer = HitRecord { t: -1.0, ..HitRecord::MISS };
    loop {
        let rest = RayRecord { t_min: max(ray.t_min, layer.t), ..*ray };
        layer = match scene.layout {
            Traversal::Rope => next_layer(scene, &mut RopeTraversal::<()>::new(scene, &rest, ray_mask), &rest, &layer),
            Traversal::Wide => {
                next_layer(scene, &mut WideTraversal::<()>::new(scene, &rest, ray_mask, true), &rest, &layer)
            }
        };
        if layer.instance == NONE {
            return light;
        }
        let instance = &scene.instances[layer.instance as usize];
        light *= surface_transmittance(scene, instance, &scene.triangles[layer.triangle as usize], layer.u, layer.v);
        if max_component(light) <= 0.0 {
            return Vec3::ZERO;
        }
    }
}

/// Whether anything that lets no light through lies between `t_min` and `t_max`.
pub(crate) fn any_hit(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> bool {
    match scene.layout {
        Traversal::Rope => find_any(scene, &mut RopeTraversal::<()>::new(scene, ray, ray_mask), ray),
        Traversal::Wide => find_any(scene, &mut WideTraversal::<()>::new(scene, ray, ray_mask, false), ray),
    }
}

/// What [`closest_hit`] costs.
pub(crate) fn count_closest_hit(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> TraversalCounts {
    match scene.layout {
        Traversal::Rope => {
            let mut walk = RopeTraversal::<TraversalCounts>::new(scene, ray, ray_mask);
            find_closest(scene, &mut walk, ray);
            walk.counter
        }
        Traversal::Wide => {
            let mut walk = WideTraversal::<TraversalCounts>::new(scene, ray, ray_mask, true);
            find_closest(scene, &mut walk, ray);
            walk.counter
        }
    }
}

/// What [`any_hit`] costs.
pub(crate) fn count_any_hit(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> TraversalCounts {
    match scene.layout {
        Traversal::Rope => {
            let mut walk = RopeTraversal::<TraversalCounts>::new(scene, ray, ray_mask);
            find_any(scene, &mut walk, ray);
            walk.counter
        }
        Traversal::Wide => {
            let mut walk = WideTraversal::<TraversalCounts>::new(scene, ray, ray_mask, false);
            find_any(scene, &mut walk, ray);
            walk.counter
        }
    }
}

/// What [`transmittance`] costs, [layered](is_layered) instances left out.
pub(crate) fn count_transmittance(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> TraversalCounts {
    match scene.layout {
        Traversal::Rope => {
            let mut walk = RopeTraversal::<TraversalCounts>::new(scene, ray, ray_mask);
            transmittance_without_layers(scene, &mut walk, ray);
            walk.counter
        }
        Traversal::Wide => {
            let mut walk = WideTraversal::<TraversalCounts>::new(scene, ray, ray_mask, false);
            transmittance_without_layers(scene, &mut walk, ray);
            walk.counter
        }
    }
}

#[inline]
fn find_closest(scene: &KernelScene<'_>, walk: &mut impl LeafTraversal, ray: &RayRecord) -> HitRecord {
    let mut hit = HitRecord { t: ray.t_max, ..HitRecord::MISS };
    while let Some(leaf) = walk.next_leaf(scene, hit.t) {
        walk.count_triangles(leaf.primitive_count());
        let place = walk.ray();
        let first = place.first_triangle + leaf.first_primitive();
        for (i, triangle) in (first..).zip(&scene.triangles[first as usize..][..leaf.primitive_count() as usize]) {
            let Some(crossing) = intersect_triangle(&place.local_shear, triangle) else { continue };
            if crossing.t >= ray.t_min {
                let (primitive, instance, back) = (triangle.primitive, place.instance, u32::from(crossing.back));
                let (t, u, v) = (crossing.t, crossing.u, crossing.v);
                let crossed =
                    HitRecord { t, u, v, instance, primitive, triangle: i, back_face: back, ..HitRecord::MISS };
                accept_hit(scene, &mut hit, crossed, place.flags);
            }
        }
    }
    if hit.instance == NONE { HitRecord::MISS } else { hit }
}

/// Takes what was crossed for the closest hit, if it is closer and there to be hit. `flags` are its instance's.
#[inline(always)]
pub(crate) fn accept_hit(scene: &KernelScene<'_>, hit: &mut HitRecord, crossed: HitRecord, flags: u32) {
    if !is_before(crossed.t, crossed.instance, crossed.primitive, hit) {
        return;
    }
    let flags = InstanceFlags::from_bits_retain(flags);
    if crossed.back_face != 0 && flags.contains(InstanceFlags::CULL_BACK) {
        return;
    }
    if flags.contains(InstanceFlags::ALPHA_MASK) {
        let instance = &scene.instances[crossed.instance as usize];
        if fails_alpha_test(scene, instance, &scene.triangles[crossed.triangle as usize], crossed.u, crossed.v) {
            return;
        }
    }
    *hit = crossed;
}

pub(crate) fn is_before(t: f32, instance: u32, primitive: u32, hit: &HitRecord) -> bool {
    if t != hit.t {
        return t < hit.t;
    }
    (instance, primitive) < (hit.instance, hit.primitive)
}

/// How much light gets through all instances but those that are [layered](is_layered), and whether there are any of these.
#[inline]
fn transmittance_without_layers(
    scene: &KernelScene<'_>,
    walk: &mut impl LeafTraversal,
    ray: &RayRecord,
) -> (Vec3, bool) {
    let mut light = Vec3::ONE;
    let mut has_layers = false;
    while let Some(leaf) = walk.next_leaf(scene, ray.t_max) {
        if is_layered(walk.ray().flags) {
            has_layers = true;
            continue;
        }
        walk.count_triangles(leaf.primitive_count());
        let place = walk.ray();
        let first = (place.first_triangle + leaf.first_primitive()) as usize;
        for triangle in &scene.triangles[first..][..leaf.primitive_count() as usize] {
            let Some(crossing) = intersect_triangle(&place.local_shear, triangle) else { continue };
            if crossing.t >= ray.t_min && crossing.t <= ray.t_max {
                light *= crossing_transmittance(scene, place.instance, triangle, &crossing);
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
    InstanceFlags::from_bits_retain(flags).contains(InstanceFlags::TRANSLUCENT | InstanceFlags::HAS_DUPLICATES)
}

/// The first crossing of a [layered](is_layered) instance after `last`, in the order of t, instance and primitive.
#[inline]
fn next_layer(scene: &KernelScene<'_>, walk: &mut impl LeafTraversal, ray: &RayRecord, last: &HitRecord) -> HitRecord {
    let mut hit = HitRecord { t: ray.t_max, ..HitRecord::MISS };
    while let Some(leaf) = walk.next_leaf(scene, hit.t) {
        let place = walk.ray();
        if !is_layered(place.flags) {
            continue;
        }
        let first = place.first_triangle + leaf.first_primitive();
        for (i, triangle) in (first..).zip(&scene.triangles[first as usize..][..leaf.primitive_count() as usize]) {
            let Some(crossing) = intersect_triangle(&place.local_shear, triangle) else { continue };
            let (t, instance, primitive) = (crossing.t, place.instance, triangle.primitive);
            if t >= ray.t_min && is_after(t, instance, primitive, last) && is_before(t, instance, primitive, &hit) {
                hit =
                    HitRecord { t, u: crossing.u, v: crossing.v, instance, primitive, triangle: i, ..HitRecord::MISS };
            }
        }
    }
    hit
}

fn is_after(t: f32, instance: u32, primitive: u32, hit: &HitRecord) -> bool {
    if t != hit.t {
        return t > hit.t;
    }
    (instance, primitive) > (hit.instance, hit.primitive)
}

#[inline]
fn find_any(scene: &KernelScene<'_>, walk: &mut impl LeafTraversal, ray: &RayRecord) -> bool {
    while let Some(leaf) = walk.next_leaf(scene, ray.t_max) {
        walk.count_triangles(leaf.primitive_count());
        let place = walk.ray();
        let first = (place.first_triangle + leaf.first_primitive()) as usize;
        for triangle in &scene.triangles[first..][..leaf.primitive_count() as usize] {
            let Some(crossing) = intersect_triangle(&place.local_shear, triangle) else { continue };
            if crossing.t >= ray.t_min
                && crossing.t <= ray.t_max
                && max_component(crossing_transmittance(scene, place.instance, triangle, &crossing)) <= 0.0
            {
                return true;
            }
        }
    }
    false
}

fn crossing_transmittance(scene: &KernelScene<'_>, instance: u32, triangle: &Triangle, crossing: &TriangleHit) -> Vec3 {
    candidate_transmittance(scene, &scene.instances[instance as usize], triangle, crossing.u, crossing.v)
}

/// How much light a triangle lets through at a point.
pub(crate) fn candidate_transmittance(
    scene: &KernelScene<'_>,
    instance: &InstanceRecord,
    triangle: &Triangle,
    u: f32,
    v: f32,
) -> Vec3 {
    if !InstanceFlags::from_bits_retain(instance.flags).contains(InstanceFlags::TRANSLUCENT) {
        return Vec3::ZERO;
    }
    surface_transmittance(scene, instance, triangle, u, v)
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;

    use super::*;
    use crate::device::DeviceArrays;
    use crate::device::layout::{GeometryRecord, MaterialFlags, MaterialRecord, Node, PrimitiveRange};

    /// Triangles one behind the other at z = 0, 1, 2, ..., in one leaf of one instance.
    fn layers(count: u32, material: MaterialRecord, flags: InstanceFlags) -> DeviceArrays {
        let mut arrays = DeviceArrays::default();
        let (min, max) = ([-2.0, -2.0, -1.0], [4.0, 4.0, count as f32]);
        let node = |primitives| Node { min, escape_index: NONE, max, primitives };
        arrays.tlas_nodes.replace(&[node(PrimitiveRange::leaf(0, 1))]);
        arrays.blas_nodes.replace(&[node(PrimitiveRange::leaf(0, count))]);
        let at = |z: f32| {
            let [v0, v1, v2] = [[-1.0, -1.0, z], [3.0, -1.0, z], [-1.0, 3.0, z]];
            Triangle::new([v0, v1, v2], z as u32)
        };
        arrays.triangles.replace(&(0..count).map(|i| at(i as f32)).collect::<Vec<_>>());
        let identity = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        let instance = InstanceRecord { mask: 2, flags: flags.bits(), ..InstanceRecord::zeroed() };
        arrays.instances.replace(&[InstanceRecord {
            local_from_world: identity,
            world_from_local: identity,
            ..instance
        }]);
        let none = GeometryRecord {
            first_index: NONE,
            first_normal: NONE,
            first_tex_coord_0: NONE,
            ..GeometryRecord::zeroed()
        };
        arrays.geometries.replace(&[GeometryRecord { first_tex_coord_1: NONE, first_color: NONE, ..none }]);
        arrays.materials.replace(&[material]);
        arrays
    }

    fn blended(alpha: f32) -> MaterialRecord {
        let flags = MaterialFlags::BLEND.bits();
        let base_color_texture = NONE;
        MaterialRecord { base_color: [1.0, 1.0, 1.0, alpha], flags, base_color_texture, ..MaterialRecord::zeroed() }
    }

    fn ray(t_min: f32, t_max: f32) -> RayRecord {
        RayRecord { origin: [0.0, 0.0, -1.0], t_min, direction: [0.0, 0.0, 1.0], t_max }
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
        let flags = InstanceFlags::TRANSLUCENT | InstanceFlags::HAS_DUPLICATES;
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
            assert_eq!(closest_hit(&scene, &ray(0.0, f32::MAX), 2), HitRecord::MISS);
            assert!(!any_hit(&scene, &ray(0.0, f32::MAX), 2));
        }
    }
}
