//! Packet traversal of a BLAS: each triangle of a leaf is tested against all 16 rays. At or below
//! [`SINGLE_RAY_THRESHOLD`] active rays a subtree or leaf is handed to single-ray traversal.
//!
//! The loop is that of `blas_traversal`; boxes are tested by one of the two forms of `node_test`, for coherent and for
//! incoherent packets.

use bytemuck::Zeroable;
use fearless_simd::Simd;
use fearless_simd::prelude::*;

use super::blas_traversal::{ChildVisit, NodeVisitor, Stack, traverse_blas};
use super::node_test::{NodeTest, NodeTestScratch};
use super::packet_queries::{InstanceGeometry, PacketQuery};
use super::ray_packet::LocalPacket;
use super::shear::Shear;
use super::simd::{F32Lanes, LANES, load, map_axes, splat_axes};
use super::single_traversal::{SingleScratch, intersect_leaf_single_rays, traverse_single_rays};
use super::triangle_test::{PlaneOperands, intersect_triangles};
use crate::device::layout::{PrimitiveRange, Triangle, WideNode};
use crate::trace::kernel::{padded_box, scaled_normal};

/// At or below this many active rays the packet switches to single-ray traversal.
pub(super) const SINGLE_RAY_THRESHOLD: u32 = 2;

/// Scratch memory of traversals: stacks and per-level results. Reused without clearing; each entry is written before it
/// is read.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct HybridScratch {
    stack: Stack,
    node_test: NodeTestScratch,
    pub(super) single: SingleScratch,
}

/// Traverses a BLAS with the active `lanes` of a packet. Never inlined, so that the register allocator has all vector
/// registers.
#[inline(never)]
pub(super) fn traverse_packet<'a, S: Simd, Q: PacketQuery, N: NodeTest<'a, S>>(
    simd: S,
    scratch: &'a mut HybridScratch,
    geometry: &'a InstanceGeometry<'a>,
    rays: &'a LocalPacket,
    lanes: u64,
    queries: &'a mut Q,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            let HybridScratch { stack, node_test, single } = scratch;
            let node_test = N::new(simd, rays, queries.t_max(), node_test);
            let mut visitor =
                PacketTraversal { simd, geometry, rays, queries, node_test, single, lanes, visited_nodes: 0 };
            traverse_blas(geometry.nodes, 0, first_ray_octant(rays, lanes), stack, &mut visitor);
        },
    );
}

/// The direction octant of the first active ray, which decides the order in which children are visited.
#[inline(always)]
fn first_ray_octant(rays: &LocalPacket, lanes: u64) -> usize {
    rays.octants[lanes.trailing_zeros() as usize % LANES] as usize
}

/// Visitor of a packet traversal with one kind of query.
struct PacketTraversal<'a, S, Q, N> {
    simd: S,
    geometry: &'a InstanceGeometry<'a>,
    rays: &'a LocalPacket,
    queries: &'a mut Q,
    node_test: N,
    single: &'a mut SingleScratch,
    /// Active lanes: one bit per ray that enters the node visited next.
    lanes: u64,
    /// Nodes visited so far.
    visited_nodes: u32,
}

impl<'a, S: Simd, Q: PacketQuery, N: NodeTest<'a, S>> PacketTraversal<'a, S, Q, N> {
    /// Tests one triangle, that of index `index`, against the active rays and offers the hits to their queries.
    #[inline(always)]
    fn intersect_triangle(&mut self, lanes: u64, triangle: &Triangle, index: u32) {
        let (simd, rays) = (self.simd, self.rays);
        // Load the shear of each ray.
        let load = |numbers: &F32Lanes| load(simd, *numbers);
        let shear = Shear {
            minus_scale: load(&rays.shear.minus_scale),
            slopes: [load(&rays.shear.slopes[0]), load(&rays.shear.slopes[1])],
            t_scale: load(&rays.shear.t_scale),
        };
        // Project the three vertices along each ray.
        let [a, b, c] = map_axes(
            [triangle.v0, triangle.v1, triangle.v2],
            #[inline(always)]
            |vertex| {
                let [x, y, t] = self.node_test.to_shear_axes(vertex);
                shear.apply(
                    [load(&rays.sheared_origins[0]) - x, load(&rays.sheared_origins[1]) - y],
                    t - load(&rays.sheared_origins[2]),
                )
            },
        );
        // Test the edges, then compute the distance.
        let corners = [[a[0], b[0], c[0]], [a[1], b[1], c[1]], [a[2], b[2], c[2]]];
        let hits = intersect_triangles(
            simd,
            lanes,
            corners,
            load(&rays.t_to_sheared),
            [load(&rays.slopes[0]), load(&rays.slopes[1])],
            #[inline(always)]
            || {
                let [least, greatest] = padded_box(triangle);
                PlaneOperands {
                    origin: [load(&rays.origins[0]), load(&rays.origins[1]), load(&rays.origins[2])],
                    direction: [load(&rays.directions[0]), load(&rays.directions[1]), load(&rays.directions[2])],
                    reciprocals: [load(&rays.reciprocals[0]), load(&rays.reciprocals[1]), load(&rays.reciprocals[2])],
                    corners: [
                        splat_axes(simd, triangle.v0),
                        splat_axes(simd, triangle.v1),
                        splat_axes(simd, triangle.v2),
                    ],
                    least: splat_axes(simd, least.to_array()),
                    greatest: splat_axes(simd, greatest.to_array()),
                    normal: splat_axes(simd, scaled_normal(triangle).to_array()),
                }
            },
        );
        let Some((mut hit_lanes, hits)) = hits else { return };
        // Clip to [t_min, t_max].
        hit_lanes &= hits.t.simd_ge(load(&rays.t_min)).to_bitmask();
        hit_lanes &= hits.t.simd_le(load(self.queries.t_max())).to_bitmask();
        // Offer the hits to the queries, and tell the node test that t_max may have shrunk.
        if hit_lanes != 0 {
            self.queries.accept_hits(simd, self.geometry, index, hit_lanes, &hits, &rays.directions);
            self.node_test.tighten_t_max(self.queries.t_max());
        }
    }
}

impl<'a, S: Simd, Q: PacketQuery, N: NodeTest<'a, S>> NodeVisitor for PacketTraversal<'a, S, Q, N> {
    #[inline(always)]
    fn intersect_children(&mut self, node: &WideNode, depth: usize) -> u32 {
        self.visited_nodes += 1;
        self.node_test.intersect_children(node, depth, self.lanes, self.queries.t_max())
    }

    #[inline(always)]
    fn cull_beyond_t_max(&self, slots: u32, depth: usize) -> u32 {
        self.node_test.cull_beyond_t_max(slots, depth)
    }

    #[inline(always)]
    fn enter_child(&mut self, node: &WideNode, depth: usize, slot: usize, child: u32) -> ChildVisit {
        // Descend as a whole near the root.
        if self.visited_nodes <= N::UNMASKED_NODES {
            return ChildVisit::Descend;
        }
        // Compute the active rays of the child. Enough of them: descend as a packet.
        let lanes = self.node_test.active_lanes(node, depth, slot, self.queries.t_max());
        if lanes.count_ones() > SINGLE_RAY_THRESHOLD {
            self.lanes = lanes;
            return ChildVisit::Descend;
        }
        // No active ray: skip the subtree.
        if lanes == 0 {
            return ChildVisit::Done { t_max_shortened: false };
        }
        // Few active rays: they have diverged from the others, finish the subtree one by one.
        traverse_single_rays(self.simd, child, self.single, self.geometry, self.rays, lanes, self.queries);
        self.node_test.tighten_t_max(self.queries.t_max());
        ChildVisit::Done { t_max_shortened: true }
    }

    #[inline(always)]
    fn visit_leaf(&mut self, node: &WideNode, depth: usize, slot: usize, triangles: PrimitiveRange) -> bool {
        // Compute the active rays of the leaf. None: skip it.
        let lanes = self.node_test.active_lanes(node, depth, slot, self.queries.t_max());
        if lanes == 0 {
            return false;
        }
        // Few active rays: single-ray triangle tests.
        if lanes.count_ones() <= SINGLE_RAY_THRESHOLD {
            intersect_leaf_single_rays(self.simd, self.geometry, self.rays, lanes, triangles, self.queries);
            self.node_test.tighten_t_max(self.queries.t_max());
            return true;
        }
        // Test each triangle against all active rays.
        let first = self.geometry.instance.first_triangle + triangles.first_primitive();
        let scene = self.geometry.scene;
        for (i, triangle) in (first..).zip(&scene.triangles[first as usize..][..triangles.primitive_count() as usize]) {
            self.intersect_triangle(lanes, triangle, i);
        }
        true
    }
}
