//! Rays of a packet that visit the same nodes: one triangle after the other against all of them. Where only a few rays meet a node they go on
//! one by one.

use bytemuck::Zeroable;
use fearless_simd::Simd;
use fearless_simd::prelude::*;

use super::blas_traversal::{NodeVisitor, Stack, traverse_blas};
use super::node_test::{self, NodeTest};
use super::packet_queries::{InstanceGeometry, PacketQuery};
use super::ray_packet::LocalPacket;
use super::simd::{F32Lanes, LANES, load, map_axes};
use super::single_traversal::{self, intersect_leaf_single_rays, traverse_single_rays};
use super::triangle_test::{PlaneOperands, Shear, intersect_triangles, plane_distances, splat_axes};
use crate::device::layout::{PrimitiveRange, Triangle, WideNode};

/// As many rays as go on one by one.
pub(super) const SINGLE_RAY_THRESHOLD: u32 = 2;

/// What walks write to. Kept from ray to ray, so that nothing clears it.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct HybridScratch {
    stack: Stack,
    boxes: node_test::NodeTestScratch,
    pub(super) single: single_traversal::SingleScratch,
}

/// The rays of these lanes. A function of its own: it needs all registers.
#[inline(never)]
pub(super) fn traverse_packet<'a, S: Simd, A: PacketQuery, B: NodeTest<'a, S>>(
    simd: S,
    memory: &'a mut HybridScratch,
    place: &'a InstanceGeometry<'a>,
    rays: &'a LocalPacket,
    lanes: u64,
    answers: &'a mut A,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            let HybridScratch { stack, boxes, single } = memory;
            let boxes = B::new(simd, rays, answers.t_max(), boxes);
            let mut walker = PacketTraversal { simd, place, rays, answers, boxes, single, lanes, visited_nodes: 0 };
            traverse_blas(place.nodes, 0, first_ray_octant(rays, lanes), stack, &mut walker);
        },
    );
}

/// Of the first ray: nodes are visited in its order.
#[inline(always)]
fn first_ray_octant(rays: &LocalPacket, lanes: u64) -> usize {
    rays.octants[lanes.trailing_zeros() as usize % LANES] as usize
}

/// The rays of a packet, that ask one kind of query.
struct PacketTraversal<'a, S, A, B> {
    simd: S,
    place: &'a InstanceGeometry<'a>,
    rays: &'a LocalPacket,
    answers: &'a mut A,
    boxes: B,
    single: &'a mut single_traversal::SingleScratch,
    /// A bit for each ray that meets the node which is visited next.
    lanes: u64,
    /// Nodes visited so far.
    visited_nodes: u32,
}

impl<'a, S: Simd, A: PacketQuery, B: NodeTest<'a, S>> PacketTraversal<'a, S, A, B> {
    /// Tests one triangle.
    #[inline(always)]
    fn intersect_triangle(&mut self, lanes: u64, triangle: &Triangle, index: u32) {
        let (simd, rays) = (self.simd, self.rays);
        let load = |numbers: &F32Lanes| load(simd, *numbers);
        let shear = Shear {
            minus_scale: load(&rays.shear.minus_scale),
            slopes: [load(&rays.shear.slopes[0]), load(&rays.shear.slopes[1])],
            t_scale: load(&rays.shear.t_scale),
        };
        let [a, b, c] = map_axes(
            [triangle.v0, triangle.v1, triangle.v2],
            #[inline(always)]
            |corner| {
                let [x, y, t] = self.boxes.to_shear_axes(corner);
                shear.apply(
                    [load(&rays.sheared_origins[0]) - x, load(&rays.sheared_origins[1]) - y],
                    t - load(&rays.sheared_origins[2]),
                )
            },
        );
        let corners = [[a[0], b[0], c[0]], [a[1], b[1], c[1]], [a[2], b[2], c[2]]];
        let crossings = intersect_triangles(
            simd,
            lanes,
            corners,
            load(&rays.depth_scale),
            #[inline(always)]
            |t, w| {
                let lanes = PlaneOperands {
                    origin: [load(&rays.origins[0]), load(&rays.origins[1]), load(&rays.origins[2])],
                    direction: [load(&rays.directions[0]), load(&rays.directions[1]), load(&rays.directions[2])],
                    corners: [
                        splat_axes(simd, triangle.v0),
                        splat_axes(simd, triangle.v1),
                        splat_axes(simd, triangle.v2),
                    ],
                    scale: -shear.minus_scale,
                };
                plane_distances(&lanes, t, w)
            },
        );
        let Some((mut crossed, crossings)) = crossings else { return };
        crossed &= crossings.t.simd_ge(load(&rays.t_min)).to_bitmask();
        crossed &= crossings.t.simd_le(load(self.answers.t_max())).to_bitmask();
        if crossed != 0 {
            self.answers.accept_hits(simd, self.place, index, crossed, &crossings);
            self.boxes.tighten_t_max(self.answers.t_max());
        }
    }
}

impl<'a, S: Simd, A: PacketQuery, B: NodeTest<'a, S>> NodeVisitor for PacketTraversal<'a, S, A, B> {
    #[inline(always)]
    fn intersect_children(&mut self, node: &WideNode, depth: usize) -> u32 {
        self.visited_nodes += 1;
        self.boxes.meet(node, depth, self.lanes, self.answers.t_max())
    }

    #[inline(always)]
    fn cull_beyond_t_max(&self, slots: u32, depth: usize) -> u32 {
        self.boxes.still_meet(slots, depth)
    }

    #[inline(always)]
    fn inner(&mut self, node: &WideNode, depth: usize, slot: usize, child: u32) -> Option<bool> {
        if self.visited_nodes <= B::UNMASKED_NODES {
            return None;
        }
        let lanes = self.boxes.active_lanes(node, depth, slot, self.answers.t_max());
        if lanes.count_ones() > SINGLE_RAY_THRESHOLD {
            self.lanes = lanes;
            return None;
        }
        if lanes == 0 {
            return Some(false);
        }
        traverse_single_rays(self.simd, child, self.single, self.place, self.rays, lanes, self.answers);
        self.boxes.tighten_t_max(self.answers.t_max());
        Some(true)
    }

    #[inline(always)]
    fn visit_leaf(&mut self, node: &WideNode, depth: usize, slot: usize, triangles: PrimitiveRange) -> bool {
        let lanes = self.boxes.active_lanes(node, depth, slot, self.answers.t_max());
        if lanes == 0 {
            return false;
        }
        if lanes.count_ones() <= SINGLE_RAY_THRESHOLD {
            intersect_leaf_single_rays(self.simd, self.place, self.rays, lanes, triangles, self.answers);
            self.boxes.tighten_t_max(self.answers.t_max());
            return true;
        }
        let first = self.place.instance.first_triangle + triangles.first_primitive();
        let scene = self.place.scene;
        for (i, triangle) in (first..).zip(&scene.triangles[first as usize..][..triangles.primitive_count() as usize]) {
            self.intersect_triangle(lanes, triangle, i);
        }
        true
    }
}
