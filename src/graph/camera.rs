//! Cameras: the projections of glTF, and lens shift.

use glam::Vec2;
use serde::{Deserialize, Serialize};

/// A camera at its node's origin that looks along the node's -Z axis with +Y up.
///
/// There are no clip planes: everything in front of the camera is visible.
///
/// **Lens shift** translates the image within the image plane without rotating the camera, as a view camera does:
/// verticals stay parallel, and a large image can be rendered in tiles. Its unit is half the image's width and height:
/// at (1, 0) the image's centre is where its right edge was, at (0, -1) where its lower edge was. These are the numbers
/// that an off-centre frustum has in its projection matrix, (right + left) / (right - left) and (top + bottom) / (top -
/// bottom); Unity's lens shift is half of them.
///
/// ```
/// use ropewalk::Camera;
/// use ropewalk::glam::Vec2;
///
/// // A level camera in front of a tower, shifted so that the top is visible.
/// let camera = Camera::perspective(0.8).with_lens_shift(Vec2::new(0.0, 0.6));
/// assert_eq!(camera.shift(), Vec2::new(0.0, 0.6));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Camera {
    /// Perspective projection.
    Perspective {
        /// Vertical field of view, in radians, above 0 and below pi.
        y_fov: f32,
        /// Width over height; `None` for the image's. If the image's differs, the whole field of view stays visible.
        aspect: Option<f32>,
        /// Lens shift, in half widths and half heights of the image; any finite numbers.
        shift: Vec2,
    },
    /// Orthographic projection.
    Orthographic {
        /// Half the width of the view volume, in scene units (glTF `xmag`).
        x_mag: f32,
        /// Half the height of the view volume, in scene units (glTF `ymag`).
        y_mag: f32,
        /// Lens shift, in half widths and half heights of the image; any finite numbers.
        shift: Vec2,
    },
}

impl Camera {
    /// A perspective projection with the vertical field of view `y_fov` in radians, without shift, with the image's
    /// aspect.
    pub fn perspective(y_fov: f32) -> Self {
        Self::Perspective { y_fov, aspect: None, shift: Vec2::ZERO }
    }

    /// An orthographic projection of `x_mag` to either side and `y_mag` up and down, without shift.
    pub fn orthographic(x_mag: f32, y_mag: f32) -> Self {
        Self::Orthographic { x_mag, y_mag, shift: Vec2::ZERO }
    }

    /// A copy with another lens shift.
    #[must_use]
    pub fn with_lens_shift(mut self, lens_shift: Vec2) -> Self {
        match &mut self {
            Self::Perspective { shift, .. } | Self::Orthographic { shift, .. } => *shift = lens_shift,
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
    /// A perspective camera with a vertical field of view of 45 degrees.
    fn default() -> Self {
        Self::perspective(std::f32::consts::FRAC_PI_4)
    }
}
