//! Node tests of a packet: 16 rays against the eight child boxes of a wide node, in a coherent and an incoherent form.
//!
//! A packet is *coherent* in an instance if all rays have the same direction octant and the same dominant axis
//! ([`is_coherent`]). [`Coherent`] bounds all rays by intervals and tests the eight boxes at once, whichever of the
//! rays hit them. Rays of an *incoherent* packet diverge at every node: [`Incoherent`] tests each box against all 16
//! rays, so that it is known which rays continue into which child. A single ray against eight boxes is in
//! `single_traversal`.

use bytemuck::Zeroable;
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f32x16, u8x16, u16x8};

use super::blas_traversal::MAX_NODE_DEPTH;
use super::ray_packet::LocalPacket;
use super::shear::{DominantAxes, SHEAR_AXES};
use super::simd::{F32Lanes, LANES, load, map_axes, reduce_max, reduce_min, splat_axes};
use super::wide_node::{child_planes, grid_step, hit_slots, near_far_shuffles, ray_interval, used_slots};
use crate::device::layout::WideNode;
use crate::trace::kernel::BOX_ENTRY_SCALE;

/// A packet's node test.
pub(super) trait NodeTest<'a, S: Simd> {
    /// Number of nodes for which the packet descends as a whole before the active rays of each child are computed.
    const UNMASKED_NODES: u32;

    fn new(simd: S, rays: &'a LocalPacket, t_max: &F32Lanes, scratch: &'a mut NodeTestScratch) -> Self;

    /// Slots of the children that some ray of `lanes` intersects; conservative: may contain others. Keeps what the
    /// methods below need for `depth`.
    fn intersect_children(&mut self, node: &WideNode, depth: usize, lanes: u64, t_max: &F32Lanes) -> u32;

    /// Mask of the rays that intersect the child at `slot` of the last node tested at `depth`, which is `node`.
    fn active_lanes(&self, node: &WideNode, depth: usize, slot: usize, t_max: &F32Lanes) -> u64;

    /// Tells the test that `t_max` has shrunk.
    fn tighten_t_max(&mut self, t_max: &F32Lanes);

    /// Of `slots`, children of the last node tested at `depth`, those that some ray may still enter by its `t_max`.
    fn cull_beyond_t_max(&self, slots: u32, depth: usize) -> u32;

    /// A vertex with its coordinates permuted to each ray's shear axes.
    fn to_shear_axes(&self, vertex: [f32; 3]) -> [f32x16<S>; 3];
}

/// Results per traversal depth, for both forms.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct NodeTestScratch {
    coherent: [CoherentLevel; MAX_NODE_DEPTH],
    incoherent: [IncoherentLevel; MAX_NODE_DEPTH],
}

/// Whether all rays have the same direction octant and the same dominant axis.
#[inline(always)]
pub(super) fn is_coherent(rays: &LocalPacket) -> bool {
    rays.shear_axes == [rays.shear_axes[0]; LANES] && rays.octants == [rays.octants[0]; LANES]
}

/// Mask of the rays whose interval from `t_min` to `t_max` overlaps a box, given the entry and exit distances of its
/// slab on each axis.
#[inline(always)]
pub(super) fn slab_test<S: Simd>(t: [[f32x16<S>; 2]; 3], t_min: f32x16<S>, t_max: f32x16<S>) -> u64 {
    let [[near_x, far_x], [near_y, far_y], [near_z, far_z]] = t;
    let t_entry = near_x.max(near_y).max(near_z.max(t_min));
    let t_exit = far_x.min(far_y).min(far_z.min(t_max));
    (t_entry * BOX_ENTRY_SCALE).simd_le(t_exit).to_bitmask()
}

/// Node test of a coherent packet: interval arithmetic bounds all 16 rays, one test against eight boxes. Which rays hit
/// a child is computed only on request ([`active_lanes`](NodeTest::active_lanes)).
///
/// A product with a reciprocal, a sum and a difference are each monotonic, rounded or not. So bounds computed from the
/// least and greatest origins and reciprocals bound, exactly, what is computed for each ray, and no box that any ray
/// hits is missed.
pub(super) struct Coherent<'a, S: Simd> {
    simd: S,
    rays: &'a LocalPacket,
    levels: &'a mut [CoherentLevel; MAX_NODE_DEPTH],
    /// Bounds of the origins: in lanes 0..8 the bound that gives the least entry distance, in lanes 8..16 the one that
    /// gives the greatest exit distance.
    origin_bounds: [f32x16<S>; 3],
    /// Bounds of the reciprocal directions, least then greatest, in the form of [`near_far_scales`].
    scale_bounds: [[f32x16<S>; 3]; 2],
    near_far_shuffles: [u8x16<S>; 3],
    t_min: f32x8<S>,
    t_max: f32x8<S>,
}

/// The last node tested at one depth.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
struct CoherentLevel {
    /// Decoded child planes per axis, near ones in lanes 0..8, far ones in 8..16: relative to the grid origin, local
    /// units.
    planes: [F32Lanes; 3],
    /// Least distance at which any ray of the packet may enter each child.
    t_entry: [f32; 8],
}

/// Reciprocal directions for near planes (lanes 0..8, times [`BOX_ENTRY_SCALE`]) and far planes (lanes 8..16, negated).
#[inline(always)]
fn near_far_scales<S: Simd>(reciprocals: f32x8<S>) -> f32x16<S> {
    (reciprocals * BOX_ENTRY_SCALE).combine(-reciprocals)
}

impl<'a, S: Simd> NodeTest<'a, S> for Coherent<'a, S> {
    const UNMASKED_NODES: u32 = 12;

    #[inline(always)]
    fn new(simd: S, rays: &'a LocalPacket, t_max: &F32Lanes, scratch: &'a mut NodeTestScratch) -> Self {
        let octant = rays.octants[0] as usize;
        Self {
            simd,
            rays,
            levels: &mut scratch.coherent,
            // Along a positive axis the greatest origin enters first and the least leaves last; else the reverse.
            origin_bounds: map_axes(
                [0, 1, 2],
                #[inline(always)]
                |axis: usize| {
                    let origins = load(simd, rays.origins[axis]);
                    let (least, greatest) = (reduce_min(origins), reduce_max(origins));
                    if octant >> axis & 1 == 0 { greatest.combine(least) } else { least.combine(greatest) }
                },
            ),
            // Either end of the range of reciprocals may give the bound, by the sign of the distance.
            scale_bounds: [
                map_axes(
                    [0, 1, 2],
                    #[inline(always)]
                    |axis: usize| near_far_scales(reduce_min(load(simd, rays.reciprocals[axis]))),
                ),
                map_axes(
                    [0, 1, 2],
                    #[inline(always)]
                    |axis: usize| near_far_scales(reduce_max(load(simd, rays.reciprocals[axis]))),
                ),
            ],
            near_far_shuffles: near_far_shuffles(simd, octant),
            // The smallest interval that holds those of all rays.
            t_min: reduce_min(load(simd, rays.t_min)),
            t_max: reduce_max(load(simd, *t_max)),
        }
    }

    #[inline(always)]
    fn intersect_children(&mut self, node: &WideNode, depth: usize, _: u64, _: &F32Lanes) -> u32 {
        let simd = self.simd;
        // For each axis: decode the child planes, and bound entry and negated exit distances over all rays.
        let steps = grid_step(simd, node);
        let [x, y, z] = map_axes(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let planes = child_planes(simd, node, axis, self.near_far_shuffles[axis]) * steps[axis];
                let distance = planes - (self.origin_bounds[axis] - f32x16::splat(simd, node.origin[axis]));
                let t = (distance * self.scale_bounds[0][axis]).min(distance * self.scale_bounds[1][axis]);
                (planes, t)
            },
        );
        // Intersect the slabs with the packet's interval.
        let (slots, t_entry) = hit_slots(node, x.1.max(y.1).max(z.1.max(ray_interval(self.t_min, self.t_max))));
        // Keep planes and entry distances for this depth.
        self.levels[depth] = CoherentLevel { planes: [x.0.into(), y.0.into(), z.0.into()], t_entry: t_entry.into() };
        slots
    }

    #[inline(always)]
    fn active_lanes(&self, node: &WideNode, depth: usize, slot: usize, t_max: &F32Lanes) -> u64 {
        let (simd, rays) = (self.simd, self.rays);
        let planes = &self.levels[depth].planes;
        // Distances of each ray to the child's planes, which were decoded when the node was tested.
        let t = map_axes(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let offset = f32x16::splat(simd, node.origin[axis]) - load(simd, rays.origins[axis]);
                let near = f32x16::splat(simd, planes[axis][slot & 7]) + offset;
                let far = f32x16::splat(simd, planes[axis][8 + (slot & 7)]) + offset;
                let reciprocals = load(simd, rays.reciprocals[axis]);
                [near * reciprocals, far * reciprocals]
            },
        );
        slab_test(t, load(simd, rays.t_min), load(simd, *t_max))
    }

    #[inline(always)]
    fn tighten_t_max(&mut self, t_max: &F32Lanes) {
        self.t_max = reduce_max(load(self.simd, *t_max));
    }

    #[inline(always)]
    fn cull_beyond_t_max(&self, slots: u32, depth: usize) -> u32 {
        slots & f32x8::simd_from(self.simd, self.levels[depth].t_entry).simd_le(self.t_max).to_bitmask() as u32
    }

    #[inline(always)]
    fn to_shear_axes(&self, vertex: [f32; 3]) -> [f32x16<S>; 3] {
        let axes = SHEAR_AXES[self.rays.shear_axes[0] as usize % SHEAR_AXES.len()];
        splat_axes(self.simd, [vertex[axes[0]], vertex[axes[1]], vertex[axes[2]]])
    }
}

/// Node test of an incoherent packet: each child's box is tested against all 16 rays.
pub(super) struct Incoherent<'a, S> {
    simd: S,
    rays: &'a LocalPacket,
    levels: &'a mut [IncoherentLevel; MAX_NODE_DEPTH],
}

/// Test results for the eight children of the last node tested at one depth.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
struct IncoherentLevel {
    /// Entry distance of each ray into each child, times [`BOX_ENTRY_SCALE`].
    t_entry: [F32Lanes; 8],
    /// Mask of the active rays that intersect each child.
    lanes: [u16; 8],
}

impl<'a, S: Simd> NodeTest<'a, S> for Incoherent<'a, S> {
    const UNMASKED_NODES: u32 = 0;

    #[inline(always)]
    fn new(simd: S, rays: &'a LocalPacket, _: &F32Lanes, scratch: &'a mut NodeTestScratch) -> Self {
        Self { simd, rays, levels: &mut scratch.incoherent }
    }

    /// Distance to a plane: `plane * (step * reciprocal) + (origin - ray.origin) * reciprocal`; `accel::blas::quantize`
    /// bounds its rounding.
    #[inline(always)]
    fn intersect_children(&mut self, node: &WideNode, depth: usize, lanes: u64, t_max: &F32Lanes) -> u32 {
        let (simd, rays) = (self.simd, self.rays);
        // For each axis: decode the child planes, and find each ray's t per grid step and at the grid origin.
        let steps = grid_step(simd, node);
        let [x, y, z] = map_axes(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let reciprocal = load(simd, rays.reciprocals[axis]);
                ChildSlabs {
                    planes: child_planes(simd, node, axis, near_far_shuffles(simd, 0)[0]).into(),
                    step: steps[axis] * reciprocal,
                    start: (f32x16::splat(simd, node.origin[axis]) - load(simd, rays.origins[axis])) * reciprocal,
                }
            },
        );
        // For each slot: entry and exit distances, and the mask of active rays that intersect the box.
        let (t_min, t_max) = (load(simd, rays.t_min), load(simd, *t_max));
        let level = &mut self.levels[depth];
        for_each_slot(
            #[inline(always)]
            |slot: usize| {
                let [x, y, z] = [x.intersect(simd, slot), y.intersect(simd, slot), z.intersect(simd, slot)];
                let t_entry = x[0].max(y[0]).max(z[0].max(t_min)) * BOX_ENTRY_SCALE;
                let t_exit = x[1].min(y[1]).min(z[1].min(t_max));
                level.t_entry[slot] = t_entry.into();
                level.lanes[slot] = (t_entry.simd_le(t_exit).to_bitmask() & lanes) as u16;
            },
        );
        // Return the slots in use that some active ray intersects.
        let missed = u16x8::simd_from(simd, level.lanes).simd_eq(0).to_bitmask() as u32;
        used_slots(node) & !missed
    }

    #[inline(always)]
    fn active_lanes(&self, _: &WideNode, depth: usize, slot: usize, t_max: &F32Lanes) -> u64 {
        let IncoherentLevel { t_entry, lanes } = &self.levels[depth];
        u64::from(lanes[slot & 7]) & load(self.simd, t_entry[slot & 7]).simd_le(load(self.simd, *t_max)).to_bitmask()
    }

    #[inline(always)]
    fn tighten_t_max(&mut self, _: &F32Lanes) {}

    /// No culling here: `active_lanes` compares each ray's own entry distance with its `t_max`.
    #[inline(always)]
    fn cull_beyond_t_max(&self, slots: u32, _: usize) -> u32 {
        slots
    }

    #[inline(always)]
    fn to_shear_axes(&self, vertex: [f32; 3]) -> [f32x16<S>; 3] {
        DominantAxes::from_rows(self.simd, self.rays.shear_axes).permute(splat_axes(self.simd, vertex))
    }
}

/// Slabs of a node's children along one axis, for 16 rays.
struct ChildSlabs<S: Simd> {
    /// Least planes in lanes 0..8, greatest in 8..16, in grid steps.
    planes: F32Lanes,
    /// Per ray: the change of t per grid step.
    step: f32x16<S>,
    /// Per ray: t at the grid origin.
    start: f32x16<S>,
}

impl<S: Simd> ChildSlabs<S> {
    /// Distances at which each ray enters and leaves the slab of the child at `slot`.
    #[inline(always)]
    fn intersect(&self, simd: S, slot: usize) -> [f32x16<S>; 2] {
        let a = f32x16::splat(simd, self.planes[slot]).mul_add(self.step, self.start);
        let b = f32x16::splat(simd, self.planes[8 + slot]).mul_add(self.step, self.start);
        [a.min(b), a.max(b)]
    }
}

/// Calls `f` for each slot. Unrolled by hand; unused slots are tested too and masked out by the caller.
#[inline(always)]
fn for_each_slot(mut f: impl FnMut(usize)) {
    f(0);
    f(1);
    f(2);
    f(3);
    f(4);
    f(5);
    f(6);
    f(7);
}
