//! The viewer in a real window, by simulated pointer and keyboard input and screenshots.
//!
//! Needs Xvfb and a Vulkan driver, which may be a software one; without Xvfb each test reports that it is skipped.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

#[path = "../../../render/builtin/mod.rs"]
mod builtin;
mod display;
mod expected;
mod viewer;

use std::path::Path;
use std::time::{Duration, Instant};

use ropewalk::glam::DVec3;
use serde_json::json;

use display::{CONTROL, Display, HOME};
use expected::{Expected, difference};
use viewer::Viewer;

/// Pictures with a smaller difference are equal up to 8-bit rounding and the tie band of two executors.
const SAME: f32 = 0.004;
/// Pictures with a larger difference show different scenes or views: at least a ball has moved.
const OTHER: f32 = 0.02;

/// The longest time until a drawn picture is on the screen. Messages cover it for 5 s.
const PATIENCE: Duration = Duration::from_secs(12);

const SMALL: [&str; 4] = ["--size", "880x380", "--samples", "1"];

#[test]
fn what_is_clicked_is_selected_and_what_is_dragged_moves_until_it_is_undone() {
    let Some(display) = Display::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let saved = folder.path().join("saved.png");
    let viewer = start(&display, &["--device", "cpu", "--save", saved.to_str().unwrap()]);
    let picture_rect @ [left, top, width, height] = viewer.wait_for_rest(&display);
    let mut expected = Expected::new(width, height);

    // 1. The screen and the saved file show the picture that the library renders.
    let first = shown(&display, picture_rect, &expected.render().to_rgba8(), "at first");
    display.keys(&[CONTROL, u32::from('s')]);
    viewer.wait("saved");
    let file = image::open(&saved).unwrap().to_rgba8();
    assert_eq!(file.dimensions(), (width.into(), height.into()));
    let file: Vec<[u8; 4]> = file.pixels().map(|pixel| pixel.0).collect();
    assert_eq!(file, expected.render().to_rgba8(), "the saved file");

    // 2. A click selects the visible node.
    let (ball, pixel) = expected.largest_ball();
    let on_screen = |[x, y]: [u32; 2]| [left as i16 + x as i16, top as i16 + y as i16];
    display.point(on_screen(pixel));
    display.button(true);
    display.button(false);
    assert_eq!(viewer.wait("selected")["node"], json!(ball));

    // 3. A drag moves it with the pointer.
    let offset = [-40_i32, -30];
    let along = |step: i32| [0, 1].map(|i| (pixel[i] as i32 + offset[i] * step / 10) as u32);
    display.button(true);
    (1..=10).for_each(|step| display.point(on_screen(along(step))));
    display.button(false);
    let moved = viewer.wait("moved");
    viewer.wait_for_rest(&display);
    let transform = expected.scene.parent(ball).unwrap().unwrap();
    assert_eq!(moved["node"], json!(transform));
    let [now, anchor] = ["translation", "anchor"].map(|point| -> DVec3 {
        let numbers: [f64; 3] = serde_json::from_value(moved[point].clone()).unwrap();
        numbers.into()
    });
    let local = expected.scene.local(transform).unwrap();
    let held = anchor + now - local.to_affine().translation;
    for (point, pixel) in [(anchor, pixel), (held, along(10))] {
        let [x, y] = expected.position_of(point);
        let [right, below] = pixel.map(|number| f64::from(number) + 0.5);
        assert!(
            (x - right).abs() < 0.1 && (y - below).abs() < 0.1,
            "it is held at {x}, {y}, the pointer is at {pixel:?}"
        );
    }
    expected.scene.set_local(transform, local.with_translation(now)).unwrap();
    let image = expected.render();
    let second = shown(&display, picture_rect, &image.to_rgba8(), "after the drag");
    assert_other(width, &second, &first, "the drag");

    // 4. Undo, redo.
    display.keys(&[CONTROL, u32::from('z')]);
    assert_eq!(viewer.wait("undone")["name"], "move");
    viewer.wait_for_rest(&display);
    shown(&display, picture_rect, &first, "undone");
    display.keys(&[CONTROL, u32::from('y')]);
    viewer.wait("redone");
    viewer.wait_for_rest(&display);
    shown(&display, picture_rect, &second, "redone");

    // 5. A drag beside the selection turns the camera, and the scene stays as it is.
    let sky = on_screen([u32::from(width) / 2, 4]);
    display.point(sky);
    display.button(true);
    (1..=5).for_each(|step| display.point([sky[0] + step * 8, sky[1] + step * 4]));
    display.button(false);
    viewer.wait_for_rest(&display);
    std::thread::sleep(Duration::from_millis(300));
    assert_other(width, &display.screenshot(picture_rect), &second, "turning");
    display.keys(&[HOME]);
    viewer.wait_for_rest(&display);
    shown(&display, picture_rect, &second, "back home");
}

#[test]
fn the_gpu_shows_its_frames_where_they_are() {
    let Some(display) = Display::start() else { return };
    let viewer = start(&display, &["--device", "gpu", "--size", "760x280"]);
    let picture_rect @ [_, _, width, height] = viewer.wait_for_rest(&display);
    let expected = Expected::new(width, height).render().to_rgba8();
    shown(&display, picture_rect, &expected, "traced by the GPU");
}

#[test]
fn a_file_that_cannot_be_read_is_told_in_the_window() {
    let Some(display) = Display::start() else { return };
    let mut viewer = Viewer::start(&display, &[&SMALL[..], &["--device", "cpu", "no-such-file.glb"]].concat());
    let event = viewer.wait("error");
    assert!(event["message"].as_str().unwrap().contains("no-such-file.glb"), "{event}");
    viewer.wait_for_rest(&display);
    let is_red = |pixel: &[u8; 4]| pixel[0] > 180 && pixel[1] < 150 && pixel[2] < 140;
    let start = Instant::now();
    while !display.screenshot([250, 310, 380, 70]).iter().any(is_red) {
        assert!(start.elapsed() < PATIENCE, "no error is to be read");
    }
    assert!(viewer.is_alive());
}

/// Starts the viewer with nothing over the picture.
fn start(display: &Display, arguments: &[&str]) -> Viewer {
    let viewer = Viewer::start(display, &[&SMALL[..], arguments].concat());
    viewer.wait("opened");
    display.focus_window();
    viewer.wait_for_rest(display);
    display.keys(&[u32::from('o')]);
    viewer
}

/// Waits until the screen shows a picture in a rectangle (left, top, width, height), and returns the pixels there.
#[track_caller]
fn shown(display: &Display, picture_rect: [u16; 4], picture: &[[u8; 4]], what: &str) -> Vec<[u8; 4]> {
    let start = Instant::now();
    loop {
        let screen = display.screenshot(picture_rect);
        let difference = difference(picture_rect[2], picture, &screen);
        if difference < SAME {
            return screen;
        }
        if start.elapsed() > PATIENCE {
            let [expected, actual] = [("expected", picture), ("actual", &screen)].map(|(name, pixels)| {
                let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{what} - {name}.png"));
                let bytes = pixels.as_flattened();
                image::save_buffer(
                    &path,
                    bytes,
                    picture_rect[2].into(),
                    picture_rect[3].into(),
                    image::ColorType::Rgba8,
                )
                .unwrap();
                path
            });
            panic!(
                "{what}: the screen differs by {difference}: {} is to look as {}",
                actual.display(),
                expected.display()
            );
        }
    }
}

#[track_caller]
fn assert_other(width: u16, a: &[[u8; 4]], b: &[[u8; 4]], what: &str) {
    let difference = difference(width, a, b);
    assert!(difference > OTHER, "{what} changed nothing: the pictures differ by {difference}");
}
