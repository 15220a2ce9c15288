//! Per-lane query state of a packet. The rules are those of [`Query`] and the functions beside it; what is done for
//! many lanes at once here is tested against them lane by lane.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, mask32x16, u32x16};
use glam::Vec3;

use super::simd::{F32Lanes, LANES, lanes_of, load};
use super::triangle_test::TriangleHits;
use crate::device::layout::{HitRecord, InstanceFlags, InstanceRecord, RayRecord, WideNode};
use crate::trace::kernel::{
    AnyQuery, ClosestQuery, Continuation, GrazingPlane, HitOrder, KernelScene, MAX_GRAZING, Query, T_BEFORE_SCALE,
    TOUCH_STEP, TransmittanceQuery, TriangleHit, candidate_hit, depth_steps, hit_depth, is_cut_out, is_opaque_at,
};

/// The instance being traversed: its record and its BLAS.
pub(super) struct InstanceGeometry<'a> {
    pub(super) scene: &'a KernelScene<'a>,
    /// Index of the instance.
    pub(super) index: u32,
    pub(super) instance: &'a InstanceRecord,
    /// The wide-node array from the BLAS's root on (other BLASes follow).
    pub(super) nodes: &'a [WideNode],
}

impl<'a> InstanceGeometry<'a> {
    /// `None` if the instance's mask and the ray mask share no bit.
    #[inline(always)]
    pub(super) fn of(scene: &'a KernelScene<'a>, index: u32, ray_mask: u32) -> Option<Self> {
        let instance = &scene.instances[index as usize];
        if instance.mask & ray_mask == 0 {
            return None;
        }
        let first_node = scene.geometries[instance.geometry as usize].first_wide_node;
        let nodes = &scene.wide_nodes[first_node as usize..];
        Some(Self { scene, index, instance, nodes })
    }

    #[inline(always)]
    fn has_flags(&self, flags: InstanceFlags) -> bool {
        InstanceFlags::from_bits_retain(self.instance.flags).contains(flags)
    }

    /// A hit with one of the instance's triangles as a candidate.
    #[inline(always)]
    fn candidate(&self, triangle: u32, hit: &TriangleHit, depth: f32) -> HitRecord {
        candidate_hit(self.index, triangle, self.scene.triangles[triangle as usize].primitive, hit, depth)
    }

    /// The depths of hits with a triangle by rays of these local directions: the packet form of the kernel's
    /// [`hit_depth`].
    #[inline(always)]
    fn depths<S: Simd>(
        &self,
        simd: S,
        triangle: u32,
        lanes: u64,
        at: &TriangleHits<f32x16<S>>,
        directions: &[F32Lanes; 3],
    ) -> f32x16<S> {
        let flags = self.instance.flags;
        let [front_steps, back_steps] = [false, true].map(|is_back| depth_steps(is_back, flags));
        // Depth is t for the fronts of what is opaque.
        if front_steps == 0.0 && at.back & lanes == 0 {
            return at.t;
        }
        let plane = GrazingPlane::of(&self.scene.triangles[triangle as usize]);
        let [x, y, z] = [load(simd, directions[0]), load(simd, directions[1]), load(simd, directions[2])];
        let slope = ((x * plane.normal.x + y * plane.normal.y) + z * plane.normal.z).abs();
        let bound = (x.abs() * plane.bound.x + y.abs() * plane.bound.y) + z.abs() * plane.bound.z;
        let most = f32x16::splat(simd, MAX_GRAZING);
        let grazing = (slope * MAX_GRAZING).simd_le(bound).select(most, bound / slope);
        let splat = |steps: f32| f32x16::splat(simd, steps * TOUCH_STEP);
        let is_back = mask32x16::from_bitmask(simd, at.back);
        at.t + at.t * (is_back.select(splat(back_steps), splat(front_steps)) * grazing)
    }
}

/// One lane of a packet's hits.
#[inline(always)]
fn hit_of_lane<S: Simd>(hits: &TriangleHits<f32x16<S>>, lane: usize) -> TriangleHit {
    let (t, u, v) = (hits.t.as_array()[lane], hits.u.as_array()[lane], hits.v.as_array()[lane]);
    TriangleHit { t, u, v, back: hits.back >> lane & 1 != 0 }
}

/// One lane of a packet's query state.
pub(super) struct QueryLane<'a, A> {
    pub(super) queries: &'a mut A,
    pub(super) lane: usize,
}

impl<A: PacketQuery> QueryLane<'_, A> {
    /// The lane's current `t_max`.
    #[inline(always)]
    pub(super) fn t_max(&self) -> f32 {
        self.queries.t_max()[self.lane]
    }

    /// Offers the lane's query a hit with a triangle, with t in [`t_min`, `t_max`]. Whether a layered instance is
    /// skipped is decided per hit, not per leaf as in the kernel: a ray that hits nothing of it needs no second pass.
    #[inline(always)]
    pub(super) fn accept_hit(
        &mut self,
        geometry: &InstanceGeometry<'_>,
        triangle: u32,
        hit: &TriangleHit,
        directions: &[F32Lanes; 3],
    ) {
        let mut query = self.queries.query(self.lane);
        let flags = geometry.instance.flags;
        if !query.skips_instance(flags) {
            let [x, y, z] = directions;
            let direction = Vec3::new(x[self.lane], y[self.lane], z[self.lane]);
            let depth = hit_depth(hit, flags, &geometry.scene.triangles[triangle as usize], direction);
            query.accept_hit(geometry.scene, &geometry.candidate(triangle, hit, depth), flags);
        }
        self.queries.set_query(self.lane, query);
    }
}

/// Query state of a 16-ray packet.
pub(super) trait PacketQuery {
    type Query: Query;
    /// Result per ray.
    type Output;
    /// Result of a ray without hits.
    const MISS: Self::Output;

    /// Initial state with the given `t_max`.
    fn new<S: Simd>(t_max: f32x16<S>) -> Self;

    /// The final results; may trace further rays for layered instances.
    fn outputs<S: Simd>(
        &self,
        simd: S,
        scene: &KernelScene<'_>,
        rays: &[RayRecord; LANES],
        ray_mask: u32,
    ) -> [Self::Output; LANES];

    /// The current `t_max` of each lane.
    fn t_max(&self) -> &F32Lanes;

    fn query(&self, lane: usize) -> Self::Query;

    fn set_query(&mut self, lane: usize, query: Self::Query);

    /// Offers a triangle's hits to `lanes`, all with t in [`t_min`, `t_max`]. `directions` are the rays', in local
    /// space.
    fn accept_hits<S: Simd>(
        &mut self,
        simd: S,
        geometry: &InstanceGeometry<'_>,
        triangle: u32,
        lanes: u64,
        at: &TriangleHits<f32x16<S>>,
        directions: &[F32Lanes; 3],
    );
}

/// Closest-hit state of a packet.
#[repr(C, align(64))]
pub(super) struct ClosestPacket {
    t: F32Lanes,
    u: F32Lanes,
    v: F32Lanes,
    instance: [u32; LANES],
    primitive: [u32; LANES],
    triangle: [u32; LANES],
    back: u64,
    /// The depth of each lane's hit, and the greatest t of a hit that may come before it.
    depth: F32Lanes,
    t_max: F32Lanes,
    starts: Continuations,
}

/// Where the rays of a packet go on, one lane each.
#[repr(C, align(64))]
struct Continuations {
    depth: F32Lanes,
    same_surface_end: F32Lanes,
    instance: [u32; LANES],
    primitive: [u32; LANES],
    back: u64,
    on_edge: u64,
    only_opaque: u64,
}

impl Continuations {
    const START: Self = Self {
        depth: [Continuation::START.passed.depth; LANES],
        same_surface_end: [Continuation::START.same_surface_end; LANES],
        instance: [Continuation::START.passed.instance; LANES],
        primitive: [Continuation::START.passed.primitive; LANES],
        back: 0,
        on_edge: 0,
        only_opaque: 0,
    };

    #[inline(always)]
    fn lane(&self, lane: usize) -> Continuation {
        let is_set = |mask: u64| mask >> lane & 1 != 0;
        let (depth, instance, primitive) = (self.depth[lane], self.instance[lane], self.primitive[lane]);
        Continuation {
            passed: HitOrder { depth, instance, primitive },
            same_surface_end: self.same_surface_end[lane],
            is_back: is_set(self.back),
            is_on_edge: is_set(self.on_edge),
            only_opaque: is_set(self.only_opaque),
        }
    }

    fn set_lane(&mut self, lane: usize, start: &Continuation) {
        let HitOrder { depth, instance, primitive } = start.passed;
        (self.depth[lane], self.instance[lane], self.primitive[lane]) = (depth, instance, primitive);
        self.same_surface_end[lane] = start.same_surface_end;
        let set = |mask: &mut u64, is_set: bool| *mask = *mask & !(1 << lane) | u64::from(is_set) << lane;
        set(&mut self.back, start.is_back);
        set(&mut self.on_edge, start.is_on_edge);
        set(&mut self.only_opaque, start.only_opaque);
    }
}

impl ClosestPacket {
    /// Lets the rays of a new packet, of which `first_ray` is the first, go on behind hits that they have passed.
    /// `starts` has the indices of all rays that do, ascending.
    pub(super) fn set_starts(&mut self, starts: &[(usize, Continuation)], first_ray: usize) {
        let from = starts.partition_point(|(ray, _)| *ray < first_ray);
        for (ray, start) in starts[from..].iter().take_while(|(ray, _)| *ray < first_ray + LANES) {
            self.starts.set_lane(ray - first_ray, start);
        }
    }
}

#[inline(always)]
fn interleaved<S: Simd>(v: [f32x16<S>; 8]) -> [f32x16<S>; 8] {
    let (a, b, c, d) = (v[0].interleave(v[4]), v[1].interleave(v[5]), v[2].interleave(v[6]), v[3].interleave(v[7]));
    [a.0, a.1, b.0, b.1, c.0, c.1, d.0, d.1]
}

impl PacketQuery for ClosestPacket {
    type Query = ClosestQuery;
    type Output = HitRecord;
    const MISS: HitRecord = HitRecord::MISS;

    #[inline(always)]
    fn new<S: Simd>(t_max: f32x16<S>) -> Self {
        let HitRecord { u, v, instance, primitive, triangle, .. } = HitRecord::MISS;
        Self {
            t: [HitRecord::MISS.t; LANES],
            u: [u; LANES],
            v: [v; LANES],
            instance: [instance; LANES],
            primitive: [primitive; LANES],
            triangle: [triangle; LANES],
            back: 0,
            depth: [HitRecord::MISS.depth; LANES],
            t_max: t_max.into(),
            starts: Continuations::START,
        }
    }

    #[inline(always)]
    fn outputs<S: Simd>(&self, simd: S, _: &KernelScene<'_>, _: &[RayRecord; LANES], _: u32) -> [HitRecord; LANES] {
        let bits = |v: [u32; LANES]| u32x16::simd_from(simd, v).bitcast::<f32x16<S>>();
        let back = mask32x16::from_bitmask(simd, self.back).select(u32x16::splat(simd, 1), u32x16::splat(simd, 0));
        let v = [
            load(simd, self.t),
            load(simd, self.u),
            load(simd, self.v),
            bits(self.instance),
            bits(self.primitive),
            bits(self.triangle),
            back.bitcast(),
            load(simd, self.depth),
        ];
        // Transpose 8 x 16 to 16 x 8 by three rounds of interleaving, so that the eight words of a hit follow one
        // another.
        let v = interleaved(interleaved(interleaved(v)));
        let words: [F32Lanes; 8] =
            [v[0].into(), v[1].into(), v[2].into(), v[3].into(), v[4].into(), v[5].into(), v[6].into(), v[7].into()];
        bytemuck::cast(words)
    }

    #[inline(always)]
    fn t_max(&self) -> &F32Lanes {
        &self.t_max
    }

    #[inline(always)]
    fn query(&self, lane: usize) -> ClosestQuery {
        let hit = HitRecord {
            t: self.t[lane],
            u: self.u[lane],
            v: self.v[lane],
            instance: self.instance[lane],
            primitive: self.primitive[lane],
            triangle: self.triangle[lane],
            back_face: (self.back >> lane & 1) as u32,
            depth: self.depth[lane],
        };
        ClosestQuery { start: self.starts.lane(lane), hit, t_max: self.t_max[lane] }
    }

    #[inline(always)]
    fn set_query(&mut self, lane: usize, ClosestQuery { hit, t_max, .. }: ClosestQuery) {
        (self.depth[lane], self.t_max[lane]) = (hit.depth, t_max);
        self.t[lane] = hit.t;
        self.u[lane] = hit.u;
        self.v[lane] = hit.v;
        self.instance[lane] = hit.instance;
        self.primitive[lane] = hit.primitive;
        self.triangle[lane] = hit.triangle;
        self.back = self.back & !(1 << lane) | u64::from(hit.back_face) << lane;
    }

    /// The packet form of [`ClosestQuery::accept_hit`](Query::accept_hit).
    #[inline(always)]
    fn accept_hits<S: Simd>(
        &mut self,
        simd: S,
        geometry: &InstanceGeometry<'_>,
        triangle: u32,
        lanes: u64,
        at: &TriangleHits<f32x16<S>>,
        directions: &[F32Lanes; 3],
    ) {
        let flags = geometry.instance.flags;
        let primitive = geometry.scene.triangles[triangle as usize].primitive;
        let mut lanes = lanes;
        // Cull back faces.
        if geometry.has_flags(InstanceFlags::CULL_BACK) {
            lanes &= !at.back;
        }
        // Candidates at or before the first hit so far; break ties by instance and primitive.
        let depth = geometry.depths(simd, triangle, lanes, at, directions);
        let first_depth = load(simd, self.depth);
        lanes &= depth.simd_le(first_depth).to_bitmask();
        for lane in lanes_of(depth.simd_eq(first_depth).to_bitmask() & lanes) {
            let order = HitOrder { depth: depth.as_array()[lane], instance: geometry.index, primitive };
            lanes &= !(u64::from(!order.is_before(&HitOrder::of(&self.query(lane).hit))) << lane);
        }
        // Drop what the ray has passed.
        let passed_end = load(simd, self.starts.same_surface_end);
        for lane in lanes_of(depth.simd_le(passed_end).to_bitmask() & lanes) {
            let candidate = geometry.candidate(triangle, &hit_of_lane(at, lane), depth.as_array()[lane]);
            lanes &= !(u64::from(!self.starts.lane(lane).is_before(&candidate)) << lane);
        }
        // Alpha test.
        if geometry.has_flags(InstanceFlags::ALPHA_MASK) {
            for lane in lanes_of(lanes) {
                let candidate = geometry.candidate(triangle, &hit_of_lane(at, lane), depth.as_array()[lane]);
                lanes &= !(u64::from(is_cut_out(geometry.scene, &candidate, flags)) << lane);
            }
        }
        // Rays that pass what is translucent.
        if geometry.has_flags(InstanceFlags::TRANSLUCENT) {
            for lane in lanes_of(lanes & self.starts.only_opaque) {
                let candidate = geometry.candidate(triangle, &hit_of_lane(at, lane), depth.as_array()[lane]);
                lanes &= !(u64::from(!is_opaque_at(geometry.scene, &candidate, flags)) << lane);
            }
        }
        // Keep the candidates that are left.
        let is_first = mask32x16::from_bitmask(simd, lanes);
        let set = |words: &mut [u32; LANES], word: u32| {
            let old = u32x16::simd_from(simd, *words);
            *words = is_first.select(u32x16::splat(simd, word), old).into();
        };
        let t_max = load(simd, self.t_max);
        self.t = is_first.select(at.t, load(simd, self.t)).into();
        self.depth = is_first.select(depth, first_depth).into();
        self.t_max = is_first.select(t_max.min(depth * T_BEFORE_SCALE), t_max).into();
        self.u = is_first.select(at.u, load(simd, self.u)).into();
        self.v = is_first.select(at.v, load(simd, self.v)).into();
        set(&mut self.instance, geometry.index);
        set(&mut self.primitive, primitive);
        set(&mut self.triangle, triangle);
        self.back = self.back & !lanes | at.back & lanes;
    }
}

/// Any-hit (occlusion) state of a packet.
pub(super) struct AnyPacket {
    t_max: F32Lanes,
    /// Mask of lanes that hit an opaque surface.
    hit_mask: u64,
}

impl PacketQuery for AnyPacket {
    type Query = AnyQuery;
    type Output = bool;
    const MISS: bool = false;

    #[inline(always)]
    fn new<S: Simd>(t_max: f32x16<S>) -> Self {
        Self { t_max: t_max.into(), hit_mask: 0 }
    }

    #[inline(always)]
    fn outputs<S: Simd>(&self, _: S, _: &KernelScene<'_>, _: &[RayRecord; LANES], _: u32) -> [bool; LANES] {
        let mut hits = [false; LANES];
        for (lane, hit) in hits.iter_mut().enumerate() {
            *hit = self.hit_mask >> lane & 1 != 0;
        }
        hits
    }

    #[inline(always)]
    fn t_max(&self) -> &F32Lanes {
        &self.t_max
    }

    #[inline(always)]
    fn query(&self, lane: usize) -> AnyQuery {
        AnyQuery { t_max: self.t_max[lane], is_hit: self.hit_mask >> lane & 1 != 0 }
    }

    #[inline(always)]
    fn set_query(&mut self, lane: usize, query: AnyQuery) {
        self.t_max[lane] = query.t_max;
        self.hit_mask |= u64::from(query.is_hit) << lane;
    }

    /// The packet form of [`AnyQuery::accept_hit`](Query::accept_hit).
    #[inline(always)]
    fn accept_hits<S: Simd>(
        &mut self,
        simd: S,
        geometry: &InstanceGeometry<'_>,
        triangle: u32,
        lanes: u64,
        at: &TriangleHits<f32x16<S>>,
        _: &[F32Lanes; 3],
    ) {
        let flags = geometry.instance.flags;
        let mut lanes = lanes;
        if geometry.has_flags(InstanceFlags::TRANSLUCENT) {
            for lane in lanes_of(lanes) {
                let candidate = geometry.candidate(triangle, &hit_of_lane(at, lane), at.t.as_array()[lane]);
                lanes &= !(u64::from(!is_opaque_at(geometry.scene, &candidate, flags)) << lane);
            }
        }
        let ended = f32x16::splat(simd, f32::NEG_INFINITY);
        self.t_max = mask32x16::from_bitmask(simd, lanes).select(ended, load(simd, self.t_max)).into();
        self.hit_mask |= lanes;
    }
}

/// Transmittance state of a packet. The product of tints is rounded in visiting order, which depends on the other rays
/// of the packet: the last bits may differ from a single ray's.
pub(super) struct TransmittancePacket {
    t_max: F32Lanes,
    light: [F32Lanes; 3],
    /// Masks of lanes that hit a layered instance, and of those that hit a translucent triangle on an edge.
    layers: u64,
    edges: u64,
}

impl PacketQuery for TransmittancePacket {
    type Query = TransmittanceQuery;
    type Output = Vec3;
    const MISS: Vec3 = Vec3::ONE;

    #[inline(always)]
    fn new<S: Simd>(t_max: f32x16<S>) -> Self {
        Self { t_max: t_max.into(), light: [[1.0; LANES]; 3], layers: 0, edges: 0 }
    }

    #[inline(always)]
    fn outputs<S: Simd>(
        &self,
        _: S,
        scene: &KernelScene<'_>,
        rays: &[RayRecord; LANES],
        ray_mask: u32,
    ) -> [Vec3; LANES] {
        let mut light = [Vec3::ONE; LANES];
        for (lane, light) in light.iter_mut().enumerate() {
            *light = self.query(lane).with_layers(scene, &rays[lane], ray_mask);
        }
        light
    }

    #[inline(always)]
    fn t_max(&self) -> &F32Lanes {
        &self.t_max
    }

    #[inline(always)]
    fn query(&self, lane: usize) -> TransmittanceQuery {
        let light = Vec3::new(self.light[0][lane], self.light[1][lane], self.light[2][lane]);
        TransmittanceQuery {
            t_max: self.t_max[lane],
            transmittance: light,
            has_layers: self.layers >> lane & 1 != 0,
            has_edges: self.edges >> lane & 1 != 0,
        }
    }

    #[inline(always)]
    fn set_query(
        &mut self,
        lane: usize,
        TransmittanceQuery { t_max, transmittance: light, has_layers, has_edges }: TransmittanceQuery,
    ) {
        self.t_max[lane] = t_max;
        for (of_lanes, light) in self.light.iter_mut().zip(light.to_array()) {
            of_lanes[lane] = light;
        }
        self.layers = self.layers & !(1 << lane) | u64::from(has_layers) << lane;
        self.edges = self.edges & !(1 << lane) | u64::from(has_edges) << lane;
    }

    /// The packet form of [`TransmittanceQuery::accept_hit`](Query::accept_hit).
    #[inline(always)]
    fn accept_hits<S: Simd>(
        &mut self,
        simd: S,
        geometry: &InstanceGeometry<'_>,
        triangle: u32,
        lanes: u64,
        at: &TriangleHits<f32x16<S>>,
        directions: &[F32Lanes; 3],
    ) {
        // Translucent: one lane after the other.
        if geometry.has_flags(InstanceFlags::TRANSLUCENT) {
            for lane in lanes_of(lanes) {
                let hit = hit_of_lane(at, lane);
                QueryLane { queries: self, lane }.accept_hit(geometry, triangle, &hit, directions);
            }
            return;
        }
        // Light from behind passes single-sided triangles.
        let culled = if geometry.has_flags(InstanceFlags::CULL_BACK) { !at.back } else { 0 };
        let lanes = lanes & !culled;
        // Opaque: all lanes are decided.
        let stopped = mask32x16::from_bitmask(simd, lanes);
        let set = |numbers: &mut F32Lanes, number: f32| {
            *numbers = stopped.select(f32x16::splat(simd, number), load(simd, *numbers)).into();
        };
        set(&mut self.t_max, f32::NEG_INFINITY);
        let [red, green, blue] = &mut self.light;
        set(red, 0.0);
        set(green, 0.0);
        set(blue, 0.0);
        self.layers &= !lanes;
        self.edges &= !lanes;
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Debug;

    use bytemuck::Zeroable as _;
    use fearless_simd::{Level, dispatch};

    use super::*;
    use crate::device::DeviceArrays;
    use crate::device::layout::{GeometryRecord, MaterialFlags, MaterialRecord, NONE, Triangle};

    /// Triangles whose alpha goes from 0 at the first vertex to 1 at the other two.
    fn arrays(material: MaterialFlags, flags: InstanceFlags) -> DeviceArrays {
        let mut arrays = DeviceArrays::default();
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [0.0, 1.0, 0.25]];
        arrays.triangles.replace(&[0, 1, 2].map(|primitive| Triangle::new(corners, primitive)));
        arrays.indices.replace(&[0, 1, 2, 0, 1, 2, 0, 1, 2]);
        arrays.colors.replace(&[[u32::MAX, 0x0000_ffff], [u32::MAX; 2], [u32::MAX; 2]]);
        arrays.geometries.replace(&[GeometryRecord {
            first_normal: NONE,
            first_tex_coord_0: NONE,
            first_tex_coord_1: NONE,
            ..GeometryRecord::zeroed()
        }]);
        arrays.materials.replace(&[MaterialRecord {
            base_color: [0.5, 0.6, 0.7, 1.0],
            alpha_cutoff: 0.5,
            flags: material.bits(),
            base_color_texture: NONE,
            ..MaterialRecord::zeroed()
        }]);
        arrays.instances.replace(&[InstanceRecord { flags: flags.bits(), ..InstanceRecord::zeroed() }; 2]);
        arrays
    }

    /// Offers random hits to a packet and, lane by lane, to its queries, after `prepare` has prepared both.
    fn packet_matches_lanes<S: Simd, P: PacketQuery<Query: PartialEq + Debug>>(
        simd: S,
        new: fn(f32) -> P::Query,
        prepare: fn(&mut P, &mut [P::Query; LANES], &mut fastrand::Rng),
    ) {
        let (mut random, mut accepted) = (fastrand::Rng::with_seed(1), 0);
        let lanes_below = |random: &mut fastrand::Rng, end: u32, scale: f32| -> F32Lanes {
            std::array::from_fn(|_| random.u32(..end) as f32 * scale)
        };
        for material in [MaterialFlags::empty(), MaterialFlags::MASK, MaterialFlags::BLEND] {
            for flags in (0..32).map(InstanceFlags::from_bits_retain) {
                let arrays = arrays(material, flags);
                let scene = &KernelScene::new(&arrays);
                // With a t_max that is hit, too.
                let mut packet = P::new(f32x16::splat(simd, 4.0));
                let mut queries = [new(4.0); LANES];
                prepare(&mut packet, &mut queries, &mut random);
                let directions = [0; 3].map(|_| lanes_below(&mut random, 5, 0.25));
                for _ in 0..20 {
                    let index = random.u32(..2);
                    let geometry =
                        InstanceGeometry { scene, index, instance: &scene.instances[index as usize], nodes: &[] };
                    // Few distances, so that there are ties.
                    let hits = TriangleHits {
                        t: load(simd, lanes_below(&mut random, 5, 1.0)),
                        u: load(simd, lanes_below(&mut random, 9, 0.0625)),
                        v: load(simd, lanes_below(&mut random, 9, 0.0625)),
                        back: u64::from(random.u32(..1 << 16)),
                    };
                    let in_range = hits.t.simd_le(load(simd, *packet.t_max())).to_bitmask();
                    let lanes = in_range & u64::from(random.u32(..1 << 16));
                    let triangle = random.u32(..3);
                    packet.accept_hits(simd, &geometry, triangle, lanes, &hits, &directions);
                    for lane in lanes_of(lanes) {
                        let before = queries[lane];
                        let query = &mut queries[lane];
                        if !query.skips_instance(geometry.instance.flags) {
                            let (hit, [x, y, z]) = (hit_of_lane(&hits, lane), &directions);
                            let direction = Vec3::new(x[lane], y[lane], z[lane]);
                            let of = &scene.triangles[triangle as usize];
                            let depth = hit_depth(&hit, geometry.instance.flags, of, direction);
                            let candidate = geometry.candidate(triangle, &hit, depth);
                            query.accept_hit(scene, &candidate, geometry.instance.flags);
                        }
                        accepted += u32::from(*query != before);
                    }
                    for (lane, query) in queries.iter().enumerate() {
                        assert_eq!(packet.query(lane), *query, "lane {lane}, {material:?}, {flags:?}");
                    }
                }
            }
        }
        assert!(accepted > 1_000, "{accepted}");
    }

    /// Lets every second ray go on behind a random hit, and every fourth pass what is translucent.
    fn continue_rays(packet: &mut ClosestPacket, queries: &mut [ClosestQuery; LANES], random: &mut fastrand::Rng) {
        let mut start = |lane: usize| {
            let depth = random.u32(..4) as f32;
            let passed = HitOrder { depth, instance: random.u32(..2), primitive: random.u32(..3) };
            let only_opaque = lane.is_multiple_of(4);
            if lane.is_multiple_of(2) {
                return Continuation { only_opaque, ..Continuation::START };
            }
            let (is_back, is_on_edge) = (random.bool(), random.bool());
            Continuation { passed, same_surface_end: depth + 1e-4, is_back, is_on_edge, only_opaque }
        };
        let starts: [Continuation; LANES] = std::array::from_fn(&mut start);
        let indexed: Vec<(usize, Continuation)> = (LANES..).zip(starts).collect();
        packet.set_starts(&indexed, LANES);
        for (query, start) in queries.iter_mut().zip(starts) {
            query.start = start;
        }
    }

    #[test]
    fn packets_accept_what_their_lanes_accept() {
        let level = Level::new();
        dispatch!(level, simd => packet_matches_lanes::<_, ClosestPacket>(simd, ClosestQuery::new, |_, _, _| ()));
        dispatch!(level, simd => packet_matches_lanes::<_, ClosestPacket>(simd, ClosestQuery::new, continue_rays));
        dispatch!(level, simd => packet_matches_lanes::<_, AnyPacket>(simd, AnyQuery::new, |_, _, _| ()));
        dispatch!(
            level,
            simd => packet_matches_lanes::<_, TransmittancePacket>(simd, TransmittanceQuery::new, |_, _, _| ())
        );
    }
}
