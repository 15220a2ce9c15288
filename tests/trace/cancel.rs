//! Frames and batches of rays that are cancelled, by every executor.

#![allow(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use bytemuck::Zeroable as _;
use glam::DAffine3;
use ropewalk::device::Needs;
use ropewalk::device::layout::{FrameParams, RayRecord};
use ropewalk::trace::FrameRequest;
use ropewalk::{Cancel, Error, Result};
use ropewalk_testkit::{Mesh, Placed, arrays, tracers};

/// A frame of a ball seen from z = 4, of more than one dispatch on a GPU.
fn request([width, height]: [u32; 2]) -> FrameRequest {
    let mut params = FrameParams::zeroed();
    params.max_rays = 1024;
    (params.width, params.height, params.ray_mask) = (width, height, 1);
    params.eye = [0.0, 0.0, 4.0];
    (params.right, params.up, params.forward) = ([0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, -1.0]);
    (params.sky_zenith, params.sky_up) = ([1.0; 3], [0.0, 1.0, 0.0]);
    FrameRequest::new(params, Needs::empty())
}

/// Makes the call with tokens that are cancelled after ever more checks, each time followed by one without, until one
/// is not cancelled; returns how many were.
fn cancel_everywhere<T: PartialEq>(mut call: impl FnMut(Option<Cancel>) -> Result<T>) -> usize {
    let expected = call(None).unwrap();
    let mut checks = 0;
    for cancelled in 0.. {
        match call(Some(Cancel::after_checks(checks))) {
            Ok(result) => {
                assert!(result == expected, "with a token");
                return cancelled;
            }
            Err(error) => assert_eq!(error, Error::Cancelled),
        }
        assert!(call(None).unwrap() == expected, "after one that was cancelled after {checks} checks");
        checks += 1 + checks / 4;
    }
    0
}

#[test]
fn after_a_call_that_was_cancelled_anywhere_the_next_one_is_as_ever() {
    let mut arrays = arrays(&[Mesh::displaced_icosphere(3)], &[Placed::new(0, DAffine3::IDENTITY)]);
    let rays: Vec<RayRecord> = (0..2000)
        .map(|i| RayRecord {
            origin: [i as f32 / 1000.0 - 1.0, 0.1, 4.0],
            t_min: 0.0,
            direction: [0.0, 0.0, -1.0],
            t_max: 100.0,
        })
        .collect();
    for mut tracer in tracers() {
        let name = tracer.device().clone();
        // A GPU traces 2^18 pixels a dispatch, and all rays of this batch in one.
        let is_gpu = name.executor == "gpu";
        let request = request(if is_gpu { [640, 480] } else { [64, 48] });
        tracer.upload(&mut arrays).unwrap();
        let frames = cancel_everywhere(|cancel| {
            tracer.set_cancel(cancel);
            let rendered = tracer.render(&arrays, &request);
            if rendered.is_err() {
                // There is no frame, neither the last one nor parts of two.
                assert!(tracer.read_image().is_ok_and(|image| image.color.is_empty()) || is_gpu);
            }
            rendered.and_then(|()| tracer.read_image()).map(|image| image.color)
        });
        assert!(frames > 1, "{name:?}: {frames}");
        let closest = cancel_everywhere(|cancel| {
            tracer.set_cancel(cancel);
            tracer.closest_hits(&arrays, &rays, 1)
        });
        let any = cancel_everywhere(|cancel| {
            tracer.set_cancel(cancel);
            tracer.any_hits(&arrays, &rays, 1)
        });
        assert!(closest.min(any) > usize::from(!is_gpu), "{name:?}: {closest}, {any}");
    }
}
