//! The door to the SIMD code: rays of any kind, one at a time or sixteen, with the lanes that this processor has.

use fearless_simd::{Level, Simd};
use glam::Vec3;

use super::answers::{AnyHits, ClosestHits};
use super::ask::{ask_one, ask_packets};
use super::lanes::LANES;
use super::together::Memory;
use crate::device::layout::{Hit, Ray};
use crate::trace::Layout;
use crate::trace::kernel::{KernelScene, Traverse, any_hit, closest_hit, transmittance};
use crate::trace::queries::{Closest, Query, Transmittance};

/// What a task traces rays with.
pub(super) struct Rays<'a> {
    scene: &'a KernelScene<'a>,
    lanes: Option<Level>,
    memory: Box<Memory>,
}

/// Calls a function with the widest lanes of this processor. What is compiled is compiled once for each of these, which takes its time: so
/// there are no more than users have.
macro_rules! with_lanes {
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
fn lanes() -> Option<Level> {
    let level = Level::new();
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx512(_) | Level::Avx2(_) => Some(level),
        #[cfg(target_arch = "aarch64")]
        Level::Neon(_) => Some(level),
        _ => None,
    }
}

impl<'a> Rays<'a> {
    pub(super) fn new(scene: &'a KernelScene<'a>) -> Self {
        // Arrays made by hand may have no wide nodes: they are walked along escape indices, a ray at a time.
        let lanes = if scene.layout == Layout::Wide { lanes() } else { None };
        Self { scene, lanes, memory: bytemuck::zeroed_box() }
    }

    /// Sixteen that follow one another best go much the same way.
    pub(super) fn closest_hits(&mut self, rays: &[Ray], ray_mask: u32, hits: &mut [Hit]) {
        let (scene, memory) = (self.scene, &mut *self.memory);
        match self.lanes {
            Some(level) => by_packets(
                rays,
                hits,
                Hit::MISS,
                |rays, hits| with_lanes!(level, simd => ask_packets::<_, ClosestHits>(simd, scene, memory, rays, ray_mask, hits)),
            ),
            None => hits.iter_mut().zip(rays).for_each(|(hit, ray)| *hit = closest_hit(scene, ray, ray_mask)),
        }
    }

    /// Sixteen that follow one another best go much the same way.
    pub(super) fn any_hits(&mut self, rays: &[Ray], ray_mask: u32, hits: &mut [bool]) {
        let (scene, memory) = (self.scene, &mut *self.memory);
        match self.lanes {
            Some(level) => by_packets(
                rays,
                hits,
                false,
                |rays, hits| with_lanes!(level, simd => ask_packets::<_, AnyHits>(simd, scene, memory, rays, ray_mask, hits)),
            ),
            None => hits.iter_mut().zip(rays).for_each(|(hit, ray)| *hit = any_hit(scene, ray, ray_mask)),
        }
    }

    fn ask<Q: Query>(&mut self, level: Level, ray: &Ray, ray_mask: u32) -> Q {
        let (scene, memory) = (self.scene, &mut *self.memory);
        with_lanes!(level, simd => ask_one(simd, scene, memory, ray, ray_mask))
    }
}

/// Calls `trace` with whole packets; where rays are left over, with one more that has rays which meet nothing.
fn by_packets<T: Copy>(
    rays: &[Ray],
    hits: &mut [T],
    miss: T,
    mut trace: impl FnMut(&[[Ray; LANES]], &mut [[T; LANES]]),
) {
    let (packets, rest) = rays.as_chunks();
    let (hits, hits_of_rest) = hits.as_chunks_mut();
    trace(packets, hits);
    if let Some(first) = rest.first() {
        let mut packet = [Ray { t_max: f32::NEG_INFINITY, ..*first }; LANES];
        packet[..rest.len()].copy_from_slice(rest);
        let mut hits = [miss; LANES];
        trace(&[packet], std::array::from_mut(&mut hits));
        hits_of_rest.copy_from_slice(&hits[..rest.len()]);
    }
}

impl<'a> Traverse<'a> for Rays<'a> {
    fn scene(&self) -> &'a KernelScene<'a> {
        self.scene
    }

    fn closest_hit(&mut self, ray: &Ray, ray_mask: u32) -> Hit {
        match self.lanes {
            Some(level) => self.ask::<Closest>(level, ray, ray_mask).0,
            None => closest_hit(self.scene, ray, ray_mask),
        }
    }

    fn transmittance(&mut self, ray: &Ray, ray_mask: u32) -> Vec3 {
        match self.lanes {
            Some(level) => self.ask::<Transmittance>(level, ray, ray_mask).light(self.scene, ray, ray_mask),
            None => transmittance(self.scene, ray, ray_mask),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compile::Compiler;
    use crate::{Core, Geometry, Material, Scene};

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
        let geometry = Geometry::new(corners, indices);
        let core = Core::Geometry {
            geometry: scene.add_geometry(geometry).unwrap(),
            material: scene.add_material(Material::default()).unwrap(),
        };
        scene.add(scene.root(), core).unwrap();
        let mut compiler = Compiler::default();
        compiler.compile(&mut scene, glam::DVec3::ZERO).unwrap();

        // Packets that start at a point and go much the same way, packets that do not, and some along an axis with a direction so short that
        // where they meet most planes is beyond all numbers; the last one is not full.
        let rays: Vec<Ray> = (0..2_507)
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
                Ray { origin: origin.to_array(), t_min: 0.0, direction: direction.to_array(), t_max: f32::MAX }
            })
            .collect();
        let scene = KernelScene::with_layout(compiler.arrays(), Layout::Wide);
        let trace = |lanes: Option<Level>| {
            let mut tracer = Rays { scene: &scene, lanes, memory: bytemuck::zeroed_box() };
            let (mut hits, mut any) = (vec![Hit::MISS; rays.len()], vec![false; rays.len()]);
            tracer.closest_hits(&rays, u32::MAX, &mut hits);
            tracer.any_hits(&rays, u32::MAX, &mut any);
            let single: Vec<Hit> = rays.iter().map(|ray| tracer.closest_hit(ray, u32::MAX)).collect();
            assert_eq!(single, hits, "{lanes:?}");
            (hits, any)
        };
        let expected = trace(None);
        let met = expected.1.iter().filter(|&&hit| hit).count();
        assert!((300..2_400).contains(&met), "{met}");
        let far = expected.1[2_000..].iter().filter(|&&hit| hit).count();
        assert!(far > 100, "{far}");
        let level = Level::new();
        #[cfg(target_arch = "x86_64")]
        let all = [level.as_avx512().map(Level::Avx512), level.as_avx2().map(Level::Avx2)];
        #[cfg(not(target_arch = "x86_64"))]
        let all = [lanes()];
        let tested = all.into_iter().flatten().filter(|&lanes| {
            assert_eq!(trace(Some(lanes)), expected, "{lanes:?}");
            true
        });
        assert_eq!(tested.count() > 0, lanes().is_some(), "{level:?}");
    }
}
