//! Queries answered by SIMD walks, sixteen rays at a time.

use fearless_simd::Simd;

use super::answers::{Answers, Place};
use super::boxes::{Alike, Mixed, are_alike};
use super::lanes::LANES;
use super::local::{LocalPacket, Packet};
use super::single::walk_singly;
use super::together::{FEW, Memory, walk_together};
use super::top::walk_top_packet;
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
            if lanes.count_ones() <= FEW || !rays.is_finite {
                walk_singly(simd, 0, &mut memory.single, &place, &rays, lanes, answers);
            } else if are_alike(&rays) {
                walk_together::<_, _, Alike<_>>(simd, memory, &place, &rays, lanes, answers);
            } else {
                walk_together::<_, _, Mixed<_>>(simd, memory, &place, &rays, lanes, answers);
            }
        },
    );
}
