//! Rays have the same hits, bit for bit, whichever traversal finds them.

#![allow(clippy::panic, clippy::unwrap_used, reason = "a test fails by panicking")]

use glam::{DAffine3, DQuat, DVec3, Vec3};
use ropewalk::accel::Tlas;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{InstanceFlags, NONE, Node, PrimitiveRange, RayRecord};
use ropewalk::trace::{Emulated, Recursive, Tracer as _, Traversal, TraversalCounts};
use ropewalk_testkit::{Builder, Mesh, Placed, Random, arrays_by, tracers};

/// Checks that all executors and traversals have the same hits for these rays.
fn agree(arrays: &mut DeviceArrays, rays: &[RayRecord], ray_mask: u32) {
    let mut tracers = tracers();
    let mut answers = tracers.iter_mut().map(|tracer| {
        tracer.upload(arrays).unwrap();
        (tracer.closest_hits(arrays, rays, ray_mask).unwrap(), tracer.any_hits(arrays, rays, ray_mask).unwrap())
    });
    let expected = answers.next().unwrap();
    let hits = expected.0.iter().filter(|hit| hit.instance != NONE).count();
    assert!(hits > rays.len() / 20, "{hits} of {} rays hit", rays.len());
    for (i, found) in answers.enumerate() {
        let first = (0..rays.len()).find(|&r| (found.0[r], found.1[r]) != (expected.0[r], expected.1[r]));
        assert!(
            first.is_none(),
            "tracer {}: {:?} is {:?}, not {:?}",
            i + 1,
            rays[first.unwrap()],
            found.0[first.unwrap()],
            expected.0[first.unwrap()]
        );
    }
}

/// Rays between random points of a cube from `-size` to `size`; directions have all lengths.
fn rays(random: &mut Random, size: f32, count: usize) -> Vec<RayRecord> {
    let mut ray = || {
        let (from, to) = (random.in_cube() * size, random.in_cube() * size);
        let direction = (to - from) * [1.0, 1e-3, 1e6][random.index(3)];
        let direction = if random.index(8) == 0 { direction * Vec3::new(1.0, 0.0, 0.0) } else { direction };
        let t_max = if random.index(4) == 0 { random.unsigned() } else { f32::MAX };
        RayRecord { origin: from.to_array(), t_min: 0.0, direction: direction.to_array(), t_max }
    };
    (0..count).map(|_| ray()).collect()
}

fn placed(random: &mut Random, meshes: usize, count: usize) -> Vec<Placed> {
    let flags = [InstanceFlags::empty(), InstanceFlags::CULL_BACK];
    let mut one = || {
        let rotation = DQuat::from_axis_angle(random.direction().as_dvec3(), f64::from(random.signed()) * 3.0);
        let scale = DVec3::splat(0.1 + f64::from(random.unsigned()));
        let translation = random.in_cube().as_dvec3() * 3.0;
        let world_from_local = DAffine3::from_scale_rotation_translation(scale, rotation, translation);
        let mask = 1 << random.index(2);
        Placed { mask, flags: flags[random.index(2)], ..Placed::new(random.index(meshes), world_from_local) }
    };
    (0..count).map(|_| one()).collect()
}

#[test]
fn fields_of_instances() {
    let mut random = Random::new(9);
    let meshes = [Mesh::soup(1, 300), Mesh::icosphere(3), Mesh::cube(), Mesh::soup(2, 1)];
    for instances in [1, 2, 40, 400] {
        let placed = placed(&mut random, meshes.len(), instances);
        let mut arrays = arrays_by(Builder::Product, &meshes, &placed);
        let rays = rays(&mut random, 4.0, 6_000);
        let rays = if instances < 3 { aimed(&mut random, &placed, rays) } else { rays };
        agree(&mut arrays, &rays, u32::MAX);
        if instances > 2 {
            agree(&mut arrays, &rays, 2);
        }
    }
}

/// The same rays, aimed at the instances.
fn aimed(random: &mut Random, placed: &[Placed], rays: Vec<RayRecord>) -> Vec<RayRecord> {
    let aim = |ray: RayRecord| {
        let at = placed[random.index(placed.len())].world_from_local.translation.as_vec3() + random.in_cube() * 0.5;
        let length = Vec3::from_array(ray.direction).length();
        RayRecord { direction: ((at - Vec3::from_array(ray.origin)).normalize() * length).to_array(), ..ray }
    };
    rays.into_iter().map(aim).collect()
}

#[test]
fn meshes_of_all_sizes() {
    let mut random = Random::new(2);
    for size in [1e-9, 1.0, 1e9] {
        let mesh = Mesh::displaced_icosphere(5).scaled(size);
        let mut arrays = arrays_by(Builder::Product, &[mesh], &[Placed::new(0, DAffine3::IDENTITY)]);
        agree(&mut arrays, &rays(&mut random, size * 1.5, 6_000), 1);
    }
}

/// A TLAS as deep as its number of instances, whose boxes all overlap, so that far more nodes wait than the stacks of
/// the kernel and of the CPU hold. No builder makes one as deep.
#[test]
fn a_tlas_deeper_than_the_stacks() {
    let mut random = Random::new(3);
    // The instances are small and apart, so that a node that is skipped in error changes hits.
    let mut one = || {
        let translation = random.in_cube().as_dvec3() * 2.0;
        Placed::new(0, DAffine3::from_scale_rotation_translation(DVec3::splat(0.1), DQuat::IDENTITY, translation))
    };
    let placed: Vec<Placed> = (0..2 * Tlas::MAX_DEPTH).map(|_| one()).collect();
    let mut arrays = arrays_by(Builder::Product, &[Mesh::cube()], &placed);
    let (min, max) = ([-3.0; 3], [3.0; 3]);
    for left_deep in [false, true] {
        let count = placed.len() as u32;
        let mut nodes = Vec::new();
        for i in 0..count {
            let leaf = PrimitiveRange::leaf(i, 1);
            let end = 2 * count - 1;
            if left_deep {
                // First all inner nodes, then the leaves from the innermost outward.
                if i + 1 < count {
                    nodes.push(Node { min, escape_index: end - i, max, primitives: PrimitiveRange::INNER });
                } else {
                    nodes.extend((0..count).map(|i| Node {
                        min,
                        escape_index: count + i,
                        max,
                        primitives: PrimitiveRange::leaf(i, 1),
                    }));
                }
            } else {
                if i + 1 < count {
                    nodes.push(Node { min, escape_index: end, max, primitives: PrimitiveRange::INNER });
                }
                nodes.push(Node { min, escape_index: nodes.len() as u32 + 1, max, primitives: leaf });
            }
        }
        let end = nodes.len() as u32;
        nodes.iter_mut().filter(|node| node.escape_index == end).for_each(|node| node.escape_index = NONE);
        assert_eq!(end, 2 * count - 1);
        arrays.tlas_nodes.replace(&nodes);
        let rays = rays(&mut random, 3.0, 3_000);
        agree(&mut arrays, &aimed(&mut random, &placed, rays), 1);
    }
}

#[test]
fn wide_nodes_cost_fewer_fetches() {
    let mut random = Random::new(4);
    let mesh = Mesh::displaced_icosphere(6);
    let arrays = arrays_by(Builder::Product, &[mesh], &[Placed::new(0, DAffine3::IDENTITY)]);
    let rays = rays(&mut random, 2.0, 20_000);
    let [rope, wide] = [Traversal::Rope, Traversal::Wide]
        .map(|layout| Emulated::default().with_traversal(layout).count_closest_hits(&arrays, &rays, 1));
    println!("{rope:?}\n{wide:?}");
    assert!(wide.nodes * 3 < rope.nodes && wide.bytes < rope.bytes, "{rope:?} {wide:?}");
    assert!(rope.boxes == rope.nodes && wide.boxes < 8 * wide.nodes);
    assert_eq!(Emulated::default().count_any_hits(&arrays, &[], 1), TraversalCounts::default());
}

#[test]
fn recursion_visits_what_ropes_do() {
    let mut random = Random::new(5);
    let meshes = [Mesh::displaced_icosphere(4), Mesh::displaced_icosphere(2)];
    let mut arrays = arrays_by(Builder::Product, &meshes, &placed(&mut random, 2, 40));
    let rays = rays(&mut random, 4.0, 5000);
    let ropes = Emulated::default().with_traversal(Traversal::Rope);
    let mut recursive = Recursive::default();
    recursive.upload(&mut arrays).unwrap();
    let closest = ropes.count_closest_hits(&arrays, &rays, 1);
    assert!(closest.triangles > 1000 && closest.instances > 1000, "{closest:?}");
    assert_eq!(recursive.count_closest_hits(&arrays, &rays, 1), closest);
    // After its hit a ray only tests the siblings on its way up.
    let (found, expected) = (recursive.count_any_hits(&arrays, &rays, 1), ropes.count_any_hits(&arrays, &rays, 1));
    assert_eq!((found.triangles, found.instances), (expected.triangles, expected.instances));
    assert!((expected.nodes..2 * expected.nodes).contains(&found.nodes), "{found:?} {expected:?}");
}
