//! Queries answered by SIMD walks, sixteen rays at a time.

use fearless_simd::Simd;

use super::local_packet::{LocalPacket, Packet};
use super::node_test::{Coherent, Incoherent, is_coherent};
use super::packet_queries::{Answers, Place};
use super::packet_traversal::{SINGLE_RAY_THRESHOLD, Memory, walk_together};
use super::simd::LANES;
use super::single_traversal::walk_singly;
use super::tlas_traversal::walk_top_packet;
use crate::device::layout::Ray;
use crate::trace::kernel::KernelScene;

/// The answers of packet after packet.
#[inline(always)]
pub(super) fn ask_packets<S: Simd, A: Answers>(
    simd: S,
    scene: &KernelScene<'_>,
    memory: &mut Memory,
    rays: &[[Ray; LANES]],
    ray_mask: u32,
    hits: &mut [[A::Hit; LANES]],
) {
    for (rays, hits) in rays.iter().zip(hits) {
        let packet = Packet::new(simd, rays);
        let mut answers = A::new(packet.t_max);
        ask(simd, scene, memory, &packet, ray_mask, &mut answers);
        *hits = answers.hits(simd, scene, rays, ray_mask);
    }
}

/// One by one where only a few meet an instance.
#[inline(always)]
fn ask<S: Simd, A: Answers>(
    simd: S,
    scene: &KernelScene<'_>,
    memory: &mut Memory,
    packet: &Packet<S>,
    ray_mask: u32,
    answers: &mut A,
) {
    walk_top_packet(
        simd,
        scene,
        packet,
        answers,
        #[inline(always)]
        |index, lanes, answers| {
            let Some(place) = Place::of(scene, index, ray_mask) else { return };
            let rays = LocalPacket::new(simd, packet, place.instance, &place.nodes[0]);
            if lanes.count_ones() <= SINGLE_RAY_THRESHOLD || !rays.is_finite {
                walk_singly(simd, 0, &mut memory.single, &place, &rays, lanes, answers);
            } else if is_coherent(&rays) {
                walk_together::<_, _, Coherent<_>>(simd, memory, &place, &rays, lanes, answers);
            } else {
                walk_together::<_, _, Incoherent<_>>(simd, memory, &place, &rays, lanes, answers);
            }
        },
    );
}
