//! Which devices are accepted, and the errors for those that are not.

use ropewalk::Error;
use ropewalk::error::Resource;
use ropewalk::trace::Tracer as _;
use ropewalk::trace::gpu::{AdapterKinds, GpuOptions, GpuTracer, optional_features, required_limits};

use super::soup::{rays, soup};
use ropewalk_testkit::Random;
use ropewalk_testkit::gpu::{tracer, usable};

#[test]
fn an_adapter_serves() {
    let Some(tracer) = tracer() else { return };
    println!("{}", tracer.device().name);
    assert_eq!(tracer.device().executor, "gpu");
}

#[test]
fn no_adapter_is_an_error() {
    let options =
        GpuOptions::default().with_adapters(AdapterKinds::IncludingSoftware).with_backends(wgpu::Backends::empty());
    let error = GpuTracer::new(&options).unwrap_err();
    assert!(matches!(&error, Error::NoGpu { reason } if reason.contains("no driver")), "{error}");
}

#[test]
fn software_adapters_are_refused_by_name_unless_any_will_do() {
    let Some(tracer) = tracer() else { return };
    if tracer.wgpu_device().adapter_info().device_type != wgpu::DeviceType::Cpu {
        println!("nothing to refuse: {} is hardware", tracer.device().name);
        return;
    }
    let error = GpuTracer::new(&GpuOptions::default()).unwrap_err();
    let Error::NoGpu { reason } = &error else { panic!("{error}") };
    let name = tracer.wgpu_device().adapter_info().name;
    assert!(reason.contains(&name) && reason.contains("software renderer"), "{reason}");
}

#[test]
fn the_application_can_bring_its_own_device() {
    let Some((adapter, _)) = adapter() else { return };
    let (device, queue) = device(&adapter, required_limits(&adapter), optional_features(&adapter));
    let mut tracer = GpuTracer::from_device(device.clone(), queue).unwrap();
    assert_eq!(tracer.wgpu_device(), &device);
    let mut random = Random::new(1);
    let mut arrays = soup(3, &mut random);
    tracer.upload(&mut arrays).unwrap();
    assert_eq!(tracer.closest_hits(&arrays, &rays(100, &mut random), u32::MAX).unwrap().len(), 100);
}

#[test]
fn a_device_with_too_low_limits_is_refused_by_the_limit() {
    let Some((adapter, _)) = adapter() else { return };
    let (device, queue) = device(&adapter, wgpu::Limits::downlevel_defaults(), wgpu::Features::empty());
    let error = GpuTracer::from_device(device, queue).unwrap_err();
    let Error::Limit { resource, needed, limit } = error else { panic!("{error}") };
    assert_eq!((resource, needed, limit), (Resource::StorageBuffers, 15, 4));
}

#[test]
fn no_more_workgroups_are_demanded_than_are_dispatched() {
    // The limits that the largest batch and a texture 8192 texels wide need.
    let enough = |limits: &mut wgpu::Limits| {
        limits.max_texture_dimension_2d = 8192;
        limits.max_compute_workgroups_per_dimension = 4096;
    };
    let Some(mut tracer) = limited(enough) else { return };
    let mut random = Random::new(5);
    let mut arrays = soup(2, &mut random);
    tracer.upload(&mut arrays).unwrap();
    let rays = rays(300_001, &mut random);
    assert_eq!(tracer.any_hits(&arrays, &rays, u32::MAX).unwrap().len(), rays.len());
    tracer.render(&arrays, &super::frame::request(8192, 9, false)).unwrap();
    tracer.render(&arrays, &super::frame::request(9, 8192, false)).unwrap();

    let Some((adapter, _)) = adapter() else { return };
    let limits = wgpu::Limits { max_compute_workgroups_per_dimension: 4095, ..required_limits(&adapter) };
    let (device, queue) = device(&adapter, limits, wgpu::Features::empty());
    let error = GpuTracer::from_device(device, queue).unwrap_err();
    assert!(matches!(error, Error::Limit { needed: 4096, limit: 4095, .. }), "{error}");
}

#[test]
fn works_without_optional_features() {
    let Some((adapter, _)) = adapter() else { return };
    let (device, queue) = device(&adapter, required_limits(&adapter), wgpu::Features::empty());
    let mut tracer = GpuTracer::from_device(device, queue).unwrap();
    let mut arrays = soup(1, &mut Random::new(2));
    tracer.upload(&mut arrays).unwrap();
    tracer.render(&arrays, &super::frame::request(8, 8, false)).unwrap();
    assert_eq!(tracer.trace_time(), None);
    assert_eq!(tracer.read_image().unwrap().color.len(), 64);
}

#[test]
fn a_lost_device_is_an_error_from_every_call() {
    let Some(tracer) = tracer() else { return };
    lose(tracer);
}

#[test]
fn a_lost_device_of_the_application_is_too() {
    let Some((adapter, _)) = adapter() else { return };
    let (device, queue) = device(&adapter, required_limits(&adapter), optional_features(&adapter));
    lose(GpuTracer::from_device(device, queue).unwrap());
}

#[test]
fn an_error_that_nobody_caught_fails_one_call_and_no_more() {
    let Some(mut tracer) = tracer() else { return };
    let mut random = Random::new(4);
    let mut arrays = soup(2, &mut random);
    let (rays, request) = (rays(10, &mut random), super::frame::request(8, 8, false));
    tracer.upload(&mut arrays).unwrap();
    let mistake = wgpu::BufferDescriptor {
        label: Some("the application's mistake"),
        size: 4,
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::MAP_WRITE,
        mapped_at_creation: false,
    };
    drop(tracer.wgpu_device().create_buffer(&mistake));
    let error = tracer.closest_hits(&arrays, &rays, 1).unwrap_err();
    assert!(matches!(&error, Error::Gpu { message, .. } if message.contains("the application's mistake")), "{error}");
    assert_eq!(tracer.closest_hits(&arrays, &rays, 1).unwrap().len(), rays.len());

    drop(tracer.wgpu_device().create_buffer(&mistake));
    assert!(tracer.render(&arrays, &request).is_err());
    tracer.render(&arrays, &request).unwrap();
    assert_eq!(tracer.read_image().unwrap().color.len(), 64);
}

fn lose(mut tracer: GpuTracer) {
    let mut random = Random::new(3);
    let mut arrays = soup(2, &mut random);
    let request = super::frame::request(8, 8, true);
    tracer.upload(&mut arrays).unwrap();
    tracer.render(&arrays, &request).unwrap();
    tracer.wgpu_device().destroy();
    assert_eq!(tracer.trace_time(), None);
    let rays = rays(10, &mut random);
    arrays.instances.write(0, &[arrays.instances[1]]);
    let outcomes = [
        tracer.read_image().err(),
        tracer.render(&arrays, &request).err(),
        tracer.read_image().err(),
        tracer.closest_hits(&arrays, &rays, 1).err(),
        tracer.any_hits(&arrays, &rays, 1).err(),
        tracer.upload(&mut arrays).err(),
    ];
    for (call, outcome) in outcomes.iter().enumerate() {
        assert!(matches!(outcome, Some(Error::DeviceLost { .. })), "call {call}: {outcome:?}");
    }
    assert_eq!(tracer.trace_time(), None);
}

/// An adapter that a tracer can be made for, and that tracer.
pub(crate) fn adapter() -> Option<(wgpu::Adapter, GpuTracer)> {
    let tracer = tracer()?;
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let wanted = tracer.wgpu_device().adapter_info();
    let found = adapters.into_iter().find(|adapter| adapter.get_info() == wanted);
    found.map(|adapter| (adapter, tracer))
}

pub(crate) fn device(
    adapter: &wgpu::Adapter,
    required_limits: wgpu::Limits,
    required_features: wgpu::Features,
) -> (wgpu::Device, wgpu::Queue) {
    let descriptor = wgpu::DeviceDescriptor { required_limits, required_features, ..Default::default() };
    pollster::block_on(adapter.request_device(&descriptor)).unwrap()
}

/// A tracer on a device whose limits were changed by `change`.
pub(crate) fn limited(change: impl FnOnce(&mut wgpu::Limits)) -> Option<GpuTracer> {
    let (adapter, _) = adapter()?;
    let mut limits = required_limits(&adapter);
    change(&mut limits);
    let (device, queue) = device(&adapter, limits, wgpu::Features::empty());
    usable(GpuTracer::from_device(device, queue))
}
