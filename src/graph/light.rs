//! Punctual lights, as `KHR_lights_punctual` defines them.

use glam::Vec3;
use serde::{Deserialize, Serialize};

/// A light at its node's origin, directed along the node's -Z axis. The scale of its world transform is ignored.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Light {
    /// Point, spot or directional.
    pub kind: LightKind,
    /// Linear colour, multiplied with `intensity`.
    pub color: Vec3,
    /// Candela (point, spot) or lux (directional).
    pub intensity: f32,
    /// Cut-off distance in scene units (point, spot); unlimited if `None`.
    pub range: Option<f32>,
}

impl Light {
    /// A point light of this intensity in candela.
    pub fn point(color: Vec3, intensity: f32) -> Self {
        Self { kind: LightKind::Point, color, intensity, range: None }
    }

    /// A directional light, infinitely far away, of this illuminance in lux.
    pub fn directional(color: Vec3, intensity: f32) -> Self {
        Self { kind: LightKind::Directional, color, intensity, range: None }
    }
}

/// The kind of a light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum LightKind {
    /// Emits equally in all directions.
    Point,
    /// Emits in a cone around -Z.
    Spot {
        /// Half angle, in radians, inside which the intensity is full.
        inner_cone_angle: f32,
        /// Half angle, in radians, outside which the intensity is 0; at most pi / 2.
        outer_cone_angle: f32,
    },
    /// Infinitely far away, in the direction -Z.
    Directional,
}
