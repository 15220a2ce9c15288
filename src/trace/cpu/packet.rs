//! Sixteen rays that go much the same way: interval arithmetic on all of them at once against eight boxes at once, single rays
//! only against the boxes of leaves and against triangles.
//!
//! A product with a reciprocal, a sum, a difference: each is monotonic, rounded or not. So bounds computed from the least and greatest
//! origins and reciprocals bound what is computed for each ray, exactly, and a box that any ray of the packet meets is met.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f32x16};
use glam::Vec3;

use super::lanes::{Axes, Unsheared, cross, each, halves, load, pair, plane_distances, planes, splats, step};
use super::single::{FIRST, Level, Stack, range};
use crate::device::layout::{Instance, Ray, Triangle, WideNode};
use crate::trace::kernel::{BOX_SLACK, KernelScene, LEAST_COMPONENT, LEAST_SHARE, reciprocal_power_of_two};
use crate::trace::queries::Candidate;

/// Rays of a packet.
pub(super) const LANES: usize = 16;

type Numbers = [f32; LANES];

/// Rays in world space, a lane each.
pub(super) struct Packet<S: Simd> {
    pub(super) origins: [f32x16<S>; 3],
    pub(super) directions: [f32x16<S>; 3],
    pub(super) t_min: f32x16<S>,
    pub(super) t_max: f32x16<S>,
}

/// Of pairs of vectors the even elements, then the odd ones.
#[inline(always)]
fn deinterleaved<S: Simd>(v: [f32x16<S>; 8]) -> [f32x16<S>; 8] {
    let (a, b, c, d) =
        (v[0].deinterleave(v[1]), v[2].deinterleave(v[3]), v[4].deinterleave(v[5]), v[6].deinterleave(v[7]));
    [a.0, b.0, c.0, d.0, a.1, b.1, c.1, d.1]
}

impl<S: Simd> Packet<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, rays: &[Ray; LANES]) -> Self {
        // Three times the even elements and the odd ones: then each vector holds one number of all rays.
        let words: &[[f32; LANES]; 8] = bytemuck::cast_ref(rays);
        let v: [f32x16<S>; 8] = [
            load(simd, words[0]),
            load(simd, words[1]),
            load(simd, words[2]),
            load(simd, words[3]),
            load(simd, words[4]),
            load(simd, words[5]),
            load(simd, words[6]),
            load(simd, words[7]),
        ];
        let v = deinterleaved(deinterleaved(deinterleaved(v)));
        Self { origins: [v[0], v[1], v[2]], t_min: v[3], directions: [v[4], v[5], v[6]], t_max: v[7] }
    }
}

/// The rays of a packet as boxes see them.
pub(super) struct Slabs<S: Simd> {
    origins: [f32x16<S>; 3],
    reciprocals: [f32x16<S>; 3],
    t_min: f32x16<S>,
}

impl<S: Simd> Packet<S> {
    #[inline(always)]
    pub(super) fn slabs(&self, simd: S) -> Slabs<S> {
        Slabs { origins: self.origins, reciprocals: reciprocals(simd, self.directions), t_min: self.t_min }
    }
}

/// As [`slab_ray`](crate::trace::kernel::slab_ray).
#[inline(always)]
fn reciprocals<S: Simd>(simd: S, directions: [f32x16<S>; 3]) -> [f32x16<S>; 3] {
    let lengths = each(
        directions,
        #[inline(always)]
        |d| d.abs(),
    );
    let least = (lengths[0].max(lengths[1]).max(lengths[2]) * LEAST_SHARE).max(LEAST_COMPONENT);
    each(
        [0, 1, 2],
        #[inline(always)]
        |axis: usize| {
            let reciprocal = f32x16::splat(simd, 1.0) / lengths[axis].max(least);
            directions[axis].simd_lt(0.0).select(-reciprocal, reciprocal)
        },
    )
}

impl<S: Simd> Slabs<S> {
    /// Where the rays enter a box and leave it.
    #[inline(always)]
    pub(super) fn meet(&self, simd: S, min: [f32; 3], max: [f32; 3], t_max: &Numbers) -> (f32x16<S>, f32x16<S>) {
        let t = each(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let a = (f32x16::splat(simd, min[axis]) - self.origins[axis]) * self.reciprocals[axis];
                let b = (f32x16::splat(simd, max[axis]) - self.origins[axis]) * self.reciprocals[axis];
                (a.min(b), a.max(b))
            },
        );
        let t_max: f32x16<S> = (*t_max).simd_into(simd);
        (t[0].0.max(t[1].0).max(t[2].0.max(self.t_min)), t[0].1.min(t[1].1).min(t[2].1.min(t_max)))
    }
}

/// A packet in the space of an instance.
pub(super) struct LocalPacket<S: Simd> {
    origins: [f32x16<S>; 3],
    directions: [f32x16<S>; 3],
    reciprocals: [f32x16<S>; 3],
    t_min: f32x16<S>,
    /// The least and greatest origins, in the lower lanes those that make planes nearer, in the upper ones those that make them farther.
    outer_origins: [f32x16<S>; 3],
    /// The least reciprocals as near planes and far planes are multiplied by them, see [`super::single`]; then the greatest.
    outer_scales: [[f32x16<S>; 3]; 2],
    near: [usize; 3],
    octant: usize,
    least_t_min: f32,
    axes: Axes,
    /// As `axes` has them.
    ordered_origins: [f32x16<S>; 3],
    scale: f32,
    slopes: [f32x16<S>; 2],
    t_scale: f32x16<S>,
    depth_scale: f32x16<S>,
}

impl<S: Simd> LocalPacket<S> {
    /// `None` if the rays do not go into one octant, or not most along one axis.
    #[inline(always)]
    pub(super) fn new(
        simd: S,
        scene: &KernelScene<'_>,
        instance: &Instance,
        packet: &Packet<S>,
    ) -> Option<(u32, Self)> {
        let first = scene.geometries[instance.geometry as usize].first_wide_node;
        let root = &scene.wide_nodes[first as usize];
        let [o, d] = [packet.origins, packet.directions];
        let rows = &instance.local_from_world;
        let origins = each(
            *rows,
            #[inline(always)]
            |[x, y, z, w]| (o[0] * x + o[1] * y) + o[2] * z + w,
        );
        let directions = each(
            *rows,
            #[inline(always)]
            |[x, y, z, _]| (d[0] * x + d[1] * y) + d[2] * z,
        );

        // 1. The way they all go.
        let least = each(
            directions,
            #[inline(always)]
            |d| {
                reduce(
                    d,
                    #[inline(always)]
                    |a, b| a.min(b),
                )
            },
        );
        let greatest = each(
            directions,
            #[inline(always)]
            |d| {
                reduce(
                    d,
                    #[inline(always)]
                    |a, b| a.max(b),
                )
            },
        );
        let negative = each(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| greatest[axis] < 0.0,
        );
        let lengths = each(
            directions,
            #[inline(always)]
            |d| d.abs(),
        );
        let [x, y, z] = lengths;
        let x_most = (x.simd_ge(y) & x.simd_ge(z)).to_bitmask();
        let y_most = y.simd_ge(z).to_bitmask();
        let depth_axis = match (x_most, y_most) {
            (0xffff, _) => 0,
            (0, 0xffff) => 1,
            (0, 0) => 2,
            _ => return None,
        };
        let goes_up = |axis: usize| least[axis] >= 0.0;
        if !(0..3).all(|axis| negative[axis] || goes_up(axis)) {
            return None;
        }

        // 2. What boxes need.
        let reciprocals = reciprocals(simd, directions);
        let least_origins = each(
            origins,
            #[inline(always)]
            |o| {
                reduce(
                    o,
                    #[inline(always)]
                    |a, b| a.min(b),
                )
            },
        );
        let greatest_origins = each(
            origins,
            #[inline(always)]
            |o| {
                reduce(
                    o,
                    #[inline(always)]
                    |a, b| a.max(b),
                )
            },
        );
        let least_reciprocals = each(
            reciprocals,
            #[inline(always)]
            |r| {
                reduce(
                    r,
                    #[inline(always)]
                    |a, b| a.min(b),
                )
            },
        );
        let greatest_reciprocals = each(
            reciprocals,
            #[inline(always)]
            |r| {
                reduce(
                    r,
                    #[inline(always)]
                    |a, b| a.max(b),
                )
            },
        );
        let outer_origins = each(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let (least, greatest) = (least_origins[axis], greatest_origins[axis]);
                if negative[axis] { pair(simd, least, greatest) } else { pair(simd, greatest, least) }
            },
        );
        let t_min = packet.t_min;

        // 3. What triangles need.
        let corner = Vec3::from_array(root.origin);
        let corner = corner.abs().max((corner + Vec3::new(step(root, 0), step(root, 1), step(root, 2)) * 255.0).abs());
        let origin = Vec3::from_array(least_origins).abs().max(Vec3::from_array(greatest_origins).abs());
        let scale = reciprocal_power_of_two(corner.max(origin).max_element());
        let [i, j] = [(depth_axis + 1) % 3, (depth_axis + 2) % 3];
        let order = if negative[depth_axis] { [j, i, depth_axis] } else { [i, j, depth_axis] };
        let depth = directions[depth_axis];
        let local = Self {
            origins,
            directions,
            reciprocals,
            t_min,
            outer_origins,
            outer_scales: [scales(simd, least_reciprocals), scales(simd, greatest_reciprocals)],
            near: each(
                negative,
                #[inline(always)]
                |negative| usize::from(negative),
            ),
            octant: usize::from(negative[0]) | usize::from(negative[1]) << 1 | usize::from(negative[2]) << 2,
            least_t_min: reduce(
                t_min,
                #[inline(always)]
                |a, b| a.min(b),
            ),
            axes: Axes { order },
            ordered_origins: each(
                order,
                #[inline(always)]
                |axis: usize| origins[axis % 3],
            ),
            scale,
            slopes: [-directions[order[0]] / depth * scale, -directions[order[1]] / depth * scale],
            t_scale: f32x16::splat(simd, 1.0) / depth,
            depth_scale: depth.abs() * scale,
        };
        Some((first, local))
    }
}

/// What near and far planes are multiplied by.
#[inline(always)]
fn scales<S: Simd>(simd: S, reciprocals: [f32; 3]) -> [f32x16<S>; 3] {
    each(
        reciprocals,
        #[inline(always)]
        |r| pair(simd, r * BOX_SLACK, -r),
    )
}

/// Folds all lanes into one.
#[inline(always)]
fn reduce<S: Simd>(v: f32x16<S>, f: impl Fn(f32x8<S>, f32x8<S>) -> f32x8<S>) -> f32 {
    let (a, b) = v.split();
    let v = f(a, b);
    let v = f(v, v.rotate_elements_left::<4>());
    let v = f(v, v.rotate_elements_left::<2>());
    f(v, v.rotate_elements_left::<1>()).as_array()[0]
}

/// Visits what the rays cross in a structure, as [`walk`](super::single::walk) does for one: `visit` is given the lane and
/// returns how far that ray goes from now on.
#[inline(always)]
pub(super) fn walk_packet<S: Simd>(
    simd: S,
    scene: &KernelScene<'_>,
    [first_node, first_triangle]: [u32; 2],
    packet: &LocalPacket<S>,
    stack: &mut Stack,
    t_max: &mut Numbers,
    mut visit: impl FnMut(usize, &Candidate) -> f32,
) {
    let stack = &mut stack.0;
    let first_of = &FIRST[packet.octant & 7];
    let nodes = &scene.wide_nodes[first_node as usize..];
    let triangles = &scene.triangles[first_triangle as usize..];
    let mut farthest = greatest(simd, t_max);
    let mut depth = 0;
    let mut index = 0;
    loop {
        let mut node = &nodes[index as usize];
        let (mut waiting, enters) = meet(simd, packet, node, range(simd, packet.least_t_min, farthest));
        stack[depth] = Level { enters, node: index, waiting: 0 };
        // The next inner node, through the leaves on the way.
        index = loop {
            while waiting == 0 {
                if depth == 0 {
                    return;
                }
                depth -= 1;
                let level = &stack[depth];
                let enters: f32x8<S> = level.enters.simd_into(simd);
                waiting = level.waiting & enters.simd_le(f32x8::splat(simd, farthest)).to_bitmask() as u32;
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
            let rays = meet_leaf(simd, packet, node, slot, t_max);
            if rays == 0 {
                continue;
            }
            let first = child.first() as usize;
            let mut closer = false;
            for (i, triangle) in triangles[first..first + child.count() as usize].iter().enumerate() {
                let index = first_triangle + (first + i) as u32;
                closer |= cross_packet(simd, packet, triangle, rays, index, t_max, &mut visit);
            }
            if closer {
                farthest = greatest(simd, t_max);
                let enters: f32x8<S> = stack[depth].enters.simd_into(simd);
                waiting &= enters.simd_le(f32x8::splat(simd, farthest)).to_bitmask() as u32;
            }
        };
    }
}

#[inline(always)]
fn greatest<S: Simd>(simd: S, numbers: &Numbers) -> f32 {
    reduce(
        (*numbers).simd_into(simd),
        #[inline(always)]
        |a: f32x8<S>, b| a.max(b),
    )
}

/// The children whose boxes some ray may meet, and where at the earliest.
#[inline(always)]
fn meet<S: Simd>(simd: S, packet: &LocalPacket<S>, node: &WideNode, range: f32x16<S>) -> (u32, [f32; 8]) {
    let [x, y, z] = each(
        [0, 1, 2],
        #[inline(always)]
        |axis: usize| {
            let step = step(node, axis);
            let offset = f32x16::splat(simd, node.origin[axis]) - packet.outer_origins[axis];
            let planes = planes(simd, node, axis, packet.near[axis]).mul_add(f32x16::splat(simd, step), offset);
            (planes * packet.outer_scales[0][axis]).min(planes * packet.outer_scales[1][axis])
        },
    );
    let (enters, leaves) = halves(x.max(y).max(z.max(range)));
    let met = (enters + leaves).simd_le(f32x8::splat(simd, 0.0)).to_bitmask() as u32;
    (met & u32::from(node.exponents[3]), enters.into())
}

/// The rays that meet the box of one child.
#[inline(always)]
fn meet_leaf<S: Simd>(simd: S, packet: &LocalPacket<S>, node: &WideNode, slot: usize, t_max: &Numbers) -> u64 {
    let t = each(
        [0, 1, 2],
        #[inline(always)]
        |axis: usize| {
            let step = step(node, axis);
            let offset = f32x16::splat(simd, node.origin[axis]) - packet.origins[axis];
            let [near, far] = [packet.near[axis] & 1, packet.near[axis] & 1 ^ 1];
            let planes = &node.planes[axis];
            let near = f32x16::splat(simd, f32::from(planes[near][slot & 7]) * step);
            let far = f32x16::splat(simd, f32::from(planes[far][slot & 7]) * step);
            ((near + offset) * packet.reciprocals[axis], (far + offset) * packet.reciprocals[axis])
        },
    );
    let enters = t[0].0.max(t[1].0).max(t[2].0.max(packet.t_min));
    let t_max: f32x16<S> = (*t_max).simd_into(simd);
    let leaves = t[0].1.min(t[1].1).min(t[2].1.min(t_max));
    (enters * BOX_SLACK).simd_le(leaves).to_bitmask()
}

/// Tests one triangle; says whether a ray ends nearer now.
#[inline(always)]
fn cross_packet<S: Simd>(
    simd: S,
    packet: &LocalPacket<S>,
    triangle: &Triangle,
    rays: u64,
    index: u32,
    t_max: &mut Numbers,
    visit: &mut impl FnMut(usize, &Candidate) -> f32,
) -> bool {
    let [x_axis, y_axis, t_axis] = packet.axes.order;
    let from = &packet.ordered_origins;
    let corners: &[[f32; 4]; 3] = bytemuck::cast_ref(triangle);
    let [a, b, c] = each(
        [0, 1, 2],
        #[inline(always)]
        |corner: usize| {
            let corner = &corners[corner];
            [
                f32x16::splat(simd, corner[x_axis & 3]) - from[0],
                f32x16::splat(simd, corner[y_axis & 3]) - from[1],
                f32x16::splat(simd, corner[t_axis & 3]) - from[2],
            ]
        },
    );
    let x = each(
        [a, b, c],
        #[inline(always)]
        |[x, _, t]| x * packet.scale + t * packet.slopes[0],
    );
    let y = each(
        [a, b, c],
        #[inline(always)]
        |[_, y, t]| y * packet.scale + t * packet.slopes[1],
    );
    let t = each(
        [a, b, c],
        #[inline(always)]
        |[_, _, t]| t * packet.t_scale,
    );
    let crossings = cross(
        simd,
        x,
        y,
        t,
        packet.depth_scale,
        #[inline(always)]
        |_, t, w| {
            let lanes = Unsheared {
                origin: packet.origins,
                direction: packet.directions,
                corners: [splats(simd, triangle.v0), splats(simd, triangle.v1), splats(simd, triangle.v2)],
                scale: packet.scale,
            };
            plane_distances(&lanes, t, w)
        },
    );
    let Some((crossed, crossings)) = crossings else { return false };
    let limits: f32x16<S> = (*t_max).simd_into(simd);
    let in_range = (crossings.t.simd_ge(packet.t_min) & crossings.t.simd_le(limits)).to_bitmask();
    let mut crossed = crossed & in_range & rays;
    if crossed == 0 {
        return false;
    }
    let (t, u, v): (Numbers, Numbers, Numbers) = (crossings.t.into(), crossings.u.into(), crossings.v.into());
    while crossed != 0 {
        let lane = crossed.trailing_zeros() as usize % LANES;
        crossed &= crossed - 1;
        let back = crossings.back >> lane & 1 != 0;
        t_max[lane] = visit(lane, &Candidate { t: t[lane], u: u[lane], v: v[lane], back, triangle: index });
    }
    true
}
