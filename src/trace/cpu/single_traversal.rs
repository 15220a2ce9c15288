//! Single-ray traversal of a BLAS: one ray of a packet against the eight children of a node, then against four
//! triangles at a time. The loop is that of `blas_traversal`.

use bytemuck::Zeroable;
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f32x8, f32x16, u8x16};

use super::blas_traversal::{ChildVisit, MAX_NODE_DEPTH, NodeVisitor, Stack, traverse_blas};
use super::packet_queries::{InstanceGeometry, PacketQuery, QueryLane};
use super::ray_packet::LocalPacket;
use super::shear::{Shear, inverse_shear_axes};
use super::simd::{F32Lanes, LANES, lanes_of, load, map_axes};
use super::triangle_test::{
    PlaneOperands, first_four, gather_corners, intersect_triangles, padded_boxes, scaled_normals, split_corners,
};
use super::wide_node::{child_planes, grid_step, hit_slots, near_far_shuffles, ray_interval};
use crate::device::layout::{PrimitiveRange, Triangle, WideNode};
use crate::trace::kernel::{BOX_ENTRY_SCALE, TriangleHit, edge_scale};

/// Scratch memory of single-ray traversal. Reused without clearing; each entry is written before it is read.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct SingleScratch {
    stack: Stack,
    /// Entry distances of the children of each node on the stack, by depth.
    t_entry: [[f32; 8]; MAX_NODE_DEPTH],
}

/// Traverses the BLAS below the node of index `root` with each ray of `lanes` in turn. Never inlined, so that the
/// register allocator has all vector registers.
#[inline(never)]
pub(super) fn traverse_single_rays<S: Simd, Q: PacketQuery>(
    simd: S,
    root: u32,
    scratch: &mut SingleScratch,
    geometry: &InstanceGeometry<'_>,
    rays: &LocalPacket,
    lanes: u64,
    queries: &mut Q,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            for lane in lanes_of(lanes) {
                let query = &mut QueryLane { queries, lane };
                traverse_single_ray(simd, root, scratch, geometry, rays, lane, query);
            }
        },
    );
}

/// Intersects the triangles of a leaf with each ray of `lanes` in turn. Never inlined, so that the register allocator
/// has all vector registers.
#[inline(never)]
pub(super) fn intersect_leaf_single_rays<S: Simd, Q: PacketQuery>(
    simd: S,
    geometry: &InstanceGeometry<'_>,
    rays: &LocalPacket,
    lanes: u64,
    triangles: PrimitiveRange,
    queries: &mut Q,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            for lane in lanes_of(lanes) {
                let query = &mut QueryLane { queries, lane };
                intersect_leaf(simd, geometry, rays, lane % LANES, triangles, query);
            }
        },
    );
}

/// Traverses the BLAS below the node of index `root` with the ray in `lane`.
#[inline(always)]
fn traverse_single_ray<S: Simd>(
    simd: S,
    root: u32,
    scratch: &mut SingleScratch,
    geometry: &InstanceGeometry<'_>,
    rays: &LocalPacket,
    lane: usize,
    query: &mut QueryLane<'_, impl PacketQuery>,
) {
    let lane = lane % LANES;
    let mut visitor = SingleTraversal::new(simd, geometry, rays, lane, query, &mut scratch.t_entry);
    traverse_blas(geometry.nodes, root, rays.octants[lane] as usize, &mut scratch.stack, &mut visitor);
}

/// Visitor of a single-ray traversal.
struct SingleTraversal<'a, 'l, S: Simd, Q> {
    simd: S,
    geometry: &'a InstanceGeometry<'a>,
    rays: &'a LocalPacket,
    lane: usize,
    query: &'a mut QueryLane<'l, Q>,
    t_entry: &'a mut [[f32; 8]; MAX_NODE_DEPTH],
    origin: [f32x16<S>; 3],
    /// Reciprocal direction per axis: scaled by [`BOX_ENTRY_SCALE`] in lanes 0..8 (near planes), negated in lanes 8..16
    /// (far planes), so that one maximum over axes yields entry and negated exit distances.
    near_far_scales: [f32x16<S>; 3],
    near_far_shuffles: [u8x16<S>; 3],
    t_max: f32x8<S>,
    ray_interval: f32x16<S>,
}

/// Broadcasts one lane of `numbers`.
#[inline(always)]
fn splat_lane<S: Simd, V: SimdFloat<S, Element = f32>>(simd: S, numbers: &F32Lanes, lane: usize) -> V {
    V::splat(simd, numbers[lane])
}

impl<'a, 'l, S: Simd, Q: PacketQuery> SingleTraversal<'a, 'l, S, Q> {
    #[inline(always)]
    fn new(
        simd: S,
        geometry: &'a InstanceGeometry<'a>,
        rays: &'a LocalPacket,
        lane: usize,
        query: &'a mut QueryLane<'l, Q>,
        t_entry: &'a mut [[f32; 8]; MAX_NODE_DEPTH],
    ) -> Self {
        let signs = f32x8::splat(simd, BOX_ENTRY_SCALE).combine(f32x8::splat(simd, -1.0));
        let t_max = f32x8::splat(simd, query.t_max());
        Self {
            simd,
            geometry,
            rays,
            lane,
            t_entry,
            origin: [
                splat_lane(simd, &rays.origins[0], lane),
                splat_lane(simd, &rays.origins[1], lane),
                splat_lane(simd, &rays.origins[2], lane),
            ],
            near_far_scales: [
                splat_lane::<S, f32x16<S>>(simd, &rays.reciprocals[0], lane) * signs,
                splat_lane::<S, f32x16<S>>(simd, &rays.reciprocals[1], lane) * signs,
                splat_lane::<S, f32x16<S>>(simd, &rays.reciprocals[2], lane) * signs,
            ],
            near_far_shuffles: near_far_shuffles(simd, rays.octants[lane] as usize),
            t_max,
            ray_interval: ray_interval(splat_lane(simd, &rays.t_min, lane), t_max),
            query,
        }
    }
}

impl<S: Simd, Q: PacketQuery> NodeVisitor for SingleTraversal<'_, '_, S, Q> {
    #[inline(always)]
    fn intersect_children(&mut self, node: &WideNode, depth: usize) -> u32 {
        let simd = self.simd;
        // For each axis: decode the child planes, and compute entry and negated exit distances.
        let steps = grid_step(simd, node);
        let [x, y, z] = map_axes(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let to_ray_origin = self.origin[axis] - f32x16::splat(simd, node.origin[axis]);
                child_planes(simd, node, axis, self.near_far_shuffles[axis]).mul_sub(steps[axis], to_ray_origin)
                    * self.near_far_scales[axis]
            },
        );
        // Intersect the slabs with the ray's interval, and keep the entry distances for this depth.
        let (slots, t_entry) = hit_slots(node, x.max(y).max(z.max(self.ray_interval)));
        self.t_entry[depth] = t_entry.into();
        slots
    }

    #[inline(always)]
    fn cull_beyond_t_max(&self, slots: u32, depth: usize) -> u32 {
        slots & f32x8::simd_from(self.simd, self.t_entry[depth]).simd_le(self.t_max).to_bitmask() as u32
    }

    #[inline(always)]
    fn enter_child(&mut self, _: &WideNode, _: usize, _: usize, _: u32) -> ChildVisit {
        ChildVisit::Descend
    }

    #[inline(always)]
    fn visit_leaf(&mut self, _: &WideNode, _: usize, _: usize, triangles: PrimitiveRange) -> bool {
        let t_max_shortened = intersect_leaf(self.simd, self.geometry, self.rays, self.lane, triangles, self.query);
        // Shorten the interval for the node tests that follow.
        if t_max_shortened {
            self.t_max = f32x8::splat(self.simd, self.query.t_max());
            self.ray_interval = ray_interval(splat_lane(self.simd, &self.rays.t_min, self.lane), self.t_max);
        }
        t_max_shortened
    }
}

/// Intersects the triangles of a leaf; returns whether a candidate was offered, so `t_max` may have shrunk.
#[inline(always)]
fn intersect_leaf<S: Simd>(
    simd: S,
    geometry: &InstanceGeometry<'_>,
    rays: &LocalPacket,
    lane: usize,
    triangles: PrimitiveRange,
    query: &mut QueryLane<'_, impl PacketQuery>,
) -> bool {
    let (mut first, mut count) =
        (geometry.instance.first_triangle + triangles.first_primitive(), triangles.primitive_count());
    let mut t_max_shortened = false;
    // Four triangles at a time; the last call takes the rest.
    while count > 4 {
        t_max_shortened |= intersect_four_triangles(simd, geometry, rays, lane, first, 4, query);
        (first, count) = (first + 4, count - 4);
    }
    t_max_shortened | intersect_four_triangles(simd, geometry, rays, lane, first, count, query)
}

/// Intersects up to four triangles, from the one of index `first` on; returns whether a candidate was offered.
#[inline(always)]
fn intersect_four_triangles<S: Simd>(
    simd: S,
    geometry: &InstanceGeometry<'_>,
    rays: &LocalPacket,
    lane: usize,
    first: u32,
    count: u32,
    query: &mut QueryLane<'_, impl PacketQuery>,
) -> bool {
    // Gather the vertices of four triangles in the ray's shear axes.
    let triangles = &geometry.scene.triangles[first as usize..];
    let mut padded = [Triangle::zeroed(); 4];
    let four = first_four(triangles, &mut padded);
    let lanes = (1 << count) - 1;
    let axes = rays.shear_axes[lane] as usize;
    let gathered = gather_corners(simd, four, axes);
    let in_memory: [F32Lanes; 3] = [gathered[0].into(), gathered[1].into(), gathered[2].into()];
    // Broadcast the ray.
    let origin: [f32x16<S>; 3] = [
        splat_lane(simd, &rays.sheared_origins[0], lane),
        splat_lane(simd, &rays.sheared_origins[1], lane),
        splat_lane(simd, &rays.sheared_origins[2], lane),
    ];
    let shear = Shear {
        minus_scale: splat_lane(simd, &rays.shear.minus_scale, lane),
        slopes: [splat_lane(simd, &rays.shear.slopes[0], lane), splat_lane(simd, &rays.shear.slopes[1], lane)],
        t_scale: splat_lane(simd, &rays.shear.t_scale, lane),
    };
    // Project the vertices along the ray.
    let [x, y, t] = shear.apply([origin[0] - gathered[0], origin[1] - gathered[1]], gathered[2] - origin[2]);
    let corners = [split_corners(x), split_corners(y), split_corners(t)];
    // Test the edges, then compute the distances.
    let hits = intersect_triangles(
        simd,
        lanes,
        corners,
        splat_lane(simd, &rays.t_to_sheared, lane),
        [splat_lane(simd, &rays.slopes[0], lane), splat_lane(simd, &rays.slopes[1], lane)],
        #[inline(always)]
        || {
            // Permute the vertices back from shear axes.
            let [x, y, z] = map_axes(
                inverse_shear_axes(axes),
                #[inline(always)]
                |shear_axis: usize| split_corners(load(simd, in_memory[shear_axis])),
            );
            let corners = [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]];
            let edge_scales = [edge_scale(&four[0]), edge_scale(&four[1]), edge_scale(&four[2]), edge_scale(&four[3])];
            let [least, greatest] = padded_boxes(corners);
            PlaneOperands {
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
                reciprocals: map_axes(
                    [0, 1, 2],
                    #[inline(always)]
                    |axis: usize| splat_lane::<S, f32x4<S>>(simd, &rays.reciprocals[axis], lane),
                ),
                corners,
                least,
                greatest,
                normal: scaled_normals(corners, edge_scales.simd_into(simd)),
            }
        },
    );
    let Some((mut hit_lanes, hits)) = hits else { return false };
    // Clip to [t_min, t_max].
    hit_lanes &= hits.t.simd_ge(rays.t_min[lane]).to_bitmask();
    hit_lanes &= hits.t.simd_le(query.t_max()).to_bitmask();
    if hit_lanes == 0 {
        return false;
    }
    // Offer the hits in slot order.
    let (t, u, v): ([f32; 4], [f32; 4], [f32; 4]) = (hits.t.into(), hits.u.into(), hits.v.into());
    while hit_lanes != 0 {
        let slot = hit_lanes.trailing_zeros() as usize & 3;
        hit_lanes &= hit_lanes - 1;
        let back = hits.back >> slot & 1 != 0;
        let hit = TriangleHit { t: t[slot], u: u[slot], v: v[slot], back };
        query.accept_hit(geometry, first + slot as u32, &hit, &rays.directions);
    }
    true
}
