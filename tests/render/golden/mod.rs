//! Golden images: scenes of one feature each, rendered on every executor and compared with an image that a person has
//! checked.
//!
//! After a change that is meant to be seen, `ROPEWALK_BLESS=1 cargo test --test frames golden` renders the pictures in
//! `tests/render/golden` anew (on the CPU). Look at each of them before it is committed. When a comparison fails, the
//! picture and its FLIP difference are kept in `tests/failed`.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

#[path = "../../../examples/render/builtin/mod.rs"]
mod builtin;
mod compare;
mod scenes;

use std::path::{Path, PathBuf};

use ropewalk::image::Image;
use ropewalk::{DeviceChoice, Renderer, RendererOptions, Result, Scene, View};

/// Builds a scene and returns the view of it.
type Build = fn(&mut Scene) -> Result<View>;

const GOLDENS: [(&str, Build); 12] = [
    ("builtin", scenes::builtin_scene),
    ("glass", scenes::glass),
    ("mirror_depth", scenes::mirror_depth),
    ("texture_wrap", scenes::texture_wrap),
    ("alpha", scenes::alpha),
    ("mirrored", scenes::mirrored),
    ("lights", scenes::lights),
    ("vertex_colors", scenes::vertex_colors),
    ("emissive_unlit", scenes::emissive_unlit),
    ("orthographic_instances", scenes::orthographic_instances),
    ("metallic_roughness", scenes::metallic_roughness),
    ("normal_texture", scenes::normal_texture),
];

/// Rays along each side of a pixel: where another driver rounds an edge to the other side of a ray, the pixel changes
/// by a quarter at most.
const SAMPLES: u32 = 2;
const MOST_BYTES: u64 = 16 * 1024;

macro_rules! golden_tests {
    ($($name:ident),* $(,)?) => {
        $(#[test]
        fn $name() {
            check(stringify!($name));
        })*

        #[test]
        fn every_golden_has_a_test() {
            assert_eq!(GOLDENS.map(|(name, _)| name), [$(stringify!($name)),*]);
        }
    };
}

golden_tests! {
    builtin, glass, mirror_depth, texture_wrap, alpha, mirrored, lights, vertex_colors, emissive_unlit, orthographic_instances,
    metallic_roughness, normal_texture,
}

#[test]
fn the_folder_holds_the_goldens_and_they_are_small() {
    if is_blessing() {
        // The other tests are writing them.
        return;
    }
    let mut found: Vec<String> = Vec::new();
    for entry in std::fs::read_dir(golden_folder()).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "png") {
            let bytes = std::fs::metadata(&path).unwrap().len();
            assert!(bytes <= MOST_BYTES, "{} has {bytes} bytes, more than {MOST_BYTES}", path.display());
            found.push(path.file_stem().unwrap().to_str().unwrap().to_owned());
        }
    }
    found.sort();
    let mut expected = GOLDENS.map(|(name, _)| name.to_owned());
    expected.sort();
    assert_eq!(found, expected);
}

fn check(name: &str) {
    let build = GOLDENS.iter().find(|(n, _)| *n == name).unwrap().1;
    let golden = golden_folder().join(format!("{name}.png"));
    if is_blessing() {
        render(build, DeviceChoice::Cpu).unwrap().save(&golden).unwrap();
        return;
    }

    let mut failures = Vec::new();
    for device in [DeviceChoice::Cpu, DeviceChoice::Emulated, DeviceChoice::Gpu] {
        let image = match render(build, device) {
            Err(ropewalk::Error::NoGpu { reason }) if !gpu_required() => {
                println!("{name} was not rendered on a GPU: {reason}");
                continue;
            }
            image => image.unwrap(),
        };
        let run = format!("{name}-{}", format!("{device:?}").to_lowercase());
        failures.extend(compare::compare(&golden, &image, &failed_folder(), &run).err());
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

fn render(build: Build, device: DeviceChoice) -> Result<Image> {
    let mut scene = Scene::new();
    let view = build(&mut scene)?;
    let view = View { width: view.width * SAMPLES, height: view.height * SAMPLES, ..view };
    let mut renderer = Renderer::new(&RendererOptions::default().with_device(device))?;
    renderer.render(&mut scene, &view)?.image()?.downscaled(SAMPLES)
}

fn is_blessing() -> bool {
    std::env::var_os("ROPEWALK_BLESS").is_some()
}

/// `scripts/test.sh` sets this variable: without an adapter, GPU tests then fail instead of being skipped.
fn gpu_required() -> bool {
    std::env::var_os("ROPEWALK_REQUIRE_GPU").is_some()
}

fn golden_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/render/golden")
}

fn failed_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/failed")
}
