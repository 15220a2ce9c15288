//! Time of a frame against what a person sees of its faults: depth of paths, their cut-off, and samples a pixel.
//!
//! The scene is the one of the example `render`: mirrors, glass, a texture and shadows. The reference has more of
//! everything; FLIP is that of the images for a screen.

use ropewalk::image::Image;
use ropewalk::{DeviceChoice, NodeKey, Renderer, RendererOptions, Scene, View};
use ropewalk_bench::{Report, Result, Target, median, time};
use ropewalk_testkit::flip::{PIXELS_PER_DEGREE, flip};

use crate::chart::{Axis, Better, Chart, Curve, Panel, Point, Scale};
use crate::{Run, builtin};

/// What a frame is rendered with.
#[derive(Clone, Copy, PartialEq)]
struct Settings {
    depth: u32,
    /// A power of two.
    cut_off: i32,
    /// Along each side of a pixel.
    samples: u32,
}

const DEFAULT: Settings = Settings { depth: 3, cut_off: -13, samples: 1 };
const REFERENCE: Settings = Settings { depth: 24, cut_off: -16, samples: 8 };

pub fn measure(run: &Run, report: &mut Report) -> Result<Chart> {
    let (size, frames) = if run.is_quick { ([160, 100], 1) } else { ([480, 300], 5) };
    let reference = if run.is_quick { Settings { samples: 4, ..REFERENCE } } else { REFERENCE };
    let mut scene = Scene::new();
    let camera = builtin::build(&mut scene)?;
    let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu))?;
    let (converged, _) = render(&mut renderer, &mut scene, camera, size, reference, 1)?;
    run.progress("image, the reference");

    let mut point = |settings: Settings, label: String| -> Result<Point> {
        let (image, milliseconds) = render(&mut renderer, &mut scene, camera, size, settings, frames)?;
        let errors = flip(size[0], &converged.to_rgba8(), &image.to_rgba8(), PIXELS_PER_DEGREE)?;
        let y = f64::from(errors.iter().sum::<f32>()) / errors.len() as f64;
        Ok(Point { x: milliseconds, y, label, is_default: settings == DEFAULT, ..Point::default() })
    };
    let mut by_depth = |samples: u32| -> Result<Vec<Point>> {
        let settings = |depth| Settings { depth, samples, ..DEFAULT };
        (0..=8).map(|depth| point(settings(depth), depth.to_string())).collect()
    };
    let depths = [by_depth(1)?, by_depth(2)?];
    let cut_offs = [-10, -7, -4].map(|cut_off| {
        let settings = Settings { depth: 8, cut_off, samples: 2 };
        point(settings, format!("2^{cut_off}"))
    });
    let cut_offs = cut_offs.into_iter().collect::<Result<Vec<Point>>>()?;
    let samples = vec![
        point(Settings { samples: 4, ..DEFAULT }, "3".to_owned())?,
        point(Settings { samples: 4, depth: 8, ..DEFAULT }, "8".to_owned())?,
    ];
    run.progress("image, all settings");
    depth_goals(&mut renderer, &mut scene, camera, report)?;

    let [one, two] = depths;
    let curve = |name: &str, points| Curve { name: name.to_owned(), is_joined: false, points };
    Ok(Chart {
        name: "image",
        panels: vec![Panel {
            title: "The built-in scene",
            x: Axis { name: "milliseconds a frame, all threads", scale: Scale::Log },
            y: Axis { name: "mean FLIP to a converged image", scale: Scale::Log },
            front: Some(Better::Less),
            curves: vec![
                curve("depth, one sample a pixel", one),
                curve("depth, 2 x 2 samples", two),
                curve("cut-off at depth 8, 2 x 2 samples", cut_offs),
                curve("depth, 4 x 4 samples", samples),
            ],
        }],
    })
}

/// With the samples of the reference, deeper paths never look worse.
fn depth_goals(renderer: &mut Renderer, scene: &mut Scene, camera: NodeKey, report: &mut Report) -> Result<()> {
    const SIZE: [u32; 2] = [160, 100];
    let settings = |depth| Settings { depth, samples: 4, ..REFERENCE };
    let (reference, _) = render(renderer, scene, camera, SIZE, settings(REFERENCE.depth), 1)?;
    let mut before = f32::INFINITY;
    for depth in 0..=8 {
        let (image, _) = render(renderer, scene, camera, SIZE, settings(depth), 1)?;
        let errors = flip(SIZE[0], &reference.to_rgba8(), &image.to_rgba8(), PIXELS_PER_DEGREE)?;
        let sum: f32 = errors.iter().sum();
        if depth > 0 {
            report.goal(
                format!("image_flip_added_by_depth_{depth}"),
                (sum - before).into(),
                Target::AtMost(0.0),
                "in all",
            );
        }
        before = sum;
    }
    Ok(())
}

/// The image, and the median of the milliseconds of some frames.
fn render(
    renderer: &mut Renderer,
    scene: &mut Scene,
    camera: NodeKey,
    [width, height]: [u32; 2],
    settings: Settings,
    frames: usize,
) -> Result<(Image, f64)> {
    let view = View {
        sky: builtin::sky(),
        max_depth: settings.depth,
        min_throughput: 2f32.powi(settings.cut_off),
        ..View::from_camera(scene, camera, width * settings.samples, height * settings.samples)?
    };
    let (mut times, mut image) = (Vec::new(), None);
    for _ in 0..frames {
        let mut rendered = None;
        times.push(time(|| rendered = Some(renderer.render(scene, &view).and_then(|frame| frame.image()))));
        image = rendered.transpose()?;
    }
    let image = image.ok_or("no frame was asked for")?.downscaled(settings.samples)?;
    Ok((image, median(times).as_secs_f64() * 1e3))
}
