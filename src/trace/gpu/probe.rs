//! Whether a driver runs long loops to their end: twin of `shaders/probe.wgsl`, which says why some do not.

use bytemuck::{Pod, Zeroable};
use wgpu::BufferUsages;
use wgpu::util::DeviceExt;

use super::context::Context;
use crate::{Error, Result};

/// How often an invocation goes round its loops: `outer * inner` nested turns, then `after`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct LoopCounts {
    outer: u32,
    inner: u32,
    after: u32,
    _pad: u32,
}

/// What an invocation counted, and a value that every turn changes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
struct Outcome {
    iterations: u32,
    value: u32,
}

/// One loop, nested loops, loops in sequence: each beyond 65,535 turns in all, none but the first in one loop.
const PLAN: [LoopCounts; 3] = [
    LoopCounts { outer: 1, inner: 100_000, after: 0, _pad: 0 },
    LoopCounts { outer: 300, inner: 300, after: 0, _pad: 0 },
    LoopCounts { outer: 1, inner: 50_000, after: 50_000, _pad: 0 },
];

const DURING: &str = "the start-up probe";

/// Refuses a device that ends loops early. A few milliseconds.
pub(super) fn check_loops(context: &Context) -> Result<()> {
    let outcomes = context.with_error_scopes(DURING, || run(context))?;
    check_outcomes(&outcomes).map_err(|why| Error::NoGpu { reason: format!("{}: {why}", context.info.name) })
}

fn run(context: &Context) -> Result<Vec<Outcome>> {
    let Context { device, .. } = context;
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
    let turns = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some("probe turns"),
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
            wgpu::BindGroupEntry { binding: 0, resource: turns.as_entire_binding() },
            wgpu::BindGroupEntry { binding: 1, resource: outcomes.as_entire_binding() },
        ],
    });
    context.submit(DURING, |encoder| {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.dispatch_workgroups(PLAN.len() as u32, 1, 1);
        drop(pass);
        encoder.copy_buffer_to_buffer(&outcomes, 0, &staging, 0, size);
    })?;
    context.read(DURING, &staging, size, bytemuck::pod_collect_to_vec)
}

/// What is wrong with the driver that gave `outcomes`.
fn check_outcomes(outcomes: &[Outcome]) -> Result<(), String> {
    let expected: Vec<Outcome> =
        PLAN.iter().enumerate().map(|(i, turns)| run_loops(*turns, i as u32, u32::MAX)).collect();
    match expected.iter().zip(outcomes).find(|(expected, outcome)| outcome.iterations < expected.iterations) {
        Some((expected, outcome)) => Err(format!(
            "the driver ends shader loops after {} of {} turns without an error, so images would be wrong; upgrade it \
             (Mesa 22.3 does this, 25.0 does not)",
            outcome.iterations, expected.iterations
        )),
        None if expected != outcomes => {
            Err("the driver computes wrong integers in long shader loops; upgrade it".into())
        }
        None => Ok(()),
    }
}

/// What invocation `index` leaves on a driver that ends its loops after `cap` turns in all.
fn run_loops(planned: LoopCounts, index: u32, cap: u32) -> Outcome {
    let turns = (planned.outer * planned.inner + planned.after).min(cap);
    let value = (0..turns).fold(index, |value, _| value.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    Outcome { iterations: turns, value }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcomes(cap: u32) -> Vec<Outcome> {
        PLAN.iter().enumerate().map(|(i, turns)| run_loops(*turns, i as u32, cap)).collect()
    }

    #[test]
    fn loops_that_end_as_written_pass() {
        assert_eq!(check_outcomes(&outcomes(u32::MAX)), Ok(()));
    }

    #[test]
    fn loops_cut_short_are_refused_with_the_reason() {
        let reason = check_outcomes(&outcomes(65_535)).unwrap_err();
        assert!(reason.contains("after 65535 of 100000 turns") && reason.contains("upgrade"), "{reason}");
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
