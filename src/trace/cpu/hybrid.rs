//! Queries answered by SIMD walks, sixteen rays at a time.

use fearless_simd::Simd;

use super::node_test::{Coherent, Incoherent, is_coherent};
use super::packet_queries::{InstanceGeometry, PacketQuery};
use super::packet_traversal::{HybridScratch, SINGLE_RAY_THRESHOLD, traverse_packet};
use super::ray_packet::{LocalPacket, RayPacket};
use super::simd::LANES;
use super::single_traversal::traverse_single_rays;
use super::tlas_traversal::traverse_tlas_packet;
use crate::device::layout::RayRecord;
use crate::trace::kernel::KernelScene;

/// The answers of packet after packet.
#[inline(always)]
pub(super) fn trace_packets<S: Simd, A: PacketQuery>(
    simd: S,
    scene: &KernelScene<'_>,
    memory: &mut HybridScratch,
    rays: &[[RayRecord; LANES]],
    ray_mask: u32,
    hits: &mut [[A::Output; LANES]],
) {
    for (rays, hits) in rays.iter().zip(hits) {
        let packet = RayPacket::new(simd, rays);
        let mut answers = A::new(packet.t_max);
        trace_packet(simd, scene, memory, &packet, ray_mask, &mut answers);
        *hits = answers.outputs(simd, scene, rays, ray_mask);
    }
}

/// One by one where only a few meet an instance.
#[inline(always)]
fn trace_packet<S: Simd, A: PacketQuery>(
    simd: S,
    scene: &KernelScene<'_>,
    memory: &mut HybridScratch,
    packet: &RayPacket<S>,
    ray_mask: u32,
    answers: &mut A,
) {
    traverse_tlas_packet(
        simd,
        scene,
        packet,
        answers,
        #[inline(always)]
        |index, lanes, answers| {
            let Some(place) = InstanceGeometry::of(scene, index, ray_mask) else { return };
            let rays = LocalPacket::new(simd, packet, place.instance, &place.nodes[0]);
            if lanes.count_ones() <= SINGLE_RAY_THRESHOLD || !rays.is_packet_safe {
                traverse_single_rays(simd, 0, &mut memory.single, &place, &rays, lanes, answers);
            } else if is_coherent(&rays) {
                traverse_packet::<_, _, Coherent<_>>(simd, memory, &place, &rays, lanes, answers);
            } else {
                traverse_packet::<_, _, Incoherent<_>>(simd, memory, &place, &rays, lanes, answers);
            }
        },
    );
}
