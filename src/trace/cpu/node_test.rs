//! Which rays of a packet meet which of eight boxes.

use bytemuck::Zeroable;
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f32x16, u8x16, u16x8, u32x16};

use super::blas_traversal::MAX_NODE_DEPTH;
use super::ray_packet::{LocalPacket, SHEAR_AXES, slab_test};
use super::simd::{
    F32Lanes, LANES, child_planes, grid_step, hit_slots, load, map_axes, near_far_shuffle, ray_interval, reduce_max,
    reduce_min, used_slots,
};
use super::triangle_test::splat_axes;
use crate::device::layout::WideNode;
use crate::trace::kernel::BOX_ENTRY_SCALE;

/// How the rays of a packet are tested against boxes.
pub(super) trait NodeTest<'a, S: Simd> {
    /// Nodes that all rays visit before it is asked which of them do.
    const UNMASKED_NODES: u32;

    fn new(simd: S, rays: &'a LocalPacket, t_max: &F32Lanes, memory: &'a mut NodeTestScratch) -> Self;

    /// The children of a node that the rays of these lanes meet, and perhaps others.
    fn meet(&mut self, node: &WideNode, depth: usize, lanes: u64, t_max: &F32Lanes) -> u32;

    /// The rays that meet a child of the node that was met last at that depth.
    fn active_lanes(&self, node: &WideNode, depth: usize, slot: usize, t_max: &F32Lanes) -> u64;

    /// Rays go less far than they did.
    fn tighten_t_max(&mut self, t_max: &F32Lanes);

    /// Those of these children of the node that was met last at that depth that may still be met.
    fn still_meet(&self, slots: u32, depth: usize) -> u32;

    /// The coordinates of a corner along the axes of each ray's shear.
    fn to_shear_axes(&self, corner: [f32; 3]) -> [f32x16<S>; 3];
}

/// Of the nodes that are being visited.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct NodeTestScratch {
    alike: [CoherentLevel; MAX_NODE_DEPTH],
    mixed: [IncoherentLevel; MAX_NODE_DEPTH],
}

/// Whether rays all go into one octant, and most along one axis.
#[inline(always)]
pub(super) fn is_coherent(rays: &LocalPacket) -> bool {
    rays.shear_axes == [rays.shear_axes[0]; LANES] && rays.octants == [rays.octants[0]; LANES]
}

/// Rays that [`is_coherent`]: interval arithmetic on all of them at once against eight boxes at once. Each ray by itself only where it is
/// asked which.
///
/// A product with a reciprocal, a sum, a difference: each is monotonic, rounded or not. So bounds computed from the least and greatest
/// origins and reciprocals bound what is computed for each ray, exactly, and a box that any ray of the packet meets is met.
pub(super) struct Coherent<'a, S: Simd> {
    simd: S,
    rays: &'a LocalPacket,
    levels: &'a mut [CoherentLevel; MAX_NODE_DEPTH],
    /// The least and greatest origins, in the lower lanes those that make planes nearer, in the upper ones those that make them farther.
    origin_bounds: [f32x16<S>; 3],
    /// The least reciprocals as near planes and far planes are multiplied by them, see [`near_far_scales`]; then the greatest.
    scale_bounds: [[f32x16<S>; 3]; 2],
    near_far_shuffles: [u8x16<S>; 3],
    t_min: f32x8<S>,
    t_max: f32x8<S>,
}

/// For each axis the near planes of a node's children, then the far ones, from the origin of the grid. Then where the packet enters the
/// children.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
struct CoherentLevel {
    planes: [F32Lanes; 3],
    enters: [f32; 8],
}

/// What near planes, in the lower lanes, and far planes are multiplied by: so that they are near by the slack of boxes, and negated.
#[inline(always)]
fn near_far_scales<S: Simd>(reciprocals: f32x8<S>) -> f32x16<S> {
    (reciprocals * BOX_ENTRY_SCALE).combine(-reciprocals)
}

impl<'a, S: Simd> NodeTest<'a, S> for Coherent<'a, S> {
    const UNMASKED_NODES: u32 = 12;

    #[inline(always)]
    fn new(simd: S, rays: &'a LocalPacket, t_max: &F32Lanes, memory: &'a mut NodeTestScratch) -> Self {
        let octant = rays.octants[0] as usize;
        Self {
            simd,
            rays,
            levels: &mut memory.alike,
            origin_bounds: map_axes(
                [0, 1, 2],
                #[inline(always)]
                |axis: usize| {
                    let origins = load(simd, rays.origins[axis]);
                    let (least, greatest) = (reduce_min(origins), reduce_max(origins));
                    if octant >> axis & 1 == 0 { greatest.combine(least) } else { least.combine(greatest) }
                },
            ),
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
            near_far_shuffles: near_far_shuffle(simd, octant),
            t_min: reduce_min(load(simd, rays.t_min)),
            t_max: reduce_max(load(simd, *t_max)),
        }
    }

    #[inline(always)]
    fn meet(&mut self, node: &WideNode, depth: usize, _: u64, _: &F32Lanes) -> u32 {
        let simd = self.simd;
        let steps = grid_step(simd, node);
        let [x, y, z] = map_axes(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let planes = child_planes(simd, node, axis, self.near_far_shuffles[axis]) * steps[axis];
                let from = planes - (self.origin_bounds[axis] - f32x16::splat(simd, node.origin[axis]));
                let t = (from * self.scale_bounds[0][axis]).min(from * self.scale_bounds[1][axis]);
                (planes, t)
            },
        );
        let (met, enters) = hit_slots(node, x.1.max(y.1).max(z.1.max(ray_interval(self.t_min, self.t_max))));
        self.levels[depth] = CoherentLevel { planes: [x.0.into(), y.0.into(), z.0.into()], enters: enters.into() };
        met
    }

    #[inline(always)]
    fn active_lanes(&self, node: &WideNode, depth: usize, slot: usize, t_max: &F32Lanes) -> u64 {
        let (simd, rays) = (self.simd, self.rays);
        let planes = &self.levels[depth].planes;
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
    fn still_meet(&self, slots: u32, depth: usize) -> u32 {
        slots & f32x8::simd_from(self.simd, self.levels[depth].enters).simd_le(self.t_max).to_bitmask() as u32
    }

    #[inline(always)]
    fn to_shear_axes(&self, corner: [f32; 3]) -> [f32x16<S>; 3] {
        let axes = SHEAR_AXES[self.rays.shear_axes[0] as usize % SHEAR_AXES.len()];
        splat_axes(self.simd, [corner[axes[0]], corner[axes[1]], corner[axes[2]]])
    }
}

/// Rays that go anywhere: one box after the other against all of them.
pub(super) struct Incoherent<'a, S> {
    simd: S,
    rays: &'a LocalPacket,
    levels: &'a mut [IncoherentLevel; MAX_NODE_DEPTH],
}

/// The children of a node.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
struct IncoherentLevel {
    /// Where each ray enters, rounded down.
    enters: [F32Lanes; 8],
    /// A bit for each ray that meets the child.
    lanes: [u16; 8],
}

impl<'a, S: Simd> NodeTest<'a, S> for Incoherent<'a, S> {
    const UNMASKED_NODES: u32 = 0;

    #[inline(always)]
    fn new(simd: S, rays: &'a LocalPacket, _: &F32Lanes, memory: &'a mut NodeTestScratch) -> Self {
        Self { simd, rays, levels: &mut memory.mixed }
    }

    /// A plane is met at `plane * (step * reciprocal) + (origin - ray.origin) * reciprocal`: see `accel::wide` for what rounding does.
    #[inline(always)]
    fn meet(&mut self, node: &WideNode, depth: usize, lanes: u64, t_max: &F32Lanes) -> u32 {
        let (simd, rays) = (self.simd, self.rays);
        let steps = grid_step(simd, node);
        let [x, y, z] = map_axes(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let reciprocal = load(simd, rays.reciprocals[axis]);
                ChildSlabs {
                    planes: child_planes(simd, node, axis, near_far_shuffle(simd, 0)[0]).into(),
                    step: steps[axis] * reciprocal,
                    start: (f32x16::splat(simd, node.origin[axis]) - load(simd, rays.origins[axis])) * reciprocal,
                }
            },
        );
        let (t_min, t_max) = (load(simd, rays.t_min), load(simd, *t_max));
        let level = &mut self.levels[depth];
        for_each_slot(
            #[inline(always)]
            |slot: usize| {
                let [x, y, z] = [x.meet(simd, slot), y.meet(simd, slot), z.meet(simd, slot)];
                let enters = x[0].max(y[0]).max(z[0].max(t_min)) * BOX_ENTRY_SCALE;
                let leaves = x[1].min(y[1]).min(z[1].min(t_max));
                level.enters[slot] = enters.into();
                level.lanes[slot] = (enters.simd_le(leaves).to_bitmask() & lanes) as u16;
            },
        );
        let missed = u16x8::simd_from(simd, level.lanes).simd_eq(0).to_bitmask() as u32;
        used_slots(node) & !missed
    }

    #[inline(always)]
    fn active_lanes(&self, _: &WideNode, depth: usize, slot: usize, t_max: &F32Lanes) -> u64 {
        let IncoherentLevel { enters, lanes } = &self.levels[depth];
        u64::from(lanes[slot & 7]) & load(self.simd, enters[slot & 7]).simd_le(load(self.simd, *t_max)).to_bitmask()
    }

    #[inline(always)]
    fn tighten_t_max(&mut self, _: &F32Lanes) {}

    /// Each ray is asked when its turn comes.
    #[inline(always)]
    fn still_meet(&self, slots: u32, _: usize) -> u32 {
        slots
    }

    #[inline(always)]
    fn to_shear_axes(&self, corner: [f32; 3]) -> [f32x16<S>; 3] {
        let simd = self.simd;
        // Pairs of rows of `SHEAR_AXES` are those of rays that go most along x, y and z.
        let axes = u32x16::simd_from(simd, self.rays.shear_axes);
        let (x_most, y_most) = (axes.simd_lt(2), axes.simd_lt(4));
        let goes_down = (axes & 1).simd_eq(1);
        let [x, y, z] = splat_axes::<S, f32x16<S>>(simd, corner);
        let (i, j) = (x_most.select(y, y_most.select(z, x)), x_most.select(z, y_most.select(x, y)));
        [goes_down.select(j, i), goes_down.select(i, j), x_most.select(x, y_most.select(y, z))]
    }
}

/// The slabs of a node's children along an axis, as rays see them.
struct ChildSlabs<S: Simd> {
    /// The least planes, then the greatest, in steps.
    planes: F32Lanes,
    /// How far a step is along each ray, and how far the origin of the grid.
    step: f32x16<S>,
    start: f32x16<S>,
}

impl<S: Simd> ChildSlabs<S> {
    /// Where rays enter and leave the slab of a child.
    #[inline(always)]
    fn meet(&self, simd: S, slot: usize) -> [f32x16<S>; 2] {
        let a = f32x16::splat(simd, self.planes[slot]).mul_add(self.step, self.start);
        let b = f32x16::splat(simd, self.planes[8 + slot]).mul_add(self.step, self.start);
        [a.min(b), a.max(b)]
    }
}

/// Not a loop: most nodes have eight children, and those that do not exist do no harm.
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
