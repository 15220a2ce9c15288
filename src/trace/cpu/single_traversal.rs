//! One ray of a packet: eight boxes at once, four triangles at once.

use bytemuck::Zeroable;
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f32x8, f32x16, u8x16};

use super::local_packet::{LocalPacket, places_of_axes};
use super::packet_queries::{Answers, Lane, Place};
use super::simd::{LANES, Numbers, each, lanes_of, load, met, near_first, planes, range, steps};
use super::triangle_test::{Shear, Unsheared, by_corner, corners_of_four, cross, first_four, plane_distances};
use super::wide_traversal::{DEPTH, Stack, Walker, walk};
use crate::device::layout::{PrimitiveRange, Triangle, WideNode};
use crate::trace::kernel::BOX_SLACK;
use crate::trace::queries::Candidate;

/// What single rays write to.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct Memory {
    stack: Stack,
    /// Where the ray enters the children of the nodes that are being visited.
    enters: [[f32; 8]; DEPTH],
}

/// The rays of these lanes, one by one, from the node of index `root` on. A function of its own: it needs all registers.
#[inline(never)]
pub(super) fn walk_singly<S: Simd, A: Answers>(
    simd: S,
    root: u32,
    memory: &mut Memory,
    place: &Place<'_>,
    rays: &LocalPacket,
    lanes: u64,
    answers: &mut A,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            for lane in lanes_of(lanes) {
                walk_lane(simd, root, memory, place, rays, lane, &mut Lane { answers, lane });
            }
        },
    );
}

/// The rays of these lanes, one by one, against the triangles of a leaf. A function of its own: it needs all registers.
#[inline(never)]
pub(super) fn cross_singly<S: Simd, A: Answers>(
    simd: S,
    place: &Place<'_>,
    rays: &LocalPacket,
    lanes: u64,
    triangles: PrimitiveRange,
    answers: &mut A,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            for lane in lanes_of(lanes) {
                cross_leaf(simd, place, rays, lane % LANES, triangles, &mut Lane { answers, lane });
            }
        },
    );
}

#[inline(always)]
fn walk_lane<S: Simd>(
    simd: S,
    root: u32,
    memory: &mut Memory,
    place: &Place<'_>,
    rays: &LocalPacket,
    lane: usize,
    answer: &mut Lane<'_, impl Answers>,
) {
    let lane = lane % LANES;
    let mut walker = Single::new(simd, place, rays, lane, answer, &mut memory.enters);
    walk(place.nodes, root, rays.octants[lane] as usize, &mut memory.stack, &mut walker);
}

/// One ray.
struct Single<'a, 'l, S: Simd, A> {
    simd: S,
    place: &'a Place<'a>,
    rays: &'a LocalPacket,
    lane: usize,
    answer: &'a mut Lane<'l, A>,
    enters: &'a mut [[f32; 8]; DEPTH],
    origin: [f32x16<S>; 3],
    /// For near planes in the lower lanes, times the slack of boxes; for far planes in the upper ones, negated.
    scales: [f32x16<S>; 3],
    orders: [u8x16<S>; 3],
    t_max: f32x8<S>,
    range: f32x16<S>,
}

/// That number of one ray in all lanes.
#[inline(always)]
fn of<S: Simd, V: SimdFloat<S, Element = f32>>(simd: S, numbers: &Numbers, lane: usize) -> V {
    V::splat(simd, numbers[lane])
}

impl<'a, 'l, S: Simd, A: Answers> Single<'a, 'l, S, A> {
    #[inline(always)]
    fn new(
        simd: S,
        place: &'a Place<'a>,
        rays: &'a LocalPacket,
        lane: usize,
        answer: &'a mut Lane<'l, A>,
        enters: &'a mut [[f32; 8]; DEPTH],
    ) -> Self {
        let signs = f32x8::splat(simd, BOX_SLACK).combine(f32x8::splat(simd, -1.0));
        let t_max = f32x8::splat(simd, answer.t_max());
        Self {
            simd,
            place,
            rays,
            lane,
            enters,
            origin: [
                of(simd, &rays.origins[0], lane),
                of(simd, &rays.origins[1], lane),
                of(simd, &rays.origins[2], lane),
            ],
            scales: [
                of::<S, f32x16<S>>(simd, &rays.reciprocals[0], lane) * signs,
                of::<S, f32x16<S>>(simd, &rays.reciprocals[1], lane) * signs,
                of::<S, f32x16<S>>(simd, &rays.reciprocals[2], lane) * signs,
            ],
            orders: near_first(simd, rays.octants[lane] as usize),
            t_max,
            range: range(of(simd, &rays.t_min, lane), t_max),
            answer,
        }
    }
}

impl<S: Simd, A: Answers> Walker for Single<'_, '_, S, A> {
    #[inline(always)]
    fn meet(&mut self, node: &WideNode, depth: usize) -> u32 {
        let simd = self.simd;
        let steps = steps(simd, node);
        let [x, y, z] = each(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let to_origin = self.origin[axis] - f32x16::splat(simd, node.origin[axis]);
                planes(simd, node, axis, self.orders[axis]).mul_sub(steps[axis], to_origin) * self.scales[axis]
            },
        );
        let (met, enters) = met(node, x.max(y).max(z.max(self.range)));
        self.enters[depth] = enters.into();
        met
    }

    #[inline(always)]
    fn still_meet(&self, slots: u32, depth: usize) -> u32 {
        slots & f32x8::simd_from(self.simd, self.enters[depth]).simd_le(self.t_max).to_bitmask() as u32
    }

    #[inline(always)]
    fn inner(&mut self, _: &WideNode, _: usize, _: usize, _: u32) -> Option<bool> {
        None
    }

    #[inline(always)]
    fn leaf(&mut self, _: &WideNode, _: usize, _: usize, triangles: PrimitiveRange) -> bool {
        let is_nearer = cross_leaf(self.simd, self.place, self.rays, self.lane, triangles, self.answer);
        if is_nearer {
            self.t_max = f32x8::splat(self.simd, self.answer.t_max());
            self.range = range(of(self.simd, &self.rays.t_min, self.lane), self.t_max);
        }
        is_nearer
    }
}

/// Tests the triangles of a leaf; says whether the ray may end nearer now.
#[inline(always)]
fn cross_leaf<S: Simd>(
    simd: S,
    place: &Place<'_>,
    rays: &LocalPacket,
    lane: usize,
    triangles: PrimitiveRange,
    answer: &mut Lane<'_, impl Answers>,
) -> bool {
    let (mut first, mut count) = (place.instance.first_triangle + triangles.first(), triangles.count());
    let mut is_nearer = false;
    while count > 4 {
        is_nearer |= cross_four(simd, place, rays, lane, first, 4, answer);
        (first, count) = (first + 4, count - 4);
    }
    is_nearer | cross_four(simd, place, rays, lane, first, count, answer)
}

/// Tests up to four triangles.
#[inline(always)]
fn cross_four<S: Simd>(
    simd: S,
    place: &Place<'_>,
    rays: &LocalPacket,
    lane: usize,
    first: u32,
    count: u32,
    answer: &mut Lane<'_, impl Answers>,
) -> bool {
    let triangles = &place.scene.triangles[first as usize..];
    let mut few = [Triangle::zeroed(); 4];
    let four = first_four(triangles, &mut few);
    let lanes = (1 << count) - 1;
    let axes = rays.axes[lane] as usize;
    let p = corners_of_four(simd, four, axes);
    let in_memory: [Numbers; 3] = [p[0].into(), p[1].into(), p[2].into()];
    let from: [f32x16<S>; 3] =
        [of(simd, &rays.from[0], lane), of(simd, &rays.from[1], lane), of(simd, &rays.from[2], lane)];
    let shear = Shear {
        minus_scale: of(simd, &rays.shear.minus_scale, lane),
        slopes: [of(simd, &rays.shear.slopes[0], lane), of(simd, &rays.shear.slopes[1], lane)],
        t_scale: of(simd, &rays.shear.t_scale, lane),
    };
    let [x, y, t] = shear.see([from[0] - p[0], from[1] - p[1]], p[2] - from[2]);
    let corners = [by_corner(x), by_corner(y), by_corner(t)];
    let crossings = cross(
        simd,
        lanes,
        corners,
        of(simd, &rays.depth_scale, lane),
        #[inline(always)]
        |t, weights| {
            let [x, y, z] = each(
                places_of_axes(axes),
                #[inline(always)]
                |place: usize| by_corner(load(simd, in_memory[place])),
            );
            let unsheared = Unsheared {
                origin: each(
                    [0, 1, 2],
                    #[inline(always)]
                    |axis: usize| of::<S, f32x4<S>>(simd, &rays.origins[axis], lane),
                ),
                direction: each(
                    [0, 1, 2],
                    #[inline(always)]
                    |axis: usize| of::<S, f32x4<S>>(simd, &rays.directions[axis], lane),
                ),
                corners: [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]],
                scale: -of::<S, f32x4<S>>(simd, &rays.shear.minus_scale, lane),
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
        let candidate = Candidate { t: t[lane], u: u[lane], v: v[lane], back, triangle: first + lane as u32 };
        answer.cross(place, &candidate);
    }
    true
}
