//! One ray of a packet: eight boxes at once, four triangles at once.

use bytemuck::Zeroable;
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f32x8, f32x16, u8x16};

use super::blas_traversal::{MAX_NODE_DEPTH, NodeVisitor, Stack, traverse_blas};
use super::packet_queries::{InstanceGeometry, PacketQuery, QueryLane};
use super::ray_packet::{LocalPacket, inverse_shear_axes};
use super::simd::{
    F32Lanes, LANES, child_planes, grid_step, hit_slots, lanes_of, load, map_axes, near_far_shuffle, ray_interval,
};
use super::triangle_test::{
    PlaneOperands, Shear, first_four, gather_corners, intersect_triangles, plane_distances, split_corners,
};
use crate::device::layout::{PrimitiveRange, Triangle, WideNode};
use crate::trace::kernel::{BOX_ENTRY_SCALE, TriangleHit};

/// What single rays write to.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct SingleScratch {
    stack: Stack,
    /// Where the ray enters the children of the nodes that are being visited.
    t_entry: [[f32; 8]; MAX_NODE_DEPTH],
}

/// The rays of these lanes, one by one, from the node of index `root` on. A function of its own: it needs all registers.
#[inline(never)]
pub(super) fn traverse_single_rays<S: Simd, A: PacketQuery>(
    simd: S,
    root: u32,
    memory: &mut SingleScratch,
    place: &InstanceGeometry<'_>,
    rays: &LocalPacket,
    lanes: u64,
    answers: &mut A,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            for lane in lanes_of(lanes) {
                traverse_single_ray(simd, root, memory, place, rays, lane, &mut QueryLane { answers, lane });
            }
        },
    );
}

/// The rays of these lanes, one by one, against the triangles of a leaf. A function of its own: it needs all registers.
#[inline(never)]
pub(super) fn intersect_leaf_single_rays<S: Simd, A: PacketQuery>(
    simd: S,
    place: &InstanceGeometry<'_>,
    rays: &LocalPacket,
    lanes: u64,
    triangles: PrimitiveRange,
    answers: &mut A,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            for lane in lanes_of(lanes) {
                intersect_leaf(simd, place, rays, lane % LANES, triangles, &mut QueryLane { answers, lane });
            }
        },
    );
}

#[inline(always)]
fn traverse_single_ray<S: Simd>(
    simd: S,
    root: u32,
    memory: &mut SingleScratch,
    place: &InstanceGeometry<'_>,
    rays: &LocalPacket,
    lane: usize,
    answer: &mut QueryLane<'_, impl PacketQuery>,
) {
    let lane = lane % LANES;
    let mut walker = SingleTraversal::new(simd, place, rays, lane, answer, &mut memory.t_entry);
    traverse_blas(place.nodes, root, rays.octants[lane] as usize, &mut memory.stack, &mut walker);
}

/// One ray.
struct SingleTraversal<'a, 'l, S: Simd, A> {
    simd: S,
    place: &'a InstanceGeometry<'a>,
    rays: &'a LocalPacket,
    lane: usize,
    answer: &'a mut QueryLane<'l, A>,
    t_entry: &'a mut [[f32; 8]; MAX_NODE_DEPTH],
    origin: [f32x16<S>; 3],
    /// For near planes in the lower lanes, times the slack of boxes; for far planes in the upper ones, negated.
    scales: [f32x16<S>; 3],
    near_far_shuffles: [u8x16<S>; 3],
    t_max: f32x8<S>,
    ray_interval: f32x16<S>,
}

/// That number of one ray in all lanes.
#[inline(always)]
fn splat_lane<S: Simd, V: SimdFloat<S, Element = f32>>(simd: S, numbers: &F32Lanes, lane: usize) -> V {
    V::splat(simd, numbers[lane])
}

impl<'a, 'l, S: Simd, A: PacketQuery> SingleTraversal<'a, 'l, S, A> {
    #[inline(always)]
    fn new(
        simd: S,
        place: &'a InstanceGeometry<'a>,
        rays: &'a LocalPacket,
        lane: usize,
        answer: &'a mut QueryLane<'l, A>,
        enters: &'a mut [[f32; 8]; MAX_NODE_DEPTH],
    ) -> Self {
        let signs = f32x8::splat(simd, BOX_ENTRY_SCALE).combine(f32x8::splat(simd, -1.0));
        let t_max = f32x8::splat(simd, answer.t_max());
        Self {
            simd,
            place,
            rays,
            lane,
            t_entry: enters,
            origin: [
                splat_lane(simd, &rays.origins[0], lane),
                splat_lane(simd, &rays.origins[1], lane),
                splat_lane(simd, &rays.origins[2], lane),
            ],
            scales: [
                splat_lane::<S, f32x16<S>>(simd, &rays.reciprocals[0], lane) * signs,
                splat_lane::<S, f32x16<S>>(simd, &rays.reciprocals[1], lane) * signs,
                splat_lane::<S, f32x16<S>>(simd, &rays.reciprocals[2], lane) * signs,
            ],
            near_far_shuffles: near_far_shuffle(simd, rays.octants[lane] as usize),
            t_max,
            ray_interval: ray_interval(splat_lane(simd, &rays.t_min, lane), t_max),
            answer,
        }
    }
}

impl<S: Simd, A: PacketQuery> NodeVisitor for SingleTraversal<'_, '_, S, A> {
    #[inline(always)]
    fn intersect_children(&mut self, node: &WideNode, depth: usize) -> u32 {
        let simd = self.simd;
        let steps = grid_step(simd, node);
        let [x, y, z] = map_axes(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let to_origin = self.origin[axis] - f32x16::splat(simd, node.origin[axis]);
                child_planes(simd, node, axis, self.near_far_shuffles[axis]).mul_sub(steps[axis], to_origin)
                    * self.scales[axis]
            },
        );
        let (met, enters) = hit_slots(node, x.max(y).max(z.max(self.ray_interval)));
        self.t_entry[depth] = enters.into();
        met
    }

    #[inline(always)]
    fn cull_beyond_t_max(&self, slots: u32, depth: usize) -> u32 {
        slots & f32x8::simd_from(self.simd, self.t_entry[depth]).simd_le(self.t_max).to_bitmask() as u32
    }

    #[inline(always)]
    fn inner(&mut self, _: &WideNode, _: usize, _: usize, _: u32) -> Option<bool> {
        None
    }

    #[inline(always)]
    fn visit_leaf(&mut self, _: &WideNode, _: usize, _: usize, triangles: PrimitiveRange) -> bool {
        let is_nearer = intersect_leaf(self.simd, self.place, self.rays, self.lane, triangles, self.answer);
        if is_nearer {
            self.t_max = f32x8::splat(self.simd, self.answer.t_max());
            self.ray_interval = ray_interval(splat_lane(self.simd, &self.rays.t_min, self.lane), self.t_max);
        }
        is_nearer
    }
}

/// Tests the triangles of a leaf; says whether the ray may end nearer now.
#[inline(always)]
fn intersect_leaf<S: Simd>(
    simd: S,
    place: &InstanceGeometry<'_>,
    rays: &LocalPacket,
    lane: usize,
    triangles: PrimitiveRange,
    answer: &mut QueryLane<'_, impl PacketQuery>,
) -> bool {
    let (mut first, mut count) =
        (place.instance.first_triangle + triangles.first_primitive(), triangles.primitive_count());
    let mut is_nearer = false;
    while count > 4 {
        is_nearer |= intersect_four_triangles(simd, place, rays, lane, first, 4, answer);
        (first, count) = (first + 4, count - 4);
    }
    is_nearer | intersect_four_triangles(simd, place, rays, lane, first, count, answer)
}

/// Tests up to four triangles.
#[inline(always)]
fn intersect_four_triangles<S: Simd>(
    simd: S,
    place: &InstanceGeometry<'_>,
    rays: &LocalPacket,
    lane: usize,
    first: u32,
    count: u32,
    answer: &mut QueryLane<'_, impl PacketQuery>,
) -> bool {
    let triangles = &place.scene.triangles[first as usize..];
    let mut few = [Triangle::zeroed(); 4];
    let four = first_four(triangles, &mut few);
    let lanes = (1 << count) - 1;
    let axes = rays.shear_axes[lane] as usize;
    let p = gather_corners(simd, four, axes);
    let in_memory: [F32Lanes; 3] = [p[0].into(), p[1].into(), p[2].into()];
    let from: [f32x16<S>; 3] = [
        splat_lane(simd, &rays.sheared_origins[0], lane),
        splat_lane(simd, &rays.sheared_origins[1], lane),
        splat_lane(simd, &rays.sheared_origins[2], lane),
    ];
    let shear = Shear {
        minus_scale: splat_lane(simd, &rays.shear.minus_scale, lane),
        slopes: [splat_lane(simd, &rays.shear.slopes[0], lane), splat_lane(simd, &rays.shear.slopes[1], lane)],
        t_scale: splat_lane(simd, &rays.shear.t_scale, lane),
    };
    let [x, y, t] = shear.apply([from[0] - p[0], from[1] - p[1]], p[2] - from[2]);
    let corners = [split_corners(x), split_corners(y), split_corners(t)];
    let crossings = intersect_triangles(
        simd,
        lanes,
        corners,
        splat_lane(simd, &rays.depth_scale, lane),
        #[inline(always)]
        |t, weights| {
            let [x, y, z] = map_axes(
                inverse_shear_axes(axes),
                #[inline(always)]
                |place: usize| split_corners(load(simd, in_memory[place])),
            );
            let unsheared = PlaneOperands {
                origin: map_axes(
                    [0, 1, 2],
                    #[inline(always)]
                    |axis: usize| splat_lane::<S, f32x4<S>>(simd, &rays.origins[axis], lane),
                ),
                direction: map_axes(
                    [0, 1, 2],
                    #[inline(always)]
                    |axis: usize| splat_lane::<S, f32x4<S>>(simd, &rays.directions[axis], lane),
                ),
                corners: [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]],
                scale: -splat_lane::<S, f32x4<S>>(simd, &rays.shear.minus_scale, lane),
            };
            plane_distances(&unsheared, t, weights)
        },
    );
    let Some((mut crossed, crossings)) = crossings else { return false };
    crossed &= crossings.t.simd_ge(rays.t_min[lane]).to_bitmask();
    crossed &= crossings.t.simd_le(answer.t_max()).to_bitmask();
    if crossed == 0 {
        return false;
    }
    let (t, u, v): ([f32; 4], [f32; 4], [f32; 4]) = (crossings.t.into(), crossings.u.into(), crossings.v.into());
    while crossed != 0 {
        let lane = crossed.trailing_zeros() as usize & 3;
        crossed &= crossed - 1;
        let back = crossings.back >> lane & 1 != 0;
        let hit = TriangleHit { t: t[lane], u: u[lane], v: v[lane], back };
        answer.accept_hit(place, first + lane as u32, &hit);
    }
    true
}
