//! Hybrid traversal: 16-ray packets that switch to single-ray traversal where few of their rays remain active.
//! (Embree's `bvh_intersector_hybrid` is the same idea.)
//!
//! The rays of a packet diverge when they enter different nodes. Packet traversal pays while several rays share a node,
//! so wherever at most [`SINGLE_RAY_THRESHOLD`] rays remain active, they are traced one by one. This is decided in
//! three places:
//!
//! - TLAS (`tlas_traversal`): a subtree that few rays enter is traversed by each of them alone.
//! - Instance (`trace_packet`, here): few rays are traced by `single_traversal`. More are traced by `packet_traversal`,
//!   with the coherent node test of `node_test` if all 16 rays have the same direction octant and the same dominant
//!   axis, else with the incoherent one.
//! - BLAS (`packet_traversal`): a subtree or leaf that few rays enter is handed to `single_traversal`.

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

/// Traces each packet and writes its results. `prepare` gets the initial state of each packet's query, and the packet's
/// index.
#[inline(always)]
pub(super) fn trace_packets<S: Simd, Q: PacketQuery>(
    simd: S,
    scene: &KernelScene<'_>,
    scratch: &mut HybridScratch,
    packets: &[[RayRecord; LANES]],
    ray_mask: u32,
    prepare: impl Fn(&mut Q, usize),
    results: &mut [[Q::Output; LANES]],
) {
    for (index, (rays, results)) in packets.iter().zip(results).enumerate() {
        // Load 16 rays.
        let packet = RayPacket::new(simd, rays);
        // Traverse both levels.
        let mut queries = Q::new(packet.t_max);
        prepare(&mut queries, index);
        trace_packet(simd, scene, scratch, &packet, ray_mask, &mut queries);
        // Write the results; for layered instances this traces further rays.
        *results = queries.outputs(simd, scene, rays, ray_mask);
    }
}

/// Traces one packet: the TLAS as a packet; in each instance coherent packet, incoherent packet or single-ray
/// traversal, by the number and coherence of the rays that hit its box.
#[inline(always)]
fn trace_packet<S: Simd, Q: PacketQuery>(
    simd: S,
    scene: &KernelScene<'_>,
    scratch: &mut HybridScratch,
    packet: &RayPacket<S>,
    ray_mask: u32,
    queries: &mut Q,
) {
    traverse_tlas_packet(
        simd,
        scene,
        packet,
        queries,
        #[inline(always)]
        |index, lanes, queries| {
            // Skip instances hidden by the ray mask.
            let Some(geometry) = InstanceGeometry::of(scene, index, ray_mask) else { return };
            // Transform the packet to local space.
            let rays = LocalPacket::new(simd, packet, geometry.instance, &geometry.nodes[0]);
            if lanes.count_ones() <= SINGLE_RAY_THRESHOLD || !rays.is_packet_safe {
                // Few active rays, or products that overflow: single rays from the root.
                traverse_single_rays(simd, 0, &mut scratch.single, &geometry, &rays, lanes, queries);
            } else if is_coherent(&rays) {
                // Coherent packet.
                traverse_packet::<_, _, Coherent<_>>(simd, scratch, &geometry, &rays, lanes, queries);
            } else {
                // Incoherent packet.
                traverse_packet::<_, _, Incoherent<_>>(simd, scratch, &geometry, &rays, lanes, queries);
            }
        },
    );
}
