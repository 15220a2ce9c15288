//! The GPU, `emulated` and `cpu` give the same hits.

use ropewalk::device::layout::{HitRecord, NONE};
use ropewalk::trace::{Cpu, Emulated, Tracer};

use super::soup::{rays, soup};
use ropewalk_testkit::Random;
use ropewalk_testkit::gpu::tracer;

/// Two executors may name different triangles for a ray only where both hits are this near, relative to their distance:
/// GPUs may contract products into fused ones and divide to 2.5 ulp, which moves a distance by a few ulp (2^-23 each)
/// of the coordinates it is computed from.
const TIE_BAND: f32 = 1.0 / (1 << 18) as f32;

/// The greatest share of rays that pass an edge on one executor and hit it on another. Edge tests have a relative
/// tolerance that is larger than rounding errors, so such rays are rare.
const MOST_AT_EDGES: f64 = 1e-4;

#[test]
fn gpu_emulated_and_cpu_hit_the_same_triangles() {
    let Some(mut gpu) = tracer() else { return };
    let mut random = Random::new(1);
    let mut arrays = soup(100, &mut random);
    gpu.upload(&mut arrays).unwrap();
    // More than one dispatch of a batch takes, and not a multiple of a workgroup.
    let rays = rays(300_001, &mut random);
    for ray_mask in [u32::MAX, 1, 2, 4] {
        let expected = Cpu::default().closest_hits(&arrays, &rays, ray_mask).unwrap();
        let few = Emulated::default().closest_hits(&arrays, &rays[..10_000], ray_mask).unwrap();
        assert_eq!(few, expected[..10_000], "cpu and emulated run the same code");
        let found = gpu.closest_hits(&arrays, &rays, ray_mask).unwrap();
        assert_eq!(found.len(), rays.len());
        let hits = expected.iter().filter(|hit| hit.instance != NONE).count();
        assert_eq!(hits > 0, ray_mask != 4, "{hits} of {}", rays.len());
        compare(&found, &expected);

        let found = gpu.any_hits(&arrays, &rays, ray_mask).unwrap();
        let blocked = Cpu::default().any_hits(&arrays, &rays, ray_mask).unwrap();
        assert_eq!(found.len(), blocked.len());
        assert_eq!(blocked.contains(&true), ray_mask != 4);
        let different = found.iter().zip(&blocked).filter(|(a, b)| a != b).count();
        assert!(different as f64 <= MOST_AT_EDGES * rays.len() as f64, "{different}");
    }
}

#[test]
fn no_rays_give_no_answers() {
    let Some(mut gpu) = tracer() else { return };
    let mut arrays = soup(1, &mut Random::new(2));
    gpu.upload(&mut arrays).unwrap();
    assert!(gpu.closest_hits(&arrays, &[], 1).unwrap().is_empty());
    assert!(gpu.any_hits(&arrays, &[], 1).unwrap().is_empty());
}

fn compare(found: &[HitRecord], expected: &[HitRecord]) {
    let mut at_edges = 0;
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        let same = (found.instance, found.primitive) == (expected.instance, expected.primitive);
        if found.instance == NONE || expected.instance == NONE {
            at_edges += usize::from(!same);
        } else {
            let near = (found.t - expected.t).abs() <= TIE_BAND * expected.t.abs();
            assert!(near || !same, "ray {i}: the same triangle at {} and {}", found.t, expected.t);
            at_edges += usize::from(!near);
        }
        if same && expected.instance != NONE {
            let off = (found.u - expected.u).abs().max((found.v - expected.v).abs());
            assert!(off <= 1e-3, "ray {i}: weights off by {off}");
            assert_eq!((found.triangle, found.back_face), (expected.triangle, expected.back_face), "ray {i}");
        }
    }
    println!("{at_edges} of {} rays at edges", found.len());
    assert!(at_edges as f64 <= MOST_AT_EDGES * found.len() as f64, "{at_edges} rays differ");
}
