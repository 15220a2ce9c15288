//! The viewpoint that a compile depends on: levels of detail, billboards and the render origin follow it.

use glam::{DAffine3, DVec3};

/// A viewpoint: levels of detail and billboards are chosen for it, and f32 positions are most precise near it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    /// Its position, in world space.
    pub eye: DVec3,
    /// The up direction of its image, in world space; unit length.
    pub up: DVec3,
    /// The height of its image, in world units.
    pub height: ViewHeight,
}

/// The height of an image, in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ViewHeight {
    /// A perspective camera: this many times the distance from the eye, 2 tan(vertical fov / 2).
    Perspective(f64),
    /// An orthographic camera: this height, at any distance.
    Orthographic(f64),
}

impl Viewpoint {
    /// The projected diameter of a sphere as a fraction of the image's height.
    pub(super) fn projected_size(&self, center: DVec3, radius: f64) -> f64 {
        let height = match self.height {
            ViewHeight::Perspective(factor) => factor * center.distance(self.eye),
            ViewHeight::Orthographic(height) => height,
        };
        2.0 * radius / height
    }
}

impl From<DVec3> for Viewpoint {
    /// A perspective viewpoint with a vertical field of view of 45 degrees and +Y up.
    fn from(eye: DVec3) -> Self {
        let factor = 2.0 * (std::f64::consts::FRAC_PI_8).tan();
        Self { eye, up: DVec3::Y, height: ViewHeight::Perspective(factor) }
    }
}

/// The largest factor by which a matrix scales one of the axes: the length of its longest column.
pub(super) fn max_axis_scale(world: &DAffine3) -> f64 {
    (0..3).map(|axis| world.matrix3.col(axis).length()).fold(0.0, f64::max)
}
