//! A packet of 16 rays in world space and, with the operands of the node and triangle tests, in an instance's local
//! space.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, mask32x16, u32x16};

use super::shear::{DominantAxes, Shear};
use super::simd::{F32Lanes, LANES, abs, load, map_axes, max_component, store};
use crate::device::layout::{InstanceRecord, RayRecord, WideNode};
use crate::trace::kernel::{MIN_COMPONENT, MIN_RELATIVE_COMPONENT, SHEARED_EXTENT, grid_extent};

/// A packet in world space, one ray per lane.
pub(super) struct RayPacket<S: Simd> {
    pub(super) origins: [f32x16<S>; 3],
    pub(super) directions: [f32x16<S>; 3],
    pub(super) t_min: f32x16<S>,
    pub(super) t_max: f32x16<S>,
}

impl<S: Simd> RayPacket<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, rays: &[RayRecord; LANES]) -> Self {
        // Transpose 16 rays of 8 words to 8 vectors of 16 lanes by three rounds of de-interleaving.
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
        let v = deinterleave(deinterleave(deinterleave(v)));
        Self { origins: [v[0], v[1], v[2]], t_min: v[3], directions: [v[4], v[5], v[6]], t_max: v[7] }
    }

    /// The ray in a lane.
    #[inline(always)]
    pub(super) fn ray(&self, lane: usize) -> RayRecord {
        let in_lane = |v: &f32x16<S>| v.as_array()[lane % LANES];
        let [origins, directions] = [&self.origins, &self.directions];
        RayRecord {
            origin: [in_lane(&origins[0]), in_lane(&origins[1]), in_lane(&origins[2])],
            t_min: in_lane(&self.t_min),
            direction: [in_lane(&directions[0]), in_lane(&directions[1]), in_lane(&directions[2])],
            t_max: in_lane(&self.t_max),
        }
    }
}

/// Splits each pair of vectors into its even and its odd elements: first all even halves, then all odd ones.
#[inline(always)]
fn deinterleave<S: Simd>(v: [f32x16<S>; 8]) -> [f32x16<S>; 8] {
    let (a, b, c, d) =
        (v[0].deinterleave(v[1]), v[2].deinterleave(v[3]), v[4].deinterleave(v[5]), v[6].deinterleave(v[7]));
    [a.0, b.0, c.0, d.0, a.1, b.1, c.1, d.1]
}

/// The reciprocal directions of the slab test, as those of [`slab_ray`](crate::trace::kernel::slab_ray).
#[inline(always)]
pub(super) fn reciprocals<S: Simd>(simd: S, directions: [f32x16<S>; 3]) -> [f32x16<S>; 3] {
    let lengths = abs(directions);
    // Bound components away from 0, as `slab_ray` does.
    let min_length = (max_component(lengths) * MIN_RELATIVE_COMPONENT).max(MIN_COMPONENT);
    map_axes(
        [0, 1, 2],
        #[inline(always)]
        |axis: usize| {
            let reciprocal = f32x16::splat(simd, 1.0) / lengths[axis].max(min_length);
            directions[axis].simd_lt(0.0).select(-reciprocal, reciprocal)
        },
    )
}

/// The rays of a packet in the local space of an instance. Kept in memory because packet traversal loads whole vectors
/// and single-ray traversal single lanes.
#[repr(C, align(64))]
pub(super) struct LocalPacket {
    pub(super) origins: [F32Lanes; 3],
    pub(super) directions: [F32Lanes; 3],
    pub(super) reciprocals: [F32Lanes; 3],
    pub(super) t_min: F32Lanes,
    pub(super) shear: Shear<F32Lanes>,
    /// The magnitudes of the shear's slopes, before they are scaled.
    pub(super) slopes: [F32Lanes; 2],
    /// Ray origins permuted to the shear axes.
    pub(super) sheared_origins: [F32Lanes; 3],
    /// Factor from t to units of sheared x and y.
    pub(super) t_to_sheared: F32Lanes,
    /// For each ray its row of [`SHEAR_AXES`](super::shear::SHEAR_AXES).
    pub(super) shear_axes: [u32; LANES],
    /// For each ray its direction octant: bit i is set where the direction is negative along axis i.
    pub(super) octants: [u32; LANES],
    /// Whether every product of a reciprocal direction with a coordinate in the node grid is finite; if not, rays are
    /// traced singly.
    pub(super) is_packet_safe: bool,
}

impl LocalPacket {
    /// Transforms a packet to the space of `instance`, the root of whose BLAS is `root`.
    #[inline(always)]
    pub(super) fn new<S: Simd>(simd: S, packet: &RayPacket<S>, instance: &InstanceRecord, root: &WideNode) -> Self {
        // Transform origins and directions. Directions are not normalised, so that t means the same as in world space.
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

        // Find the direction octants.
        let bit = |is_set: mask32x16<S>, bit: u32| is_set.select(u32x16::splat(simd, bit), u32x16::splat(simd, 0));
        let [x, y, z] = directions;
        let octants = bit(x.simd_lt(0.0), 1) | bit(y.simd_lt(0.0), 2) | bit(z.simd_lt(0.0), 4);

        // Permute to the shear axes of each ray, by its dominant axis and sign.
        let axes = DominantAxes::new(directions);
        let [i, j, depth] = axes.permute(directions);
        let sheared_origins = axes.permute(origins);

        // Compute the shear as `kernel::shear_ray` does, scaled by a power of two to coordinates up to SHEARED_EXTENT.
        let extents = max_component(abs(origins)).max(f32x16::splat(simd, grid_extent(root)));
        let scale = reciprocal_power_of_two(simd, extents * (1.0 / SHEARED_EXTENT));
        let slopes = [-i / depth, -j / depth];
        let shear = Shear {
            minus_scale: (-scale).into(),
            slopes: [(slopes[0] * scale).into(), (slopes[1] * scale).into()],
            t_scale: (f32x16::splat(simd, 1.0) / depth).into(),
        };

        // Check that the products of the packet's node tests stay finite.
        let reciprocals = reciprocals(simd, directions);
        let greatest_products = extents * 4.0 * max_component(abs(reciprocals));
        Self {
            origins: store(origins),
            directions: store(directions),
            reciprocals: store(reciprocals),
            t_min: packet.t_min.into(),
            shear,
            slopes: [slopes[0].abs().into(), slopes[1].abs().into()],
            sheared_origins: store(sheared_origins),
            t_to_sheared: (depth.abs() * scale).min(f32::MAX).into(),
            shear_axes: axes.rows(simd).into(),
            octants: octants.into(),
            is_packet_safe: greatest_products.simd_lt(f32::MAX).to_bitmask() == 0xffff,
        }
    }
}

/// The packet form of the kernel's [`reciprocal_power_of_two`](crate::trace::kernel::reciprocal_power_of_two).
#[inline(always)]
fn reciprocal_power_of_two<S: Simd>(simd: S, v: f32x16<S>) -> f32x16<S> {
    let exponents = (v.bitcast::<u32x16<S>>() >> 23).min(u32x16::splat(simd, 253));
    ((u32x16::splat(simd, 254) - exponents) << 23).bitcast()
}
