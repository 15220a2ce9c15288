//! Run-time dispatch to AVX-512, AVX2 or NEON: splits any number of rays into 16-ray packets and traces them with the
//! widest instruction set of this processor. On other processors, and in arrays without wide nodes, the kernel traces
//! one ray at a time.

use fearless_simd::{Level, Simd};
use glam::Vec3;

use super::hybrid::trace_packets;
use super::packet_queries::{AnyPacket, ClosestPacket, PacketQuery, TransmittancePacket};
use super::packet_traversal::HybridScratch;
use super::simd::LANES;
use crate::device::layout::{HitRecord, RayRecord};
use crate::trace::Traversal;
use crate::trace::kernel::{Continuation, KernelScene, any_hit, next_hit, transmittance};

/// Packet queries of one task: scene, instruction set and scratch memory.
pub(super) struct PacketTracer<'a> {
    pub(super) scene: &'a KernelScene<'a>,
    simd_level: Option<Level>,
    scratch: Box<HybridScratch>,
}

/// Calls `$call` compiled for instruction set `$level`. The whole traversal is compiled once per listed set, so only
/// common ones are listed.
macro_rules! dispatch_simd {
    ($level:expr, $simd:ident => $call:expr) => {
        match $level {
            #[cfg(target_arch = "x86_64")]
            Level::Avx512($simd) => $simd.vectorize(
                #[inline(always)]
                || $call,
            ),
            #[cfg(target_arch = "x86_64")]
            Level::Avx2($simd) => $simd.vectorize(
                #[inline(always)]
                || $call,
            ),
            #[cfg(target_arch = "aarch64")]
            Level::Neon($simd) => $simd.vectorize(
                #[inline(always)]
                || $call,
            ),
            _ => unreachable!("`supported_simd_level` returns no other level"),
        }
    };
}

/// The processor's instruction set, if the SIMD traversal is compiled for it.
fn supported_simd_level() -> Option<Level> {
    let level = Level::new();
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx512(_) | Level::Avx2(_) => Some(level),
        #[cfg(target_arch = "aarch64")]
        Level::Neon(_) => Some(level),
        _ => None,
    }
}

impl<'a> PacketTracer<'a> {
    pub(super) fn new(scene: &'a KernelScene<'a>) -> Self {
        // Without wide nodes (hand-made arrays) rays are traced one at a time by the kernel's rope traversal.
        let simd_level = if scene.traversal == Traversal::Wide { supported_simd_level() } else { None };
        Self { scene, simd_level, scratch: bytemuck::zeroed_box() }
    }

    /// Finds the closest hit of each ray. Here and in the methods below, 16 consecutive rays form a packet and should
    /// be similar in origin and direction.
    pub(super) fn closest_hits(&mut self, rays: &[RayRecord], ray_mask: u32, hits: &mut [HitRecord]) {
        self.next_hits(rays, &[], ray_mask, hits);
    }

    /// Finds the next hit of each ray, behind those that it has passed: `starts` has the indices of the rays that have
    /// passed any, ascending.
    pub(super) fn next_hits(
        &mut self,
        rays: &[RayRecord],
        starts: &[(usize, Continuation)],
        ray_mask: u32,
        hits: &mut [HitRecord],
    ) {
        match self.simd_level {
            Some(level) => {
                let prepare = |query: &mut ClosestPacket, packet: usize| {
                    if !starts.is_empty() {
                        query.set_starts(starts, packet * LANES);
                    }
                };
                self.trace_rays(level, rays, ray_mask, prepare, hits);
            }
            None => {
                let mut starts = starts.iter().peekable();
                for (index, (hit, ray)) in hits.iter_mut().zip(rays).enumerate() {
                    let start = starts.next_if(|(of, _)| *of == index).map_or(Continuation::START, |(_, start)| *start);
                    *hit = next_hit(self.scene, ray, start, ray_mask);
                }
            }
        }
    }

    /// Finds whether each ray hits an opaque surface.
    pub(super) fn any_hits(&mut self, rays: &[RayRecord], ray_mask: u32, hits: &mut [bool]) {
        match self.simd_level {
            Some(level) => self.trace_rays::<AnyPacket>(level, rays, ray_mask, |_, _| (), hits),
            None => hits.iter_mut().zip(rays).for_each(|(hit, ray)| *hit = any_hit(self.scene, ray, ray_mask)),
        }
    }

    /// The transmittance of each ray between `t_min` and `t_max`, per colour channel.
    pub(super) fn transmittances(&mut self, rays: &[RayRecord], ray_mask: u32, transmittances: &mut [Vec3]) {
        match self.simd_level {
            Some(level) => self.trace_rays::<TransmittancePacket>(level, rays, ray_mask, |_, _| (), transmittances),
            None => {
                transmittances.iter_mut().zip(rays).for_each(|(t, ray)| *t = transmittance(self.scene, ray, ray_mask));
            }
        }
    }

    /// Traces whole packets; a partial last packet is padded with rays of empty interval, which hit nothing. `prepare`
    /// gets the initial state of each packet's query, and the packet's index.
    fn trace_rays<Q: PacketQuery<Output: Copy>>(
        &mut self,
        level: Level,
        rays: &[RayRecord],
        ray_mask: u32,
        prepare: impl Fn(&mut Q, usize),
        results: &mut [Q::Output],
    ) {
        let (scene, scratch) = (self.scene, &mut *self.scratch);
        let mut trace = |first: usize, packets: &[[RayRecord; LANES]], results: &mut [[Q::Output; LANES]]| {
            let prepare = |query: &mut Q, packet: usize| prepare(query, first + packet);
            dispatch_simd!(level, simd => trace_packets(simd, scene, scratch, packets, ray_mask, prepare, results));
        };
        // Trace whole packets.
        let (packets, rest) = rays.as_chunks();
        let (results, results_of_rest) = results.as_chunks_mut();
        trace(0, packets, results);
        // Pad the rest with empty rays.
        if let Some(first) = rest.first() {
            let mut packet = [RayRecord { t_max: f32::NEG_INFINITY, ..*first }; LANES];
            packet[..rest.len()].copy_from_slice(rest);
            let mut results = [Q::MISS; LANES];
            trace(packets.len(), &[packet], std::array::from_mut(&mut results));
            results_of_rest.copy_from_slice(&results[..rest.len()]);
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec4;

    use super::*;
    use crate::compile::Compiler;
    use crate::graph::{BlasKind, Quality};
    use crate::trace::kernel::is_layered;
    use crate::{Core, Geometry, Material, Scene};

    /// Every other test runs with the widest instruction set: this one with all that the processor has.
    #[test]
    fn every_simd_level_matches_the_kernel() {
        let mut random = fastrand::Rng::with_seed(4);
        let mut vector = |scale: f32| (Vec3::new(random.f32(), random.f32(), random.f32()) * 2.0 - 1.0) * scale;
        // Small triangles all over a cube.
        let corners: Vec<Vec3> = (0..600)
            .flat_map(|_| {
                let (at, a, b) = (vector(1.0), vector(0.2), vector(0.2));
                [at, at + a, at + b].map(|corner| corner * 1e3)
            })
            .collect();
        let mut scene = Scene::new();
        let indices: Vec<[u32; 3]> = (0..600).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        // Two thirds of the triangles are translucent, half of all in a structure that refers to triangles from several
        // leaves.
        let tint = Vec4::new(0.5, 0.7, 0.9, 1.0);
        let [opaque, panes] = [Material::default(), Material { base_color: tint, ..Material::glass(1.5) }];
        let structure = Some(BlasKind::Bvh(Quality::High));
        let parts = [
            (opaque, Geometry::new(corners.clone(), indices[..200].to_vec())),
            (panes.clone(), Geometry::new(corners.clone(), indices[200..300].to_vec())),
            (panes, Geometry { blas_kind: structure, ..Geometry::new(corners, indices[300..].to_vec()) }),
        ];
        for (material, geometry) in parts {
            let (geometry, material) = (scene.add_geometry(geometry).unwrap(), scene.add_material(material).unwrap());
            scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
        }
        let mut compiler = Compiler::default();
        compiler.compile(&mut scene, glam::DVec3::ZERO).unwrap();

        // Coherent packets from one point, incoherent packets, and packets along an axis with a direction so short that
        // the distances to most planes overflow; the last one is not full.
        let rays: Vec<RayRecord> = (0..2_507)
            .map(|i| {
                let aim = Vec3::new((i / 16 % 16) as f32 / 8.0 - 1.0, (i / 256) as f32 / 2.0 - 1.0, 0.0);
                let (origin, direction) = match i {
                    0..1_000 => (Vec3::new(0.3, 0.2, 3.0), aim + vector(0.05) - Vec3::new(0.3, 0.2, 3.0)),
                    1_000..2_000 => (vector(2.0), vector(1.0)),
                    _ => {
                        let side = if i % 2 == 0 { 2.0 } else { -2.0 };
                        (vector(1.0).with_z(side), Vec3::new(0.0, 0.0, -side * 1e-38))
                    }
                };
                let (origin, direction) = (origin * 1e3, direction * 1e3);
                RayRecord { origin: origin.to_array(), t_min: 0.0, direction: direction.to_array(), t_max: f32::MAX }
            })
            .collect();
        let scene = KernelScene::with_traversal(compiler.arrays(), Traversal::Wide);
        // Run the three queries at one SIMD level.
        let trace = |simd_level: Option<Level>| {
            let mut tracer = PacketTracer { scene: &scene, simd_level, scratch: bytemuck::zeroed_box() };
            let (mut hits, mut occluded) = (vec![HitRecord::MISS; rays.len()], vec![false; rays.len()]);
            let mut light = vec![Vec3::NAN; rays.len()];
            tracer.closest_hits(&rays, u32::MAX, &mut hits);
            tracer.any_hits(&rays, u32::MAX, &mut occluded);
            tracer.transmittances(&rays, u32::MAX, &mut light);
            (hits, occluded, light)
        };
        assert!(scene.instances.iter().any(|instance| is_layered(instance.flags)));
        // The scalar kernel gives the reference; check that enough of its rays hit, miss and are dimmed.
        let expected = trace(None);
        let dimmed = expected.2.iter().filter(|light| light.x > 0.0 && light.x < 1.0).count();
        assert!(dimmed > 50, "{dimmed}");
        let occluded = expected.1.iter().filter(|&&hit| hit).count();
        assert!((300..2_400).contains(&occluded), "{occluded}");
        let with_short_directions = expected.1[2_000..].iter().filter(|&&hit| hit).count();
        assert!(with_short_directions > 100, "{with_short_directions}");
        // Compare every level that this processor has.
        let level = Level::new();
        #[cfg(target_arch = "x86_64")]
        let all = [level.as_avx512().map(Level::Avx512), level.as_avx2().map(Level::Avx2)];
        #[cfg(not(target_arch = "x86_64"))]
        let all = [supported_simd_level()];
        let tested = all.into_iter().flatten().filter(|&level| {
            let (hits, occluded, light) = trace(Some(level));
            assert_eq!((&hits, &occluded), (&expected.0, &expected.1), "{level:?}");
            // A product of tints is rounded in visiting order.
            let differs = |(a, b): (&Vec3, &Vec3)| !a.abs_diff_eq(*b, 1e-6);
            assert_eq!(light.iter().zip(&expected.2).position(differs), None, "{level:?}");
            true
        });
        assert_eq!(tested.count() > 0, supported_simd_level().is_some(), "{level:?}");
    }
}
