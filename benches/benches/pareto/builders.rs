//! Time of builds against time of rays, for each structure, and both together for a number of frames a build.

use std::time::Duration;

use glam::{DVec3, Vec3};
use ropewalk::accel::{Blas, BlasBuildParams};
use ropewalk::compile::Compiler;
use ropewalk::device::layout::Node;
use ropewalk::{Core, Geometry, Material, Scene};
use ropewalk_bench::columns::soup;
use ropewalk_bench::rays::{RayKind, RaySets};
use ropewalk_bench::scenes::{ImageSize, Recipe, SCENES};
use ropewalk_bench::shapes::bumpy_sphere;
use ropewalk_bench::{Report, Result, Target, median, time};

use crate::Run;
use crate::chart::{Axis, Better, Chart, Curve, Panel, Point, Scale};
use crate::hits::STRUCTURES;
use crate::tracers::{Executor, OverArrays, Tracing as _};

/// Frames from one build to the next.
const FRAMES: [u32; 4] = [1, 10, 100, 1000];

pub fn measure(run: &Run, report: &mut Report) -> Result<Chart> {
    // 1. What the compiler chooses, which does not depend on the mesh.
    let chosen = FRAMES.iter().map(|&frames| automatic(frames)).collect::<Result<Vec<usize>>>()?;
    for (frames, (&chosen, expected)) in FRAMES.iter().zip(chosen.iter().zip(["Low", "Medium", "Medium", "Medium"])) {
        let is_as_documented = f64::from(u8::from(STRUCTURES[chosen].0 == expected));
        let name = format!("builders_automatic_choice_after_{frames}_frames_is_{expected}");
        report.goal(name, is_as_documented, Target::AtLeast(1.0), "of 1");
    }
    // 2. What would have been best.
    let titles = [
        ("bunny", "The bunny", "The bunny: builds and rays together"),
        ("sponza", "Sponza", "Sponza: builds and rays together"),
    ];
    let mut panels = Vec::new();
    for (name, title, together) in titles {
        let recipe = SCENES.iter().find(|recipe| recipe.name == name).ok_or("there is no such scene")?;
        let times = times(recipe, if run.is_quick { 1 } else { 7 }, run.is_quick)?;
        panels.extend(panels_of(title, together, &times, &chosen));
        run.progress(&format!("builders, {name}"));
    }
    Ok(Chart { name: "builders", panels })
}

/// Of each structure, the milliseconds of a build and of a frame's rays.
fn times(recipe: &Recipe, samples: usize, is_quick: bool) -> Result<Vec<[f64; 2]>> {
    let scene = recipe.load(ImageSize::Paper)?;
    let (triangles, sets) = (scene.triangles(), RaySets::new(&scene)?);
    let every = if is_quick { 20 } else { 1 };
    let rays: Vec<_> = sets.of(RayKind::Diffuse).iter().step_by(every).copied().collect();
    let geometry = soup(&triangles);
    let params = STRUCTURES.map(|(_, structure)| BlasBuildParams::new(structure));
    let tracers = params.iter().map(|params| OverArrays::new(&triangles, params, Executor::Cpu));
    let tracers = tracers.collect::<Result<Vec<_>>>()?;
    let mut measured = vec![[const { Vec::new() }; 2]; params.len()];
    for _ in 0..samples {
        for ((params, tracer), [builds, traces]) in params.iter().zip(&tracers).zip(&mut measured) {
            builds.push(time(|| Blas::build(&geometry, params).is_ok()));
            traces.push(tracer.trace(&rays)?.1);
        }
    }
    let milliseconds = |times: Vec<Duration>| median(times).as_secs_f64() * 1e3;
    Ok(measured.into_iter().map(|times| times.map(milliseconds)).collect())
}

fn panels_of(title: &'static str, together: &'static str, times: &[[f64; 2]], chosen: &[usize]) -> [Panel; 2] {
    let named = || STRUCTURES.iter().map(|(name, structure)| (*name, *structure)).zip(times);
    let point = |((name, structure), &[x, y]): ((&str, _), &[f64; 2])| {
        let is_default = structure == BlasBuildParams::default().structure;
        Point { x, y, label: name.to_owned(), is_default, ..Point::default() }
    };
    let points = Curve { name: "structures".to_owned(), is_joined: false, points: named().map(point).collect() };
    // Milliseconds a frame, in units of those of the best structure.
    let all = |structure: usize, frames: u32| times[structure][0] / f64::from(frames) + times[structure][1];
    let of = |structure: usize, frames: u32| {
        let best = (0..times.len()).map(|other| all(other, frames)).fold(f64::INFINITY, f64::min);
        let y = all(structure, frames);
        Point { x: frames.into(), y: y / best, detail: format!("{y:.2} ms a frame"), ..Point::default() }
    };
    let curve = |(structure, (name, _)): (usize, &(&str, _))| Curve {
        name: (*name).to_owned(),
        is_joined: true,
        points: FRAMES.iter().map(|&frames| of(structure, frames)).collect(),
    };
    let mut curves: Vec<Curve> = STRUCTURES.iter().enumerate().map(curve).collect();
    let choice = FRAMES.iter().zip(chosen).map(|(&frames, &chosen)| {
        let point = of(chosen, frames);
        Point { is_default: true, detail: format!("{}, {}", STRUCTURES[chosen].0, point.detail), ..point }
    });
    curves.push(Curve { name: "the automatic choice".to_owned(), is_joined: true, points: choice.collect() });
    [
        Panel {
            title,
            x: Axis { name: "build, milliseconds", scale: Scale::Log },
            y: Axis { name: "diffuse rays of a frame of 800x600, milliseconds", scale: Scale::Linear },
            front: Some(Better::Less),
            curves: vec![points],
        },
        Panel {
            title: together,
            x: Axis { name: "frames a build", scale: Scale::Log },
            y: Axis { name: "build and rays a frame, in units of the best structure's", scale: Scale::Log },
            front: None,
            curves,
        },
    ]
}

/// Which of the structures a geometry gets that does not ask for one, if its triangles change after so many frames.
fn automatic(frames: u32) -> Result<usize> {
    let mesh = bumpy_sphere(2_000);
    let turned = |turn: usize| {
        let mut indices = mesh.indices.to_vec();
        indices.rotate_left(turn);
        Geometry { indices: indices.into(), ..mesh.clone() }
    };
    let (mut scene, mut compiler) = (Scene::new(), Compiler::new());
    let material = scene.add_material(Material::default())?;
    let geometry = scene.add_geometry(mesh.clone())?;
    let moved = scene.add(scene.root(), Core::Geometry { geometry, material })?;
    for change in 1..=5 {
        scene.set_geometry(geometry, turned(change))?;
        for frame in 0..frames {
            // Something else changes in each frame.
            scene.set_mask(moved, 1 + frame % 2)?;
            compiler.compile(&mut scene, DVec3::ZERO)?;
        }
    }
    let corner = |node: &Node| Vec3::from_array(node.min);
    for (i, (_, structure)) in STRUCTURES.into_iter().enumerate() {
        let nodes = Blas::build(&turned(5), &BlasBuildParams::new(structure))?.nodes;
        let own = compiler.arrays().blas_nodes.iter().take(nodes.len());
        if own.map(corner).eq(nodes.iter().map(corner)) {
            return Ok(i);
        }
    }
    Err("the compiler has built something else".into())
}
