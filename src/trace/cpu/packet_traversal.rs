//! Rays of a packet that visit the same nodes: one triangle after the other against all of them. Where only a few rays meet a node they go on
//! one by one.

use bytemuck::Zeroable;
use fearless_simd::Simd;
use fearless_simd::prelude::*;

use super::local_packet::LocalPacket;
use super::node_test::{self, Boxes};
use super::packet_queries::{Answers, Place};
use super::simd::{LANES, Numbers, each, load};
use super::single_traversal::{self, cross_singly, walk_singly};
use super::triangle_test::{Shear, Unsheared, cross, plane_distances, splats};
use super::wide_traversal::{Stack, Walker, walk};
use crate::device::layout::{PrimitiveRange, Triangle, WideNode};

/// As many rays as go on one by one.
pub(super) const SINGLE_RAY_THRESHOLD: u32 = 2;

/// What walks write to. Kept from ray to ray, so that nothing clears it.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct Memory {
    stack: Stack,
    boxes: node_test::Memory,
    pub(super) single: single_traversal::Memory,
}

/// The rays of these lanes. A function of its own: it needs all registers.
#[inline(never)]
pub(super) fn walk_together<'a, S: Simd, A: Answers, B: Boxes<'a, S>>(
    simd: S,
    memory: &'a mut Memory,
    place: &'a Place<'a>,
    rays: &'a LocalPacket,
    lanes: u64,
    answers: &'a mut A,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            let Memory { stack, boxes, single } = memory;
            let boxes = B::new(simd, rays, answers.t_max(), boxes);
            let mut walker = Together { simd, place, rays, answers, boxes, single, lanes, visited: 0 };
            walk(place.nodes, 0, octant(rays, lanes), stack, &mut walker);
        },
    );
}

/// Of the first ray: nodes are visited in its order.
#[inline(always)]
fn octant(rays: &LocalPacket, lanes: u64) -> usize {
    rays.octants[lanes.trailing_zeros() as usize % LANES] as usize
}

/// The rays of a packet, that ask one kind of query.
struct Together<'a, S, A, B> {
    simd: S,
    place: &'a Place<'a>,
    rays: &'a LocalPacket,
    answers: &'a mut A,
    boxes: B,
    single: &'a mut single_traversal::Memory,
    /// A bit for each ray that meets the node which is visited next.
    lanes: u64,
    /// Nodes visited so far.
    visited: u32,
}

impl<'a, S: Simd, A: Answers, B: Boxes<'a, S>> Together<'a, S, A, B> {
    /// Tests one triangle.
    #[inline(always)]
    fn cross(&mut self, lanes: u64, triangle: &Triangle, index: u32) {
        let (simd, rays) = (self.simd, self.rays);
        let load = |numbers: &Numbers| load(simd, *numbers);
        let shear = Shear {
            minus_scale: load(&rays.shear.minus_scale),
            slopes: [load(&rays.shear.slopes[0]), load(&rays.shear.slopes[1])],
            t_scale: load(&rays.shear.t_scale),
        };
        let [a, b, c] = each(
            [triangle.v0, triangle.v1, triangle.v2],
            #[inline(always)]
            |corner| {
                let [x, y, t] = self.boxes.along_axes(corner);
                shear.see([load(&rays.from[0]) - x, load(&rays.from[1]) - y], t - load(&rays.from[2]))
            },
        );
        let corners = [[a[0], b[0], c[0]], [a[1], b[1], c[1]], [a[2], b[2], c[2]]];
        let crossings = cross(
            simd,
            lanes,
            corners,
            load(&rays.depth_scale),
            #[inline(always)]
            |t, w| {
                let lanes = Unsheared {
                    origin: [load(&rays.origins[0]), load(&rays.origins[1]), load(&rays.origins[2])],
                    direction: [load(&rays.directions[0]), load(&rays.directions[1]), load(&rays.directions[2])],
                    corners: [splats(simd, triangle.v0), splats(simd, triangle.v1), splats(simd, triangle.v2)],
                    scale: -shear.minus_scale,
                };
                plane_distances(&lanes, t, w)
            },
        );
        let Some((mut crossed, crossings)) = crossings else { return };
        crossed &= crossings.t.simd_ge(load(&rays.t_min)).to_bitmask();
        crossed &= crossings.t.simd_le(load(self.answers.t_max())).to_bitmask();
        if crossed != 0 {
            self.answers.accept(simd, self.place, index, crossed, &crossings);
            self.boxes.shorten(self.answers.t_max());
        }
    }
}

impl<'a, S: Simd, A: Answers, B: Boxes<'a, S>> Walker for Together<'a, S, A, B> {
    #[inline(always)]
    fn meet(&mut self, node: &WideNode, depth: usize) -> u32 {
        self.visited += 1;
        self.boxes.meet(node, depth, self.lanes, self.answers.t_max())
    }

    #[inline(always)]
    fn still_meet(&self, slots: u32, depth: usize) -> u32 {
        self.boxes.still_meet(slots, depth)
    }

    #[inline(always)]
    fn inner(&mut self, node: &WideNode, depth: usize, slot: usize, child: u32) -> Option<bool> {
        if self.visited <= B::COHERENT {
            return None;
        }
        let lanes = self.boxes.lanes(node, depth, slot, self.answers.t_max());
        if lanes.count_ones() > SINGLE_RAY_THRESHOLD {
            self.lanes = lanes;
            return None;
        }
        if lanes == 0 {
            return Some(false);
        }
        walk_singly(self.simd, child, self.single, self.place, self.rays, lanes, self.answers);
        self.boxes.shorten(self.answers.t_max());
        Some(true)
    }

    #[inline(always)]
    fn leaf(&mut self, node: &WideNode, depth: usize, slot: usize, triangles: PrimitiveRange) -> bool {
        let lanes = self.boxes.lanes(node, depth, slot, self.answers.t_max());
        if lanes == 0 {
            return false;
        }
        if lanes.count_ones() <= SINGLE_RAY_THRESHOLD {
            cross_singly(self.simd, self.place, self.rays, lanes, triangles, self.answers);
            self.boxes.shorten(self.answers.t_max());
            return true;
        }
        let first = self.place.instance.first_triangle + triangles.first();
        let scene = self.place.scene;
        for (i, triangle) in (first..).zip(&scene.triangles[first as usize..][..triangles.count() as usize]) {
            self.cross(lanes, triangle, i);
        }
        true
    }
}
