//! Queries answered by SIMD walks: of sixteen rays, and of one.

use fearless_simd::Simd;

use super::answers::{Answers, Place};
use super::lanes::LANES;
use super::local::{LocalPacket, Packet};
use super::single::{walk_single, walk_singly};
use super::together::{self, Together, go_together};
use super::top::{walk_top, walk_top_packet};
use super::walk::{Stack, walk};
use crate::device::layout::{Instance, Ray, WideNode};
use crate::trace::kernel::KernelScene;
use crate::trace::queries::Query;

/// What walks write to. Kept from ray to ray, so that nothing clears it.
#[derive(Default)]
pub(super) struct Memory {
    stack: Stack,
    packets: together::Memory,
}

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
        *hits = answers.hits(simd);
    }
}

/// One by one where the rays do not go much the same way.
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
            let instance = &scene.instances[index as usize];
            if instance.mask & ray_mask == 0 {
                return;
            }
            let nodes = nodes_of(scene, instance);
            let rays = LocalPacket::new(simd, packet, instance, &nodes[0]);
            let place = Place { scene, index, instance };
            if go_together(&rays) {
                walk_together(simd, nodes, memory, &place, &rays, answers);
            } else {
                walk_singly(simd, nodes, 0, &mut memory.packets.stack, &place, &rays, lanes, answers);
            }
        },
    );
}

/// One ray.
#[inline(always)]
pub(super) fn ask_one<S: Simd, Q: Query>(
    simd: S,
    scene: &KernelScene<'_>,
    memory: &mut Memory,
    ray: &Ray,
    ray_mask: u32,
) -> Q {
    let packet = Packet::new(simd, &[*ray; LANES]);
    let mut query = Q::start(ray.t_max);
    walk_top(
        scene,
        ray,
        ray.t_max,
        #[inline(always)]
        |index| {
            let instance = &scene.instances[index as usize];
            if instance.mask & ray_mask != 0 {
                let nodes = nodes_of(scene, instance);
                let rays = LocalPacket::new(simd, &packet, instance, &nodes[0]);
                let place = Place { scene, index, instance };
                query = walk_single(simd, nodes, &mut memory.packets.stack, &place, &rays, 0, query);
            }
            query.t_max()
        },
    );
    query.finish();
    query
}

/// The structure of an instance's geometry, and what follows it.
fn nodes_of<'a>(scene: &KernelScene<'a>, instance: &Instance) -> &'a [WideNode] {
    &scene.wide_nodes[scene.geometries[instance.geometry as usize].first_wide_node as usize..]
}

/// Rays that [`go_together`]. A function of its own: it needs all registers.
#[inline(never)]
fn walk_together<S: Simd, A: Answers>(
    simd: S,
    nodes: &[WideNode],
    memory: &mut Memory,
    place: &Place<'_>,
    rays: &LocalPacket<S>,
    answers: &mut A,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            let mut walker = Together::new(simd, place, rays, answers, nodes, &mut memory.packets);
            walk(simd, nodes, 0, rays.octant(0), &mut memory.stack, &mut walker);
        },
    );
}
