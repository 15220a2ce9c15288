//! Cache of the kernel's compute pipelines: one per entry point and variant, created on first use.

use std::collections::HashMap;

use super::context::Context;
use crate::Result;
use crate::trace::shader::{EntryPoint, KernelVariant};

/// The pipelines created so far, and the bind group layouts that they share.
#[derive(Debug)]
pub(super) struct Pipelines {
    pipelines: HashMap<(EntryPoint, KernelVariant), wgpu::ComputePipeline>,
    frame: wgpu::BindGroupLayout,
    batch: wgpu::BindGroupLayout,
}

impl Pipelines {
    /// `frame` and `batch` are the layouts of group 1 of the entry points that render and of the entry points of ray
    /// batches.
    pub(super) fn new(frame: wgpu::BindGroupLayout, batch: wgpu::BindGroupLayout) -> Self {
        Self { pipelines: HashMap::new(), frame, batch }
    }

    /// Layout of group 1 of the entry points that render.
    pub(super) fn frame_layout(&self) -> &wgpu::BindGroupLayout {
        &self.frame
    }

    /// Layout of group 1 of the entry points of ray batches.
    pub(super) fn batch_layout(&self) -> &wgpu::BindGroupLayout {
        &self.batch
    }

    /// Number of compiled pipelines.
    pub(super) fn len(&self) -> usize {
        self.pipelines.len()
    }

    /// The pipeline of a variant, and whether it is new: drivers may compile a shader only when it is first dispatched.
    /// `scene` is the layout of group 0.
    pub(super) fn pipeline(
        &mut self,
        context: &Context,
        scene: &wgpu::BindGroupLayout,
        entry_point: EntryPoint,
        variant: KernelVariant,
    ) -> Result<(wgpu::ComputePipeline, bool)> {
        // Reuse a pipeline that was compiled before.
        if let Some(pipeline) = self.pipelines.get(&(entry_point, variant)) {
            return Ok((pipeline.clone(), false));
        }
        // Choose the layout of group 1 by the kind of entry point.
        let own_group = match entry_point {
            EntryPoint::Render | EntryPoint::RenderAovs => &self.frame,
            EntryPoint::ClosestHits | EntryPoint::AnyHits => &self.batch,
        };
        // Compile the variant, and keep it.
        let pipeline = context.with_error_scopes("compiling the kernel", || {
            Ok(compile(context, [Some(scene), Some(own_group)], entry_point, variant))
        })?;
        self.pipelines.insert((entry_point, variant), pipeline.clone());
        Ok((pipeline, true))
    }
}

fn compile(
    context: &Context,
    groups: [Option<&wgpu::BindGroupLayout>; 2],
    entry_point: EntryPoint,
    variant: KernelVariant,
) -> wgpu::ComputePipeline {
    let name = entry_point.name();
    // Create the module from the variant's source.
    let module = context.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(name),
        source: wgpu::ShaderSource::Wgsl(entry_point.source(variant).into()),
    });
    // Group 0 is the scene, group 1 the entry point's own.
    let layout = context.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(name),
        bind_group_layouts: &groups,
        immediate_size: 0,
    });
    context.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(name),
        layout: Some(&layout),
        module: &module,
        entry_point: Some(name),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    })
}
