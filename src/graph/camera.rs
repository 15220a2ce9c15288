//! Cameras: the projections of glTF.

use serde::{Deserialize, Serialize};

/// A camera at its node's origin that looks along the node's -Z axis with +Y up.
///
/// Ray tracing needs no clip planes: whatever is in front of the camera is seen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Camera {
    /// Objects shrink with distance.
    Perspective {
        /// Vertical field of view, in radians, above 0 and below pi.
        y_fov: f32,
        /// Width over height; `None` for the image's. Where the image's differs, the whole field stays visible.
        aspect: Option<f32>,
    },
    /// Objects keep their size.
    Orthographic {
        /// Half the width seen, in the scene's unit of length.
        x_mag: f32,
        /// Half the height seen.
        y_mag: f32,
    },
}

impl Camera {
    /// Checks that its numbers are in their ranges.
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) names the first that is not.
    pub fn validate(&self) -> crate::Result<()> {
        super::ranges::check_camera(self)
    }
}

impl Default for Camera {
    /// A perspective camera that sees 45 degrees from top to bottom.
    fn default() -> Self {
        Self::Perspective { y_fov: std::f32::consts::FRAC_PI_4, aspect: None }
    }
}
