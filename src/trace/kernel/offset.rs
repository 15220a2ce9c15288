//! Origins of secondary rays: offset along the geometric normal by a bound on the hit point's rounding error. Twin of
//! `shaders/shared/offset.wgsl`.
//!
//! A hit point is rounded in three steps: interpolated in local space, transformed to world space, and transformed back
//! to local space when the next ray enters the same instance. With u = 2^-24, V the largest absolute coordinates of the
//! triangle's vertices, W = `world_from_local` and L = `local_from_world`, the point that the next ray starts from in
//! local space differs from one of the triangle's plane by at most, per coordinate:
//!
//! - interpolation: 8 u V (three products, two sums, and the weights' own rounding);
//! - to the world: 4 u |W| (V, 1), the rounding of W's numbers included, and u |W| (V, 1) for adding the offset; |L|
//!   takes both back to local space;
//! - to local space: 4 u (|L| (|W| (V, 1)) + |l|), l being L's translation, the rounding of L's numbers included;
//! - the next ray's direction turns by 4 u in local space, which moves the ray by as much again over the object's
//!   extent.
//!
//! Together less than 16 u (V + |L| (|W| (V, 1)) + |l|) ([`TRANSFORM_ERROR_FACTOR`]). The intersection test moves edges
//! by a tolerance of its own, 8 u times sums of some six extents of the triangle: less than 64 u of its longest edge
//! ([`EDGE_ERROR`]). The bound `e` is the sum; for the unnormalised local normal n it is |n|.e in the direction of n. A
//! step d along the world normal L^T n / |L^T n| moves the point in local space by d L L^T n / |L^T n|, which along n
//! is d |L^T n|. Hence d = |n|.e / |L^T n|.
//!
//! In a unit object at the origin that is at most 2e-5; where an object lies a thousand times its size away from the
//! render origin, at most 5e-3 of its size (both tested). Not bounded: a triangle a hundred times longer than wide,
//! seen within 1e-3 of edge-on, may have a larger error in t, so that a secondary ray at such an angle occasionally
//! hits its own surface.

use glam::Vec3;

use super::intersect::{max_component, reciprocal_power_of_two};
use super::math::{cross3, dot3, length3, transform_normal, transform_point};
use super::surface::Surface;
use crate::device::layout::{InstanceRecord, Triangle};

pub(super) const HALF_ULP: f32 = 1.0 / 16_777_216.0;
pub(super) const TRANSFORM_ERROR_FACTOR: f32 = 16.0 * HALF_ULP;
pub(super) const EDGE_ERROR: f32 = 64.0 * HALF_ULP;

/// A hit point in world space, the unit geometric normal on the front side, and the offset for secondary rays along it
/// (a rounding bound, world units).
pub(crate) struct HitPoint {
    pub position: Vec3,
    pub normal: Vec3,
    pub ray_offset: f32,
}

/// Reconstructs the hit point. A triangle that rounds to a line has no plane: its normal is `fallback`, a unit vector.
pub(crate) fn hit_point(instance: &InstanceRecord, triangle: &Triangle, weights: Vec3, fallback: Vec3) -> HitPoint {
    let [v0, v1, v2] = [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from_array);
    // World-space position.
    let local = (v0 * weights.x + v1 * weights.y) + v2 * weights.z;
    let position = transform_point(&instance.world_from_local, local);
    // Geometric normal from edges that are scaled to about 1.
    let edge_1 = v1 - v0;
    let edge_2 = v2 - v0;
    let extent = max_component(edge_1.abs().max(edge_2.abs()));
    let to_unit_edges = reciprocal_power_of_two(extent);
    let local_normal = cross3(edge_1 * to_unit_edges, edge_2 * to_unit_edges);
    let world_normal = transform_normal(&instance.local_from_world, local_normal);
    let largest = max_component(world_normal.abs());
    let has_plane = largest > 0.0;
    if !has_plane {
        return HitPoint { position, normal: fallback, ray_offset: 0.0 };
    }

    // Bound of the rounding error per coordinate, local space.
    let max_abs = v0.abs().max(v1.abs()).max(v2.abs());
    let round_trip = transform_abs(&instance.local_from_world, transform_abs(&instance.world_from_local, max_abs));
    let error = TRANSFORM_ERROR_FACTOR * (max_abs + round_trip) + Vec3::splat(EDGE_ERROR * extent);

    // Distance along the world-space normal that covers it.
    let scale = reciprocal_power_of_two(largest);
    let scaled_length = length3(world_normal * scale);
    let distance = (dot3(local_normal.abs(), error) * scale) / scaled_length;
    HitPoint { position, normal: world_normal * (scale / scaled_length), ray_offset: distance }
}

/// |M| (`max_abs`, 1): bounds every coordinate, and every partial sum, of a transformed point whose coordinates do not
/// exceed `max_abs`.
fn transform_abs(rows: &[[f32; 4]; 3], max_abs: Vec3) -> Vec3 {
    let [x, y, z] = rows.map(|[x, y, z, w]| dot3(Vec3::new(x, y, z).abs(), max_abs) + w.abs());
    Vec3::new(x, y, z)
}

/// The origin of a secondary ray with the given direction: the position offset along the geometric normal to the side
/// that the direction points to.
pub(crate) fn offset_ray_origin(surface: &Surface, direction: Vec3) -> Vec3 {
    if dot3(direction, surface.geometric_normal) >= 0.0 {
        return surface.position + surface.geometric_normal * surface.ray_offset;
    }
    surface.position - surface.geometric_normal * surface.ray_offset
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DQuat, DVec3};

    use super::*;
    use crate::compile::Compiler;
    use crate::device::layout::{HitRecord, NONE, RayRecord};
    use crate::graph::{Core, Geometry, Material, Scene, Transform};
    use crate::trace::kernel::surface::{MIN_COSINE, surface_at};
    use crate::trace::kernel::{KernelScene, any_hit, closest_hit};

    /// Random numbers from 0 to 1, and directions.
    struct Random(fastrand::Rng);

    impl Random {
        fn next(&mut self) -> f64 {
            self.0.f64()
        }

        fn direction(&mut self) -> DVec3 {
            loop {
                let v = DVec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0;
                if v.length_squared() < 1.0 {
                    return v.try_normalize().unwrap_or(DVec3::Z);
                }
            }
        }

        /// On the side of `normal`; half of them nearly in its plane.
        fn outward(&mut self, normal: Vec3) -> Vec3 {
            let normal = normal.as_dvec3();
            let tangent = self.direction().reject_from(normal).normalize();
            let slope =
                if self.next() < 0.5 { self.next() } else { f64::from(MIN_COSINE) * (1.0 + 15.0 * self.next()) };
            (tangent * (1.0 - slope * slope).sqrt() + normal * slope).as_vec3()
        }
    }

    /// A closed convex surface of revolution of `rows` by `columns` quads, within 1 of the origin: `radius_height`
    /// gives the distance from the axis, and the height, of each row. The ends are fans of triangles, thin ones if
    /// there are many.
    fn lathed(rows: u32, columns: u32, scale: f32, radius_height: impl Fn(f32) -> (f32, f32)) -> Geometry {
        let mut positions = Vec::new();
        // Rings of vertices, then the two poles.
        for row in 1..rows {
            let (radius, height) = radius_height(row as f32 / rows as f32);
            for column in 0..columns {
                let angle = column as f32 / columns as f32 * std::f32::consts::TAU;
                positions.push(Vec3::new(radius * angle.cos(), height, -radius * angle.sin()) * scale);
            }
        }
        let top = positions.len() as u32;
        positions.extend([Vec3::Y, Vec3::NEG_Y].map(|pole| pole * scale));
        let vertex = |row: u32, column: u32| row * columns + column % columns;
        let mut indices = Vec::new();
        // A fan around each pole, and two triangles per quad between the rings.
        for c in 0..columns {
            indices.push([top, vertex(0, c), vertex(0, c + 1)]);
            indices.push([vertex(rows - 2, c + 1), vertex(rows - 2, c), top + 1]);
            for r in 0..rows - 2 {
                let [a, b, d, e] = [vertex(r, c), vertex(r, c + 1), vertex(r + 1, c), vertex(r + 1, c + 1)];
                indices.extend([[a, d, e], [a, e, b]]);
            }
        }
        Geometry::new(positions, indices)
    }

    /// A fan around the origin, in one plane with it: nothing but the triangles' size tells how far to step away.
    fn disc(scale: f32) -> Geometry {
        let angle = |i: u32| i as f32 / 7.0 * std::f32::consts::TAU;
        let ring = (0..7).map(|i| Vec3::new(angle(i).cos(), 0.0, -angle(i).sin()) * scale);
        Geometry::new(
            [Vec3::ZERO].into_iter().chain(ring).collect::<Vec<_>>(),
            [1, 2, 3, 4, 5, 6, 7].map(|i| [0, i, i % 7 + 1]),
        )
    }

    fn meshes(scale: f32) -> [(&'static str, Geometry); 5] {
        let sphere = |t: f32| ((t * std::f32::consts::PI).sin(), (t * std::f32::consts::PI).cos());
        // Up one cap, down the side, in on the other: all of a face's triangles in one plane.
        let drum = |t: f32| (1.0f32.min(3.0 * t).min(3.0 * (1.0 - t)), (3.0 - 6.0 * t).clamp(-1.0, 1.0));
        [
            ("fine sphere", lathed(64, 96, scale, sphere)),
            ("double pyramid", lathed(2, 4, scale, |t| ((t * std::f32::consts::PI).sin(), 1.0 - 2.0 * t))),
            ("drum", lathed(30, 12, scale, drum)),
            ("disc", disc(scale)),
            ("rod", lathed(12, 8, scale, |t| (0.1 * (t * std::f32::consts::PI).sin(), 1.0 - 2.0 * t))),
        ]
    }

    struct Counts {
        outward: u32,
        inward: u32,
        /// Rays that entered within the intersection test's tolerance of an edge, and then through the neighbour too.
        entered_twice: u32,
        /// The largest offset over the object's size, where the object is near the origin and where it is far.
        offsets: [f32; 2],
    }

    /// Rays from outside hit a convex mesh; those that leave the hit outward must meet nothing, those that leave inward
    /// the far side from within.
    fn check(name: &str, geometry: Geometry, place: DAffine3, size: f64, eye: DVec3, hits: u32, counts: &mut Counts) {
        // Compile a scene of one glass instance.
        let mut scene = Scene::new();
        let geometry = scene.add_geometry(geometry).unwrap();
        let material = scene.add_material(Material::glass(1.5)).unwrap();
        let node = scene.add(scene.root(), Transform::Matrix(place)).unwrap();
        scene.add(node, Core::Geometry { geometry, material }).unwrap();
        let mut compiler = Compiler::new();
        compiler.compile(&mut scene, eye).unwrap();
        let kernel = KernelScene::new(compiler.arrays());
        let extent = place.matrix3.determinant().abs().cbrt() * size;

        let mut random = Random(fastrand::Rng::with_seed(17));
        let mut found = 0;
        for _ in 0..hits * 10 {
            // Shoot at a random point of a random triangle, from outside the mesh.
            let triangle = &kernel.triangles[(random.next() * kernel.triangles.len() as f64) as usize];
            let (a, b) = (random.next() as f32, random.next() as f32);
            let weights = Vec3::new(1.0 - a, a * (1.0 - b), a * b);
            let target = hit_point(&kernel.instances[0], triangle, weights, Vec3::X).position;
            let direction = random.direction();
            let origin = (target.as_dvec3() - direction * extent * 4.0).as_vec3();
            let ray = ray(origin, direction.as_vec3());
            let hit = closest_hit(&kernel, &ray, u32::MAX);
            if hit.instance == NONE {
                continue;
            }
            // Keep only hits on the outside.
            let surface = surface_at(&kernel, &hit, direction.as_vec3());
            if surface.is_inside {
                continue;
            }
            // Let rays leave the hit, and note the offset relative to the object's size.
            check_hit(name, &kernel, &hit, &surface, &mut random, counts);
            let far = usize::from(place.translation.distance(eye) > 100.0 * extent);
            counts.offsets[far] = counts.offsets[far].max((f64::from(surface.ray_offset) / extent) as f32);
            found += 1;
            if found == hits {
                return;
            }
        }
        panic!("{name}: only {found} of {hits} hits");
    }

    fn check_hit(
        name: &str,
        kernel: &KernelScene<'_>,
        hit: &HitRecord,
        surface: &Surface,
        random: &mut Random,
        counts: &mut Counts,
    ) {
        // Rays that leave outward must meet nothing.
        for _ in 0..4 {
            let direction = random.outward(surface.geometric_normal);
            let leaving = ray(offset_ray_origin(surface, direction), direction);
            let again = closest_hit(kernel, &leaving, u32::MAX);
            assert_eq!(again.instance, NONE, "{name}: {hit:?} is left along {leaving:?} and met again as {again:?}");
            assert!(!any_hit(kernel, &leaving, u32::MAX), "{name}: {hit:?}");
            counts.outward += 1;
        }
        // One that goes inward must not meet the triangle that it starts on.
        let direction = random.outward(-surface.geometric_normal);
        let entering = ray(offset_ray_origin(surface, direction), direction);
        let far = closest_hit(kernel, &entering, u32::MAX);
        assert_ne!(far.triangle, hit.triangle, "{name}: {hit:?} is entered and met again from {entering:?}");
        counts.entered_twice += u32::from(far.instance != NONE && far.back_face == 0);
        counts.inward += u32::from(far.instance != NONE);
    }

    fn ray(origin: Vec3, direction: Vec3) -> RayRecord {
        RayRecord { origin: origin.to_array(), t_min: 0.0, direction: direction.to_array(), t_max: f32::MAX }
    }

    #[test]
    fn no_ray_meets_the_convex_surface_that_it_leaves() {
        let mut counts = Counts { outward: 0, inward: 0, entered_twice: 0, offsets: [0.0; 2] };
        let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 1.0);
        for scale in [1e-6, 1e-3, 1.0, 1e3, 1e6] {
            let stretch = DVec3::new(1.0, 3.0, -0.2);
            // The size in the geometry, then in the instance; rotated and mirrored; a thousand times its size away from
            // the eye.
            let places = [
                (scale as f32, DAffine3::IDENTITY, DVec3::ZERO),
                (1.0, DAffine3::from_scale_rotation_translation(stretch * scale, turn, DVec3::ZERO), DVec3::ZERO),
                (scale as f32, DAffine3::from_rotation_translation(turn, DVec3::splat(1e3 * scale)), DVec3::ZERO),
                (
                    1.0,
                    DAffine3::from_scale_rotation_translation(stretch * scale, turn, DVec3::splat(1e9)),
                    DVec3::splat(1e9),
                ),
            ];
            for (geometry_scale, place, eye) in places {
                for (name, geometry) in meshes(geometry_scale) {
                    check(name, geometry, place, f64::from(geometry_scale), eye, 3200, &mut counts);
                }
            }
        }
        let Counts { outward, inward, entered_twice, offsets: [near, far] } = counts;
        eprintln!(
            "{outward} rays outward, {inward} inward, {entered_twice} of them twice, offset {near:e}, far {far:e}"
        );
        assert!(outward >= 1_000_000 && inward > 200_000, "{outward} {inward}");
        assert!(entered_twice * 10_000 < inward, "{entered_twice} of {inward}");
        assert!(near < 2e-5 && far < 5e-3, "{near} {far}");
    }
}
