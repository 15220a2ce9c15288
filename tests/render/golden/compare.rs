//! Compares an image with a golden one. If they differ, the image and a map of the differences are written to files.

use std::path::Path;

use ropewalk::image::Image;
use ropewalk_testkit::flip::{PIXELS_PER_DEGREE, flip};

/// The greatest mean of the FLIP errors. Executors on one machine differ by less than 0.0001.
const MOST_MEAN: f32 = 0.002;
/// The greatest 99th percentile of the FLIP errors: an error that covers more than 1 % of the image, 11 by 11 pixels,
/// fails.
const MOST_99TH: f32 = 0.05;

/// Compares `image` with the PNG file `golden`.
///
/// # Errors
/// How much they differ, and the files in the folder `failed` that hold the image and the map; their names start with
/// `run`.
pub(crate) fn compare(golden: &Path, image: &Image, failed: &Path, run: &str) -> Result<(), String> {
    let kept = [failed.join(format!("{run}.png")), failed.join(format!("{run}-flip.png"))];
    let [actual, difference] = [&kept[0], &kept[1]].map(|path| path.display().to_string());
    for path in &kept {
        // Files of an earlier failure are removed.
        let _ = std::fs::remove_file(path);
    }
    let keep = |problem: String| {
        std::fs::create_dir_all(failed).unwrap();
        image.save(&kept[0]).unwrap();
        Err(format!("{run} {problem}; the picture is {actual}. {HOW_TO_BLESS}"))
    };

    let expected = match image::open(golden) {
        Ok(expected) => expected.to_rgba8(),
        Err(error) => return keep(format!("has nothing to compare with: {}: {error}", golden.display())),
    };
    if (expected.width(), expected.height()) != (image.width, image.height) {
        return keep(format!("is {}x{}, but {} is not", image.width, image.height, golden.display()));
    }

    let expected: Vec<[u8; 4]> = expected.pixels().map(|pixel| pixel.0).collect();
    let errors = flip(image.width, &expected, &image.to_rgba8(), PIXELS_PER_DEGREE).unwrap();
    let mean = errors.iter().sum::<f32>() / errors.len() as f32;
    let percentile = percentile(&errors, 0.99);
    if mean <= MOST_MEAN && percentile <= MOST_99TH {
        return Ok(());
    }
    std::fs::create_dir_all(failed).unwrap();
    let map = errors.iter().map(|&e| heat(e)).collect();
    Image::new(image.width, image.height, map).save(&kept[1]).unwrap();
    keep(format!(
        "differs from {}: mean FLIP {mean:.4} (at most {MOST_MEAN}), 99th percentile {percentile:.4} (at most {MOST_99TH}); \
         the difference is {difference}",
        golden.display()
    ))
}

const HOW_TO_BLESS: &str =
    "If this is meant: ROPEWALK_BLESS=1 cargo test --test frames golden, and look at what it makes.";

/// The smallest error that is not less than this share of all errors.
fn percentile(errors: &[f32], part: f64) -> f32 {
    let mut sorted = errors.to_vec();
    sorted.sort_by(f32::total_cmp);
    sorted[((sorted.len() - 1) as f64 * part).ceil() as usize]
}

/// A color map of errors from 0 to 1: black, red, yellow, white.
fn heat(error: f32) -> [f32; 4] {
    let ramp = |start: f32| ((error - start) * 3.0).clamp(0.0, 1.0);
    [ramp(0.0), ramp(1.0 / 3.0), ramp(2.0 / 3.0), 1.0]
}

/// A grey image with a small square of another grey, and a golden file of it.
#[cfg(test)]
fn square(value: f32, side: u32) -> Image {
    let pixel = |x: u32, y: u32| if x < side && y < side { value } else { 0.5 };
    let color = (0..96).flat_map(|y| (0..128).map(move |x| pixel(x, y))).map(|v| [v, v, v, 1.0]).collect();
    Image::new(128, 96, color)
}

#[test]
fn equal_images_pass_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let golden = folder.path().join("golden.png");
    square(0.2, 12).save(&golden).unwrap();
    compare(&golden, &square(0.2, 12), &folder.path().join("failed"), "run").unwrap();
    assert!(!folder.path().join("failed").exists());
}

#[test]
fn a_small_square_of_another_grey_fails_and_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let golden = folder.path().join("golden.png");
    square(0.2, 12).save(&golden).unwrap();
    let message = compare(&golden, &square(0.3, 12), folder.path(), "run").unwrap_err();
    for kept in ["run.png", "run-flip.png"] {
        assert!(message.contains(kept), "{message}");
        assert!(image::open(folder.path().join(kept)).is_ok());
    }
}

#[test]
fn a_missing_golden_or_one_of_another_size_fails() {
    let folder = tempfile::tempdir().unwrap();
    let golden = folder.path().join("golden.png");
    assert!(compare(&golden, &square(0.2, 12), folder.path(), "run").unwrap_err().contains("nothing to compare"));
    Image::new(96, 128, square(0.2, 12).color).save(&golden).unwrap();
    assert!(compare(&golden, &square(0.2, 12), folder.path(), "run").unwrap_err().contains("is 128x96"));
}
