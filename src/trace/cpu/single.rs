//! One ray at a time through wide nodes: eight boxes at once, then four triangles at once.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f32x8, f32x16};
use glam::Vec3;

use super::lanes::{Axes, corners, cross, each, halves, planes};
use crate::device::layout::{Instance, Ray, Triangle, WideNode};
use crate::trace::kernel::{BOX_SLACK, KernelScene, ShearRay, SlabRay, plane_distance, shear_ray, slab_ray};
use crate::trace::queries::Candidate;

/// A node whose children are being visited.
#[derive(Clone, Copy)]
pub(super) struct Level {
    /// Where the ray enters the children's boxes.
    pub(super) enters: [f32; 8],
    pub(super) node: u32,
    /// A bit for each child that is still to be visited.
    pub(super) waiting: u32,
}

/// The levels above the current one. Kept from ray to ray, so that nothing clears it.
pub(super) struct Stack(pub(super) [Level; crate::accel::MAX_WIDE_DEPTH + 1]);

impl Default for Stack {
    fn default() -> Self {
        Self([Level { enters: [0.0; 8], node: 0, waiting: 0 }; crate::accel::MAX_WIDE_DEPTH + 1])
    }
}

/// For each octant of a ray's direction and each set of children the slot of the first to be visited: the least `slot ^ octant`.
pub(super) static FIRST: [[u8; 256]; 8] = {
    let mut first = [[0; 256]; 8];
    let mut octant = 0;
    while octant < 8 {
        let mut set = 1;
        while set < 256 {
            let mut rank = 0;
            while set >> (rank ^ octant) & 1 == 0 {
                rank += 1;
            }
            first[octant][set] = (rank ^ octant) as u8;
            set += 1;
        }
        octant += 1;
    }
    first
};

/// A ray in the space of an instance.
pub(super) struct LocalRay<S: Simd> {
    origin: [f32; 3],
    /// For near planes in the lower lanes, times the slack of boxes; for far planes in the upper ones, negated.
    scales: [f32x16<S>; 3],
    near: [usize; 3],
    octant: usize,
    axes: Axes,
    x_scale: f32x4<S>,
    slope_x: f32x4<S>,
    slope_y: f32x4<S>,
    t_scale: f32x4<S>,
    depth_scale: f32x4<S>,
    shear: ShearRay,
    t_min: f32,
}

impl<S: Simd> LocalRay<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, origin: Vec3, direction: Vec3, t_min: f32, root: &WideNode) -> Self {
        let slab = slab_ray(origin, direction);
        let step = |axis: usize| f32::from_bits(u32::from(root.exponents[axis]) << 23);
        let least = Vec3::from_array(root.origin);
        let greatest = least + Vec3::new(step(0), step(1), step(2)) * 255.0;
        let extent = least.abs().max(greatest.abs()).max(origin.abs()).max_element();
        let shear = shear_ray(origin, direction, extent);
        Self::of(simd, &slab, &shear, direction, t_min)
    }

    #[inline(always)]
    fn of(simd: S, slab: &SlabRay, shear: &ShearRay, direction: Vec3, t_min: f32) -> Self {
        let d = direction.abs();
        let depth_axis = if d.x >= d.y && d.x >= d.z {
            0
        } else if d.y >= d.z {
            1
        } else {
            2
        };
        let order = [(depth_axis + 1) % 3, (depth_axis + 2) % 3];
        let swap = direction[depth_axis] < 0.0;
        let order = if swap { [order[1], order[0], depth_axis] } else { [order[0], order[1], depth_axis] };
        let splat = |value| f32x4::splat(simd, value);
        Self {
            origin: slab.origin.to_array(),
            scales: each(
                slab.reciprocal.to_array(),
                #[inline(always)]
                |r| f32x8::splat(simd, r * BOX_SLACK).combine(f32x8::splat(simd, -r)),
            ),
            near: slab.reciprocal.to_array().map(|r| usize::from(r < 0.0)),
            octant: [0, 1, 2].iter().map(|&axis| usize::from(slab.reciprocal[axis] < 0.0) << axis).sum(),
            axes: Axes { order },
            x_scale: splat(shear.x_row[order[0]]),
            slope_x: splat(shear.x_row[depth_axis]),
            slope_y: splat(shear.y_row[depth_axis]),
            t_scale: splat(shear.t_row[depth_axis]),
            depth_scale: splat(shear.depth_scale),
            shear: *shear,
            t_min,
        }
    }
}

/// Visits what the ray crosses in the structure that starts at these places of `wide_nodes` and `triangles`, near parts first, as long as it lies no farther than `t_max`, which `visit` returns anew.
#[inline(always)]
pub(super) fn walk<S: Simd>(
    simd: S,
    scene: &KernelScene<'_>,
    [first_node, first_triangle]: [u32; 2],
    ray: &LocalRay<S>,
    stack: &mut Stack,
    mut t_max: f32,
    mut visit: impl FnMut(&Candidate) -> f32,
) {
    let stack = &mut stack.0;
    let first_of = &FIRST[ray.octant & 7];
    let nodes = &scene.wide_nodes[first_node as usize..];
    let triangles = &scene.triangles[first_triangle as usize..];
    let mut range = range(simd, ray.t_min, t_max);
    let mut depth = 0;
    let mut index = 0;
    loop {
        let node = &nodes[index as usize];
        let (mut waiting, enters) = meet(simd, ray, node, range);
        stack[depth] = Level { enters, node: index, waiting: 0 };
        let mut node = node;
        // The next inner node, through the leaves on the way.
        index = loop {
            while waiting == 0 {
                if depth == 0 {
                    return;
                }
                depth -= 1;
                let level = &stack[depth];
                let enters: f32x8<S> = level.enters.simd_into(simd);
                waiting = level.waiting & enters.simd_le(f32x8::splat(simd, t_max)).to_bitmask() as u32;
                node = &nodes[level.node as usize];
            }
            let slot = usize::from(first_of[waiting as usize & 255]) & 7;
            waiting &= !(1 << slot);
            let child = node.children[slot];
            if child.count() == 0 {
                stack[depth].waiting = waiting;
                depth += usize::from(waiting != 0);
                break child.first();
            }
            let leaf = &triangles[child.first() as usize..];
            let count = child.count() as usize;
            let before = t_max;
            for start in (0..count).step_by(4) {
                t_max = cross_four(
                    simd,
                    ray,
                    leaf,
                    start,
                    count - start,
                    first_triangle + child.first(),
                    t_max,
                    &mut visit,
                );
            }
            if t_max != before {
                range = self::range(simd, ray.t_min, t_max);
                let enters: f32x8<S> = stack[depth].enters.simd_into(simd);
                waiting &= enters.simd_le(f32x8::splat(simd, t_max)).to_bitmask() as u32;
            }
        };
    }
}

/// What boxes must reach of the ray: its start in the lower lanes, its end, negated, in the upper ones.
#[inline(always)]
pub(super) fn range<S: Simd>(simd: S, t_min: f32, t_max: f32) -> f32x16<S> {
    f32x8::splat(simd, t_min * BOX_SLACK).combine(f32x8::splat(simd, -t_max))
}

/// The children whose boxes the ray meets, and where.
#[inline(always)]
fn meet<S: Simd>(simd: S, ray: &LocalRay<S>, node: &WideNode, range: f32x16<S>) -> (u32, [f32; 8]) {
    let [x, y, z] = each(
        [0, 1, 2],
        #[inline(always)]
        |axis: usize| {
            let step = f32::from_bits(u32::from(node.exponents[axis]) << 23);
            let offset = node.origin[axis] - ray.origin[axis];
            let planes = planes(simd, node, axis, ray.near[axis]);
            planes.mul_add(f32x16::splat(simd, step), f32x16::splat(simd, offset)) * ray.scales[axis]
        },
    );
    // Where it enters, and where it leaves, negated: the greatest of both.
    let (enters, leaves) = halves(x.max(y).max(z.max(range)));
    let met = (enters + leaves).simd_le(f32x8::splat(simd, 0.0)).to_bitmask() as u32;
    (met & u32::from(node.exponents[3]), enters.into())
}

/// Four triangles, the last ones of the array over and over.
#[inline(always)]
pub(super) fn four_of(leaf: &[Triangle], start: usize) -> [Triangle; 4] {
    match leaf.get(start..start + 4) {
        Some(four) => [four[0], four[1], four[2], four[3]],
        None => {
            let last = leaf.len() - 1;
            [leaf[start.min(last)], leaf[(start + 1).min(last)], leaf[(start + 2).min(last)], leaf[last]]
        }
    }
}

#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "a part of `walk`")]
fn cross_four<S: Simd>(
    simd: S,
    ray: &LocalRay<S>,
    leaf: &[Triangle],
    start: usize,
    count: usize,
    first: u32,
    mut t_max: f32,
    visit: &mut impl FnMut(&Candidate) -> f32,
) -> f32 {
    let four = four_of(leaf, start);
    let [x_axis, y_axis, t_axis] = ray.axes.order;
    let [a, b, c] = each(
        corners(simd, &four, ray.axes),
        #[inline(always)]
        |[x, y, t]| [x - ray.origin[x_axis], y - ray.origin[y_axis], t - ray.origin[t_axis]],
    );
    let x = each(
        [a, b, c],
        #[inline(always)]
        |[x, _, t]| x * ray.x_scale + t * ray.slope_x,
    );
    let y = each(
        [a, b, c],
        #[inline(always)]
        |[_, y, t]| y * ray.x_scale + t * ray.slope_y,
    );
    let t = each(
        [a, b, c],
        #[inline(always)]
        |[_, _, t]| t * ray.t_scale,
    );
    // Seldom more than one of them.
    let crossings = cross(
        simd,
        x,
        y,
        t,
        ray.depth_scale,
        #[inline(always)]
        |crossed, t, weights| {
            plane_distances(&ray.shear, &four, crossed, t.map(f32x4::into), weights.map(f32x4::into)).simd_into(simd)
        },
    );
    let Some((mut crossed, crossings)) = crossings else { return t_max };
    crossed &= (1 << count.min(4)) - 1;
    crossed &= (crossings.t.simd_ge(f32x4::splat(simd, ray.t_min)) & crossings.t.simd_le(f32x4::splat(simd, t_max)))
        .to_bitmask();
    if crossed != 0 {
        let (t, u, v): ([f32; 4], [f32; 4], [f32; 4]) = (crossings.t.into(), crossings.u.into(), crossings.v.into());
        while crossed != 0 {
            let lane = crossed.trailing_zeros() as usize & 3;
            crossed &= crossed - 1;
            let triangle = first + (start + lane) as u32;
            let back = crossings.back >> lane & 1 != 0;
            t_max = visit(&Candidate { t: t[lane], u: u[lane], v: v[lane], back, triangle });
        }
    }
    t_max
}

/// Of those that the ray crosses.
#[inline(never)]
fn plane_distances(
    ray: &ShearRay,
    four: &[Triangle; 4],
    mut crossed: u64,
    t: [[f32; 4]; 3],
    weights: [[f32; 4]; 3],
) -> [f32; 4] {
    let mut distances = [0.0; 4];
    while crossed != 0 {
        let lane = crossed.trailing_zeros() as usize & 3;
        crossed &= crossed - 1;
        let of_lane = |v: [[f32; 4]; 3]| Vec3::new(v[0][lane], v[1][lane], v[2][lane]);
        distances[lane] = plane_distance(ray, &four[lane], of_lane(t), of_lane(weights));
    }
    distances
}

/// The instance's own ray.
#[inline(always)]
pub(super) fn local_ray<S: Simd>(
    simd: S,
    scene: &KernelScene<'_>,
    instance: &Instance,
    ray: &Ray,
) -> (u32, LocalRay<S>) {
    let first = scene.geometries[instance.geometry as usize].first_wide_node;
    let origin = crate::trace::kernel::math::transform_point(&instance.local_from_world, Vec3::from_array(ray.origin));
    let direction =
        crate::trace::kernel::math::transform_vector(&instance.local_from_world, Vec3::from_array(ray.direction));
    (first, LocalRay::new(simd, origin, direction, ray.t_min, &scene.wide_nodes[first as usize]))
}
