//! Sixteen rays, a lane each: in world space, and in the space of an instance with all that boxes and triangles need.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, mask32x16, u32x16};

use super::simd::{F32Lanes, LANES, abs, load, map_axes, max_component};
use super::triangle_test::Shear;
use crate::device::layout::{InstanceRecord, RayRecord, WideNode};
use crate::trace::kernel::{BOX_ENTRY_SCALE, MIN_COMPONENT, MIN_RELATIVE_COMPONENT, grid_extent};

/// Rays in world space.
pub(super) struct RayPacket<S: Simd> {
    pub(super) origins: [f32x16<S>; 3],
    pub(super) directions: [f32x16<S>; 3],
    pub(super) t_min: f32x16<S>,
    pub(super) t_max: f32x16<S>,
}

impl<S: Simd> RayPacket<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, rays: &[RayRecord; LANES]) -> Self {
        // Three times the even elements and the odd ones: then each vector holds one number of all rays.
        let words: &[F32Lanes; 8] = bytemuck::cast_ref(rays);
        let v: [f32x16<S>; 8] = [
            load(simd, words[0]),
            load(simd, words[1]),
            load(simd, words[2]),
            load(simd, words[3]),
            load(simd, words[4]),
            load(simd, words[5]),
            load(simd, words[6]),
            load(simd, words[7]),
        ];
        let v = deinterleaved(deinterleaved(deinterleaved(v)));
        Self { origins: [v[0], v[1], v[2]], t_min: v[3], directions: [v[4], v[5], v[6]], t_max: v[7] }
    }

    /// One of them.
    #[inline(always)]
    pub(super) fn ray(&self, lane: usize) -> RayRecord {
        let of_lane = |v: &f32x16<S>| v.as_array()[lane % LANES];
        let [o, d] = [&self.origins, &self.directions];
        RayRecord {
            origin: [of_lane(&o[0]), of_lane(&o[1]), of_lane(&o[2])],
            t_min: of_lane(&self.t_min),
            direction: [of_lane(&d[0]), of_lane(&d[1]), of_lane(&d[2])],
            t_max: of_lane(&self.t_max),
        }
    }
}

/// Of pairs of vectors the even elements, then the odd ones.
#[inline(always)]
fn deinterleaved<S: Simd>(v: [f32x16<S>; 8]) -> [f32x16<S>; 8] {
    let (a, b, c, d) =
        (v[0].deinterleave(v[1]), v[2].deinterleave(v[3]), v[4].deinterleave(v[5]), v[6].deinterleave(v[7]));
    [a.0, b.0, c.0, d.0, a.1, b.1, c.1, d.1]
}

/// [`slab_ray`](crate::trace::kernel::slab_ray)'s reciprocals.
#[inline(always)]
pub(super) fn reciprocals<S: Simd>(simd: S, directions: [f32x16<S>; 3]) -> [f32x16<S>; 3] {
    let lengths = abs(directions);
    let least = (max_component(lengths) * MIN_RELATIVE_COMPONENT).max(MIN_COMPONENT);
    map_axes(
        [0, 1, 2],
        #[inline(always)]
        |axis: usize| {
            let reciprocal = f32x16::splat(simd, 1.0) / lengths[axis].max(least);
            directions[axis].simd_lt(0.0).select(-reciprocal, reciprocal)
        },
    )
}

/// A bit for each ray that meets a box between `t_min` and `t_max`: by where it enters and leaves the slab of each axis.
#[inline(always)]
pub(super) fn slab_test<S: Simd>(t: [[f32x16<S>; 2]; 3], t_min: f32x16<S>, t_max: f32x16<S>) -> u64 {
    let [[near_x, far_x], [near_y, far_y], [near_z, far_z]] = t;
    let enters = near_x.max(near_y).max(near_z.max(t_min));
    let leaves = far_x.min(far_y).min(far_z.min(t_max));
    (enters * BOX_ENTRY_SCALE).simd_le(leaves).to_bitmask()
}

/// The rays of a packet in the space of an instance, in memory: some are taken from it all at once, some one by one.
#[repr(C, align(64))]
pub(super) struct LocalPacket {
    pub(super) origins: [F32Lanes; 3],
    pub(super) directions: [F32Lanes; 3],
    pub(super) reciprocals: [F32Lanes; 3],
    pub(super) t_min: F32Lanes,
    pub(super) shear: Shear<F32Lanes>,
    /// The origins along the axes of the shear.
    pub(super) sheared_origins: [F32Lanes; 3],
    pub(super) depth_scale: F32Lanes,
    /// For each ray which of [`SHEAR_AXES`] are its shear's.
    pub(super) shear_axes: [u32; LANES],
    /// For each ray bit 0 where it goes down x, bit 1 where down y, bit 2 where down z.
    pub(super) octants: [u32; LANES],
    /// Whether the products of reciprocals with whatever coordinates are numbers.
    pub(super) is_packet_safe: bool,
}

impl LocalPacket {
    /// In the space of an instance whose geometry has that root.
    #[inline(always)]
    pub(super) fn new<S: Simd>(simd: S, packet: &RayPacket<S>, instance: &InstanceRecord, root: &WideNode) -> Self {
        let [o, d] = [packet.origins, packet.directions];
        let rows = &instance.local_from_world;
        let origins = map_axes(
            *rows,
            #[inline(always)]
            |[x, y, z, w]| (o[0] * x + o[1] * y) + o[2] * z + w,
        );
        let directions = map_axes(
            *rows,
            #[inline(always)]
            |[x, y, z, _]| (d[0] * x + d[1] * y) + d[2] * z,
        );
        let bit = |is_set: mask32x16<S>, bit: u32| is_set.select(u32x16::splat(simd, bit), u32x16::splat(simd, 0));
        let [x, y, z] = directions;
        let octants = bit(x.simd_lt(0.0), 1) | bit(y.simd_lt(0.0), 2) | bit(z.simd_lt(0.0), 4);

        // As `shear_ray`.
        let [x, y, z] = abs(directions);
        let x_most = x.simd_ge(y) & x.simd_ge(z);
        let y_most = y.simd_ge(z);
        let goes_down = x_most.select(directions[0], y_most.select(directions[1], directions[2])).simd_lt(0.0);
        let axes = x_most.select(u32x16::splat(simd, 0), y_most.select(u32x16::splat(simd, 2), u32x16::splat(simd, 4)));
        let along = |[x, y, z]: [f32x16<S>; 3]| {
            let depth = x_most.select(x, y_most.select(y, z));
            let i = x_most.select(y, y_most.select(z, x));
            let j = x_most.select(z, y_most.select(x, y));
            [goes_down.select(j, i), goes_down.select(i, j), depth]
        };
        let [i, j, depth] = along(directions);
        let from = along(origins);
        let extents = max_component(abs(origins)).max(f32x16::splat(simd, grid_extent(root)));
        let scale = reciprocal_power_of_two(simd, extents);
        let reciprocals = reciprocals(simd, directions);
        Self {
            origins: store(origins),
            directions: store(directions),
            reciprocals: store(reciprocals),
            t_min: packet.t_min.into(),
            shear: Shear {
                minus_scale: (-scale).into(),
                slopes: [(-i / depth * scale).into(), (-j / depth * scale).into()],
                t_scale: (f32x16::splat(simd, 1.0) / depth).into(),
            },
            sheared_origins: store(from),
            depth_scale: (depth.abs() * scale).into(),
            shear_axes: (axes + bit(goes_down, 1)).into(),
            octants: octants.into(),
            is_packet_safe: (extents * 4.0 * max_component(abs(reciprocals))).simd_lt(f32::MAX).to_bitmask() == 0xffff,
        }
    }
}

/// For rays that go most along x, up and down it, then along y, then along z: the axes that become x, y and t. Left and right are
/// swapped for a ray that looks down the axis, so that the winding stays.
pub(super) const SHEAR_AXES: [[usize; 3]; 6] = [[1, 2, 0], [2, 1, 0], [2, 0, 1], [0, 2, 1], [0, 1, 2], [1, 0, 2]];

/// Where x, y and z stand in a row of [`SHEAR_AXES`].
#[inline(always)]
pub(super) fn inverse_shear_axes(axes: usize) -> [usize; 3] {
    static PLACES: [[usize; 3]; SHEAR_AXES.len()] = {
        let mut places = [[0; 3]; SHEAR_AXES.len()];
        let mut i = 0;
        while i < SHEAR_AXES.len() * 3 {
            places[i / 3][SHEAR_AXES[i / 3][i % 3]] = i % 3;
            i += 1;
        }
        places
    };
    PLACES[axes % PLACES.len()]
}

#[inline(always)]
fn store<S: Simd>(v: [f32x16<S>; 3]) -> [F32Lanes; 3] {
    [v[0].into(), v[1].into(), v[2].into()]
}

/// As [the kernel's](crate::trace::kernel::reciprocal_power_of_two).
#[inline(always)]
fn reciprocal_power_of_two<S: Simd>(simd: S, v: f32x16<S>) -> f32x16<S> {
    let exponents = (v.bitcast::<u32x16<S>>() >> 23).min(u32x16::splat(simd, 253));
    ((u32x16::splat(simd, 254) - exponents) << 23).bitcast()
}
