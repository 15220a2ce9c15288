//! The CPU executors make the same image, pixel for pixel, whatever its size.

#![allow(clippy::panic, clippy::unwrap_used, reason = "a test fails by panicking")]

use bytemuck::Zeroable as _;
use glam::DAffine3;
use ropewalk::Error;
use ropewalk::device::Needs;
use ropewalk::device::layout::{FrameParams, LIGHT_DIRECTIONAL, LightRecord};
use ropewalk::image::Image;
use ropewalk::trace::{Cpu, Emulated, FrameRequest, Recursive, Tracer};
use ropewalk_testkit::{Mesh, Placed, arrays};

/// A frame seen from z = 4 towards the origin, under a white sky.
fn request(width: u32, height: u32, aovs: bool) -> FrameRequest {
    let mut params = FrameParams::zeroed();
    params.max_rays = 1024;
    params.eye = [0.0, 0.0, 4.0];
    params.width = width;
    params.right = [0.5, 0.0, 0.0];
    params.height = height;
    params.up = [0.0, 0.5, 0.0];
    params.max_depth = 3;
    params.forward = [0.0, 0.0, -1.0];
    params.sky_zenith = [1.0; 3];
    params.sky_horizon = [1.0; 3];
    params.sky_ground = [1.0; 3];
    params.sky_up = [0.0, 1.0, 0.0];
    params.ray_mask = 1;
    FrameRequest::new(params, Needs::empty()).with_aovs(aovs)
}

fn sun(direction: [f32; 3]) -> LightRecord {
    let mut light = LightRecord::zeroed();
    (light.kind, light.direction, light.color) = (LIGHT_DIRECTIONAL, direction, [1.0; 3]);
    light
}

/// A bumpy ball whose material is half glass, under a light from above.
fn images(request: &FrameRequest) -> [Image; 3] {
    let mut arrays = arrays(&[Mesh::displaced_icosphere(3)], &[Placed::new(0, DAffine3::IDENTITY)]);
    let mut glass = arrays.materials[0];
    (glass.transmission, glass.roughness) = (0.5, 0.0);
    arrays.materials.replace(&[glass]);
    arrays.lights.replace(&[sun([0.0, -1.0, 0.0])]);
    let mut tracers: [Box<dyn Tracer>; 3] =
        [Box::new(Emulated::default()), Box::new(Cpu::default()), Box::new(Recursive::default())];
    tracers.each_mut().map(|tracer| {
        tracer.upload(&mut arrays).unwrap();
        tracer.render(&arrays, request).unwrap();
        tracer.read_image().unwrap()
    })
}

#[test]
fn images_are_equal_whether_tiles_fit_or_not() {
    for (width, height) in [(1, 1), (16, 16), (32, 16), (37, 19), (100, 3), (15, 50)] {
        let mut frame = request(width, height, true);
        frame.params.light_count = 1;
        let [emulated, cpu, recursive] = images(&frame);
        assert_eq!(emulated.color.len(), (width * height) as usize);
        assert_eq!(emulated, cpu, "{width} x {height}");
        assert_eq!(emulated, recursive, "{width} x {height}");
    }
}

#[test]
fn aovs_tell_what_was_met() {
    for image in images(&request(32, 32, true)) {
        let aovs = image.aovs.expect("they were asked for");
        let (corner, middle) = (0, 16 * 32 + 16);
        assert_eq!(aovs.depth[corner], f32::INFINITY);
        assert_eq!((aovs.node[corner], aovs.triangle[corner]), (Default::default(), u32::MAX));
        assert!((2.0..4.0).contains(&aovs.depth[middle]) && aovs.normal[middle][2] > 0.0);
        assert!(aovs.node[middle] != Default::default() && aovs.triangle[middle] < 1280);
    }
    assert!(images(&request(8, 8, false)).iter().all(|image| image.aovs.is_none()));
}

#[test]
fn the_rays_of_a_frame_are_counted() {
    let mut arrays = arrays(&[Mesh::displaced_icosphere(3)], &[Placed::new(0, DAffine3::IDENTITY)]);
    arrays.lights.replace(&[sun([0.0, 0.0, -1.0])]);
    let mut frame = request(32, 32, true);
    let mut emulated = Emulated::default();
    emulated.render(&arrays, &frame).unwrap();
    let depth = emulated.read_image().unwrap().aovs.unwrap().depth;
    let first_hits = depth.iter().filter(|depth| depth.is_finite()).count() as u64;

    let unlit = emulated.count_frame(&arrays, &frame);
    assert_eq!((unlit.radiance_rays, unlit.primary_hits, unlit.shadow_rays), (1024, first_hits, 0));
    frame.params.light_count = 1;
    let lit = emulated.count_frame(&arrays, &frame);
    assert_eq!((lit.radiance_rays, lit.primary_hits), (1024, first_hits));
    // No shadow rays start from facets that the light only grazes.
    assert!((first_hits * 9 / 10..=first_hits).contains(&lit.shadow_rays), "{lit:?}");
    assert!(unlit.cost.nodes > 1024 && lit.cost.nodes > unlit.cost.nodes && lit.cost.triangles > unlit.cost.triangles);
}

#[test]
fn frames_without_pixels_are_empty() {
    for (width, height) in [(0, 0), (0, 7), (7, 0)] {
        let [emulated, cpu, recursive] = images(&request(width, height, true));
        assert!(emulated.color.is_empty());
        assert_eq!(emulated, cpu);
        assert_eq!(emulated, recursive);
    }
}

#[test]
fn frames_too_large_are_refused_before_anything_is_allocated() {
    let arrays = arrays(&[Mesh::cube()], &[Placed::new(0, DAffine3::IDENTITY)]);
    let mut tracers: [Box<dyn Tracer>; 3] =
        [Box::new(Emulated::default()), Box::new(Cpu::default()), Box::new(Recursive::default())];
    for tracer in &mut tracers {
        for (width, height) in [(u32::MAX, u32::MAX), (1 << 15, 1 << 14), (u32::MAX, 1)] {
            let error = tracer.render(&arrays, &request(width, height, false));
            assert!(matches!(error, Err(Error::Limit { .. })), "{width} x {height}");
        }
    }
}
