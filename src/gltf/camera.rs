//! Cameras.

use ::gltf::json;
use glam::Vec2;
use json::camera::Type;
use json::validation::Checked::{Invalid, Valid};

use super::warnings::Warnings;
use super::{Document, GltfFault, WarningKind};
use crate::Result;
use crate::graph::Camera;

/// The largest vertical field of view that is accepted, in radians: 179 degrees.
const MAX_Y_FOV: f32 = 179.0 / 180.0 * std::f32::consts::PI;

/// The camera with this index in the file; `None` if it is of a type that glTF does not define. The clip planes are not
/// used.
pub(super) fn convert(document: &Document, index: usize, warnings: &mut Warnings) -> Result<Option<Camera>> {
    // One that is no camera at all has been left out, with a warning.
    let Some(camera) = &document.cameras[index] else { return Ok(None) };
    let pointer = format!("/cameras/{index}");
    if camera.perspective.is_some() || camera.orthographic.is_some() {
        let fallback = "znear and zfar are not used: all that is in front of the camera is seen";
        warnings.add(document, WarningKind::Feature, "clip planes", &*pointer, fallback);
    }
    // Lengths, angles and ratios must be finite and above 0.
    let positive = |what: &'static str, value: f32| {
        let valid = value > 0.0 && value.is_finite();
        if valid {
            Ok(value)
        } else {
            Err(document.error_at(&*pointer, GltfFault::OutOfRange { what, value, expected: "finite and above 0" }))
        }
    };
    match (&camera.type_, &camera.perspective, &camera.orthographic) {
        (Valid(Type::Perspective), Some(perspective), _) => {
            let mut y_fov = positive("yfov", perspective.yfov)?;
            // Clamp a field of view that is too wide.
            if y_fov > MAX_Y_FOV {
                let fallback = format!("is {y_fov}, too wide to be seen: {MAX_Y_FOV} is used");
                warnings.add(document, WarningKind::Value, "yfov", &*pointer, fallback);
                y_fov = MAX_Y_FOV;
            }
            // Without an aspect ratio, the camera takes that of the image.
            let aspect = perspective.aspect_ratio.map(|aspect| positive("aspectRatio", aspect)).transpose()?;
            Ok(Some(Camera::Perspective { y_fov, aspect, shift: Vec2::ZERO }))
        }
        (Valid(Type::Orthographic), _, Some(orthographic)) => {
            let (x_mag, y_mag) = (orthographic.xmag, orthographic.ymag);
            // A negative magnitude would mirror the image; its sign is dropped.
            if x_mag < 0.0 || y_mag < 0.0 {
                let fallback = "not supported: the image is not mirrored";
                warnings.add(document, WarningKind::Feature, "negative xmag or ymag", &*pointer, fallback);
            }
            Ok(Some(Camera::orthographic(positive("xmag", x_mag.abs())?, positive("ymag", y_mag.abs())?)))
        }
        // A camera of a known type must have the properties of that type.
        (Valid(_), ..) => Err(document.error_at(pointer, GltfFault::NoProperties)),
        (Invalid, ..) => {
            warnings.add(document, WarningKind::Feature, "camera of unknown type", pointer, "left out");
            Ok(None)
        }
    }
}
