//! Who looks at a scene, as far as what is compiled depends on it.

use glam::{DAffine3, DVec3};

/// The eye that levels of detail and billboards are chosen for, and near which positions are exact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    /// Where it is, in the world.
    pub eye: DVec3,
    /// Which way is up in its image, in the world; of length 1.
    pub up: DVec3,
    /// How much of the world its image shows from bottom to top.
    pub height: ViewHeight,
}

/// How much of the world an image shows from bottom to top.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ViewHeight {
    /// This many times the distance: a perspective camera, 2 tan(fov / 2).
    Perspective(f64),
    /// This length, at any distance: an orthographic camera.
    Orthographic(f64),
}

impl Viewpoint {
    /// The share of the image's height that a sphere takes.
    pub(super) fn projected_size(&self, center: DVec3, radius: f64) -> f64 {
        let height = match self.height {
            ViewHeight::Perspective(factor) => factor * center.distance(self.eye),
            ViewHeight::Orthographic(height) => height,
        };
        2.0 * radius / height
    }
}

impl From<DVec3> for Viewpoint {
    /// An eye that sees 45 degrees, with +Y up.
    fn from(eye: DVec3) -> Self {
        let factor = 2.0 * (std::f64::consts::FRAC_PI_8).tan();
        Self { eye, up: DVec3::Y, height: ViewHeight::Perspective(factor) }
    }
}

/// The longest axis of a matrix.
pub(super) fn max_axis_scale(world: &DAffine3) -> f64 {
    (0..3).map(|axis| world.matrix3.col(axis).length()).fold(0.0, f64::max)
}
