//! The executor `gpu`, timed by its own clock and by the wall clock.

use std::cell::RefCell;
use std::time::Duration;

use bytemuck::Pod;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{HitRecord, NONE, RayRecord};
use ropewalk::trace::gpu::{AdapterKinds, GpuOptions, GpuTracer, RayBuffers};
use ropewalk::trace::{Tracer as _, Traversal};
use serde_json::{Value, json};
use wgpu::{BufferUsages, ComputePassDescriptor, ComputePassTimestampWrites, DeviceType};

use crate::rays::{RayKind, any_answer, closest_answer};
use crate::runner::Runner;
use crate::{Options, Result, time};

/// The best GPU there is. A software renderer only where the options ask for it.
///
/// # Errors
/// There is none.
pub fn open(options: &Options) -> Result<GpuTracer> {
    Ok(open_among(if options.software { AdapterKinds::IncludingSoftware } else { AdapterKinds::Hardware })?)
}

fn open_among(adapters: AdapterKinds) -> ropewalk::Result<GpuTracer> {
    GpuTracer::new(&GpuOptions::default().with_adapters(adapters))
}

/// What tables call its executor: "gpu", or "software renderer".
pub fn label(tracer: &GpuTracer) -> &'static str {
    if is_software(tracer) { "software renderer" } else { "gpu" }
}

fn is_software(tracer: &GpuTracer) -> bool {
    tracer.wgpu_device().adapter_info().device_type == DeviceType::Cpu
}

/// Name, driver, interface and features of the best adapter, be it a GPU or not; else why there is none.
pub(crate) fn adapter() -> Value {
    let tracer = match open_among(AdapterKinds::IncludingSoftware) {
        Ok(tracer) => tracer,
        Err(error) => return json!({ "error": error.to_string() }),
    };
    let info = tracer.wgpu_device().adapter_info();
    let features: Vec<_> = tracer.wgpu_device().features().iter_names().map(|(name, _)| name).collect();
    json!({
        "name": info.name,
        "type": format!("{:?}", info.device_type),
        "software": is_software(&tracer),
        "backend": info.backend.to_str(),
        "driver": info.driver,
        "driver_info": info.driver_info,
        "features": features,
    })
}

/// A GPU with a scene uploaded.
pub struct Gpu(RefCell<GpuTracer>);

impl Gpu {
    /// On the adapter that [`open`] takes.
    ///
    /// # Errors
    /// There is none, or the scene is too large for it.
    pub fn new(options: &Options, arrays: &mut DeviceArrays, traversal: Traversal) -> Result<Self> {
        let mut tracer = open(options)?.with_traversal(traversal);
        tracer.upload(arrays)?;
        Ok(Self(RefCell::new(tracer)))
    }

    /// See [`label`].
    pub fn label(&self) -> &'static str {
        label(&self.0.borrow())
    }

    /// Its name and driver.
    pub fn name(&self) -> String {
        self.0.borrow().device().name.clone()
    }

    /// Rays and hits stay on the GPU; the time is the GPU's own. `None` if it has no clock.
    pub fn resident<'a>(&'a self, rays: &[RayRecord], kind: RayKind) -> Option<Resident<'a>> {
        let tracer = self.0.borrow();
        let (device, queue) = (tracer.wgpu_device(), tracer.wgpu_queue());
        if !device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return None;
        }
        let buffer = |size: usize, usage| {
            let size = size as u64;
            device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false })
        };
        let answers_size = rays.len() * if kind.is_any_hit() { size_of::<u32>() } else { size_of::<HitRecord>() };
        let resident = Resident {
            tracer: &self.0,
            kind,
            count: rays.len() as u32,
            rays: buffer(size_of_val(rays), BufferUsages::STORAGE | BufferUsages::COPY_DST),
            answers: buffer(answers_size, BufferUsages::STORAGE | BufferUsages::COPY_SRC),
            queries: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: None,
                ty: wgpu::QueryType::Timestamp,
                count: 2,
            }),
            ticks: buffer(2 * size_of::<u64>(), BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC),
        };
        queue.write_buffer(&resident.rays, 0, bytemuck::cast_slice(rays));
        Some(resident)
    }

    /// As an application calls it: rays are copied to the GPU and hits are read back. Timed by the wall clock.
    pub fn transferred<'a>(
        &'a self,
        arrays: &'a DeviceArrays,
        rays: &'a [RayRecord],
        kind: RayKind,
    ) -> Transferred<'a> {
        Transferred { tracer: &self.0, arrays, rays, kind, answers: Vec::new() }
    }
}

/// See [`Gpu::resident`].
pub struct Resident<'a> {
    tracer: &'a RefCell<GpuTracer>,
    kind: RayKind,
    count: u32,
    rays: wgpu::Buffer,
    answers: wgpu::Buffer,
    queries: wgpu::QuerySet,
    ticks: wgpu::Buffer,
}

impl Resident<'_> {
    fn trace(&self) -> Result<Duration> {
        let mut tracer = self.tracer.borrow_mut();
        let mut encoder = tracer.wgpu_device().create_command_encoder(&Default::default());
        let buffers = RayBuffers::new(&self.rays, &self.answers, self.count).with_ray_mask(NONE);
        self.stamp(&mut encoder, 0);
        if self.kind.is_any_hit() {
            tracer.record_any_hits(&mut encoder, &buffers)?;
        } else {
            tracer.record_closest_hits(&mut encoder, &buffers)?;
        }
        self.stamp(&mut encoder, 1);
        encoder.resolve_query_set(&self.queries, 0..2, &self.ticks, 0);
        tracer.wgpu_queue().submit([encoder.finish()]);
        let ticks: Vec<u64> = read(&tracer, &self.ticks)?;
        let nanoseconds = (ticks[1] - ticks[0]) as f64 * f64::from(tracer.wgpu_queue().get_timestamp_period());
        Ok(Duration::from_nanos(nanoseconds as u64))
    }

    /// A pass that does nothing but note the time.
    fn stamp(&self, encoder: &mut wgpu::CommandEncoder, index: u32) {
        let writes = ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: (index == 0).then_some(0),
            end_of_pass_write_index: (index == 1).then_some(1),
        };
        encoder.begin_compute_pass(&ComputePassDescriptor { label: None, timestamp_writes: Some(writes) });
    }
}

impl Runner for Resident<'_> {
    fn run(&mut self) -> Duration {
        self.trace().unwrap_or(Duration::MAX)
    }

    fn answers(&self) -> Vec<f32> {
        let tracer = self.tracer.borrow();
        if self.kind.is_any_hit() {
            let hits: Vec<u32> = read(&tracer, &self.answers).unwrap_or_default();
            return hits.into_iter().map(|hit| any_answer(hit != 0)).collect();
        }
        read::<HitRecord>(&tracer, &self.answers).unwrap_or_default().iter().map(closest_answer).collect()
    }
}

/// The whole of a buffer.
fn read<T: Pod>(tracer: &GpuTracer, buffer: &wgpu::Buffer) -> Result<Vec<T>> {
    let device = tracer.wgpu_device();
    let staging = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: buffer.size(),
        usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&Default::default());
    encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, buffer.size());
    tracer.wgpu_queue().submit([encoder.finish()]);
    staging.slice(..).map_async(wgpu::MapMode::Read, |_| {});
    device.poll(wgpu::PollType::wait_indefinitely())?;
    let view = staging.slice(..).get_mapped_range()?;
    Ok(view.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect())
}

/// See [`Gpu::transferred`].
pub struct Transferred<'a> {
    tracer: &'a RefCell<GpuTracer>,
    arrays: &'a DeviceArrays,
    rays: &'a [RayRecord],
    kind: RayKind,
    answers: Vec<f32>,
}

impl Runner for Transferred<'_> {
    fn run(&mut self) -> Duration {
        let mut tracer = self.tracer.borrow_mut();
        if self.kind.is_any_hit() {
            let mut hits = Vec::new();
            let time = time(|| hits = tracer.any_hits(self.arrays, self.rays, NONE).unwrap_or_default());
            self.answers = hits.into_iter().map(any_answer).collect();
            return time;
        }
        let mut hits = Vec::new();
        let time = time(|| hits = tracer.closest_hits(self.arrays, self.rays, NONE).unwrap_or_default());
        self.answers = hits.iter().map(closest_answer).collect();
        time
    }

    fn answers(&self) -> Vec<f32> {
        self.answers.clone()
    }
}
