//! Which rays of a packet meet which of eight boxes.

use bytemuck::Zeroable;
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f32x16, u8x16, u16x8, u32x16};

use super::local_packet::{AXES, LocalPacket, meet_slabs};
use super::simd::{LANES, Numbers, children, each, greatest_of, least_of, load, met, near_first, planes, range, steps};
use super::triangle_test::splats;
use super::wide_traversal::DEPTH;
use crate::device::layout::WideNode;
use crate::trace::kernel::BOX_SLACK;

/// How the rays of a packet are tested against boxes.
pub(super) trait Boxes<'a, S: Simd> {
    /// Nodes that all rays visit before it is asked which of them do.
    const COHERENT: u32;

    fn new(simd: S, rays: &'a LocalPacket, t_max: &Numbers, memory: &'a mut Memory) -> Self;

    /// The children of a node that the rays of these lanes meet, and perhaps others.
    fn meet(&mut self, node: &WideNode, depth: usize, lanes: u64, t_max: &Numbers) -> u32;

    /// The rays that meet a child of the node that was met last at that depth.
    fn lanes(&self, node: &WideNode, depth: usize, slot: usize, t_max: &Numbers) -> u64;

    /// Rays go less far than they did.
    fn shorten(&mut self, t_max: &Numbers);

    /// Those of these children of the node that was met last at that depth that may still be met.
    fn still_meet(&self, slots: u32, depth: usize) -> u32;

    /// The coordinates of a corner along the axes of each ray's shear.
    fn along_axes(&self, corner: [f32; 3]) -> [f32x16<S>; 3];
}

/// Of the nodes that are being visited.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct Memory {
    alike: [Planes; DEPTH],
    mixed: [Children; DEPTH],
}

/// Whether rays all go into one octant, and most along one axis.
#[inline(always)]
pub(super) fn is_coherent(rays: &LocalPacket) -> bool {
    rays.axes == [rays.axes[0]; LANES] && rays.octants == [rays.octants[0]; LANES]
}

/// Rays that [`are_alike`]: interval arithmetic on all of them at once against eight boxes at once. Each ray by itself only where it is
/// asked which.
///
/// A product with a reciprocal, a sum, a difference: each is monotonic, rounded or not. So bounds computed from the least and greatest
/// origins and reciprocals bound what is computed for each ray, exactly, and a box that any ray of the packet meets is met.
pub(super) struct Coherent<'a, S: Simd> {
    simd: S,
    rays: &'a LocalPacket,
    levels: &'a mut [Planes; DEPTH],
    /// The least and greatest origins, in the lower lanes those that make planes nearer, in the upper ones those that make them farther.
    outer_origins: [f32x16<S>; 3],
    /// The least reciprocals as near planes and far planes are multiplied by them, see [`scales`]; then the greatest.
    outer_scales: [[f32x16<S>; 3]; 2],
    orders: [u8x16<S>; 3],
    t_min: f32x8<S>,
    t_max: f32x8<S>,
}

/// For each axis the near planes of a node's children, then the far ones, from the origin of the grid. Then where the packet enters the
/// children.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
struct Planes {
    planes: [Numbers; 3],
    enters: [f32; 8],
}

/// What near planes, in the lower lanes, and far planes are multiplied by: so that they are near by the slack of boxes, and negated.
#[inline(always)]
fn scales<S: Simd>(reciprocals: f32x8<S>) -> f32x16<S> {
    (reciprocals * BOX_SLACK).combine(-reciprocals)
}

impl<'a, S: Simd> Boxes<'a, S> for Coherent<'a, S> {
    const COHERENT: u32 = 12;

    #[inline(always)]
    fn new(simd: S, rays: &'a LocalPacket, t_max: &Numbers, memory: &'a mut Memory) -> Self {
        let octant = rays.octants[0] as usize;
        Self {
            simd,
            rays,
            levels: &mut memory.alike,
            outer_origins: each(
                [0, 1, 2],
                #[inline(always)]
                |axis: usize| {
                    let origins = load(simd, rays.origins[axis]);
                    let (least, greatest) = (least_of(origins), greatest_of(origins));
                    if octant >> axis & 1 == 0 { greatest.combine(least) } else { least.combine(greatest) }
                },
            ),
            outer_scales: [
                each(
                    [0, 1, 2],
                    #[inline(always)]
                    |axis: usize| scales(least_of(load(simd, rays.reciprocals[axis]))),
                ),
                each(
                    [0, 1, 2],
                    #[inline(always)]
                    |axis: usize| scales(greatest_of(load(simd, rays.reciprocals[axis]))),
                ),
            ],
            orders: near_first(simd, octant),
            t_min: least_of(load(simd, rays.t_min)),
            t_max: greatest_of(load(simd, *t_max)),
        }
    }

    #[inline(always)]
    fn meet(&mut self, node: &WideNode, depth: usize, _: u64, _: &Numbers) -> u32 {
        let simd = self.simd;
        let steps = steps(simd, node);
        let [x, y, z] = each(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let planes = planes(simd, node, axis, self.orders[axis]) * steps[axis];
                let from = planes - (self.outer_origins[axis] - f32x16::splat(simd, node.origin[axis]));
                let t = (from * self.outer_scales[0][axis]).min(from * self.outer_scales[1][axis]);
                (planes, t)
            },
        );
        let (met, enters) = met(node, x.1.max(y.1).max(z.1.max(range(self.t_min, self.t_max))));
        self.levels[depth] = Planes { planes: [x.0.into(), y.0.into(), z.0.into()], enters: enters.into() };
        met
    }

    #[inline(always)]
    fn lanes(&self, node: &WideNode, depth: usize, slot: usize, t_max: &Numbers) -> u64 {
        let (simd, rays) = (self.simd, self.rays);
        let planes = &self.levels[depth].planes;
        let t = each(
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
        meet_slabs(t, load(simd, rays.t_min), load(simd, *t_max))
    }

    #[inline(always)]
    fn shorten(&mut self, t_max: &Numbers) {
        self.t_max = greatest_of(load(self.simd, *t_max));
    }

    #[inline(always)]
    fn still_meet(&self, slots: u32, depth: usize) -> u32 {
        slots & f32x8::simd_from(self.simd, self.levels[depth].enters).simd_le(self.t_max).to_bitmask() as u32
    }

    #[inline(always)]
    fn along_axes(&self, corner: [f32; 3]) -> [f32x16<S>; 3] {
        let axes = AXES[self.rays.axes[0] as usize % AXES.len()];
        splats(self.simd, [corner[axes[0]], corner[axes[1]], corner[axes[2]]])
    }
}

/// Rays that go anywhere: one box after the other against all of them.
pub(super) struct Incoherent<'a, S> {
    simd: S,
    rays: &'a LocalPacket,
    levels: &'a mut [Children; DEPTH],
}

/// The children of a node.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
struct Children {
    /// Where each ray enters, rounded down.
    enters: [Numbers; 8],
    /// A bit for each ray that meets the child.
    lanes: [u16; 8],
}

impl<'a, S: Simd> Boxes<'a, S> for Incoherent<'a, S> {
    const COHERENT: u32 = 0;

    #[inline(always)]
    fn new(simd: S, rays: &'a LocalPacket, _: &Numbers, memory: &'a mut Memory) -> Self {
        Self { simd, rays, levels: &mut memory.mixed }
    }

    /// A plane is met at `plane * (step * reciprocal) + (origin - ray.origin) * reciprocal`: see `accel::wide` for what rounding does.
    #[inline(always)]
    fn meet(&mut self, node: &WideNode, depth: usize, lanes: u64, t_max: &Numbers) -> u32 {
        let (simd, rays) = (self.simd, self.rays);
        let steps = steps(simd, node);
        let [x, y, z] = each(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let reciprocal = load(simd, rays.reciprocals[axis]);
                Slabs {
                    planes: planes(simd, node, axis, near_first(simd, 0)[0]).into(),
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
                let enters = x[0].max(y[0]).max(z[0].max(t_min)) * BOX_SLACK;
                let leaves = x[1].min(y[1]).min(z[1].min(t_max));
                level.enters[slot] = enters.into();
                level.lanes[slot] = (enters.simd_le(leaves).to_bitmask() & lanes) as u16;
            },
        );
        let missed = u16x8::simd_from(simd, level.lanes).simd_eq(0).to_bitmask() as u32;
        children(node) & !missed
    }

    #[inline(always)]
    fn lanes(&self, _: &WideNode, depth: usize, slot: usize, t_max: &Numbers) -> u64 {
        let Children { enters, lanes } = &self.levels[depth];
        u64::from(lanes[slot & 7]) & load(self.simd, enters[slot & 7]).simd_le(load(self.simd, *t_max)).to_bitmask()
    }

    #[inline(always)]
    fn shorten(&mut self, _: &Numbers) {}

    /// Each ray is asked when its turn comes.
    #[inline(always)]
    fn still_meet(&self, slots: u32, _: usize) -> u32 {
        slots
    }

    #[inline(always)]
    fn along_axes(&self, corner: [f32; 3]) -> [f32x16<S>; 3] {
        let simd = self.simd;
        // Pairs of rows of `AXES` are those of rays that go most along x, y and z.
        let axes = u32x16::simd_from(simd, self.rays.axes);
        let (x_most, y_most) = (axes.simd_lt(2), axes.simd_lt(4));
        let goes_down = (axes & 1).simd_eq(1);
        let [x, y, z] = splats::<S, f32x16<S>>(simd, corner);
        let (i, j) = (x_most.select(y, y_most.select(z, x)), x_most.select(z, y_most.select(x, y)));
        [goes_down.select(j, i), goes_down.select(i, j), x_most.select(x, y_most.select(y, z))]
    }
}

/// The slabs of a node's children along an axis, as rays see them.
struct Slabs<S: Simd> {
    /// The least planes, then the greatest, in steps.
    planes: Numbers,
    /// How far a step is along each ray, and how far the origin of the grid.
    step: f32x16<S>,
    start: f32x16<S>,
}

impl<S: Simd> Slabs<S> {
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
