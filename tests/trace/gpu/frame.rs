//! Frames: sizes, bands, textures that stay on the GPU, and images that are read back.

use ropewalk::device::Needs;
use ropewalk::error::Resource;
use ropewalk::graph::NodeKey;
use ropewalk::trace::{Emulated, FrameRequest, Tracer as _};
use ropewalk::{Error, image::Image};

use super::device::limited;
use super::soup::{params, soup};
use ropewalk_testkit::Random;
use ropewalk_testkit::gpu::tracer;

pub(crate) fn request(width: u32, height: u32, aovs: bool) -> FrameRequest {
    FrameRequest::new(params(width, height), Needs::empty()).with_aovs(aovs)
}

#[test]
fn frames_of_any_size_are_read_whole() {
    let Some(mut tracer) = tracer() else { return };
    let mut arrays = soup(20, &mut Random::new(1));
    tracer.upload(&mut arrays).unwrap();
    // One pixel; rows that are padded when they are read; rows without padding; several bands, of which the last is not
    // full.
    for (width, height) in [(1, 1), (7, 3), (64, 20), (1001, 555)] {
        for aovs in [false, true] {
            let request = request(width, height, aovs);
            tracer.render(&arrays, &request).unwrap();
            compare(&tracer.read_image().unwrap(), &emulated(&arrays, &request));
        }
    }
}

#[test]
fn a_frame_without_pixels_is_empty() {
    let Some(mut tracer) = tracer() else { return };
    let mut arrays = soup(2, &mut Random::new(2));
    tracer.upload(&mut arrays).unwrap();
    tracer.render(&arrays, &request(8, 8, false)).unwrap();
    for (width, height) in [(0, 0), (0, 5), (5, 0)] {
        tracer.render(&arrays, &request(width, height, true)).unwrap();
        let image = tracer.read_image().unwrap();
        assert_eq!((image.width, image.height, image.color.len()), (width, height, 0));
        assert!(image.aovs.is_some_and(|aovs| aovs.depth.is_empty()));
        assert!(tracer.texture().is_none());
    }
}

#[test]
fn misses_have_no_node_and_no_end() {
    let Some(mut tracer) = tracer() else { return };
    let mut arrays = soup(1, &mut Random::new(3));
    tracer.upload(&mut arrays).unwrap();
    tracer.render(&arrays, &request(64, 64, true)).unwrap();
    let aovs = tracer.read_image().unwrap().aovs.unwrap();
    let missed = |i: &usize| aovs.triangle[*i] == u32::MAX;
    let misses: Vec<usize> = (0..64 * 64).filter(missed).collect();
    assert!(!misses.is_empty() && misses.len() < 64 * 64);
    for i in misses {
        assert_eq!((aovs.depth[i], aovs.node[i], aovs.normal[i]), (f32::INFINITY, NodeKey::default(), [0.0; 3]));
    }
}

#[test]
fn images_larger_than_a_texture_are_refused() {
    let Some(mut tracer) = limited(|limits| limits.max_texture_dimension_2d = 256) else { return };
    let mut arrays = soup(1, &mut Random::new(4));
    tracer.upload(&mut arrays).unwrap();
    tracer.render(&arrays, &request(256, 256, false)).unwrap();
    for (size, expected) in [((257, 4), Resource::ImageWidth), ((4, 300), Resource::ImageHeight)] {
        let error = tracer.render(&arrays, &request(size.0, size.1, false)).unwrap_err();
        assert!(matches!(error, Error::Limit { resource, limit: 256, .. } if resource == expected), "{error}");
    }
    assert!(tracer.render(&arrays, &request(u32::MAX, u32::MAX, false)).is_err());
    tracer.render(&arrays, &request(8, 8, false)).unwrap();
    assert_eq!(tracer.read_image().unwrap().color.len(), 64);
}

#[test]
fn the_texture_for_a_window_holds_the_frame() {
    let Some(mut tracer) = tracer() else { return };
    let mut arrays = soup(20, &mut Random::new(5));
    tracer.upload(&mut arrays).unwrap();
    assert!(tracer.texture().is_none());
    tracer.render(&arrays, &request(40, 30, false)).unwrap();
    let texture = tracer.texture().unwrap();
    assert_eq!((texture.width(), texture.height(), texture.format()), (40, 30, wgpu::TextureFormat::Rgba32Float));
    assert!(texture.usage().contains(wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_SRC));
    let texture = texture.clone();
    tracer.render(&arrays, &request(40, 30, false)).unwrap();
    assert_eq!(tracer.texture().unwrap(), &texture, "a frame of the same size is made in the same texture");
}

#[test]
fn a_kernel_is_compiled_once_for_each_set_of_needs() {
    let Some(mut tracer) = tracer() else { return };
    let mut arrays = soup(2, &mut Random::new(6));
    tracer.upload(&mut arrays).unwrap();
    for _ in 0..3 {
        tracer.render(&arrays, &request(8, 8, false)).unwrap();
        tracer.render(&arrays, &FrameRequest::new(params(8, 8), Needs::CULLING)).unwrap();
    }
    assert_eq!(tracer.pipeline_count(), 2);
}

#[test]
fn the_time_of_a_frame_is_the_gpus() {
    let Some(mut tracer) = tracer() else { return };
    assert_eq!(tracer.trace_time(), None);
    let mut arrays = soup(20, &mut Random::new(7));
    tracer.upload(&mut arrays).unwrap();
    tracer.render(&arrays, &request(600, 600, false)).unwrap();
    let has_timestamps = tracer.wgpu_device().features().contains(wgpu::Features::TIMESTAMP_QUERY);
    assert_eq!(tracer.trace_time().is_some(), has_timestamps);
    assert!(tracer.trace_time().is_none_or(|time| !time.is_zero()));
}

fn emulated(arrays: &ropewalk::device::DeviceArrays, request: &FrameRequest) -> Image {
    let mut emulated = Emulated::default();
    emulated.render(arrays, request).unwrap();
    emulated.read_image().unwrap()
}

/// Asserts that two images show the same, pixel by pixel.
fn compare(found: &Image, expected: &Image) {
    assert_eq!((found.width, found.height), (expected.width, expected.height));
    assert_eq!(found.color.len(), (found.width * found.height) as usize);
    assert_eq!(found.aovs.is_some(), expected.aovs.is_some());
    for (i, (found, expected)) in found.color.iter().zip(&expected.color).enumerate() {
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() <= 1e-3 * expected.abs().max(1.0), "pixel {i}: {found} for {expected}");
        }
    }
    let (Some(found), Some(expected)) = (&found.aovs, &expected.aovs) else { return };
    assert_eq!(found.node, expected.node);
    assert_eq!(found.triangle, expected.triangle);
    for (found, expected) in found.depth.iter().zip(&expected.depth) {
        assert!(found == expected || (found - expected).abs() <= 1e-4 * expected.abs(), "{found} for {expected}");
    }
}
