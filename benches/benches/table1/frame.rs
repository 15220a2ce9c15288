//! The executors that trace a frame, and the clocks that time it.

use std::time::Duration;

use rayon::ThreadPool;
use ropewalk::device::DeviceArrays;
use ropewalk::trace::{Cpu, Emulated, FrameCounts, FrameRequest, Recursive, Tracer, Traversal, TraversalCounts};
#[cfg(feature = "gpu")]
use ropewalk_bench::gpu;
use ropewalk_bench::scenes::BenchScene;
use ropewalk_bench::{Options, Result, time};

use crate::PaperColumn;

/// An executor of the table.
pub struct Executor<'a> {
    pub name: String,
    pub paper_column: Option<PaperColumn>,
    /// Whether it traces the paper's arrays instead of the shipped ones.
    pub is_paper: bool,
    /// Its traversal, if the kernel can count it.
    pub traversal: Option<Traversal>,
    tracer: Box<dyn Tracer + Send>,
    pool: &'a ThreadPool,
    clock: Clock,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Clock {
    /// The wall clock, until the frame is traced.
    Call,
    /// The GPU's own clock.
    #[cfg(feature = "gpu")]
    Gpu,
    /// The wall clock, until the image is in main memory.
    #[cfg(feature = "gpu")]
    ReadBack,
}

impl Clock {
    /// The time of a frame, given how long the call took.
    #[cfg_attr(not(feature = "gpu"), expect(unused_variables, reason = "for the GPU"))]
    fn read(self, call: Duration, tracer: &dyn Tracer) -> Option<Duration> {
        match self {
            Self::Call => Some(call),
            #[cfg(feature = "gpu")]
            Self::Gpu => tracer.trace_time(),
            #[cfg(feature = "gpu")]
            Self::ReadBack => {
                let mut is_read = false;
                let read = time(|| is_read = tracer.read_image().is_ok());
                is_read.then_some(call + read)
            }
        }
    }
}

impl Executor<'_> {
    /// Traces the frame once. Returns the greatest duration if that fails.
    pub fn trace(&mut self, arrays: &DeviceArrays, request: &FrameRequest) -> Duration {
        let Self { tracer, pool, clock, .. } = self;
        let traced = pool.install(|| {
            let mut result = Ok(());
            let call = time(|| result = tracer.render(arrays, request));
            result.ok()?;
            clock.read(call, &**tracer)
        });
        traced.unwrap_or(Duration::MAX)
    }

    /// The colours of the last frame.
    pub fn image(&self) -> Result<Vec<[f32; 4]>> {
        Ok(self.tracer.read_image()?.color)
    }
}

/// The counts of the frame for each executor. `cpu` (packets) and recursion have no counts, but trace the same rays.
pub fn counts<'a>(
    executors: &[Executor<'_>],
    request: &FrameRequest,
    arrays: impl Fn(&Executor<'_>) -> &'a DeviceArrays,
) -> Vec<FrameCounts> {
    let traversal = |executor: &Executor| Some((executor.traversal?, executor.is_paper));
    let mut counted: Vec<((Traversal, bool), FrameCounts)> = Vec::new();
    for executor in executors {
        let Some(traversal) = traversal(executor) else { continue };
        if counted.iter().all(|(other, _)| *other != traversal) {
            counted.push((
                traversal,
                Emulated::default().with_traversal(traversal.0).count_frame(arrays(executor), request),
            ));
        }
    }
    let mut rays = counted.first().map_or(FrameCounts::default(), |(_, counts)| *counts);
    rays.cost = TraversalCounts::default();
    let of = |executor: &Executor| counted.iter().find(|(other, _)| Some(*other) == traversal(executor));
    executors.iter().map(|executor| of(executor).map_or(rays, |(_, counts)| *counts)).collect()
}

/// All executors, those of the paper first. Prints a message if there is no GPU.
pub fn executors<'a>(
    scene: &mut BenchScene,
    paper: &mut DeviceArrays,
    #[cfg_attr(not(feature = "gpu"), expect(unused_variables, reason = "for the GPU"))] options: &Options,
    [one, all]: &'a [ThreadPool; 2],
) -> Result<Vec<Executor<'a>>> {
    let new = |name: &str, tracer: Box<dyn Tracer + Send>, pool| Executor {
        name: name.to_owned(),
        paper_column: None,
        is_paper: false,
        traversal: None,
        tracer,
        pool,
        clock: Clock::Call,
    };
    let emulated = |traversal| Box::new(Emulated::default().with_traversal(traversal));
    let mut executors = vec![
        Executor {
            paper_column: Some(PaperColumn::Recursive),
            is_paper: true,
            ..new("recursive, paper's structure", Box::<Recursive>::default(), one)
        },
        Executor {
            paper_column: Some(PaperColumn::Emulated),
            is_paper: true,
            traversal: Some(Traversal::Rope),
            ..new("emulated, paper's structure, rope", emulated(Traversal::Rope), one)
        },
        Executor { traversal: Some(Traversal::Rope), ..new("emulated, rope", emulated(Traversal::Rope), one) },
        Executor { traversal: Some(Traversal::Wide), ..new("emulated, wide", emulated(Traversal::Wide), one) },
        new("cpu, 1 thread", Box::<Cpu>::default(), one),
        new(&format!("cpu, {} threads", all.current_num_threads()), Box::<Cpu>::default(), all),
    ];
    for executor in &mut executors {
        executor.tracer.upload(if executor.is_paper { &mut *paper } else { scene.compiler.arrays_mut() })?;
    }
    #[cfg(feature = "gpu")]
    match gpus(scene, paper, options, all) {
        Ok(gpus) => executors.extend(gpus),
        Err(error) => println!("{}: gpu: skipped: {error}", scene.name),
    }
    Ok(executors)
}

/// The GPU by each traversal: the time that it says itself and, for the shipped one, until a user has the image.
#[cfg(feature = "gpu")]
fn gpus<'a>(
    scene: &mut BenchScene,
    paper: &mut DeviceArrays,
    options: &Options,
    pool: &'a ThreadPool,
) -> Result<Vec<Executor<'a>>> {
    let entries = [
        (", paper's structure, rope", Traversal::Rope, true, Clock::Gpu),
        (", wide", Traversal::Wide, false, Clock::Gpu),
        (", wide, until read back", Traversal::Wide, false, Clock::ReadBack),
    ];
    let mut executors = Vec::new();
    for (how, traversal, is_paper, clock) in entries {
        let mut tracer = gpu::open(options)?.with_traversal(traversal);
        tracer.upload(if is_paper { &mut *paper } else { scene.compiler.arrays_mut() })?;
        let features = tracer.wgpu_device().features();
        if clock == Clock::Gpu && !features.contains(wgpu::Features::TIMESTAMP_QUERY) {
            println!("{}: {}{how}: skipped: it has no clock", scene.name, gpu::label(&tracer));
            continue;
        }
        executors.push(Executor {
            name: format!("{}{how}", gpu::label(&tracer)),
            paper_column: (gpu::label(&tracer) == "gpu").then_some(PaperColumn::Gpu),
            is_paper,
            traversal: Some(traversal),
            tracer: Box::new(tracer),
            pool,
            clock,
        });
    }
    Ok(executors)
}
