//! Cameras: the projections of glTF, and lens shift.

use glam::Vec2;
use serde::{Deserialize, Serialize};

/// A camera at its node's origin that looks along the node's -Z axis with +Y up.
///
/// Ray tracing needs no clip planes: whatever is in front of the camera is seen.
///
/// **Lens shift** moves the image over the plane that it is seen in without turning the camera, as a view camera's lens does:
/// verticals stay vertical, and the tiles of a large image fit. It is in units of half the image's width and height: at
/// (1, 0) the image's centre is where its right edge was, at (0, -1) where its lower edge was. These are the numbers that an
/// off-centre frustum has in its projection matrix, (right + left) / (right - left) and (top + bottom) / (top - bottom);
/// Unity's lens shift is half of them.
///
/// ```
/// use ropewalk::Camera;
/// use ropewalk::glam::Vec2;
///
/// // Looks level at a tower, and sees it up to its top.
/// let camera = Camera::perspective(0.8).shifted(Vec2::new(0.0, 0.6));
/// assert_eq!(camera.shift(), Vec2::new(0.0, 0.6));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Camera {
    /// Objects shrink with distance.
    Perspective {
        /// Vertical field of view, in radians, above 0 and below pi.
        y_fov: f32,
        /// Width over height; `None` for the image's. Where the image's differs, the whole field stays visible.
        aspect: Option<f32>,
        /// Lens shift, in half widths and half heights of the image; any finite numbers.
        shift: Vec2,
    },
    /// Objects keep their size.
    Orthographic {
        /// Half the width seen, in the scene's unit of length.
        x_mag: f32,
        /// Half the height seen.
        y_mag: f32,
        /// Lens shift, in half widths and half heights of the image; any finite numbers.
        shift: Vec2,
    },
}

impl Camera {
    /// Objects shrink with distance. `y_fov` is the vertical field of view in radians; no shift, the image's aspect.
    pub fn perspective(y_fov: f32) -> Self {
        Self::Perspective { y_fov, aspect: None, shift: Vec2::ZERO }
    }

    /// Objects keep their size. Sees `x_mag` to either side and `y_mag` up and down; no shift.
    pub fn orthographic(x_mag: f32, y_mag: f32) -> Self {
        Self::Orthographic { x_mag, y_mag, shift: Vec2::ZERO }
    }

    /// The same camera with another lens shift.
    #[must_use]
    pub fn with_lens_shift(mut self, by: Vec2) -> Self {
        match &mut self {
            Self::Perspective { shift, .. } | Self::Orthographic { shift, .. } => *shift = by,
        }
        self
    }

    /// The lens shift, in half widths and half heights of the image.
    pub fn shift(&self) -> Vec2 {
        match *self {
            Self::Perspective { shift, .. } | Self::Orthographic { shift, .. } => shift,
        }
    }

    /// Checks that its numbers are in their ranges.
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) names the first that is not.
    pub fn validate(&self) -> crate::Result<()> {
        super::value_checks::check_camera(self)
    }
}

impl Default for Camera {
    /// A perspective camera that sees 45 degrees from top to bottom.
    fn default() -> Self {
        Self::perspective(std::f32::consts::FRAC_PI_4)
    }
}
