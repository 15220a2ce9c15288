//! Start-up test for drivers that silently stop long shader loops (llvmpipe of Mesa 22 after 65,535 iterations). Twin
//! of `shaders/probe.wgsl`.

use bytemuck::{Pod, Zeroable};
use wgpu::BufferUsages;
use wgpu::util::DeviceExt;

use super::context::Context;
use crate::{Error, Result};

/// Loop trip counts of an invocation: `outer * inner` nested iterations, then `after` in a second loop.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct LoopCounts {
    outer: u32,
    inner: u32,
    after: u32,
    _pad: u32,
}

/// Iterations counted, and a value that depends on each.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
struct Outcome {
    iterations: u32,
    value: u32,
}

/// Three loop shapes (one loop, nested loops, loops in sequence), each over 65,535 iterations in total; only the first
/// in a single loop.
const PLAN: [LoopCounts; 3] = [
    LoopCounts { outer: 1, inner: 100_000, after: 0, _pad: 0 },
    LoopCounts { outer: 300, inner: 300, after: 0, _pad: 0 },
    LoopCounts { outer: 1, inner: 50_000, after: 50_000, _pad: 0 },
];

/// Operation named in errors.
const OPERATION: &str = "the start-up probe";

/// Runs the test; [`Error::NoGpu`] if the device ends loops early. Takes a few milliseconds.
pub(super) fn check_loops(context: &Context) -> Result<()> {
    let outcomes = context.with_error_scopes(OPERATION, || run(context))?;
    check_outcomes(&outcomes).map_err(|why| Error::NoGpu { reason: format!("{}: {why}", context.info.name) })
}

/// Dispatches the planned loops and reads back their outcomes.
fn run(context: &Context) -> Result<Vec<Outcome>> {
    let Context { device, .. } = context;
    // Compile the probe.
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("probe"),
        source: wgpu::ShaderSource::Wgsl(include_str!("../../../shaders/probe.wgsl").into()),
    });
    let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("probe"),
        layout: None,
        module: &module,
        entry_point: Some("probe"),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    });
    // Upload the loop counts, and make room for the outcomes.
    let loop_counts = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some("probe loops"),
        contents: bytemuck::cast_slice(&PLAN),
        usage: BufferUsages::STORAGE,
    });
    let size = size_of::<[Outcome; PLAN.len()]>() as u64;
    let outcomes = context.buffer("probe outcomes", size, BufferUsages::STORAGE | BufferUsages::COPY_SRC);
    let staging = context.staging(size);
    let bind_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("probe"),
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: loop_counts.as_entire_binding() },
            wgpu::BindGroupEntry { binding: 1, resource: outcomes.as_entire_binding() },
        ],
    });
    // Run one workgroup per loop shape, and read the outcomes back.
    context.submit(OPERATION, |encoder| {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.dispatch_workgroups(PLAN.len() as u32, 1, 1);
        drop(pass);
        encoder.copy_buffer_to_buffer(&outcomes, 0, &staging, 0, size);
    })?;
    context.read(OPERATION, &staging, size, bytemuck::pod_collect_to_vec)
}

/// Compares outcomes with the expected ones; the error says what the driver does wrong.
fn check_outcomes(outcomes: &[Outcome]) -> Result<(), String> {
    let expected: Vec<Outcome> =
        PLAN.iter().enumerate().map(|(i, counts)| run_loops(*counts, i as u32, u32::MAX)).collect();
    match expected.iter().zip(outcomes).find(|(expected, outcome)| outcome.iterations < expected.iterations) {
        Some((expected, outcome)) => Err(format!(
            "the driver ends shader loops after {} of {} iterations without an error, so images would be wrong; \
             upgrade it (Mesa 22.3 does this, 25.0 does not)",
            outcome.iterations, expected.iterations
        )),
        None if expected != outcomes => {
            Err("the driver computes wrong integers in long shader loops; upgrade it".into())
        }
        None => Ok(()),
    }
}

/// Expected outcome of invocation `index` if loops end after `cap` iterations.
fn run_loops(counts: LoopCounts, index: u32, cap: u32) -> Outcome {
    let iterations = (counts.outer * counts.inner + counts.after).min(cap);
    let value = (0..iterations).fold(index, |value, _| value.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    Outcome { iterations, value }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcomes(cap: u32) -> Vec<Outcome> {
        PLAN.iter().enumerate().map(|(i, counts)| run_loops(*counts, i as u32, cap)).collect()
    }

    #[test]
    fn loops_that_end_as_written_pass() {
        assert_eq!(check_outcomes(&outcomes(u32::MAX)), Ok(()));
    }

    #[test]
    fn loops_that_end_early_are_refused_with_the_reason() {
        let reason = check_outcomes(&outcomes(65_535)).unwrap_err();
        assert!(reason.contains("after 65535 of 100000 iterations") && reason.contains("upgrade"), "{reason}");
    }

    #[test]
    fn each_kind_of_loop_is_refused_on_its_own() {
        for capped in 0..PLAN.len() {
            let mut outcomes = outcomes(u32::MAX);
            outcomes[capped] = run_loops(PLAN[capped], capped as u32, 65_535);
            assert!(check_outcomes(&outcomes).is_err(), "{:?}", PLAN[capped]);
        }
    }

    #[test]
    fn wrong_values_are_refused() {
        let mut outcomes = outcomes(u32::MAX);
        outcomes[1].value ^= 1;
        assert!(check_outcomes(&outcomes).is_err());
        assert!(check_outcomes(&[]).is_err());
    }
}
