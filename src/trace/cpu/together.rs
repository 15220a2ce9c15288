//! Rays of a packet that go much the same way: interval arithmetic on all of them at once against eight boxes at once, single rays
//! only against the boxes of leaves and against triangles.
//!
//! A product with a reciprocal, a sum, a difference: each is monotonic, rounded or not. So bounds computed from the least and greatest
//! origins and reciprocals bound what is computed for each ray, exactly, and a box that any ray of the packet meets is met.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f32x16, u8x16};

use super::answers::{Answers, Place};
use super::lanes::{LANES, Numbers, each, greatest_of, least_of, load, near_first, planes, steps};
use super::local::{LocalPacket, meet_slabs};
use super::single::walk_singly;
use super::triangles::{Unsheared, cross, plane_distances, splats};
use super::walk::{DEPTH, Stack, Walker, met, range};
use crate::device::layout::{PrimitiveRange, Triangle, WideNode};
use crate::trace::kernel::BOX_SLACK;

/// Nodes that rays visit together before it is asked which of them meet a node at all.
const COHERENT: u32 = 12;
/// As many rays as go on one by one.
const FEW: u32 = 2;

/// What packets write to. Kept from packet to packet, so that nothing clears it.
#[derive(Default)]
pub(super) struct Memory {
    planes: Planes,
    /// Of single rays.
    pub(super) stack: Stack,
}

/// Whether rays all go into one octant, and most along one axis.
#[inline(always)]
pub(super) fn go_together<S: Simd>(rays: &LocalPacket<S>) -> bool {
    let agree = |lanes: u64| lanes == 0 || lanes == 0xffff;
    let ([x, y, z], [most_x, most_y]) = (rays.down, rays.most);
    agree(x) && agree(y) && agree(z) && agree(most_x) && agree(most_y)
}

/// Of the nodes that are being visited, for each axis the near planes of the children, then the far ones, from the origin of the grid.
/// Kept from packet to packet, so that nothing clears it.
struct Planes([[Numbers; 3]; DEPTH]);

impl Default for Planes {
    fn default() -> Self {
        Self([[[0.0; LANES]; 3]; DEPTH])
    }
}

/// All rays of a packet, that ask one kind of query.
pub(super) struct Together<'a, S: Simd, A> {
    simd: S,
    place: &'a Place<'a>,
    rays: &'a LocalPacket<S>,
    answers: &'a mut A,
    memory: &'a mut Memory,
    nodes: &'a [WideNode],
    /// Inner nodes below the root visited so far.
    visited: u32,
    /// The least and greatest origins, in the lower lanes those that make planes nearer, in the upper ones those that make them farther.
    outer_origins: [f32x16<S>; 3],
    /// The least reciprocals as near planes and far planes are multiplied by them, see [`super::single`]; then the greatest.
    outer_scales: [[f32x16<S>; 3]; 2],
    orders: [u8x16<S>; 3],
    least_t_min: f32x8<S>,
    t_max: f32x8<S>,
    range: f32x16<S>,
    axes: [usize; 3],
    /// The origins along `axes`.
    from: [f32x16<S>; 3],
}

impl<'a, S: Simd, A: Answers> Together<'a, S, A> {
    /// Of rays that [`go_together`].
    #[inline(always)]
    pub(super) fn new(
        simd: S,
        place: &'a Place<'a>,
        rays: &'a LocalPacket<S>,
        answers: &'a mut A,
        nodes: &'a [WideNode],
        memory: &'a mut Memory,
    ) -> Self {
        let least_t_min = least_of(rays.t_min);
        let t_max = greatest_of(load(simd, *answers.t_max()));
        let axes = rays.axes(0);
        Self {
            simd,
            place,
            rays,
            answers,
            memory,
            nodes,
            visited: 0,
            outer_origins: each(
                [0, 1, 2],
                #[inline(always)]
                |axis: usize| {
                    let (least, greatest) = (least_of(rays.origins[axis]), greatest_of(rays.origins[axis]));
                    if rays.down[axis] == 0 { greatest.combine(least) } else { least.combine(greatest) }
                },
            ),
            outer_scales: [
                each(
                    rays.reciprocals,
                    #[inline(always)]
                    |r| scales(least_of(r)),
                ),
                each(
                    rays.reciprocals,
                    #[inline(always)]
                    |r| scales(greatest_of(r)),
                ),
            ],
            orders: each(
                rays.down,
                #[inline(always)]
                |down| near_first(simd, down != 0),
            ),
            least_t_min,
            t_max,
            range: range(least_t_min, t_max),
            axes,
            from: each(
                axes,
                #[inline(always)]
                |axis: usize| rays.origins[axis.min(2)],
            ),
        }
    }

    /// The rays that meet the box in that slot.
    #[inline(always)]
    fn meet_lanes(&self, node: &WideNode, depth: usize, slot: usize) -> u64 {
        let simd = self.simd;
        let planes = &self.memory.planes.0[depth];
        let t = each(
            [0, 1, 2],
            #[inline(always)]
            |axis: usize| {
                let offset = f32x16::splat(simd, node.origin[axis]) - self.rays.origins[axis];
                let near = f32x16::splat(simd, planes[axis][slot & 7]) + offset;
                let far = f32x16::splat(simd, planes[axis][8 + (slot & 7)]) + offset;
                [near * self.rays.reciprocals[axis], far * self.rays.reciprocals[axis]]
            },
        );
        meet_slabs(t, self.rays.t_min, load(simd, *self.answers.t_max()))
    }

    /// Answers have changed.
    #[inline(always)]
    fn shorten(&mut self) {
        self.t_max = greatest_of(load(self.simd, *self.answers.t_max()));
        self.range = range(self.least_t_min, self.t_max);
    }

    /// Tests one triangle; says whether it was met.
    #[inline(always)]
    fn cross(&mut self, lanes: u64, triangle: &Triangle, index: u32) -> bool {
        let simd = self.simd;
        let corners: &[[f32; 4]; 3] = bytemuck::cast_ref(triangle);
        let [a, b, c] = each(
            [0, 1, 2],
            #[inline(always)]
            |corner: usize| {
                let along = |i: usize| f32x16::splat(simd, corners[corner][self.axes[i] & 3]);
                let across = [self.from[0] - along(0), self.from[1] - along(1)];
                self.rays.shear.see(across, along(2) - self.from[2])
            },
        );
        let corners = [[a[0], b[0], c[0]], [a[1], b[1], c[1]], [a[2], b[2], c[2]]];
        let rays = self.rays;
        let crossings = cross(
            simd,
            lanes,
            corners,
            rays.depth_scale,
            #[inline(always)]
            |t, w| {
                let lanes = Unsheared {
                    origin: rays.origins,
                    direction: rays.directions,
                    corners: [splats(simd, triangle.v0), splats(simd, triangle.v1), splats(simd, triangle.v2)],
                    scale: -rays.shear.minus_scale,
                };
                plane_distances(&lanes, t, w)
            },
        );
        let Some((mut crossed, crossings)) = crossings else { return false };
        crossed &= crossings.t.simd_ge(self.rays.t_min).to_bitmask();
        crossed &= crossings.t.simd_le(load(simd, *self.answers.t_max())).to_bitmask();
        if crossed == 0 {
            return false;
        }
        self.answers.accept(simd, self.place, index, crossed, &crossings);
        true
    }
}

/// What near and far planes are multiplied by.
#[inline(always)]
fn scales<S: Simd>(reciprocals: f32x8<S>) -> f32x16<S> {
    (reciprocals * BOX_SLACK).combine(-reciprocals)
}

impl<S: Simd, A: Answers> Walker<S> for Together<'_, S, A> {
    #[inline(always)]
    fn meet(&mut self, node: &WideNode, depth: usize) -> (u32, f32x8<S>) {
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
        self.memory.planes.0[depth] = [x.0.into(), y.0.into(), z.0.into()];
        met(simd, node, x.1.max(y.1).max(z.1.max(self.range)))
    }

    /// The intervals of a packet that has visited many nodes may be so wide that no ray of it meets the child, or few do.
    #[inline(always)]
    fn inner(&mut self, node: &WideNode, depth: usize, slot: usize, child: u32) -> Option<bool> {
        self.visited += 1;
        if self.visited <= COHERENT {
            return None;
        }
        let lanes = self.meet_lanes(node, depth, slot);
        if lanes.count_ones() > FEW {
            return None;
        }
        if lanes == 0 {
            return Some(false);
        }
        walk_singly(self.simd, self.nodes, child, &mut self.memory.stack, self.place, self.rays, lanes, self.answers);
        self.shorten();
        Some(true)
    }

    #[inline(always)]
    fn leaf(&mut self, node: &WideNode, depth: usize, slot: usize, triangles: PrimitiveRange) -> bool {
        let lanes = self.meet_lanes(node, depth, slot);
        if lanes == 0 {
            return false;
        }
        let first = self.place.instance.first_triangle + triangles.first();
        let scene = self.place.scene;
        let mut is_met = false;
        for (i, triangle) in (first..).zip(&scene.triangles[first as usize..][..triangles.count() as usize]) {
            is_met |= self.cross(lanes, triangle, i);
        }
        if is_met {
            self.shorten();
        }
        is_met
    }

    #[inline(always)]
    fn t_max(&self) -> f32x8<S> {
        self.t_max
    }
}
