//! One ray of a packet: eight boxes at once, four triangles at once.

use bytemuck::Zeroable as _;
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f32x8, f32x16, u8x16};

use super::answers::{Answers, Place};
use super::lanes::{each, lanes_of, near_first, planes, steps};
use super::local::LocalPacket;
use super::triangles::{Shear, Unsheared, by_corner, corners_of_four, cross, first_four, lowest_four, plane_distances};
use super::walk::{Stack, Walker, met, range, walk};
use crate::device::layout::{PrimitiveRange, Triangle, WideNode};
use crate::trace::kernel::BOX_SLACK;
use crate::trace::queries::{Candidate, Query};

/// The rays of these lanes, one by one, from the node of index `root` on. A function of its own: it needs all registers.
#[expect(clippy::too_many_arguments, reason = "a part of two loops")]
#[inline(never)]
pub(super) fn walk_singly<S: Simd, A: Answers>(
    simd: S,
    nodes: &[WideNode],
    root: u32,
    stack: &mut Stack,
    place: &Place<'_>,
    rays: &LocalPacket<S>,
    lanes: u64,
    answers: &mut A,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            for lane in lanes_of(lanes) {
                answers.set_query(lane, walk_lane(simd, nodes, root, stack, place, rays, lane, answers.query(lane)));
            }
        },
    );
}

/// One ray of a packet. A function of its own: it needs all registers.
#[inline(never)]
pub(super) fn walk_single<S: Simd, Q: Query>(
    simd: S,
    nodes: &[WideNode],
    stack: &mut Stack,
    place: &Place<'_>,
    rays: &LocalPacket<S>,
    lane: usize,
    query: Q,
) -> Q {
    simd.vectorize(
        #[inline(always)]
        || walk_lane(simd, nodes, 0, stack, place, rays, lane, query),
    )
}

#[expect(clippy::too_many_arguments, reason = "a part of two functions")]
#[inline(always)]
fn walk_lane<S: Simd, Q: Query>(
    simd: S,
    nodes: &[WideNode],
    root: u32,
    stack: &mut Stack,
    place: &Place<'_>,
    rays: &LocalPacket<S>,
    lane: usize,
    query: Q,
) -> Q {
    let mut walker = Single::new(simd, place, rays, lane, query);
    walk(simd, nodes, root, rays.octant(lane), stack, &mut walker);
    walker.query
}

/// One ray that asks a query.
struct Single<'a, S: Simd, Q> {
    simd: S,
    place: &'a Place<'a>,
    /// Of the geometry, and what follows them.
    triangles: &'a [Triangle],
    query: Q,
    origin: [f32x16<S>; 3],
    /// For near planes in the lower lanes, times the slack of boxes; for far planes in the upper ones, negated.
    scales: [f32x16<S>; 3],
    orders: [u8x16<S>; 3],
    t_min: f32x8<S>,
    range: f32x16<S>,
    axes: [usize; 3],
    /// The origin along `axes`.
    from: [f32x16<S>; 3],
    shear: Shear<f32x16<S>>,
    depth_scale: f32x4<S>,
    direction: [f32x4<S>; 3],
}

impl<'a, S: Simd, Q: Query> Single<'a, S, Q> {
    #[inline(always)]
    fn new(simd: S, place: &'a Place<'a>, rays: &LocalPacket<S>, lane: usize, query: Q) -> Self {
        let of_lane = |v: &f32x16<S>| f32x16::splat(simd, v.as_array()[lane]);
        let origin = [of_lane(&rays.origins[0]), of_lane(&rays.origins[1]), of_lane(&rays.origins[2])];
        let signs = f32x8::splat(simd, BOX_SLACK).combine(f32x8::splat(simd, -1.0));
        let axes = rays.axes(lane);
        let t_min = f32x8::splat(simd, rays.t_min.as_array()[lane]);
        Self {
            simd,
            place,
            triangles: &place.scene.triangles[place.instance.first_triangle as usize..],
            origin,
            scales: [
                of_lane(&rays.reciprocals[0]) * signs,
                of_lane(&rays.reciprocals[1]) * signs,
                of_lane(&rays.reciprocals[2]) * signs,
            ],
            orders: each(
                rays.down,
                #[inline(always)]
                |down| near_first(simd, down >> lane & 1 != 0),
            ),
            t_min,
            range: range(t_min, f32x8::splat(simd, query.t_max())),
            axes,
            from: each(
                axes,
                #[inline(always)]
                |axis: usize| of_lane(&rays.origins[axis.min(2)]),
            ),
            shear: Shear {
                minus_scale: of_lane(&rays.shear.minus_scale),
                slopes: [of_lane(&rays.shear.slopes[0]), of_lane(&rays.shear.slopes[1])],
                t_scale: of_lane(&rays.shear.t_scale),
            },
            depth_scale: f32x4::splat(simd, rays.depth_scale.as_array()[lane]),
            direction: each(
                rays.directions,
                #[inline(always)]
                |d| f32x4::splat(simd, d.as_array()[lane]),
            ),
            query,
        }
    }

    /// Tests up to four triangles of the geometry from that one on; says whether the ray ends nearer now.
    #[inline(always)]
    fn cross_four(&mut self, first: u32, count: u32) -> bool {
        let simd = self.simd;
        let triangles = &self.triangles[first as usize..];
        let mut few = [Triangle::zeroed(); 4];
        let four = first_four(triangles, &mut few);
        let lanes = (1 << count) - 1;
        let p = corners_of_four(simd, four, self.axes);
        let [x, y, t] = self.shear.see([self.from[0] - p[0], self.from[1] - p[1]], p[2] - self.from[2]);
        let corners = [by_corner(x), by_corner(y), by_corner(t)];
        let crossings = cross(
            simd,
            lanes,
            corners,
            self.depth_scale,
            #[inline(always)]
            |t, weights| {
                let [x, y, z] = each(
                    corners_of_four(simd, four, [0, 1, 2]),
                    #[inline(always)]
                    |v| by_corner(v),
                );
                let unsheared = Unsheared {
                    origin: each(
                        self.origin,
                        #[inline(always)]
                        |o| lowest_four(o),
                    ),
                    direction: self.direction,
                    corners: [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]],
                    scale: -lowest_four(self.shear.minus_scale),
                };
                plane_distances(&unsheared, t, weights)
            },
        );
        let Some((mut crossed, crossings)) = crossings else { return false };
        crossed &= crossings.t.simd_ge(self.t_min.split().0).to_bitmask();
        crossed &= crossings.t.simd_le(f32x4::splat(simd, self.query.t_max())).to_bitmask();
        if crossed == 0 {
            return false;
        }
        let before = self.query.t_max();
        let (t, u, v): ([f32; 4], [f32; 4], [f32; 4]) = (crossings.t.into(), crossings.u.into(), crossings.v.into());
        while crossed != 0 {
            let lane = crossed.trailing_zeros() as usize & 3;
            crossed &= crossed - 1;
            let back = crossings.back >> lane & 1 != 0;
            let triangle = self.place.instance.first_triangle + first + lane as u32;
            let candidate = Candidate { t: t[lane], u: u[lane], v: v[lane], back, triangle };
            self.query.cross(self.place.scene, self.place.index, self.place.instance, &candidate);
        }
        self.range = range(self.t_min, self.t_max());
        self.query.t_max() != before
    }
}

impl<S: Simd, Q: Query> Walker<S> for Single<'_, S, Q> {
    #[inline(always)]
    fn meet(&mut self, node: &WideNode, _: usize) -> (u32, f32x8<S>) {
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
        met(simd, node, x.max(y).max(z.max(self.range)))
    }

    #[inline(always)]
    fn inner(&mut self, _: &WideNode, _: usize, _: usize, _: u32) -> Option<bool> {
        None
    }

    #[inline(always)]
    fn leaf(&mut self, _: &WideNode, _: usize, _: usize, triangles: PrimitiveRange) -> bool {
        let (mut first, mut count) = (triangles.first(), triangles.count());
        let mut is_nearer = false;
        while count > 4 {
            is_nearer |= self.cross_four(first, 4);
            (first, count) = (first + 4, count - 4);
        }
        is_nearer | self.cross_four(first, count)
    }

    #[inline(always)]
    fn t_max(&self) -> f32x8<S> {
        f32x8::splat(self.simd, self.query.t_max())
    }
}
