//! The kernel's pipelines: one for each entry point and set of needs, made when first asked for.

use std::collections::HashMap;

use super::context::Context;
use crate::Result;
use crate::compile::Needs;
use crate::trace::shader::EntryPoint;

/// The pipelines made so far.
#[derive(Debug)]
pub(super) struct Pipelines {
    made: HashMap<(EntryPoint, Needs), wgpu::ComputePipeline>,
    frame: wgpu::PipelineLayout,
    batch: wgpu::PipelineLayout,
}

impl Pipelines {
    /// `scene` is group 0 of every entry point; `frame` and `batch` are group 1 of those that write images and of those
    /// that answer rays.
    pub(super) fn new(
        context: &Context,
        scene: &wgpu::BindGroupLayout,
        frame: &wgpu::BindGroupLayout,
        batch: &wgpu::BindGroupLayout,
    ) -> Self {
        let layout = |label, own| {
            context.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(label),
                bind_group_layouts: &[Some(scene), Some(own)],
                immediate_size: 0,
            })
        };
        Self { made: HashMap::new(), frame: layout("frame", frame), batch: layout("batch", batch) }
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.made.len()
    }

    /// The pipeline, and whether it is new: drivers compile a shader when it is first dispatched.
    pub(super) fn pipeline(
        &mut self,
        context: &Context,
        entry_point: EntryPoint,
        needs: Needs,
    ) -> Result<(wgpu::ComputePipeline, bool)> {
        if let Some(pipeline) = self.made.get(&(entry_point, needs)) {
            return Ok((pipeline.clone(), false));
        }
        let layout = match entry_point {
            EntryPoint::Render | EntryPoint::RenderAovs => &self.frame,
            EntryPoint::ClosestHits | EntryPoint::AnyHits => &self.batch,
        };
        let pipeline = context.scoped("compiling the kernel", || Ok(compile(context, layout, entry_point, needs)))?;
        self.made.insert((entry_point, needs), pipeline.clone());
        Ok((pipeline, true))
    }
}

fn compile(
    context: &Context,
    layout: &wgpu::PipelineLayout,
    entry_point: EntryPoint,
    needs: Needs,
) -> wgpu::ComputePipeline {
    let name = entry_point.name();
    let module = context.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(name),
        source: wgpu::ShaderSource::Wgsl(entry_point.source(needs).into()),
    });
    context.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(name),
        layout: Some(layout),
        module: &module,
        entry_point: Some(name),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    })
}
