//! Rays and hits in buffers that the application owns.

use ropewalk::Error;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{HitRecord, RayRecord};
use ropewalk::trace::Tracer as _;
use ropewalk::trace::gpu::{GpuTracer, RayBuffers};
use wgpu::BufferUsages;
use wgpu::util::DeviceExt as _;

use super::device::limited;
use super::soup::{rays, soup};
use ropewalk_testkit::Random;
use ropewalk_testkit::gpu::tracer;

/// The hits of `rays`, traced from a buffer into a buffer.
fn resident<T: bytemuck::Pod>(tracer: &mut GpuTracer, rays: &[RayRecord], ray_mask: u32, closest: bool) -> Vec<T> {
    let (device, queue) = (tracer.wgpu_device().clone(), tracer.wgpu_queue().clone());
    let contents = bytemuck::cast_slice(rays);
    let usage = BufferUsages::STORAGE;
    let rays_buffer = device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents, usage });
    let size = size_of_val(rays) as u64 / size_of::<RayRecord>() as u64 * size_of::<T>() as u64;
    let buffer =
        |usage| device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false });
    let answers = buffer(BufferUsages::STORAGE | BufferUsages::COPY_SRC);
    let staging = buffer(BufferUsages::COPY_DST | BufferUsages::MAP_READ);
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let buffers = RayBuffers::new(&rays_buffer, &answers, rays.len() as u32).with_ray_mask(ray_mask);
    match closest {
        true => tracer.record_closest_hits(&mut encoder, &buffers).unwrap(),
        false => tracer.record_any_hits(&mut encoder, &buffers).unwrap(),
    }
    encoder.copy_buffer_to_buffer(&answers, 0, &staging, 0, size);
    queue.submit([encoder.finish()]);
    staging.slice(..).map_async(wgpu::MapMode::Read, |result| result.unwrap());
    device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    let view = staging.slice(..).get_mapped_range().unwrap();
    bytemuck::pod_collect_to_vec(&view)
}

fn same(mut tracer: GpuTracer, mut arrays: DeviceArrays, rays: &[RayRecord]) {
    tracer.upload(&mut arrays).unwrap();
    for ray_mask in [u32::MAX, 2] {
        let expected = tracer.closest_hits(&arrays, rays, ray_mask).unwrap();
        assert!(expected.iter().any(|hit| hit.instance != u32::MAX));
        assert_eq!(resident::<HitRecord>(&mut tracer, rays, ray_mask, true), expected);
        let expected = tracer.any_hits(&arrays, rays, ray_mask).unwrap();
        let found = resident::<u32>(&mut tracer, rays, ray_mask, false);
        assert_eq!(found.iter().map(|&answer| answer != 0).collect::<Vec<_>>(), expected);
    }
}

#[test]
fn rays_that_stay_on_the_gpu_hit_the_same() {
    let Some(tracer) = tracer() else { return };
    let mut random = Random::new(1);
    let arrays = soup(20, &mut random);
    // More rays than one dispatch takes.
    same(tracer, arrays, &rays(300_001, &mut random));
}

#[test]
fn and_so_they_do_where_the_scene_is_split() {
    let Some(tracer) = limited(|limits| limits.max_storage_buffer_binding_size = 4800) else { return };
    let mut random = Random::new(2);
    let arrays = soup(37, &mut random);
    same(tracer, arrays, &rays(150, &mut random));
}

#[test]
fn buffers_that_do_not_do_are_refused() {
    let Some(mut tracer) = tracer() else { return };
    let mut arrays = soup(2, &mut Random::new(3));
    let device = tracer.wgpu_device().clone();
    let buffer = |size, usage| {
        device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false })
    };
    let [good, small] = [320, 319 / 4 * 4].map(|size| buffer(size, BufferUsages::STORAGE));
    let copies = buffer(320, BufferUsages::COPY_DST);
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let mut refusal = |tracer: &mut GpuTracer, rays, answers, count| {
        tracer.record_closest_hits(&mut encoder, &RayBuffers::new(rays, answers, count).with_ray_mask(1)).err()
    };
    assert!(matches!(refusal(&mut tracer, &good, &good, 1), Some(Error::Gpu { .. })), "nothing was uploaded");
    tracer.upload(&mut arrays).unwrap();
    let too_small = |error| matches!(error, Some(Error::Limit { needed: 320, limit: 316, .. }));
    assert!(too_small(refusal(&mut tracer, &small, &good, 10)) && too_small(refusal(&mut tracer, &good, &small, 10)));
    let huge = refusal(&mut tracer, &good, &good, u32::MAX);
    assert!(matches!(huge, Some(Error::Limit { needed: 137_438_953_440, .. })), "{huge:?}");
    assert!(matches!(refusal(&mut tracer, &copies, &good, 10), Some(Error::OutOfRange { .. })));
    assert!(refusal(&mut tracer, &good, &good, 0).is_none());
}
