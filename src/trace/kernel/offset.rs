//! Origins of secondary rays: offset along the geometric normal by a bound on the hit point's rounding error. Twin of
//! `shaders/shared/offset.wgsl`.
//!
//! An error within the triangle's plane costs nothing: the point is still on the plane. So the barycentric weights may
//! be anything, and edges do not count; what does is how far along the normal rounding takes the point, and how far off
//! it the next ray's triangle test finds the plane. Let u = 2^-24, v0, v1, v2 the vertices, e1 = v1 - v0 and e2 = v2 -
//! v0, n their cross product, W = `world_from_local` and L = `local_from_world`. All bounds are per coordinate, and
//! each is multiplied by that coordinate of the normal: where a plane lies along two axes, only its third coordinate
//! counts, and the triangle's extent, along the other two, does not.
//!
//! 1. **Interpolation.** c is the vertex with the greatest weight, m = a e1 + b e2 the way from there to the point; a
//!    and b are exact by definition. The edges have a [sum's rounding](sum_error) each, together E = |a| error(e1) +
//!    |b| error(e2); products and their sum one each: 2 u R, where R = |a| |e1| + |b| |e2|; c + m that of a sum.
//! 2. **To world space.** Each of W's numbers is rounded, and each product and sum ([`Columns::transform`]).
//! 3. **Adding the offset** rounds once: u |position|.
//! 4. **To local space,** where the next ray enters the same instance: as step 2, but L is exact by definition, since
//!    what is drawn is the geometry under L's inverse.
//! 5. **The triangle test** of that ray, which leaves the surface, computes t = n.q / n.d (`intersect.rs`, point 5), q
//!    being the way from the ray's origin to the vertex with the greatest weight where its line crosses the plane: that
//!    is c, or another where weights are about equal ([`LIKELY_WEIGHT`]). t is negative, and the triangle is not hit,
//!    if n.q has the right sign. Of n.q's errors, those of q, of the products, and of the differences in n are u |n|
//!    |q| each; and as n.q is about 0, the first sum is about the third product, and rounds like it. The products in n
//!    have u N.|q|, N being n with all products positive. A rounded edge turns the plane about c: an error of e1 moves
//!    it by a times that at the point, hence E for both. Together |n|.(E + u (3, 3, 4) |q|) + u N.|q|.
//!
//! Steps 1, 4 and 5 are in local space, where a step d along the world normal L^T n / |L^T n| leads d |L^T n| / |n|
//! away from the plane. Steps 2 and 3 are in world space. The offset is the sum of both. Terms in u^2, the offset's own
//! part in q, and the rounding of the bound itself are covered by [`OFFSET_MARGIN`]; where nothing is rounded, as in a
//! plane through the origin of an instance that is not turned, a ray must still start off the plane, and does so by
//! [`LEAST_OFFSET`] of the triangle's extent.
//!
//! A ray leaves with a slope of `MIN_COSINE` or more. n.d then has the right sign too, unless N exceeds |n| by some
//! hundred times: a sliver that lies along no axis, or an instance as uneven. There a secondary ray that leaves within
//! 1e-3 of edge-on may hit its own surface. Beyond an edge the triangle test has a tolerance; why rays that start
//! beside one do not hit by it is in `intersect.rs`, point 2.
//!
//! The offset is a few ulps of the coordinates that are added and multiplied along the normal. A test compares it with
//! the largest error seen in f64.

use glam::Vec3;

use super::intersect::{max_component, reciprocal_power_of_two};
use super::math::{cross3, dot3, length3, min, transform_normal};
use super::surface::Surface;
use crate::device::layout::{InstanceFlags, InstanceRecord, Triangle};

pub(super) const HALF_ULP: f32 = 1.0 / 16_777_216.0;
/// Relative to the triangle's extent: 2^-48, a rounding of a rounding.
pub(super) const LEAST_OFFSET: f32 = HALF_ULP * HALF_ULP;
/// Factor on the bound that covers terms of second order.
pub(super) const OFFSET_MARGIN: f32 = 1.0 + 1.0 / 64.0;
/// A vertex of at least this weight at the hit point may have the greatest where the next ray crosses the plane.
pub(super) const LIKELY_WEIGHT: f32 = 0.25;

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
    let edge_1 = v1 - v0;
    let edge_2 = v2 - v0;
    // 1. The position, by way of the vertex with the greatest weight.
    let (mut corner, mut along_1, mut along_2) = (v2, weights.y, weights.z - 1.0);
    if weights.x >= weights.y && weights.x >= weights.z {
        (corner, along_1, along_2) = (v0, weights.y, weights.z);
    } else if weights.y >= weights.z {
        (corner, along_1, along_2) = (v1, weights.y - 1.0, weights.z);
    }
    let from_corner = edge_1 * along_1 + edge_2 * along_2;
    let local = corner + from_corner;
    let world_from_local = Columns::of(&instance.world_from_local, instance.flags, InstanceFlags::EXACT_WORLD_ROWS);
    let (position, to_world_error) = world_from_local.transform(local, 1.0);

    // 2. The geometric normal, from edges that are scaled to about 1.
    let extent = max_component(edge_1.abs().max(edge_2.abs()));
    let to_unit_edges = reciprocal_power_of_two(extent);
    let (unit_1, unit_2) = (edge_1 * to_unit_edges, edge_2 * to_unit_edges);
    let local_normal = cross3(unit_1, unit_2);
    let world_normal = transform_normal(&instance.local_from_world, local_normal);
    let largest = max_component(world_normal.abs());
    let has_plane = largest > 0.0;
    if !has_plane {
        return HitPoint { position, normal: fallback, ray_offset: 0.0 };
    }
    let scale = reciprocal_power_of_two(largest);
    let scaled_length = length3(world_normal * scale);
    let normal = world_normal * (scale / scaled_length);

    // 3. Bounds of the rounding errors along the normal: in local space steps 1, 4 and 5, in world space 2 and 3.
    let edges_error = sum_error(v0, v1, edge_1) * along_1.abs() + sum_error(v0, v2, edge_2) * along_2.abs();
    let reach = edge_1.abs() * along_1.abs() + edge_2.abs() * along_2.abs();
    let to_corners = to_likely_corners(edge_1, edge_2, weights);
    let rounded = reach * 2.0 + to_corners * Vec3::new(3.0, 3.0, 4.0);
    let local_from_world = Columns::of(&instance.local_from_world, instance.flags, InstanceFlags::EXACT_LOCAL_ROWS);
    let (_, to_local_error) = local_from_world.transform(position, 0.0);
    let local_error = ((edges_error * 2.0 + rounded * HALF_ULP) + sum_error(corner, from_corner, local))
        + (to_local_error + Vec3::splat(LEAST_OFFSET * extent));
    let products = dot3(abs_cross3(unit_1.abs(), unit_2.abs()), to_corners);
    let along_local = dot3(local_normal.abs(), local_error) + products * HALF_ULP;
    let world_error = to_world_error + position.abs() * HALF_ULP;

    // 4. The distance along the world-space normal that covers them.
    let distance = (along_local * scale) / scaled_length + dot3(normal.abs(), world_error);
    HitPoint { position, normal, ray_offset: distance * OFFSET_MARGIN }
}

/// Bounds the way from a point of a triangle to the vertex by which the next ray's test measures its distance, per
/// coordinate: to any vertex with a weight that is not far from the greatest.
fn to_likely_corners(edge_1: Vec3, edge_2: Vec3, weights: Vec3) -> Vec3 {
    let from_v0 = edge_1 * weights.y + edge_2 * weights.z;
    let mut largest = Vec3::ZERO;
    if weights.x >= LIKELY_WEIGHT {
        largest = from_v0.abs();
    }
    if weights.y >= LIKELY_WEIGHT {
        largest = largest.max((from_v0 - edge_1).abs());
    }
    if weights.z >= LIKELY_WEIGHT {
        largest = largest.max((from_v0 - edge_2).abs());
    }
    largest
}

/// The cross product of two vectors with all products added: of vectors without negative components, the sums that
/// bound the rounding of their cross product, whatever their signs were.
fn abs_cross3(a: Vec3, b: Vec3) -> Vec3 {
    Vec3::new(a.y * b.z + a.z * b.y, a.z * b.x + a.x * b.z, a.x * b.y + a.y * b.x)
}

/// An affine matrix by columns.
struct Columns {
    x: Vec3,
    y: Vec3,
    z: Vec3,
    translation: Vec3,
    /// Per row: 0 if it is exact, so that it multiplies without rounding; else 1.
    is_rounded: Vec3,
}

impl Columns {
    /// `exact_rows` are the three flags of the instance that say which rows are exact.
    #[inline(always)]
    fn of(rows: &[[f32; 4]; 3], flags: u32, exact_rows: InstanceFlags) -> Self {
        let [x, y, z, translation] = [0, 1, 2, 3].map(|i| Vec3::new(rows[0][i], rows[1][i], rows[2][i]));
        let exact = flags >> exact_rows.bits().trailing_zeros();
        let is_rounded = [exact & 1, exact >> 1 & 1, exact >> 2 & 1].map(|is_exact| 1.0 - is_exact as f32);
        Self { x, y, z, translation, is_rounded: is_rounded.into() }
    }

    /// Transforms a point, as [`transform_point`](super::math::transform_point) does, and bounds the error per
    /// coordinate. `matrix_rounding` is 1 if the matrix is a rounded one, and 0 if it is exact by definition.
    ///
    /// What is exact adds nothing: the products of an exact row, a sum with 0. So the bound is 0 for an instance that
    /// is not moved, and a sum's rounding for one that is only moved.
    #[inline(always)]
    fn transform(&self, point: Vec3, matrix_rounding: f32) -> (Vec3, Vec3) {
        let (x, y, z) = (self.x * point.x, self.y * point.y, self.z * point.z);
        let sum_xy = x + y;
        let sum_xyz = sum_xy + z;
        let transformed = sum_xyz + self.translation;
        // A rounding of each product, and of each number of the matrix.
        let products = (x.abs() + y.abs()) + z.abs();
        let rounded = products * (1.0 + matrix_rounding) + self.translation.abs() * matrix_rounding;
        // The sums.
        let sums = (sum_error(x, y, sum_xy) + sum_error(sum_xy, z, sum_xyz))
            + sum_error(sum_xyz, self.translation, transformed);
        (transformed, rounded * self.is_rounded * HALF_ULP + sums)
    }
}

/// Bounds the rounding error of a sum, per coordinate: half an ulp of it, and no more than the smaller operand, since
/// the greater one is a number that it could be rounded to.
fn sum_error(a: Vec3, b: Vec3, sum: Vec3) -> Vec3 {
    let smallest = |a: f32, b: f32, sum: f32| min(min(a.abs(), b.abs()), sum.abs() * HALF_ULP);
    Vec3::new(smallest(a.x, b.x, sum.x), smallest(a.y, b.y, sum.y), smallest(a.z, b.z, sum.z))
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
    use crate::trace::kernel::math::transform_point;
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

    /// How a random triangle lies.
    #[derive(Clone, Copy, Debug)]
    enum Kind {
        /// Along two axes, at any coordinate of the third.
        AxisAligned,
        /// As that, but tilted by a thousandth.
        NearlyAligned,
        Tilted,
        /// Tilted, and a hundred times longer than wide.
        Sliver,
    }

    /// A triangle of this size, so many times its size away from the origin of its space.
    fn random_triangle(random: &mut Random, kind: Kind, size: f64, away: f64) -> [DVec3; 3] {
        let [along, across] = loop {
            let [a, b] = [random.direction(), random.direction()];
            if a.cross(b).length() > 0.3 {
                break [a, b];
            }
        };
        let mut edges = [along, if matches!(kind, Kind::Sliver) { along * 0.7 + across * 0.01 } else { across }];
        let axis = (random.next() * 3.0) as usize;
        for edge in &mut edges {
            match kind {
                Kind::AxisAligned => edge[axis] = 0.0,
                Kind::NearlyAligned => edge[axis] *= 1e-3,
                Kind::Tilted | Kind::Sliver => {}
            }
        }
        let first = (random.direction() * random.next() + random.direction() * 3.0) * away;
        [first, first + edges[0], first + edges[1]].map(|v| v * size)
    }

    /// Compiles a triangle and its neighbour in one plane, placed by a matrix, with the render origin at 0.
    fn compiled(corners: [Vec3; 3], place: DAffine3) -> Compiler {
        let [v0, v1, v2] = corners;
        let mut scene = Scene::new();
        let geometry = Geometry::new(vec![v0, v1, v2, v1 + (v2 - v0)], [[0, 1, 2], [2, 1, 3]]);
        let geometry = scene.add_geometry(geometry).unwrap();
        let material = scene.add_material(Material { double_sided: true, ..Material::default() }).unwrap();
        let node = scene.add(scene.root(), Transform::Matrix(place)).unwrap();
        scene.add(node, Core::Geometry { geometry, material }).unwrap();
        let mut compiler = Compiler::new();
        compiler.compile(&mut scene, DVec3::ZERO).unwrap();
        compiler
    }

    /// The plane of a triangle as it is drawn, in f64.
    struct ExactPlane {
        /// The first vertex, and the unit normal, in local space.
        corner: DVec3,
        normal: DVec3,
        local_from_world: DAffine3,
        /// Factor from a distance from the plane in local space to one in world space.
        world_scale: f64,
    }

    impl ExactPlane {
        fn new(instance: &InstanceRecord, triangle: &Triangle) -> Self {
            let [v0, v1, v2] = [triangle.v0, triangle.v1, triangle.v2].map(|v| Vec3::from_array(v).as_dvec3());
            let [x, y, z] = instance.local_from_world.map(|row| row.map(f64::from));
            let linear = glam::DMat3::from_cols_array_2d(&[x, y, z].map(|[x, y, z, _]| [x, y, z])).transpose();
            let local_from_world = DAffine3::from_mat3_translation(linear, DVec3::new(x[3], y[3], z[3]));
            let normal = (v1 - v0).cross(v2 - v0).normalize();
            let world_scale = 1.0 / (linear.transpose() * normal).length();
            Self { corner: v0, normal, local_from_world, world_scale }
        }

        /// The signed distance of a world-space point from the plane.
        fn distance(&self, point: Vec3) -> f64 {
            let local = self.local_from_world.transform_point3(point.as_dvec3());
            self.normal.dot(local - self.corner) * self.world_scale
        }

        /// The signed distance of the origin of a ray from the plane as the triangle test computes it.
        fn computed_distance(
            &self,
            instance: &InstanceRecord,
            triangle: &Triangle,
            weights: Vec3,
            origin: Vec3,
        ) -> f64 {
            let vertices = [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from_array);
            let [v0, v1, v2] = vertices;
            let origin = transform_point(&instance.local_from_world, origin);
            let largest = vertices.iter().fold(origin.abs(), |largest, v| largest.max(v.abs()));
            let scale = reciprocal_power_of_two(max_component(largest));
            let normal = cross3((v1 - v0) * scale, (v2 - v0) * scale);
            let corner = (0..3).max_by(|&i, &j| weights[i].total_cmp(&weights[j])).unwrap();
            let height = f64::from(dot3(normal, vertices[corner] - origin));
            let exact = (v1.as_dvec3() - v0.as_dvec3()).cross(v2.as_dvec3() - v0.as_dvec3()).length();
            -height / (exact * f64::from(scale).powi(2)) * self.world_scale
        }
    }

    /// What is measured of one kind of triangle in one place.
    #[derive(Default)]
    struct Measured {
        /// The largest error, world units: how far the triangle test is off when it finds a ray's origin at some
        /// distance from the plane, of which the ray was meant to start at.
        error: f64,
        offsets: Vec<f64>,
    }

    /// Compares offsets of random points of a triangle with the errors they must cover, and lets rays leave.
    fn measure(name: &str, corners: [Vec3; 3], place: DAffine3, random: &mut Random, measured: &mut Measured) -> usize {
        let compiler = compiled(corners, place);
        let kernel = KernelScene::new(compiler.arrays());
        let instance = &kernel.instances[0];
        let triangle = kernel.triangles.iter().find(|triangle| triangle.primitive == 0).unwrap();
        let plane = ExactPlane::new(instance, triangle);
        let mut rays = 0;
        for i in 0..100 {
            // Points anywhere, some beside an edge and some at a vertex.
            let (a, b) = (random.next() as f32, random.next() as f32);
            let b = if i % 10 == 0 { b * 1e-6 } else { b };
            let a = if i % 50 == 0 { 0.0 } else { a };
            let weights = Vec3::new(1.0 - a, a * (1.0 - b), a * b);
            let at = hit_point(instance, triangle, weights, Vec3::X);
            let offset = f64::from(at.ray_offset);
            measured.offsets.push(offset);
            for side in [1.0f32, -1.0] {
                // Errors of origins at various distances, up to the offset: all of these roundings could have happened.
                let wanted = random.next() as f32 * at.ray_offset;
                for wanted in [wanted, at.ray_offset] {
                    let origin = at.position + at.normal * (side * wanted);
                    let found = plane.computed_distance(instance, triangle, weights, origin);
                    let error = (found - f64::from(side * wanted)).abs();
                    assert!(error < offset, "{name}: {error:e} of {offset:e} at {weights} of {corners:?} {place}");
                    measured.error = measured.error.max(error);
                    // The exact distance of the rounded origin differs less, but for the triangle test's own rounding.
                    let error = (plane.distance(origin) - f64::from(side * wanted)).abs();
                    assert!(error < offset, "{name}: {error:e} of {offset:e} at {weights} of {corners:?} {place}");
                }
                // A ray that leaves meets neither this triangle nor its neighbour.
                for _ in 0..2 {
                    let direction = random.outward(at.normal * side);
                    let leaving = ray(at.position + at.normal * (side * at.ray_offset), direction);
                    let again = closest_hit(&kernel, &leaving, u32::MAX);
                    assert_eq!(again.instance, NONE, "{name}: {weights} of {corners:?} {place} along {leaving:?}");
                    assert!(!any_hit(&kernel, &leaving, u32::MAX));
                    rays += 1;
                }
            }
        }
        rays
    }

    /// The places at which the triangles are tested, of this size.
    fn places(size: f64) -> [(&'static str, DAffine3); 8] {
        let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 1.0);
        let stretch = DVec3::new(1.0, 3.0, -0.2);
        let way = DVec3::new(0.9, -1.3, 0.7) * size;
        [
            ("identity", DAffine3::IDENTITY),
            ("moved", DAffine3::from_translation(way)),
            ("moved far", DAffine3::from_translation(way * 1e3)),
            ("turned", DAffine3::from_quat(turn)),
            ("turned and moved", DAffine3::from_rotation_translation(turn, way)),
            ("turned and moved far", DAffine3::from_rotation_translation(turn, way * 1e3)),
            ("scaled", DAffine3::from_scale_rotation_translation(DVec3::splat(1e-3), turn, way * 1e-3)),
            ("stretched", DAffine3::from_scale_rotation_translation(stretch, turn, way)),
        ]
    }

    #[test]
    fn offsets_are_a_few_times_the_largest_error_seen() {
        let mut random = Random(fastrand::Rng::with_seed(3));
        let (mut ratios, mut rays, mut exact) = (Vec::new(), 0, 0);
        for size in [1e-3, 1.0, 30.0, 1e3, 1e6] {
            for kind in [Kind::AxisAligned, Kind::NearlyAligned, Kind::Tilted, Kind::Sliver] {
                for (away, (place_name, place)) in
                    [0.0, 1.0, 10.0].into_iter().flat_map(|a| places(size).map(|p| (a, p)))
                {
                    let name = format!("{kind:?} of size {size}, {away} sizes away, {place_name}");
                    let triangle = random_triangle(&mut random, kind, size, away);
                    let mut measured = Measured::default();
                    // Copies that are larger by up to a hundredth: other roundings of about the same numbers.
                    for _ in 0..12 {
                        let larger = 1.0 + 0.01 * random.next();
                        let corners = triangle.map(|v| (v * larger).as_vec3());
                        let mut place = place;
                        place.translation *= larger;
                        rays += measure(&name, corners, place, &mut random, &mut measured);
                    }
                    let largest = measured.offsets.iter().fold(0.0, |m: f64, &offset| m.max(offset));
                    if largest < 8.0 * f64::from(LEAST_OFFSET) * size {
                        // Nothing is rounded along the normal.
                        exact += 1;
                        continue;
                    }
                    ratios.extend(measured.offsets.iter().map(|offset| offset / measured.error));
                }
            }
        }
        ratios.sort_by(f64::total_cmp);
        let at = |fraction: f64| ratios[((ratios.len() - 1) as f64 * fraction) as usize];
        println!(
            "{} offsets over {rays} rays: median {:.2}, 99 % {:.2}, largest {:.2} times the largest error; {exact} exact",
            ratios.len(),
            at(0.5),
            at(0.99),
            at(1.0),
        );
        assert!(ratios.len() > 400_000 && rays > 1_000_000 && exact > 0, "{} {rays} {exact}", ratios.len());
        assert!(at(1.0) <= 8.0, "{}", at(1.0));
    }
}
