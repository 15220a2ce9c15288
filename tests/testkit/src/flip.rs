//! FLIP: how different two images look to a person.

use glam::{Mat3, Vec3};

/// The usual viewing conditions for [`flip`]: a monitor 3840 pixels and 0.7 m wide, seen from 0.7 m.
pub const PIXELS_PER_DEGREE: f32 = 67.0;

/// The difference, 0 to 1 a pixel, that a person sees when two sRGB images are shown in turn at the same place.
/// Alpha is ignored. `pixels_per_degree` (of the visual field) says how large they are seen: see [`PIXELS_PER_DEGREE`].
///
/// O(pixels * `pixels_per_degree`). Source: P. Andersson et al., "FLIP: A Difference Evaluator for Alternating Images",
/// HPG 2020; filters separated as in the authors' own program.
///
/// # Errors
/// Where the images differ in size, are not whole rows of `width` pixels, or have no pixels, or `pixels_per_degree` is
/// not between 1 and 1000.
pub fn flip(width: u32, reference: &[[u8; 4]], test: &[[u8; 4]], pixels_per_degree: f32) -> Result<Vec<f32>, String> {
    if reference.len() != test.len() {
        return Err(format!("{} pixels cannot be compared with {}", test.len(), reference.len()));
    }
    if reference.is_empty() || width == 0 || !reference.len().is_multiple_of(width as usize) {
        return Err(format!("{} pixels are not rows of {width}", test.len()));
    }
    if !(1.0..=1000.0).contains(&pixels_per_degree) {
        return Err(format!("{pixels_per_degree} pixels per degree are not between 1 and 1000"));
    }

    let [reference, test] = [reference, test].map(|pixels| YcxczImage::new(width as usize, pixels));
    let [color_reference, color_test] = [&reference, &test].map(|image| perceived_lab(image, pixels_per_degree));
    let [features_reference, features_test] = [&reference, &test].map(|image| features(image, pixels_per_degree));

    let colors = color_reference.iter().zip(&color_test).map(|(a, b)| color_difference(*a, *b));
    let features = features_reference.iter().zip(&features_test).map(|(a, b)| feature_difference(*a, *b));
    Ok(colors.zip(features).map(|(color, feature)| color.powf(1.0 - feature)).collect())
}

/// The white of the display (D65).
const WHITE: Vec3 = Vec3::new(0.950_428_5, 1.0, 1.088_900_4);

/// Columns: the XYZ of red, green and blue of sRGB.
const XYZ_FROM_LINEAR: Mat3 = Mat3::from_cols(
    Vec3::new(0.412_386_56, 0.212_636_82, 0.019_330_62),
    Vec3::new(0.357_591_5, 0.715_183, 0.119_197_17),
    Vec3::new(0.180_450_5, 0.072_180_2, 0.950_372_6),
);

/// A plane of the image, row by row.
type Plane = Vec<f32>;

/// An image in the opponent colour space `YCxCz`: luminance, red to green, blue to yellow.
struct YcxczImage {
    width: usize,
    planes: [Plane; 3],
}

impl YcxczImage {
    fn new(width: usize, pixels: &[[u8; 4]]) -> Self {
        let mut planes: [Plane; 3] = Default::default();
        for &[r, g, b, _] in pixels {
            let linear = Vec3::from_array([r, g, b].map(|c| linear_from_srgb(f32::from(c) / 255.0)));
            let xyz = XYZ_FROM_LINEAR * linear / WHITE;
            planes[0].push(116.0 * xyz.y - 16.0);
            planes[1].push(500.0 * (xyz.x - xyz.y));
            planes[2].push(200.0 * (xyz.y - xyz.z));
        }
        Self { width, planes }
    }
}

/// 1. What the eye resolves at this distance: each opponent plane is filtered by its contrast sensitivity and converted
///    to L*a*b*, with chroma weighted by lightness (the Hunt effect). Section 4.1.
fn perceived_lab(image: &YcxczImage, pixels_per_degree: f32) -> Vec<Vec3> {
    // Scales of the sensitivity functions, in degrees squared: the widest gives the filters' common radius.
    const LUMINANCE: f32 = 0.0047;
    const RED_GREEN: f32 = 0.0053;
    const BLUE_YELLOW: [(f32, f32); 2] = [(34.1, 0.04), (13.5, 0.025)];

    let pi_squared = std::f32::consts::PI * std::f32::consts::PI;
    let radius = (3.0 * (BLUE_YELLOW[0].1 / (2.0 * pi_squared)).sqrt() * pixels_per_degree).ceil();
    let gaussian = |scale: f32| {
        kernel(radius, |x| (-pi_squared * (x / pixels_per_degree) * (x / pixels_per_degree) / scale).exp())
    };
    let filtered = |plane: &Plane, kernel: &[f32]| convolve(plane, image.width, kernel, kernel);

    let [y, cx, cz] = &image.planes;
    let y = filtered(y, &normalized(gaussian(LUMINANCE)));
    let cx = filtered(cx, &normalized(gaussian(RED_GREEN)));
    // A sum of two Gaussians, each separable: their weights in two dimensions are the squares of those in one.
    let [wide, narrow] = BLUE_YELLOW.map(|(weight, scale)| {
        let amplitude = (weight * (std::f32::consts::PI / scale).sqrt()).sqrt();
        gaussian(scale).into_iter().map(|g| amplitude * g).collect::<Vec<f32>>()
    });
    let total = wide.iter().sum::<f32>().hypot(narrow.iter().sum());
    let [wide, narrow] = [wide, narrow].map(|kernel| kernel.into_iter().map(|w| w / total).collect::<Vec<f32>>());
    let (cz_wide, cz_narrow) = (filtered(cz, &wide), filtered(cz, &narrow));

    let linear_from_xyz = XYZ_FROM_LINEAR.inverse();
    (0..y.len())
        .map(|i| {
            let luminance = (y[i] + 16.0) / 116.0;
            let xyz = Vec3::new(luminance + cx[i] / 500.0, luminance, luminance - (cz_wide[i] + cz_narrow[i]) / 200.0)
                * WHITE;
            let displayable = (linear_from_xyz * xyz).clamp(Vec3::ZERO, Vec3::ONE);
            hunt_lab(displayable)
        })
        .collect()
}

fn hunt_lab(linear: Vec3) -> Vec3 {
    const DELTA: f32 = 6.0 / 29.0;
    let compressed = (XYZ_FROM_LINEAR * linear / WHITE)
        .map(|c| if c > DELTA * DELTA * DELTA { c.cbrt() } else { c / (3.0 * DELTA * DELTA) + 4.0 / 29.0 });
    let lightness = 116.0 * compressed.y - 16.0;
    let chroma = [500.0 * (compressed.x - compressed.y), 200.0 * (compressed.y - compressed.z)];
    Vec3::new(lightness, 0.01 * lightness * chroma[0], 0.01 * lightness * chroma[1])
}

/// 2. The distance of two colours, 0 to 1, with large distances compressed. Section 4.1.3.
fn color_difference(a: Vec3, b: Vec3) -> f32 {
    const EXPONENT: f32 = 0.7;
    /// This share of the greatest distance is mapped to the range up to `CUT_TO`, the rest to that up to 1.
    const COMPRESSION_START: f32 = 0.4;
    const CUT_TO: f32 = 0.95;

    let hyab = |a: Vec3, b: Vec3| ((a.x - b.x).abs() + (a.y - b.y).hypot(a.z - b.z)).powf(EXPONENT);
    let greatest = hyab(hunt_lab(Vec3::Y), hunt_lab(Vec3::Z));
    let (distance, cut) = (hyab(a, b), COMPRESSION_START * greatest);
    if distance < cut { distance * CUT_TO / cut } else { CUT_TO + (distance - cut) / (greatest - cut) * (1.0 - CUT_TO) }
}

/// 3. The strength of edges and of points at each pixel. Section 4.2.
fn features(image: &YcxczImage, pixels_per_degree: f32) -> Vec<[f32; 2]> {
    /// Width of an edge that the eye detects, in degrees.
    const FEATURE_WIDTH: f32 = 0.082;

    let sigma = 0.5 * FEATURE_WIDTH * pixels_per_degree;
    let radius = (3.0 * sigma).ceil();
    let gaussian = |x: f32| (-x * x / (2.0 * sigma * sigma)).exp();
    let smooth = normalized(kernel(radius, gaussian));
    let first = normalized_by_sign(kernel(radius, |x| -x * gaussian(x)));
    let second = normalized_by_sign(kernel(radius, |x| (x * x / (sigma * sigma) - 1.0) * gaussian(x)));

    let luminance: Plane = image.planes[0].iter().map(|y| (y + 16.0) / 116.0).collect();
    let magnitude = |derivative: &[f32]| {
        let along_x = convolve(&luminance, image.width, derivative, &smooth);
        let along_y = convolve(&luminance, image.width, &smooth, derivative);
        along_x.into_iter().zip(along_y).map(|(x, y)| x.hypot(y)).collect::<Plane>()
    };
    magnitude(&first).into_iter().zip(magnitude(&second)).map(|(edge, point)| [edge, point]).collect()
}

/// 4. The difference of the strength of edges and points in two images at a pixel. Section 4.2.
fn feature_difference(a: [f32; 2], b: [f32; 2]) -> f32 {
    let greatest = (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
    (greatest * std::f32::consts::FRAC_1_SQRT_2).sqrt()
}

/// Samples a function at the integers from `-radius` to `radius`.
fn kernel(radius: f32, weight: impl Fn(f32) -> f32) -> Vec<f32> {
    let radius = radius as i32;
    (-radius..=radius).map(|x| weight(x as f32)).collect()
}

/// Scales the weights to a sum of 1.
fn normalized(kernel: Vec<f32>) -> Vec<f32> {
    let sum: f32 = kernel.iter().sum();
    kernel.into_iter().map(|w| w / sum).collect()
}

/// Scales the positive weights to a sum of 1 and the negative ones to -1.
fn normalized_by_sign(kernel: Vec<f32>) -> Vec<f32> {
    let positive: f32 = kernel.iter().filter(|w| **w > 0.0).sum();
    let negative: f32 = kernel.iter().filter(|w| **w < 0.0).sum();
    kernel.into_iter().map(|w| if w > 0.0 { w / positive } else { -w / negative }).collect()
}

/// Convolves rows with one kernel and columns with another. Beyond its borders, the image continues with the border's
/// values.
fn convolve(plane: &Plane, width: usize, along_x: &[f32], along_y: &[f32]) -> Plane {
    let height = plane.len() / width;
    let clamped = |position: usize, offset: usize, kernel: &[f32], len: usize| {
        (position + offset).saturating_sub(kernel.len() / 2).min(len - 1)
    };
    let mut rows = Plane::with_capacity(plane.len());
    for row in plane.chunks_exact(width) {
        rows.extend(
            (0..width)
                .map(|x| along_x.iter().enumerate().map(|(i, w)| w * row[clamped(x, i, along_x, width)]).sum::<f32>()),
        );
    }
    let mut result = Plane::with_capacity(plane.len());
    for y in 0..height {
        result.extend((0..width).map(|x| {
            along_y.iter().enumerate().map(|(i, w)| w * rows[clamped(y, i, along_y, height) * width + x]).sum::<f32>()
        }));
    }
    result
}

fn linear_from_srgb(encoded: f32) -> f32 {
    if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: u32 = 48;

    /// Ramps under a checkerboard, 48 by 36.
    fn pattern() -> Vec<[u8; 4]> {
        let pixel = |x: u32, y: u32| {
            let checker = if (x / 8 + y / 8).is_multiple_of(2) { 200 } else { 40 };
            [(x * 5 % 256) as u8, (y * 7 % 256) as u8, checker, 255]
        };
        (0..36).flat_map(|y| (0..WIDTH).map(move |x| pixel(x, y))).collect()
    }

    /// Pixels of the same pairs of images compared by the authors' C++ program (as packaged by the crate nv-flip
    /// 0.1.2).
    #[track_caller]
    fn assert_like_the_authors(test: &[[u8; 4]], pixels_per_degree: f32, mean: f32, samples: [(usize, f32); 3]) {
        let errors = flip(WIDTH, &pattern(), test, pixels_per_degree).unwrap();
        let ours = errors.iter().sum::<f32>() / errors.len() as f32;
        assert!((ours - mean).abs() < 1e-5, "mean {ours}, not {mean}");
        for (i, expected) in samples {
            assert!((errors[i] - expected).abs() < 2e-5, "pixel {i}: {}, not {expected}", errors[i]);
        }
    }

    #[test]
    fn a_shift_by_one_pixel_is_as_the_authors_say() {
        let shifted: Vec<_> =
            pattern().chunks(WIDTH as usize).flat_map(|row| row[1..].iter().chain(row.last())).copied().collect();
        let samples = [(0, 0.019_816_127), (777, 0.050_398_763), (1700, 0.104_989_43)];
        assert_like_the_authors(&shifted, PIXELS_PER_DEGREE, 0.134_837, samples);
    }

    #[test]
    fn inverted_blue_is_as_the_authors_say_at_two_distances() {
        let inverted: Vec<_> = pattern().into_iter().map(|[r, g, b, a]| [r, g, 255 - b, a]).collect();
        let near = [(0, 0.857_469_14), (777, 0.388_812_24), (1700, 0.664_577_1)];
        assert_like_the_authors(&inverted, PIXELS_PER_DEGREE, 0.493_014, near);
        let far = [(0, 0.860_849_56), (777, 0.603_443_7), (1700, 0.952_661_4)];
        assert_like_the_authors(&inverted, 30.0, 0.720_131, far);
    }

    #[test]
    fn equal_images_do_not_differ_and_black_differs_from_white() {
        assert!(flip(WIDTH, &pattern(), &pattern(), PIXELS_PER_DEGREE).unwrap().iter().all(|&e| e == 0.0));
        let errors = flip(4, &[[0; 4]; 16], &[[255; 4]; 16], PIXELS_PER_DEGREE).unwrap();
        assert!(errors.iter().all(|e| (e - 0.967_391_85).abs() < 1e-5), "{errors:?}");
    }

    #[test]
    fn images_that_cannot_be_compared_are_errors() {
        let pixels = [[0; 4]; 6];
        assert!(flip(3, &pixels, &pixels[..3], PIXELS_PER_DEGREE).is_err());
        assert!(flip(4, &pixels, &pixels, PIXELS_PER_DEGREE).is_err());
        assert!(flip(0, &pixels, &pixels, PIXELS_PER_DEGREE).is_err());
        assert!(flip(3, &[], &[], PIXELS_PER_DEGREE).is_err());
        assert!(flip(3, &pixels, &pixels, f32::NAN).is_err());
    }
}
