//! The ray queries closest hit, any hit and transmittance, independent of the traversal. Twin of
//! `shaders/shared/traverse.wgsl`.

use glam::Vec3;

use super::KernelScene;
use super::intersect::max_component;
use super::math::max;
use super::query::{
    AnyQuery, ClosestQuery, Continuation, LayerQuery, Query, TransmittanceQuery, candidate_transmittance,
    intersect_leaf,
};
use super::rope::RopeTraversal;
use super::traversal_state::{LeafTraversal, TraversalCounter};
use super::wide::WideTraversal;
use crate::device::layout::{HitRecord, InstanceFlags, NONE, RayRecord};
use crate::trace::Traversal;

/// The queries by which `render_pixel` traces its rays.
pub(crate) trait RayQueries<'a> {
    fn scene(&self) -> &'a KernelScene<'a>;

    /// See [`next_hit`].
    fn next_hit(&mut self, ray: &RayRecord, start: Continuation, ray_mask: u32) -> HitRecord;

    /// See [`transmittance`].
    fn transmittance(&mut self, ray: &RayRecord, ray_mask: u32) -> Vec3;
}

impl<'a> RayQueries<'a> for &'a KernelScene<'a> {
    fn scene(&self) -> &'a KernelScene<'a> {
        self
    }

    fn next_hit(&mut self, ray: &RayRecord, start: Continuation, ray_mask: u32) -> HitRecord {
        next_hit(self, ray, start, ray_mask)
    }

    fn transmittance(&mut self, ray: &RayRecord, ray_mask: u32) -> Vec3 {
        transmittance(self, ray, ray_mask)
    }
}

/// The first hit in [`t_min`, `t_max`], in the [order of hits](super::query::HitOrder): the closest, but for surfaces
/// that touch.
pub(crate) fn closest_hit(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> HitRecord {
    next_hit(scene, ray, Continuation::START, ray_mask)
}

/// The first hit in [`t_min`, `t_max`] of a ray that goes on behind one that it has passed; `t_min` should be
/// [`Continuation::t_min`].
pub(crate) fn next_hit(scene: &KernelScene<'_>, ray: &RayRecord, start: Continuation, ray_mask: u32) -> HitRecord {
    let (query, ()) = run_query(scene, ray, ray_mask, ClosestQuery::behind(ray.t_max, start));
    query.hit
}

/// Occlusion query: whether the ray hits an opaque surface in [`t_min`, `t_max`].
pub(crate) fn any_hit(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> bool {
    let (query, ()) = run_query(scene, ray, ray_mask, AnyQuery::new(ray.t_max));
    query.is_hit
}

/// Transmittance along the ray in [`t_min`, `t_max`], per colour channel: the product over all surfaces hit; 0 if one
/// is opaque. The light travels against the ray, from a light source to the ray's origin: a single-sided surface that
/// it meets from behind lets it pass, as it lets sight pass from there.
pub(crate) fn transmittance(scene: &KernelScene<'_>, ray: &RayRecord, ray_mask: u32) -> Vec3 {
    let (query, ()) = run_query(scene, ray, ray_mask, TransmittanceQuery::new(ray.t_max));
    query.with_layers(scene, ray, ray_mask)
}

/// Transmittance of the instances with certain flags, found by repeated closest-hit traversals that each go on behind
/// the last hit.
pub(crate) fn transmittance_of_layers(
    scene: &KernelScene<'_>,
    ray: &RayRecord,
    instances: InstanceFlags,
    ray_mask: u32,
) -> Vec3 {
    let mut transmittance = Vec3::ONE;
    let mut start = Continuation::START;
    loop {
        // Find the next layer behind the last one.
        let layer = next_layer(scene, ray, start, instances, ray_mask);
        if layer.instance == NONE {
            return transmittance;
        }
        // Multiply by its transmittance; an opaque one ends the ray.
        let flags = scene.instances[layer.instance as usize].flags;
        transmittance *= candidate_transmittance(scene, &layer, flags);
        if max_component(transmittance) <= 0.0 {
            return Vec3::ZERO;
        }
        start = Continuation::behind(scene, &layer, Vec3::from_array(ray.direction));
    }
}

/// The first hit, of an instance with certain flags, behind the one that the ray has passed.
fn next_layer(
    scene: &KernelScene<'_>,
    ray: &RayRecord,
    start: Continuation,
    flags: InstanceFlags,
    ray_mask: u32,
) -> HitRecord {
    let rest = RayRecord { t_min: max(ray.t_min, start.t_min()), ..*ray };
    let query = LayerQuery { closest: ClosestQuery::behind(ray.t_max, start), flags };
    let (query, ()) = run_query(scene, &rest, ray_mask, query);
    query.closest.hit
}

/// Runs a query by the scene's traversal; returns its final state and what a counter counted (`()` counts nothing).
#[inline]
pub(crate) fn run_query<C: TraversalCounter, Q: Query>(
    scene: &KernelScene<'_>,
    ray: &RayRecord,
    ray_mask: u32,
    mut query: Q,
) -> (Q, C) {
    match scene.traversal {
        Traversal::Rope => {
            let mut traversal = RopeTraversal::new(scene, ray, ray_mask);
            intersect_leaves(scene, &mut traversal, &mut query);
            (query, traversal.counter)
        }
        Traversal::Wide => {
            let mut traversal = WideTraversal::new(scene, ray, ray_mask, Q::ORDER);
            intersect_leaves(scene, &mut traversal, &mut query);
            (query, traversal.counter)
        }
    }
}

/// Offers the hits in all leaves of a traversal to a query, until it is decided.
#[inline]
fn intersect_leaves(scene: &KernelScene<'_>, traversal: &mut impl LeafTraversal, query: &mut impl Query) {
    while let Some(leaf) = traversal.next_leaf(scene, query.t_max()) {
        // Layered instances are for one query and not for another.
        if query.skips_instance(traversal.ray().flags) {
            continue;
        }
        // Test each triangle; accept or reject the hits.
        traversal.count_triangles(leaf.primitive_count());
        let ray = traversal.ray();
        let first = ray.first_triangle + leaf.first_primitive();
        let triangles = &scene.triangles[first as usize..][..leaf.primitive_count() as usize];
        intersect_leaf(scene, ray, first, triangles, query);
        if query.is_decided() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;

    use super::*;
    use crate::device::DeviceArrays;
    use crate::device::layout::{
        GeometryRecord, InstanceFlags, InstanceRecord, MaterialFlags, MaterialRecord, Node, PrimitiveRange, Triangle,
    };

    /// Triangles one behind the other at z = 0, 1, 2, ..., in one leaf of one instance.
    fn layers(count: u32, material: MaterialRecord, flags: InstanceFlags) -> DeviceArrays {
        // Make a TLAS of one leaf, and a BLAS of one leaf that holds all triangles.
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
        // Place it once, at the identity, without vertex attributes.
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
        // Put triangles 0 to 4 into the first leaf, 4 to 7 into the second.
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
