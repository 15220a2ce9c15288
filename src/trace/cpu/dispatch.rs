//! The door to the SIMD code: any number of rays, sixteen at a time, with the lanes that this processor has.

use fearless_simd::{Level, Simd};
use glam::Vec3;

use super::hybrid::trace_packets;
use super::packet_queries::{AnyPacket, ClosestPacket, PacketQuery, TransmittancePacket};
use super::packet_traversal::HybridScratch;
use super::simd::LANES;
use crate::device::layout::{HitRecord, RayRecord};
use crate::trace::Traversal;
use crate::trace::kernel::{KernelScene, any_hit, closest_hit, transmittance};

/// What a task traces rays with.
pub(super) struct PacketTracer<'a> {
    pub(super) scene: &'a KernelScene<'a>,
    simd_level: Option<Level>,
    scratch: Box<HybridScratch>,
}

/// Calls a function with the widest lanes of this processor. What is compiled is compiled once for each of these, which takes its time: so
/// there are no more than users have.
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
            _ => unreachable!("`lanes` says which there are"),
        }
    };
}

/// The processor's lanes, if it has those that the walks are compiled for.
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
        // Arrays made by hand may have no wide nodes: they are walked along escape indices, a ray at a time.
        let lanes = if scene.traversal == Traversal::Wide { supported_simd_level() } else { None };
        Self { scene, simd_level: lanes, scratch: bytemuck::zeroed_box() }
    }

    /// Of the rays that are asked, here and below, sixteen that follow one another best go much the same way.
    pub(super) fn closest_hits(&mut self, rays: &[RayRecord], ray_mask: u32, hits: &mut [HitRecord]) {
        match self.simd_level {
            Some(level) => self.trace_rays::<ClosestPacket>(level, rays, ray_mask, hits),
            None => hits.iter_mut().zip(rays).for_each(|(hit, ray)| *hit = closest_hit(self.scene, ray, ray_mask)),
        }
    }

    pub(super) fn any_hits(&mut self, rays: &[RayRecord], ray_mask: u32, hits: &mut [bool]) {
        match self.simd_level {
            Some(level) => self.trace_rays::<AnyPacket>(level, rays, ray_mask, hits),
            None => hits.iter_mut().zip(rays).for_each(|(hit, ray)| *hit = any_hit(self.scene, ray, ray_mask)),
        }
    }

    /// How much light gets through.
    pub(super) fn transmittances(&mut self, rays: &[RayRecord], ray_mask: u32, light: &mut [Vec3]) {
        match self.simd_level {
            Some(level) => self.trace_rays::<TransmittancePacket>(level, rays, ray_mask, light),
            None => {
                light.iter_mut().zip(rays).for_each(|(light, ray)| *light = transmittance(self.scene, ray, ray_mask));
            }
        }
    }

    /// By whole packets; where rays are left over, by one more that has rays which meet nothing.
    fn trace_rays<A: PacketQuery<Output: Copy>>(
        &mut self,
        level: Level,
        rays: &[RayRecord],
        ray_mask: u32,
        hits: &mut [A::Output],
    ) {
        let (scene, memory) = (self.scene, &mut *self.scratch);
        let mut ask = |rays: &[[RayRecord; LANES]], hits: &mut [[A::Output; LANES]]| {
            dispatch_simd!(level, simd => trace_packets::<_, A>(simd, scene, memory, rays, ray_mask, hits));
        };
        let (packets, rest) = rays.as_chunks();
        let (hits, hits_of_rest) = hits.as_chunks_mut();
        ask(packets, hits);
        if let Some(first) = rest.first() {
            let mut packet = [RayRecord { t_max: f32::NEG_INFINITY, ..*first }; LANES];
            packet[..rest.len()].copy_from_slice(rest);
            let mut hits = [A::MISS; LANES];
            ask(&[packet], std::array::from_mut(&mut hits));
            hits_of_rest.copy_from_slice(&hits[..rest.len()]);
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec4;

    use super::*;
    use crate::compile::Compiler;
    use crate::trace::kernel::is_layered;
    use crate::{BlasKind, Core, Geometry, Material, Quality, Scene};

    /// Numbers between -1 and 1, by a linear congruence.
    fn random(state: &mut u64) -> f32 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 40) as f32 / (1 << 23) as f32 - 1.0
    }

    /// The widest lanes are those that every other test runs with: here are all that this processor has.
    #[test]
    fn all_lanes_meet_what_the_kernel_meets() {
        let state = &mut 1;
        let mut vector = |scale: f32| Vec3::new(random(state), random(state), random(state)) * scale;
        let corners: Vec<Vec3> = (0..600)
            .flat_map(|_| {
                let (at, a, b) = (vector(1.0), vector(0.2), vector(0.2));
                [at, at + a, at + b].map(|corner| corner * 1e3)
            })
            .collect();
        let mut scene = Scene::new();
        let indices: Vec<[u32; 3]> = (0..600).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        // Most of it lets light through, a half with triangles in several leaves.
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

        // Packets that start at a point and go much the same way, packets that do not, and some along an axis with a direction so short that
        // where they meet most planes is beyond all numbers; the last one is not full.
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
        let trace = |lanes: Option<Level>| {
            let mut tracer = PacketTracer { scene: &scene, simd_level: lanes, scratch: bytemuck::zeroed_box() };
            let (mut hits, mut any) = (vec![HitRecord::MISS; rays.len()], vec![false; rays.len()]);
            let mut light = vec![Vec3::NAN; rays.len()];
            tracer.closest_hits(&rays, u32::MAX, &mut hits);
            tracer.any_hits(&rays, u32::MAX, &mut any);
            tracer.transmittances(&rays, u32::MAX, &mut light);
            (hits, any, light)
        };
        assert!(scene.instances.iter().any(|instance| is_layered(instance.flags)));
        let expected = trace(None);
        let dimmed = expected.2.iter().filter(|light| light.x > 0.0 && light.x < 1.0).count();
        assert!(dimmed > 50, "{dimmed}");
        let met = expected.1.iter().filter(|&&hit| hit).count();
        assert!((300..2_400).contains(&met), "{met}");
        let far = expected.1[2_000..].iter().filter(|&&hit| hit).count();
        assert!(far > 100, "{far}");
        let level = Level::new();
        #[cfg(target_arch = "x86_64")]
        let all = [level.as_avx512().map(Level::Avx512), level.as_avx2().map(Level::Avx2)];
        #[cfg(not(target_arch = "x86_64"))]
        let all = [supported_simd_level()];
        let tested = all.into_iter().flatten().filter(|&lanes| {
            let (hits, any, light) = trace(Some(lanes));
            assert_eq!((&hits, &any), (&expected.0, &expected.1), "{lanes:?}");
            // A product of tints is rounded in the order in which they are met.
            let differs = |(a, b): (&Vec3, &Vec3)| !a.abs_diff_eq(*b, 1e-6);
            assert_eq!(light.iter().zip(&expected.2).position(differs), None, "{lanes:?}");
            true
        });
        assert_eq!(tested.count() > 0, supported_simd_level().is_some(), "{level:?}");
    }
}
