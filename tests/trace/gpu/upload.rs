//! Uploads copy only changes, and afterwards the GPU has the content of the arrays: its hits are compared with those of
//! an executor that reads the arrays in place.

use ropewalk::Error;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{GeometryRecord, InstanceRecord, MaterialRecord, Node, RayRecord, Triangle};
use ropewalk::error::Resource;
use ropewalk::trace::gpu::GpuTracer;
use ropewalk::trace::{Emulated, Tracer as _};

use super::device::limited;
use super::soup::{TRIANGLES_A_LEAF, link, rays, set_instance, soup};
use ropewalk_testkit::Random;
use ropewalk_testkit::gpu::tracer;

#[test]
fn the_first_upload_copies_all_and_the_second_nothing() {
    let Some(mut tracer) = tracer() else { return };
    let mut arrays = soup(10, &mut Random::new(1));
    let all = 10 * (2 * size_of::<Node>() + size_of::<InstanceRecord>() + TRIANGLES_A_LEAF * size_of::<Triangle>());
    assert_eq!(
        tracer.upload(&mut arrays).unwrap(),
        (all + size_of::<GeometryRecord>() + size_of::<MaterialRecord>()) as u64
    );
    assert_eq!(tracer.bind_group_rebuilds(), 1);
    assert_eq!(tracer.upload(&mut arrays).unwrap(), 0);
    assert_eq!(tracer.bind_group_rebuilds(), 1);
}

#[test]
fn one_changed_element_is_all_that_is_copied() {
    let Some(mut tracer) = tracer() else { return };
    let mut random = Random::new(2);
    let mut arrays = soup(1000, &mut random);
    tracer.upload(&mut arrays).unwrap();
    let rays = rays(500, &mut random);
    for i in [0, 500, 999] {
        let moved = InstanceRecord { first_triangle: 0, ..arrays.instances[i] };
        let moved = if i == 0 { InstanceRecord { mask: 4, ..moved } } else { moved };
        arrays.instances.write(i, &[moved]);
        assert_eq!(tracer.upload(&mut arrays).unwrap(), size_of::<InstanceRecord>() as u64);
        agree(&mut tracer, &arrays, &rays);
    }
    assert_eq!(tracer.bind_group_rebuilds(), 1);
}

#[test]
fn scattered_changes_arrive_each_in_its_place() {
    let Some(mut tracer) = tracer() else { return };
    let mut random = Random::new(10);
    let mut arrays = soup(400, &mut random);
    tracer.upload(&mut arrays).unwrap();
    let rays = rays(2000, &mut random);
    for step in [2, 7, 50] {
        let mut changed = 0;
        for i in (0..400).step_by(step) {
            // The instance gets the triangles of another one.
            let other = ((i + step) % 400 * TRIANGLES_A_LEAF) as u32;
            changed += usize::from(arrays.instances[i].first_triangle != other);
            arrays.instances.write(i, &[InstanceRecord { first_triangle: other, ..arrays.instances[i] }]);
        }
        assert!(changed > 400 / step / 2, "{changed}");
        assert_eq!(tracer.upload(&mut arrays).unwrap(), (changed * size_of::<InstanceRecord>()) as u64);
        agree(&mut tracer, &arrays, &rays);
    }
}

#[test]
fn an_executor_that_comes_later_copies_all() {
    let Some(mut tracer) = tracer() else { return };
    let mut random = Random::new(3);
    let mut arrays = soup(20, &mut random);
    Emulated::default().upload(&mut arrays).unwrap();
    assert!(tracer.upload(&mut arrays).unwrap() > 0);
    agree(&mut tracer, &arrays, &rays(500, &mut random));
}

#[test]
fn arrays_that_grow_keep_what_they_held() {
    let Some(mut tracer) = tracer() else { return };
    let mut random = Random::new(4);
    let mut arrays = soup(1, &mut random);
    tracer.upload(&mut arrays).unwrap();
    let rays = rays(300, &mut random);
    for count in 2..=200 {
        let triangles = TRIANGLES_A_LEAF * size_of::<Triangle>();
        set_instance(&mut arrays, count - 1, &mut random);
        link(&mut arrays);
        // In the TLAS, its own leaf changes and the leaf before it.
        let added = size_of::<InstanceRecord>() + triangles + size_of::<Node>() + 2 * size_of::<Node>();
        assert_eq!(tracer.upload(&mut arrays).unwrap(), added as u64, "{count}");
        if count % 20 == 0 {
            agree(&mut tracer, &arrays, &rays);
        }
    }
    // Buffers grow geometrically, so there are far fewer new buffers than uploads.
    assert!(tracer.bind_group_rebuilds() < 60, "{}", tracer.bind_group_rebuilds());
}

#[test]
fn random_edits_leave_the_gpu_with_what_the_arrays_hold() {
    let Some(mut tracer) = tracer() else { return };
    let mut random = Random::new(18);
    let mut arrays = soup(50, &mut random);
    let rays = rays(200, &mut random);
    for _ in 0..60 {
        let count = arrays.instances.len();
        match random.unsigned() {
            x if x < 0.6 => {
                for _ in 0..3 {
                    let i = (random.unsigned() * count as f32) as usize;
                    set_instance(&mut arrays, i.min(count), &mut random);
                }
            }
            x if x < 0.8 => {
                let kept = arrays.instances[..count / 4].to_vec();
                arrays.instances.replace(&kept);
            }
            _ => {
                for i in count..count + 100 {
                    set_instance(&mut arrays, i, &mut random);
                }
            }
        }
        link(&mut arrays);
        tracer.upload(&mut arrays).unwrap();
        agree(&mut tracer, &arrays, &rays);
    }
}

#[test]
fn memory_follows_the_arrays_down() {
    let Some(mut tracer) = tracer() else { return };
    let mut random = Random::new(6);
    let mut arrays = soup(2000, &mut random);
    tracer.upload(&mut arrays).unwrap();
    let before = tracer.memory_bytes();
    let few = arrays.instances[..10].to_vec();
    arrays.instances.replace(&few);
    let few = arrays.triangles[..10 * TRIANGLES_A_LEAF].to_vec();
    arrays.triangles.replace(&few);
    link(&mut arrays);
    tracer.upload(&mut arrays).unwrap();
    assert!(tracer.memory_bytes() < before / 4, "{} of {before}", tracer.memory_bytes());
    agree(&mut tracer, &arrays, &rays(500, &mut random));
}

#[test]
fn an_empty_scene_is_a_scene() {
    let Some(mut tracer) = tracer() else { return };
    let mut random = Random::new(7);
    let rays = rays(100, &mut random);
    let mut arrays = DeviceArrays::default();
    assert_eq!(tracer.upload(&mut arrays).unwrap(), 0);
    assert!(tracer.closest_hits(&arrays, &rays, u32::MAX).unwrap().iter().all(|hit| hit.instance == u32::MAX));
    // An emptied array leaves nothing of its earlier content.
    let mut arrays = soup(5, &mut random);
    tracer.upload(&mut arrays).unwrap();
    arrays.tlas_nodes.replace(&[]);
    arrays.instances.replace(&[]);
    tracer.upload(&mut arrays).unwrap();
    assert!(tracer.any_hits(&arrays, &rays, u32::MAX).unwrap().iter().all(|blocked| !blocked));
}

#[test]
fn an_array_too_large_for_a_buffer_is_named_before_anything_is_written() {
    let Some(mut tracer) = limited(|limits| {
        limits.max_storage_buffer_binding_size = 40_000;
        limits.max_storage_buffers_per_shader_stage = needed_buffers();
    }) else {
        return;
    };
    let mut random = Random::new(8);
    let mut arrays = soup(10, &mut random);
    let all = tracer.upload(&mut arrays).unwrap();
    let before = arrays.triangles.to_vec();
    arrays.instances.write(3, &[arrays.instances[4]]);
    arrays.triangles.write(900, &[arrays.triangles[0]]);
    let error = tracer.upload(&mut arrays).unwrap_err();
    let Error::Limit { resource, needed, limit } = error else { panic!("{error}") };
    assert_eq!((resource, needed, limit), (Resource::GpuArray("triangles"), 901 * 48, 40_000));
    // The failed upload copied nothing, and the next one copies all changes.
    arrays.triangles.replace(&before);
    let copied = tracer.upload(&mut arrays).unwrap();
    assert!(copied >= size_of::<InstanceRecord>() as u64 && copied < all, "{copied}");
    agree(&mut tracer, &arrays, &rays(300, &mut random));
}

#[test]
fn large_arrays_lie_in_several_bindings_and_rays_hit_the_same() {
    // 25 instances of four triangles fit; then parts of 64 nodes and 64 triangles.
    let Some(mut tracer) = limited(|limits| limits.max_storage_buffer_binding_size = 4800) else { return };
    let mut random = Random::new(11);
    let mut arrays = soup(25, &mut random);
    tracer.upload(&mut arrays).unwrap();
    let rays = rays(2000, &mut random);
    agree(&mut tracer, &arrays, &rays);
    let pipelines = tracer.pipeline_count();

    // The arrays grow beyond the limit of one part, back and forth across it, and shrink again.
    for count in [26, 36, 16, 17, 32, 33, 37, 20, 37] {
        grow(&mut arrays, count, &mut random);
        tracer.upload(&mut arrays).unwrap();
        agree(&mut tracer, &arrays, &rays);
        // Changed ranges that cross the border between two parts.
        for i in [15, 16, count - 1] {
            set_instance(&mut arrays, i, &mut random);
        }
        link(&mut arrays);
        tracer.upload(&mut arrays).unwrap();
        agree(&mut tracer, &arrays, &rays);
        assert_eq!(tracer.upload(&mut arrays).unwrap(), 0);
    }
    assert!(tracer.pipeline_count() > pipelines, "whole arrays are read by a kernel of their own");
    tracer.render(&arrays, &super::frame::request(64, 48, true)).unwrap();
    let mut emulated = Emulated::default();
    emulated.render(&arrays, &super::frame::request(64, 48, true)).unwrap();
    let (found, expected) = (tracer.read_image().unwrap().aovs.unwrap(), emulated.read_image().unwrap().aovs.unwrap());
    assert_eq!((found.node, found.triangle), (expected.node, expected.triangle));
}

#[test]
fn what_the_bindings_cannot_hold_is_refused_with_what_they_can() {
    let Some(mut tracer) = limited(|limits| {
        limits.max_storage_buffer_binding_size = 4800;
        limits.max_storage_buffers_per_shader_stage = needed_buffers() + 2;
    }) else {
        return;
    };
    let mut random = Random::new(12);
    let mut arrays = soup(37, &mut random);
    tracer.upload(&mut arrays).unwrap();
    agree(&mut tracer, &arrays, &rays(1000, &mut random));
    arrays.triangles.write(192, &[arrays.triangles[0]]);
    let error = tracer.upload(&mut arrays).unwrap_err();
    let Error::Limit { resource, needed, limit } = error else { panic!("{error}") };
    assert_eq!((resource, needed, limit), (Resource::GpuArray("triangles"), 193 * 48, 3 * 64 * 48));
}

#[test]
fn tracing_before_any_upload_is_an_error() {
    let Some(mut tracer) = tracer() else { return };
    let arrays = DeviceArrays::default();
    let error = tracer.closest_hits(&arrays, &[], 1).unwrap_err();
    assert!(error.to_string().contains("no scene was uploaded"), "{error}");
    assert!(tracer.render(&arrays, &super::frame::request(4, 4, false)).is_err());
}

#[test]
fn arrays_of_many_megabytes_arrive_whole() {
    let Some(mut tracer) = tracer() else { return };
    let mut random = Random::new(9);
    let mut arrays = soup(3, &mut random);
    // The triangles that are hit lie beyond the first 64 MiB, which are written in parts.
    let far = 1_500_000;
    let triangles = arrays.triangles.to_vec();
    arrays.triangles.write(far, &triangles);
    let moved = |i: &InstanceRecord| InstanceRecord { first_triangle: i.first_triangle + far as u32, ..*i };
    let instances: Vec<_> = arrays.instances.iter().map(moved).collect();
    arrays.instances.replace(&instances);
    assert!(tracer.upload(&mut arrays).unwrap() > 64 << 20);
    agree(&mut tracer, &arrays, &rays(1000, &mut random));
}

/// The storage buffers that the kernel needs where no array is split.
fn needed_buffers() -> u32 {
    15
}

/// Adds or removes instances until there are `count`.
fn grow(arrays: &mut DeviceArrays, count: usize, random: &mut Random) {
    let old = arrays.instances.len();
    for i in old..count {
        set_instance(arrays, i, random);
    }
    arrays.instances.truncate(count);
    arrays.blas_nodes.truncate(count);
    arrays.triangles.truncate(count * TRIANGLES_A_LEAF);
    link(arrays);
}

/// Compares the hits of `rays` by triangle with those of an executor that reads `arrays` in place.
fn agree(tracer: &mut GpuTracer, arrays: &DeviceArrays, rays: &[RayRecord]) {
    let found = tracer.closest_hits(arrays, rays, u32::MAX).unwrap();
    let expected = Emulated::default().closest_hits(arrays, rays, u32::MAX).unwrap();
    assert_eq!(found.len(), expected.len());
    let mut hits = 0;
    for (found, expected) in found.iter().zip(&expected) {
        assert_eq!((found.instance, found.primitive), (expected.instance, expected.primitive));
        hits += usize::from(expected.instance != u32::MAX);
    }
    assert!(hits > 0, "no ray hit anything");
}
