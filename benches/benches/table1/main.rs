//! The paper's Table I: its three scenes, reflective and refractive, three levels deep, and its three claims.
//!
//! Time is that of tracing one frame of an unchanged scene. Sphere, bunny and dragon fill about the same part of the
//! image, and a quarter of that from twice the distance. The renderer has no soft shadows yet: with shadows, one ray
//! goes from each hit to one point light. Emulated and recursive run on one thread; both traverse the paper's own
//! structure, one triangle a leaf, and emulated the shipped one too.

mod claims;
mod frame;

use std::fmt;
use std::process::ExitCode;

use clap::Parser;
use glam::Vec3;
use rayon::ThreadPool;
use ropewalk::trace::{FrameCounts, FrameRequest};
use ropewalk::{Light, Material, Transform};
use ropewalk_bench::layouts::paper_arrays;
use ropewalk_bench::scenes::{BenchScene, ImageSize, Recipe, SCENES};
use ropewalk_bench::{Contender, Options, Report, Result, finish, medians, thread_pool};

use claims::Walks;
use frame::Executor;

/// The paper's scenes and its seconds a frame: CUDA, OpenCL, CPU (pointers and recursion), Emulated (arrays, one
/// thread). A GTX 280 and a Core 2 Quad at 2.5 GHz, 2010; soft shadows from precomputed transfer, without rays.
const PAPER: [(&str, [f64; 4]); 3] = [
    ("sphere", [0.105, 0.33, 17.9, 1.93]),
    ("bunny", [0.187, 0.515, 5.115, 2.01]),
    ("dragon", [0.41, 1.49, 13.25, 4.46]),
];
/// An executor of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PaperColumn {
    /// CUDA and OpenCL.
    Gpu,
    /// Pointers and recursion.
    Recursive,
    /// Arrays, one thread.
    Emulated,
}

/// The factor by which an image is smaller along each side with `--quick`.
const QUICK_PART: u32 = 4;
/// By how much a pixel's colour may differ from another executor's: a quarter of an 8-bit step.
const SAME: f32 = 1e-3;
/// The share of the light that is transmitted, of that which a surface does not mirror.
const TRANSMISSION: f32 = 0.5;

#[derive(Debug, Parser)]
struct Arguments {
    #[command(flatten)]
    options: Options,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    finish(measure_all(&arguments.options), &arguments.options)
}

/// The view and the light of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setting {
    /// From twice the distance.
    is_far: bool,
    has_shadows: bool,
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (distance, shadows) =
            (if self.is_far { "double" } else { "usual" }, if self.has_shadows { "on" } else { "off" });
        write!(f, "{distance} distance, shadows {shadows}")
    }
}

const SETTINGS: [Setting; 3] = [
    Setting { is_far: false, has_shadows: false },
    Setting { is_far: false, has_shadows: true },
    Setting { is_far: true, has_shadows: true },
];

/// One figure of the table.
pub struct Measured {
    scene: &'static str,
    triangles: u64,
    setting: Setting,
    executor: String,
    /// The paper's figure to compare it with.
    paper_column: Option<PaperColumn>,
    seconds: f64,
    /// The counts of the frame, if there are any.
    counts: FrameCounts,
    /// The number of pixels that differ from those of the first executor.
    other_pixels: usize,
}

impl Measured {
    fn a_ray(&self, total: f64) -> f64 {
        total / (self.counts.radiance_rays + self.counts.shadow_rays) as f64
    }
}

fn measure_all(options: &Options) -> Result<Report> {
    let columns = [
        "scene",
        "triangles",
        "size",
        "distance",
        "shadows",
        "executor",
        "seconds a frame",
        "times recursive",
        "the paper's seconds",
        "primary rays that hit",
        "rays",
        "shadow rays",
        "ns a ray",
        "nodes a ray",
        "triangles a ray",
        "bytes a ray",
        "other pixels",
    ];
    let mut report = Report::new(&columns);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let pools = [thread_pool(1)?, thread_pool(threads)?];
    let (mut measured, mut walks) = (Vec::new(), Vec::new());
    for (name, _) in PAPER {
        let Some(recipe) = SCENES.iter().find(|recipe| recipe.name == name) else { continue };
        measure_scene(recipe, options, &pools, &mut measured, &mut walks)?;
    }
    for figure in &measured {
        add_row(figure, &measured, options, &mut report);
    }
    for claim in claims::claims(&measured, &walks) {
        report.note(claim);
    }
    Ok(report)
}

/// A scene of glass that is half matt, with a light.
fn load(recipe: &Recipe, options: &Options) -> Result<BenchScene> {
    let material = Material {
        transmission: TRANSMISSION,
        roughness: 0.0,
        double_sided: true,
        ..Material::diffuse(Vec3::new(0.9, 0.8, 0.7))
    };
    let mut scene = recipe.scene(&material)?;
    let light = scene.add(scene.root(), Transform::from_translation(recipe.light()))?;
    scene.add(light, Light::point(Vec3::ONE, 1.0))?;
    BenchScene::compile(recipe.name, &mut scene, recipe.view(size(options), 1.0), recipe.light())
}

fn size(options: &Options) -> [u32; 2] {
    ImageSize::Paper.pixels().map(|pixels| if options.quick { pixels / QUICK_PART } else { pixels })
}

fn measure_scene(
    recipe: &Recipe,
    options: &Options,
    pools: &[ThreadPool; 2],
    measured: &mut Vec<Measured>,
    walks: &mut Vec<Walks>,
) -> Result<()> {
    let mut scene = load(recipe, options)?;
    let mut paper = paper_arrays(scene.arrays())?;
    let mut executors = frame::executors(&mut scene, &mut paper, options, pools)?;
    walks.push(Walks::count(&scene, &mut paper)?);
    for setting in SETTINGS {
        let view = recipe.view(size(options), if setting.is_far { 2.0 } else { 1.0 });
        let lights = if setting.has_shadows { scene.arrays().lights.len() as u32 } else { 0 };
        let params = view.frame_params(scene.compiler.origin(), lights);
        let request = FrameRequest::new(params, scene.needs);
        let arrays = |executor: &Executor| if executor.is_paper { &paper } else { scene.arrays() };
        let mut contenders: Vec<Contender> = Vec::new();
        for executor in &mut executors {
            let arrays = arrays(executor);
            contenders.push(Box::new(move || executor.trace(arrays, &request)));
        }
        let times = medians(3, &mut contenders);
        drop(contenders);
        let truth = executors[0].image()?;
        let counts = frame::counts(&executors, &request, arrays);
        for ((executor, time), counts) in executors.iter().zip(times).zip(counts) {
            let image = executor.image()?;
            let differs = |(a, b): &(&[f32; 4], &[f32; 4])| a.iter().zip(*b).any(|(a, b)| (a - b).abs() > SAME);
            measured.push(Measured {
                scene: scene.name,
                triangles: scene.triangle_count(),
                setting,
                executor: executor.name.clone(),
                paper_column: executor.paper_column,
                seconds: time.as_secs_f64(),
                counts,
                other_pixels: truth.len().abs_diff(image.len()) + truth.iter().zip(&image).filter(differs).count(),
            });
        }
    }
    Ok(())
}

fn add_row(figure: &Measured, all: &[Measured], options: &Options, report: &mut Report) {
    let recursive = all.iter().find(|other| {
        (other.scene, other.setting, other.paper_column) == (figure.scene, figure.setting, Some(PaperColumn::Recursive))
    });
    let paper = PAPER.iter().find(|(name, _)| *name == figure.scene).filter(|_| !figure.setting.is_far);
    let paper = paper.zip(figure.paper_column).map(|((_, [cuda, opencl, recursive, emulated]), column)| match column {
        PaperColumn::Gpu => format!("CUDA {cuda}; OpenCL {opencl}"),
        PaperColumn::Recursive => recursive.to_string(),
        PaperColumn::Emulated => emulated.to_string(),
    });
    let [width, height] = size(options);
    let FrameCounts { radiance_rays: rays, primary_hits, shadow_rays, cost: work, .. } = figure.counts;
    let a_ray = |total: u64| if total == 0 { String::new() } else { format!("{:.1}", figure.a_ray(total as f64)) };
    report.row([
        figure.scene.to_owned(),
        figure.triangles.to_string(),
        format!("{width}x{height}"),
        if figure.setting.is_far { "double" } else { "usual" }.to_owned(),
        if figure.setting.has_shadows { "on" } else { "off" }.to_owned(),
        figure.executor.clone(),
        format!("{:.4}", figure.seconds),
        recursive.map_or(String::new(), |recursive| format!("{:.2}", recursive.seconds / figure.seconds)),
        paper.unwrap_or_default(),
        primary_hits.to_string(),
        rays.to_string(),
        shadow_rays.to_string(),
        format!("{:.0}", figure.a_ray(figure.seconds * 1e9)),
        a_ray(work.nodes),
        a_ray(work.triangles),
        a_ray(work.bytes),
        figure.other_pixels.to_string(),
    ]);
}
